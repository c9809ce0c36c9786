"""Forms of friction: chosen by held-out loops, rejected where they lack something; only significant drifts."""

import dataclasses

import numpy as np
import pandas as pd
import pytest

from mckibben import ExponentialLaw, IsobaricDataset, catalog, identify, identify_hysteresis
from mckibben.errors import IdentificationError
from mckibben.identification import FrictionForm
from mckibben.identification.loading_path import LoadingPaths
from mckibben.muscle import MaxwellSlip, forces
from mckibben.units import bar, mm, percent

LAW = catalog.law("lei-mas-10-180n")
LENGTH = 180 * mm
WIDTH = 12.0  # N
HALF_WIDTHS = {
    "coulomb": lambda contraction, pressure, tension: WIDTH,
    "pressure": lambda contraction, pressure, tension: WIDTH * pressure / (3.5 * bar),
    "tension": lambda contraction, pressure, tension: 0.06 * tension,
    "contraction": lambda contraction, pressure, tension: WIDTH * (1 - contraction / 0.3),
}


def loops(kind, *, drift=0.0, noise=0.05, lowest=0.0, clipped=True):
    """Points of two repeats of loops at six pressures; drift in N/h, `lowest` tension [N] of a loop."""
    rng = np.random.default_rng(0)
    parts, start = [], 0.0
    for repeat in range(2):
        for pressure in np.arange(1, 7) * bar:
            fine = np.linspace(-0.03, 0.25, 2000)
            below = forces(LAW, fine, pressure) <= lowest
            top = fine[np.argmax(below)] if lowest and below.any() else 0.25
            stroke = np.linspace(-0.03, top, round((top + 0.03) * LENGTH / (2 * mm)) + 1)
            contraction = np.concatenate([stroke, stroke[::-1][1:]])
            side = np.repeat([-1.0, 1.0], [len(stroke), len(stroke) - 1])
            tension = np.maximum(forces(LAW, contraction, pressure), 0)
            time = start + 7.0 * np.arange(len(contraction))
            if kind == "viscous":  # the speed varies along a stroke
                speed = mm * (1 + 3 * np.sin(np.pi * (contraction + 0.03) / (top + 0.03)) ** 2)
                steps = np.abs(np.diff(contraction)) * LENGTH / (0.5 * (speed[1:] + speed[:-1]))
                time = start + np.concatenate([[0.0], np.cumsum(steps)])
                friction = np.clip(5e3 * side * speed, -tension, tension)
            else:
                friction = side * np.minimum(HALF_WIDTHS[kind](contraction, pressure, tension), tension / 2)
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
@pytest.mark.parametrize("kind", ["coulomb", "pressure", "tension", "viscous"])
def test_the_form_is_found_by_held_out_loops(kind):
    found = identify_hysteresis(ExponentialLaw, loops(kind))
    assert found.form is FrictionForm(kind)
    assert found.lack_of_fit is None
    assert found.drift is None or abs(found.drift.rate) * 3600 < 0.5
    assert law_error(found.law) < 0.3
    expected = {
        "coulomb": (found.friction.half_width, WIDTH),
        "pressure": (found.friction.growth * bar, WIDTH / 3.5),
        "tension": (found.friction.tension_growth, 0.06),
        "viscous": (found.friction.viscous, 5e3),
    }[kind]
    assert expected[0] == pytest.approx(expected[1], rel=0.03)
    assert kind in found.verdict()


