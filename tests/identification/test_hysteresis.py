"""Friction, law and drift from loading and unloading curves of the simulated rig, whose truth is known."""

import dataclasses

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification import fit_law
from mckibben.identification.fit import warning_texts
from mckibben.identification.friction import identify_hysteresis
from mckibben.identification.friction_model import FRICTION, FrictionForm, PathDependentModel
from mckibben.identification.loading_path import DriftBasis, LoadingPaths
from mckibben.muscle import ExponentialLaw, MaxwellSlip, Muscle, forces
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar, mm

SPECIMEN, LAW = catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n")
MUSCLE = Muscle(SPECIMEN, LAW)
ABSENT = dict.fromkeys(FRICTION, 0.0)
PROTOCOL = IsobaricProtocol(pressures=np.arange(1, 7) * bar, step=2 * mm, repeats=2, samples=100)


def off(law):
    """RMSE of a law from the true one [N], over the taut domain."""
    contraction, pressure = np.meshgrid(np.linspace(0, 0.2, 21), np.linspace(1, 6, 6) * bar)
    true = forces(LAW, contraction, pressure)
    there = (true > 10) & (true < 600)
    return float(np.sqrt(np.mean((forces(law, contraction, pressure) - true)[there] ** 2)))


@pytest.fixture(scope="module")
def drifting():
    """Hysteresis, which grows with pressure, and a sensor that drifts."""
    friction = MaxwellSlip(10.0, 1.5 * mm, growth=1 / bar, reference_pressure=3.5 * bar)
    data = SimulatedIsobaricTest(Muscle(SPECIMEN, LAW, friction), force_drift=0.5).run(PROTOCOL, seed=1)
    return data, identify_hysteresis(ExponentialLaw, data)


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [{}, {"force_drift": -0.5, "force_wander": 0.1}])
def test_hysteresis_and_law_are_found_as_well_as_the_law_without(sensor):
    found = identify_hysteresis(ExponentialLaw, SimulatedIsobaricTest(MUSCLE, **sensor).run(PROTOCOL, seed=2))
    assert found.friction.half_width == pytest.approx(12, rel=2e-3)
    assert found.friction.presliding_length == pytest.approx(0.5 * mm, rel=0.1)
    assert found.friction.growth == 0.0 and np.isnan(found.standard_errors["growth"])
    clean = off(fit_law(ExponentialLaw, SimulatedIsobaricTest(MUSCLE, hysteresis=0).run(PROTOCOL, seed=2)).law)
    assert off(found.law) < 2.5 * clean < 0.05  # both are a few hundredths of a newton
    assert (found.drift is None) == (not sensor)


@pytest.mark.slow
def test_growth_and_drift_are_found_with_their_errors(drifting):
    _, found = drifting
    friction, errors = found.friction, found.standard_errors
    assert friction.reference_pressure == pytest.approx(3.5 * bar)
    for name, true in (("half_width", 10.0), ("growth", 1 / bar), ("presliding_length", 1.5 * mm)):
        assert abs(getattr(friction, name) - true) < 4 * errors[name] < 0.1 * true
    assert found.drift.rate * 3600 == pytest.approx(0.5, rel=0.1)
    for name, true in (("a2", LAW.a2), ("decay", LAW.decay)):
        assert abs(getattr(found.law, name) - true) < 4 * errors[name] < 0.1 * abs(true)
    assert not warning_texts(found.notes) and found.rmse < 0.12
    assert [name for name in errors if np.isnan(errors[name])] == ["tension_growth", "viscous", "viscous_asymmetry"]


@pytest.mark.slow
def test_the_parts_add_up_to_what_was_measured(drifting):
    data, found = drifting
    np.testing.assert_allclose(found.force + found.residuals, data.force, rtol=1e-12)
    np.testing.assert_allclose(found.tension, np.maximum(forces(found.law, data.contraction, data.pressure), 0))
    assert found.rmse == pytest.approx(np.sqrt(np.mean(found.residuals[~data.slack] ** 2)))
    assert found.used.all() and not found.points_left_out  # slack points tell the zero, and count
    assert found.points_slack == np.count_nonzero(data.slack)


