"""Forms of friction are chosen by held-out loops; only significant drifts."""

import numpy as np
import pytest

from mckibben import ExponentialLaw, IsobaricDataset, catalog, identify_hysteresis
from mckibben.errors import IdentificationError
from mckibben.identification import FrictionForm, fit_law
from mckibben.identification.loading_path import LoadingPaths
from mckibben.muscle import MaxwellSlip, forces
from mckibben.units import bar, mm

LAW = catalog.law("lei-mas-10-180n")
LENGTH = 180 * mm
WIDTH = 12.0  # N
HALF_WIDTHS = {
    "coulomb": lambda contraction, pressure, tension: WIDTH,
    "pressure": lambda contraction, pressure, tension: WIDTH * pressure / (3.5 * bar),
    "tension": lambda contraction, pressure, tension: 0.06 * tension,
}


DAMPING = {"viscous": (5e3, 5e3), "directional": (7e3, 3e3)}  # N*s/m, while it lengthens and shortens


def loops(kind, *, drift=0.0, noise=0.05, lowest=0.0, clipped=True):
    """Points of two repeats of loops at six pressures; drift in N/h, `lowest` tension [N] of a loop."""
    rng = np.random.default_rng(0)
    parts, start = [], 0.0
    for repeat in range(2):
        for number, pressure in enumerate(np.arange(1, 7) * bar):
            fine = np.linspace(-0.03, 0.25, 2000)
            below = forces(LAW, fine, pressure) <= lowest
            top = fine[np.argmax(below)] if lowest and below.any() else 0.25
            stroke = np.linspace(-0.03, top, round((top + 0.03) * LENGTH / (2 * mm)) + 1)
            contraction = np.concatenate([stroke, stroke[::-1][1:]])
            side = np.repeat([-1.0, 1.0], [len(stroke), len(stroke) - 1])
            tension = np.maximum(forces(LAW, contraction, pressure), 0)
            time = start + 7.0 * np.arange(len(contraction))
            if kind in DAMPING:  # the speed varies along a stroke, and from loop to loop
                speed = (
                    mm
                    * (1 + (repeat + number) % 2)
                    * (1 + 3 * np.sin(np.pi * (contraction + 0.03) / (top + 0.03)) ** 2)
                )
                steps = np.abs(np.diff(contraction)) * LENGTH / (0.5 * (speed[1:] + speed[:-1]))
                time = start + np.concatenate([[0.0], np.cumsum(steps)])
                damping = np.where(side > 0, *DAMPING[kind])
                friction = np.clip(damping * side * speed, -tension, tension)
            else:
                friction = side * np.minimum(HALF_WIDTHS[kind](contraction, pressure, tension), tension)
            force = tension + friction + noise * rng.standard_normal(len(time)) + drift / 3600 * time
            if clipped:
                force = np.where(tension > 0, np.maximum(force, 0), 0.0)
            direction = np.where(side > 0, "loading", "unloading")
            columns = (time, np.full(len(time), pressure), contraction, force, direction, np.full(len(time), repeat))
            parts.append(columns)
            start = time[-1] + 20
    names = ("time", "pressure", "contraction", "force", "direction", "repeat")
    joined = (np.concatenate(column) for column in zip(*parts, strict=True))
    return IsobaricDataset.of(**dict(zip(names, joined, strict=True)), initial_length=LENGTH)


def law_error(law):
    contraction, pressure = np.meshgrid(np.linspace(0, 0.2, 21), np.linspace(1, 6, 6) * bar)
    true = forces(LAW, contraction, pressure)
    known = (true > 10) & (true < 600)
    return float(np.sqrt(np.mean((forces(law, contraction, pressure) - true)[known] ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["coulomb", "pressure", "tension", *DAMPING])
def test_the_form_is_found_by_held_out_loops(kind):
    found = identify_hysteresis(ExponentialLaw, loops(kind))
    assert found.form is FrictionForm(kind)
    assert found.drift is None or abs(found.drift.rate) * 3600 < 0.5
    assert law_error(found.law) < (0.5 if kind in DAMPING else 0.3)
    expected = {
        "coulomb": (found.friction.half_width, WIDTH),
        "pressure": (found.friction.growth * bar, WIDTH / 3.5),
        "tension": (found.friction.tension_growth, 0.06),
        "viscous": (found.friction.viscous, 5e3),
        "directional": (found.friction.viscous_asymmetry, 0.4),
    }[kind]
    assert expected[0] == pytest.approx(expected[1], rel=0.05 if kind in DAMPING else 0.03)
    assert kind in found.verdict()


@pytest.mark.parametrize("drift", [-3.0, 3.0])
@pytest.mark.slow
def test_drift_of_a_load_cell_that_is_never_negative_does_not_ruin_the_law(drift):
    data = loops("coulomb", drift=drift)
    found = identify_hysteresis(ExponentialLaw, data)
    assert found.drift.rate * 3600 == pytest.approx(drift, rel=0.15)
    corrected = found.corrected_points
    assert corrected.slack[data.slack].all()
    assert law_error(fit_law(ExponentialLaw, corrected).law) < 0.4


@pytest.mark.slow
def test_a_form_that_the_data_do_not_determine_is_refused():
    data = loops("coulomb")
    with pytest.raises(IdentificationError, match="three pressures"):
        identify_hysteresis(ExponentialLaw, data.at([2 * bar, 4 * bar]), form=FrictionForm.PRESSURE)
    with pytest.raises(IdentificationError, match="speed"):
        identify_hysteresis(ExponentialLaw, data, form=FrictionForm.VISCOUS)


@pytest.mark.slow
def test_a_stop_and_go_recording_whose_samples_mostly_rest_has_rates():
    """Steps of 2 mm in 1 s, then 4 s of rest: most rates are 0."""
    rows, rng = [], np.random.default_rng(0)
    friction = MaxwellSlip(8.0, 0.5 * mm)
    for number, pressure in enumerate(np.arange(2, 6) * bar):
        stops = np.concatenate([np.arange(0, 31, 2), np.arange(28, -1, -2)]) * mm
        shortening = np.repeat(stops, 10)
        for k in range(1, len(stops)):  # two samples on the way
            shortening[10 * k : 10 * k + 2] = stops[k - 1] + (stops[k] - stops[k - 1]) * np.array([1 / 3, 2 / 3])
        contraction = shortening / LENGTH
        tension = np.maximum(forces(LAW, contraction, pressure), 0)
        force = tension + friction.path_response(LENGTH - shortening, tension, pressure, side=1.0)
        force = np.maximum(force + 0.2 * rng.standard_normal(len(force)), 0)
        time = 0.5 * np.arange(len(force)) + 1000.0 * number
        direction = np.where(np.arange(len(force)) < 160, "unloading", "loading")
        rows.append((time, np.full(len(force), pressure), contraction, force, direction))
    names = ("time", "pressure", "contraction", "force", "direction")
    columns = dict(zip(names, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    data = IsobaricDataset.of(**columns, initial_length=LENGTH, slack_force=2.0)
    assert np.median(np.abs(LoadingPaths.of(data).rate(data))) == 0.0
    found = identify_hysteresis(ExponentialLaw, data)
    assert found.friction.half_width == pytest.approx(8.0, rel=0.1)
