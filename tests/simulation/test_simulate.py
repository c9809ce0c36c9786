"""Simulate: what it refuses, what it warns of, and that a controller knows its model and not the plant."""

import equinox as eqx
import jax
import numpy as np
import pytest

from mckibben import catalog
from mckibben.control import PID, Constant, PositionStiffnessControl, Reference, Sine
from mckibben.errors import RangeError, ReachabilityWarning, SimulationError, UnreachableError
from mckibben.muscle import Muscle
from mckibben.plant import PlantState
from mckibben.simulation import simulate
from mckibben.units import bar, deg

WISH = Reference(angle=Sine(10 * deg, 0.5), stiffness=Constant(15.0))


def control_of(model) -> PositionStiffnessControl:
    return PositionStiffnessControl(PID(2 * bar, 60 * bar, 0.4 * bar), PID(0.08 * bar, 5 * bar, 0.0), model=model)


@pytest.fixture(scope="module")
def control(knee):
    return control_of(knee)


@pytest.fixture(scope="module")
def other_knee(knee):
    """The same knee with muscles after the maker's chart, fitted: another law of the same kind."""
    from mckibben.identification import identify
    from mckibben.muscle import ExponentialLaw

    law = identify(ExponentialLaw, catalog.dataset("festo-tool-10mm")).law
    muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), law)
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
        simulate(plant, control, WISH, **times)
    for number in named:
        assert number in str(caught.value)
    assert caught.value.value == times["duration"]
    assert caught.value.unit == "s"


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
@pytest.mark.parametrize("name", ["duration", "control_period"])
def test_times_are_positive_and_finite(plant, control, name, bad):
    with pytest.raises(SimulationError, match=f"{name.replace('_', ' ')} is .*; give a positive time"):
        simulate(plant, control, WISH, **{name: bad})


@pytest.mark.parametrize("substeps", [0, -3])
def test_substeps_are_at_least_one(plant, control, substeps):
    with pytest.raises(SimulationError, match=f"{substeps} integration steps") as caught:
        simulate(plant, control, WISH, substeps=substeps)
    assert caught.value.value == substeps


def test_a_start_that_cannot_be_held_is_an_error(plant, control):
    heavy = eqx.tree_at(lambda p: p.load.mass2, plant, 50.0)
    with pytest.raises(UnreachableError, match="0 deg"):
        simulate(heavy, control, WISH, duration=0.2)
    far = Reference(angle=Constant(60 * deg), stiffness=Constant(15.0))
    with pytest.raises(RangeError, match=r"contraction -4\.6 % is outside -3\.\.25 % of MAS-10-180N"):
        simulate(plant, control, far, duration=0.2)


def test_the_same_inputs_give_the_same_run_and_stay_as_they_were(plant, control):
    before = jax.tree.map(np.array, eqx.filter((plant, control, WISH), eqx.is_inexact_array_like))
    one, two = (simulate(plant, control, WISH, duration=0.2, scenario="this") for _ in range(2))
    assert one.table.identical(two.table)
    after = jax.tree.map(np.array, eqx.filter((plant, control, WISH), eqx.is_inexact_array_like))
    jax.tree.map(np.testing.assert_array_equal, before, after)
    assert one.table.attrs["scenario"] == "this"
    assert one.table["time"].to_numpy() == pytest.approx(np.arange(200) * 1e-3)


def test_it_starts_at_rest_on_the_wish_unless_told(plant, control):
    shifted = Reference(angle=Constant(5 * deg), stiffness=Constant(15.0))
    table = simulate(plant, control, shifted, duration=0.2).table
    assert float(table["angle"][0]) == pytest.approx(5 * deg)
    assert float(table["velocity"][0]) == 0.0
    low, high = float(table["lowest_stiffness"][0]), float(table["highest_stiffness"][0])
    assert float(table["stiffness"][0]) == pytest.approx((low + high) / 2, rel=1e-6)  # affine: amid the co-contractions
    given = simulate(plant, control, shifted, duration=0.2, initial=PlantState(0.02, 0.3, (2e5, 2.5e5))).table
    for name, value in (("angle", 0.02), ("velocity", 0.3), ("pressure1", 2e5), ("pressure2", 2.5e5)):
        assert float(given[name][0]) == value


def test_a_start_in_whole_numbers_is_a_start(plant, control):
    whole = simulate(plant, control, WISH, duration=0.2, initial=PlantState(0, 0, (200_000, 200_000)))
    real = simulate(plant, control, WISH, duration=0.2, initial=PlantState(0.0, 0.0, (2e5, 2e5)))
    assert whole.table.identical(real.table)


def test_out_of_reach_is_a_warning_in_words(as_printed, load, plant, control):
    from mckibben.plant import IdealValve, JointPlant

    far = Reference(angle=Sine(20 * deg, 0.5), stiffness=Constant(72.5))
    with pytest.warns(ReachabilityWarning, match="no pressures within limits hold the desired angle") as caught:
        simulate(JointPlant(as_printed, load, IdealValve()), control_of(as_printed), far, duration=0.2)
    assert len([w for w in caught if w.category is ReachabilityWarning]) == 1
    assert caught[0].filename == __file__  # it points to the caller
    simulate(plant, control, WISH, duration=0.2)  # silent; a warning of ours would be an error here


def test_a_true_model_estimates_truly_and_a_wrong_one_wrongly(plant, knee, other_knee):
    true, wrong = (
        simulate(plant, control_of(model), WISH, duration=0.2, initial=PlantState(0.0, 0.0, (2.5e5, 2.5e5)))
        for model in (knee, other_knee)
    )
    assert true.metrics()["estimate_rmse"] < 1e-9
    assert wrong.metrics()["estimate_rmse"] > 0.1
    np.testing.assert_allclose(  # what it is wrong by is what the two models differ by
        wrong.table["stiffness_estimate"],
        other_knee.stiffness(
            wrong.table["angle"].to_numpy(), (wrong.table["pressure1"].to_numpy(), wrong.table["pressure2"].to_numpy())
        ),
        rtol=1e-9,
    )


def test_the_controller_does_not_see_the_plants_law(plant, control, other_knee):
    start = PlantState(0.01, 0.0, (2.5e5, 2.7e5))
    other = eqx.tree_at(lambda p: p.joint, plant, other_knee)
    one = simulate(plant, control, WISH, duration=0.2, initial=start).table
    two = simulate(other, control, WISH, duration=0.2, initial=start).table
    for name in ("command1", "command2", "stiffness_estimate"):
        assert float(one[name][0]) == float(two[name][0]), name
    assert float(one["stiffness"][0]) != pytest.approx(float(two["stiffness"][0]), rel=1e-3)
    assert not np.allclose(one["angle"][1:], two["angle"][1:], rtol=0, atol=1e-5)


def test_the_numbers_in_the_error_tell_the_two_apart(plant, control):
    with pytest.raises(SimulationError) as caught:
        simulate(plant, control, WISH, duration=10.0000005)
    assert "10.0000005" in str(caught.value)


def test_substeps_are_whole(plant, control):
    with pytest.raises(SimulationError):
        simulate(plant, control, WISH, duration=0.2, substeps=2.5)