@pytest.mark.slow
def test_a_static_fit_to_the_corrected_points_is_the_same_law(drifting):
    data, found = drifting
    assert off(fit_law(ExponentialLaw, data).law) > 0.5  # as they are, it is out by far
    assert off(fit_law(ExponentialLaw, found.corrected_points).law) < 1.5 * off(found.law) + 0.01


@pytest.mark.slow
def test_a_presliding_shorter_than_a_step_is_said_not_to_be_known():
    coarse = dataclasses.replace(PROTOCOL, step=5 * mm)
    found = identify_hysteresis(ExponentialLaw, SimulatedIsobaricTest(MUSCLE).run(coarse, seed=1))
    assert np.isnan(found.standard_errors["presliding_length"])
    assert found.friction.presliding_length <= 1.25 * mm  # a quarter of a step
    assert 0.5 * mm < found.undetermined["presliding_length"] < 2.5 * mm
    assert [note.field for note in found.notes] == ["presliding_length"]
    assert found.friction.half_width == pytest.approx(12, rel=5e-3)


@pytest.mark.slow
def test_data_that_cannot_tell_are_refused(drifting):
    data, _ = drifting
    direction = data.table["direction"].to_numpy()

    def refused(match, changed):
        with pytest.raises(IdentificationError, match=match):
            identify_hysteresis(ExponentialLaw, changed)

    refused("the dataset has loading alone", data.select(direction == "loading"))
    refused("the dataset has no directions", IsobaricDataset(data.table.drop_vars("direction")))
    nameless = data.table.copy()
    del nameless.attrs["initial_length"]
    refused("the initial length is unknown", IsobaricDataset(nameless))
    shuffled = np.random.default_rng(0).permutation(len(data))
    timeless = data.table.drop_vars("time")
    refused("paths at constant pressure|against the direction", IsobaricDataset(timeless.isel(point=shuffled)))
    refused("paths at constant pressure", IsobaricDataset(data.table.drop_vars("set_pressure")))
    by_length = np.lexsort([data.contraction, data.levels])
    refused("the direction changes .* times in .* moves", IsobaricDataset(timeless.isel(point=by_length)))
    refused("the data show no hysteresis", SimulatedIsobaricTest(MUSCLE, hysteresis=0).run(PROTOCOL, seed=1))


@pytest.mark.slow
def test_rows_may_be_in_any_order_where_there_are_times(drifting):
    data, found = drifting
    shuffled = np.random.default_rng(0).permutation(len(data))
    again = identify_hysteresis(ExponentialLaw, IsobaricDataset(data.table.isel(point=shuffled)))
    assert again.friction.half_width == pytest.approx(found.friction.half_width, rel=1e-6)
    np.testing.assert_allclose(again.residuals, found.residuals[shuffled], atol=1e-3)


@pytest.fixture(scope="module")
def model(drifting):
    data, _ = drifting
    strokes = LoadingPaths.of(data)
    line = DriftBasis.candidates(strokes, data)[1]
    rate = 2e-3 * np.sin(np.arange(len(data)))
    tension = np.maximum(forces(LAW, data.contraction, data.pressure), 0)
    return PathDependentModel(
        tension, strokes, data, line, np.ones(len(data), bool), np.ones(len(data)), 3 * bar, 200.0, rate
    )


@pytest.mark.slow
def test_the_force_along_the_way_is_that_of_the_rig(model):
    quiet = {"force_noise": 0, "pressure_noise": 0, "regulator_offset": 0}
    own = MaxwellSlip(9.0, 1 * mm, growth=1 / bar, reference_pressure=3 * bar)
    data = SimulatedIsobaricTest(Muscle(SPECIMEN, LAW, own), **quiet).run(PROTOCOL, seed=0)
    tension = np.maximum(forces(LAW, data.contraction, data.pressure), 0)
    exact = dataclasses.replace(model, tension=tension, paths=LoadingPaths.of(data), means=data, rate=None)
    friction = exact.force({**ABSENT, "half_width": 9.0, "growth": 1 / bar, "log_presliding": np.log(1e-3)})
    np.testing.assert_allclose(tension + friction, data.force, atol=1e-9)


