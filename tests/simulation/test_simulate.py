"""Simulate: what it refuses, what it warns of, and that a controller knows its model and not the plant."""

import warnings

import equinox as eqx
import jax
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import (
    CallError,
    McKibbenWarning,
    RangeError,
    ReachabilityWarning,
    SimulationError,
    UnreachableError,
)
from mckibben.plant import PlantState
from mckibben.units import bar, deg

REFERENCE = mk.Reference(angle=mk.Sine(10 * deg, 0.5), stiffness=mk.Constant(15.0))


def control_of(model) -> mk.PositionStiffnessControl:
    return mk.PositionStiffnessControl(
        mk.PID(2 * bar, 60 * bar, 0.4 * bar), mk.PID(0.08 * bar, 5 * bar, 0.0), model=model
    )


@pytest.fixture(scope="module")
def control(knee):
    return control_of(knee)


@pytest.fixture(scope="module")
def other_knee(knee):
    """The same knee with muscles after the maker's chart, fitted: another law of the same kind."""
    from mckibben.identification import fit_law
    from mckibben.muscle import ExponentialLaw

    law = fit_law(ExponentialLaw, mk.catalog.dataset("festo-tool-10mm")).law
    muscle = mk.Muscle(mk.catalog.specimen("MAS-10-180N-AA-MC-O"), law)
    return eqx.tree_at(lambda j: (j.muscle1, j.muscle2), knee, (muscle, muscle))


@pytest.mark.parametrize(
    ("times", "named"),
    [
        ({"duration": 0.1005}, ("0.1005 s", "0.001 s")),
        ({"duration": 1.0, "control_period": 0.3}, ("1 s", "0.3 s", "0.9 s")),
        ({"duration": 1e-4, "control_period": 1e-3}, ("0.0001 s", "0.001 s")),
    ],
)
def test_a_duration_of_no_whole_number_of_periods_names_both(plant, control, times, named):
    with pytest.raises(SimulationError) as caught:
        mk.simulate(plant, control, REFERENCE, **times)
    for number in named:
        assert number in str(caught.value)
    assert caught.value.value == times["duration"]
    assert caught.value.unit == "s"


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("name", ["duration", "control_period"])
def test_times_are_positive_and_finite(plant, control, name, bad):
    with pytest.raises(SimulationError, match=f"{name.replace('_', ' ')} is .*; give a positive time"):
        mk.simulate(plant, control, REFERENCE, **{name: bad})


@pytest.mark.parametrize("substeps", [0, -3, 2.5])
def test_substeps_are_at_least_one(plant, control, substeps):
    with pytest.raises(SimulationError, match=f"substeps is {substeps}") as caught:
        mk.simulate(plant, control, REFERENCE, substeps=substeps)
    assert caught.value.value == substeps


def test_much_memory_is_announced_before_the_run(plant, control):
    with pytest.warns(McKibbenWarning), pytest.raises(SimulationError):
        mk.simulate(plant, control, REFERENCE, duration=3600.0, substeps=0)


@pytest.mark.slow
def test_a_start_that_cannot_be_held_is_an_error(plant, control):
    heavy = eqx.tree_at(lambda p: p.load.mass2, plant, 50.0)
    with pytest.raises(UnreachableError, match="0 deg"):
        mk.simulate(heavy, control, REFERENCE, duration=0.2)
    far = mk.Reference(angle=mk.Constant(60 * deg), stiffness=mk.Constant(15.0))
    with pytest.raises(RangeError, match=r"contraction -4\.6 % is outside -3\.\.25 % of MAS-10-180N"):
        mk.simulate(plant, control, far, duration=0.2)


def test_the_same_inputs_give_the_same_run_and_stay_as_they_were(plant, control):
    before = jax.tree.map(np.array, eqx.filter((plant, control, REFERENCE), eqx.is_inexact_array_like))
    one, two = (mk.simulate(plant, control, REFERENCE, duration=0.2, scenario="this") for _ in range(2))
    assert one.to_dataset().identical(two.to_dataset())
    after = jax.tree.map(np.array, eqx.filter((plant, control, REFERENCE), eqx.is_inexact_array_like))
    jax.tree.map(np.testing.assert_array_equal, before, after)
    assert one.to_dataset().attrs["scenario"] == "this"
    assert one.times == pytest.approx(np.arange(200) * 1e-3)