@pytest.mark.parametrize(("given", "kind"), [("coulomb", "pressure"), ("coulomb", "tension"), ("constant", "viscous")])
@pytest.mark.slow
def test_a_wrong_form_is_rejected_and_another_offered(given, kind):
    found = identify_hysteresis(ExponentialLaw, loops(kind), form=FrictionForm(given))
    assert found.comparison is None
    assert found.lack_of_fit.remedy is not FrictionForm(given)
    assert found.lack_of_fit.p_value < 1e-3
    assert any("rejected" in warning for warning in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("few", [False, True])
def test_a_dependence_that_no_form_has_is_named(few):
    """Also by few paths, in which a growth with tension passes for it."""
    data = loops("contraction", noise=0.5)
    if few:
        data = data.select(data.table["repeat"].to_numpy() == 0).at(np.arange(3, 7) * bar)
    found = identify_hysteresis(ExponentialLaw, data)
    assert (found.lack_of_fit.quantity, found.lack_of_fit.remedy) == ("contraction", None)


@pytest.mark.parametrize("drift", [-3.0, 3.0])
@pytest.mark.slow
def test_drift_of_a_load_cell_that_is_never_negative_does_not_ruin_the_law(drift):
    data = loops("coulomb", drift=drift)
    found = identify_hysteresis(ExponentialLaw, data)
    assert found.drift.rate * 3600 == pytest.approx(drift, rel=0.15)
    corrected = found.corrected(data)
    assert corrected.slack[data.slack].all()
    assert law_error(identify(ExponentialLaw, corrected).law) < 0.4


@pytest.mark.slow
def test_there_is_no_drift_without_one():
    data = loops("coulomb", lowest=20.0)
    assert not data.slack.any()
    found = identify_hysteresis(ExponentialLaw, data)
    assert found.drift is None
    assert law_error(found.law) < 0.3


@pytest.mark.slow
def test_drift_may_be_left_out():
    found = identify_hysteresis(ExponentialLaw, loops("coulomb", drift=3.0, clipped=False), drift=False)
    assert found.drift is None
    assert not found.offset.any()


@pytest.mark.slow
def test_a_form_that_the_data_do_not_determine_is_refused():
    data = loops("coulomb")
    with pytest.raises(IdentificationError, match="three pressures"):
        identify_hysteresis(ExponentialLaw, data.at([2 * bar, 4 * bar]), form=FrictionForm.PRESSURE)
    with pytest.raises(IdentificationError, match="speed"):
        identify_hysteresis(ExponentialLaw, data, form=FrictionForm.VISCOUS)


FRICTION = MaxwellSlip(10.0, 0.5 * mm, growth=2 / bar, reference_pressure=3.5 * bar)
BY_RATE = {
    "pressure": FRICTION,
    "rate": dataclasses.replace(FRICTION, rate_growth=0.5, rate_speed=5 * mm),
}


def strokes(friction, more=None):
    """Points of sines of 9 mm at three rates and four pressures, from a recording."""
    rng, parts = np.random.default_rng(0), []
    sines = [np.pi * rate * np.arange(0, 1 / rate, 0.02) for rate in (0.03, 0.1, 0.3)]
    contraction = np.concatenate([0.08 - 0.05 * np.cos(2 * phase) for phase in sines])
    time, length = 0.02 * np.arange(len(contraction)), LENGTH * (1 - contraction)
    rate = np.gradient(length, time)
    for number, pressure in enumerate(np.arange(2, 6) * bar):
        tension = np.maximum(forces(LAW, contraction, pressure), 0)
        force = tension + friction.path_response(length, tension, pressure, side=1.0)
        force += np.asarray(friction.viscous_force(length, tension, pressure, rate))
        force += 0.0 if more is None else more(rate)
        force += 0.3 * rng.standard_normal(len(time))
        loading = np.gradient(contraction) < 0
        repeat = np.cumsum(np.diff(loading, prepend=loading[0]))
        travel = np.floor((contraction - contraction.min()) / (0.2 * percent))
        turns = np.flatnonzero(np.diff(repeat))
        travel[[0, *(turns + 1)]], travel[[*turns, -1]] = -1, -2  # where the friction reverses: not averaged
        clock = number * (time[-1] + 5) + time
        parts.append(
            np.column_stack([clock, np.full(len(time), pressure), force, contraction, loading, repeat, travel])
        )
    samples = pd.DataFrame(
        np.concatenate(parts), columns=["time", "pressure", "force", "contraction", "loading", "repeat", "travel"]
    )
    means = samples.groupby(["pressure", "repeat", "loading", "travel"]).mean().reset_index().sort_values("time")
    columns = {name: means[name].to_numpy() for name in ("time", "pressure", "force", "contraction")}
    return IsobaricDataset.of(
        **columns,
        set_pressure=columns["pressure"],
        repeat=means["repeat"].to_numpy(int),
        direction=np.where(means["loading"] > 0, "loading", "unloading"),
        initial_length=LENGTH,
        slack_force=1.0,
    )


@pytest.mark.filterwarnings("ignore::mckibben.errors.McKibbenWarning")  # fast strokes contradict slow ones
@pytest.mark.slow
@pytest.mark.parametrize("kind", list(BY_RATE))
def test_dependence_on_the_rate_is_identified_only_if_the_data_ask_for_it(kind):
    true = BY_RATE[kind]
    found = identify_hysteresis(ExponentialLaw, strokes(true))
    assert found.form is FrictionForm(kind) and found.lack_of_fit is None
    friction, errors = found.friction, found.standard_errors
    assert friction.growth == pytest.approx(true.growth, rel=0.03)
    assert friction.presliding_length == pytest.approx(true.presliding_length, rel=0.05)
    for name in ("rate_growth", "rate_speed"):
        assert (getattr(friction, name) is None) == (getattr(true, name) is None) == (not np.isfinite(errors[name]))
        if getattr(true, name) is not None:
            assert getattr(friction, name) == pytest.approx(getattr(true, name), rel=0.06)


@pytest.mark.filterwarnings("ignore::mckibben.errors.McKibbenWarning")  # fast strokes contradict slow ones
@pytest.mark.slow
def test_friction_of_another_dependence_on_the_rate_is_noticed():
    found = identify_hysteresis(ExponentialLaw, strokes(FRICTION, lambda rate: 1e5 * rate * np.abs(rate)))
    assert found.warnings and (found.lack_of_fit is None or "rate" in found.lack_of_fit.quantity)


def test_forms_that_need_rates_are_refused_without_them():
    data = loops("coulomb")
    for form in (FrictionForm.VISCOUS, FrictionForm.RATE):
        with pytest.raises(IdentificationError) as refused:
            identify_hysteresis(ExponentialLaw, data, form=form)
        assert form.value in str(refused.value)


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