def test_the_jacobian_is_that_of_small_changes(model):
    names = FRICTION
    values = {
        "half_width": 10.0,
        "growth": 1 / bar,
        "tension_growth": 0.01,
        "viscous": 500.0,
        "viscous_asymmetry": 0.3,
        "log_presliding": float(np.log(1.3e-3)),
    }
    offsets = np.linspace(0.2, 0.4, model.drift.points.shape[1])
    columns = model.jacobian(values, names)
    for k, name in enumerate(names):
        small = 1e-6 * max(abs(values[name]), 1e-9)
        up, down = ({**values, name: values[name] + sign * small} for sign in (1, -1))
        quotient = (model.residuals(up, offsets) - model.residuals(down, offsets)) / (2 * small)
        smooth = np.abs(columns[:, k] - quotient) < 1e-3 * np.abs(quotient).max()
        assert smooth.mean() > 0.98  # but at points where a slider just gives way
    drift = model.residuals(values, offsets + np.eye(len(offsets))[-1]) - model.residuals(values, offsets)
    np.testing.assert_allclose(columns[:, -1], drift, atol=1e-9)


@pytest.mark.parametrize("overshot", [True, False])
@pytest.mark.slow
def test_a_turning_point_measured_in_both_directions_may_have_been_passed(overshot):
    """Between its two rows the muscle went farther and came back, or it rested: the forces tell.

    Where it rested, noise of the length is not taken for a presliding length.
    """
    stroke, half_width, rows = np.linspace(0, 0.1, 12), 8.0, []
    for level in (4 * bar, 5 * bar, 6 * bar):
        out = [(level, eps, "unloading", -half_width) for eps in stroke]
        back = [(level, eps, "loading", half_width) for eps in stroke[::-1]]
        rows += [*out, *(back if overshot else [(level, stroke[-1], "loading", -half_width), *back[1:]])]
    pressure, contraction, direction, friction = (np.array(column) for column in zip(*rows, strict=True))
    rng = np.random.default_rng(0)
    force = forces(LAW, contraction, pressure) + friction + rng.normal(0, 0.2, len(friction))
    contraction = contraction + rng.normal(0, 1e-4, len(friction))
    data = IsobaricDataset.of(
        pressure=pressure, contraction=contraction, force=force, direction=direction, initial_length=0.25
    )
    found = identify_hysteresis(ExponentialLaw, data)
    assert found.friction.half_width == pytest.approx(half_width, abs=0.2)
    bound = found.undetermined["presliding_length"]
    assert np.isinf(bound) if overshot else found.friction.presliding_length < bound < 1 * mm
    assert found.rmse == pytest.approx(0.3, rel=0.3)
    assert fit_law(ExponentialLaw, found.corrected_points).rmse == pytest.approx(found.rmse, rel=0.3)


@pytest.mark.slow
def test_estimates_scatter_by_their_standard_errors_under_noise_of_the_length():
    """A wrong length at a reversal shifts all points of the next stroke."""
    protocol = dataclasses.replace(PROTOCOL, pressures=np.array([3.0, 4.0, 5.0]) * bar, step=0.4 * mm, samples=4)
    rig = SimulatedIsobaricTest(MUSCLE, presliding_length=0.8 * mm, regulator_offset=0.0)
    scores = []
    for seed in range(8):
        data = rig.run(protocol, seed=seed)
        noise = np.random.default_rng(seed).normal(0, 20e-6 / SPECIMEN.initial_length, len(data))
        noisy = IsobaricDataset(data.table.assign(contraction=data.table["contraction"] + noise))
        found = identify_hysteresis(ExponentialLaw, noisy, drift=False, form=FrictionForm.CONSTANT)
        scores.append((found.friction.presliding_length - 0.8 * mm) / found.standard_errors["presliding_length"])
    assert abs(np.mean(scores)) < 0.7
    assert 0.5 < np.std(scores) < 1.4