def test_it_starts_at_rest_on_the_reference_unless_told(plant, control):
    shifted = mk.Reference(angle=mk.Constant(5 * deg), stiffness=mk.Constant(15.0))
    table = mk.simulate(plant, control, shifted, duration=0.2)
    assert float(table["angle"][0]) == pytest.approx(5 * deg)
    assert float(table["velocity"][0]) == 0.0
    low, high = float(table["lowest_stiffness"][0]), float(table["highest_stiffness"][0])
    assert float(table["stiffness"][0]) == pytest.approx((low + high) / 2, rel=1e-6)  # affine: amid the co-contractions
    given = mk.simulate(plant, control, shifted, duration=0.2, initial=PlantState(0.02, 0.3, (2e5, 2.5e5)))
    for name, value in (("angle", 0.02), ("velocity", 0.3), ("pressure1", 2e5), ("pressure2", 2.5e5)):
        assert float(given[name][0]) == value


def test_out_of_reach_is_a_warning_in_words(as_printed, load, plant, control):
    from mckibben.actuator import IdealValve

    far = mk.Reference(angle=mk.Sine(20 * deg, 0.5), stiffness=mk.Constant(72.5))
    with pytest.warns(ReachabilityWarning, match=r"cannot hold the desired angle .* is outside -3\.\.25 %") as caught:
        mk.simulate(mk.JointPlant(as_printed, load, IdealValve()), control_of(as_printed), far, duration=0.2)
    assert len([w for w in caught if w.category is ReachabilityWarning]) == 1
    assert caught[0].filename == __file__  # it points to the caller
    mk.simulate(plant, control, REFERENCE, duration=0.2)  # silent; a warning of ours would be an error here


@pytest.mark.slow
def test_a_true_model_estimates_truly_and_a_wrong_one_wrongly(plant, knee, other_knee):
    true, wrong = (
        mk.simulate(plant, control_of(model), REFERENCE, duration=0.2, initial=PlantState(0.0, 0.0, (2.5e5, 2.5e5)))
        for model in (knee, other_knee)
    )
    assert true.metrics["estimate_rmse"] < 1e-9
    assert wrong.metrics["estimate_rmse"] > 0.1
    np.testing.assert_allclose(  # what it is wrong by is what the two models differ by
        wrong["stiffness_estimate"],
        other_knee.stiffness(wrong["angle"], (wrong["pressure1"], wrong["pressure2"])),
        rtol=1e-9,
    )


@pytest.mark.parametrize("swap", [("plant", "controller"), ("controller", "reference")])
@pytest.mark.parametrize("run", [mk.simulate, mk.simulate_many])
def test_swapped_arguments_are_named(plant, control, swap, run):
    given = {"plant": plant, "controller": control, "reference": REFERENCE}
    given |= {name: given[other] for name, other in (swap, swap[::-1])}
    with pytest.raises(CallError, match="are arguments swapped") as caught:
        run(**given, duration=0.2)
    assert caught.value.field in swap


def test_an_initial_number_is_no_state(plant, control):
    with pytest.raises(CallError) as caught:
        mk.simulate(plant, control, REFERENCE, duration=0.2, initial=0.05)  # type: ignore[arg-type]
    assert (caught.value.field, caught.value.value) == ("initial", 0.05)


def test_a_signal_of_numpy_is_referred_to_jax(plant, control):
    for signal in (lambda t: 0.1 * np.sin(t), lambda t: 0.1 if t[0] > 1 else 0.0 * t):
        with pytest.raises(SimulationError, match=r"jax\.numpy"):
            mk.simulate(plant, control, mk.Reference(signal, 15.0), duration=0.2)


@pytest.mark.slow
def test_a_minimum_tension_that_the_stiffness_does_not_allow_is_said(plant, knee, load):
    reference = mk.Reference(0.0, 12.0)

    def run(tension):
        control = mk.DecouplingControl(
            knee, load, mk.PolePlacement(60.0), mk.ExtendedStateObserver(200.0), minimum_tension=tension
        )
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            mk.simulate(plant, control, reference, duration=0.02)
        found = [one for one in found if issubclass(one.category, ReachabilityWarning)]
        assert {one.filename for one in found} <= {__file__}
        return [str(one.message) for one in found]

    assert run(1.0) == []
    (text,) = run(100.0)
    assert "minimum tension of 100 N" in text


def test_gains_in_bar_are_warned_of(knee):
    loops = mk.PID(kp=2.0, ki=60.0, kd=0.05), mk.PID(kp=0.5, ki=20.0, kd=0.0)
    with pytest.warns(McKibbenWarning, match="2 \\* bar"):
        mk.PositionStiffnessControl(*loops, model=knee)
