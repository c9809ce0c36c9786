"""Tuning on a small budget: its cost is that of `simulate`, it never gets worse, and it repeats itself."""

import dataclasses
import math

import equinox as eqx
import numpy as np
import pytest

from mckibben.control import PID, Constant, PositionStiffnessControl, Reference, Sine, Step
from mckibben.simulation import simulate
from mckibben.study.tuning import Cost, tune_pid
from mckibben.units import bar, deg

WISHES = [
    Reference(angle=Sine(10 * deg, 0.5), stiffness=Constant(15.0)),
    Reference(angle=Constant(0.0), stiffness=Step(before=13.0, after=16.0, at=0.1)),
]
SCALES = Cost(angle_scale=0.1 * deg, stiffness_scale=0.1)
SMALL = {"duration": 0.2, "generations": 2, "population": 8, "control_period": 2e-3}
NAMES = ("kp", "ki", "kd")


@pytest.fixture(scope="module")
def control(knee):
    position, stiffness = PID(2 * bar, 60 * bar, 0.4 * bar), PID(0.08 * bar, 5 * bar, 0.0)
    return PositionStiffnessControl(position, stiffness, model=knee)


@pytest.fixture(scope="module")
def initial(plant):
    return plant.at_rest(0.0, stiffness=12.0)


@pytest.fixture(scope="module")
def progress():
    return []


@pytest.fixture(scope="module")
def tuned(plant, control, initial, progress):
    return tune_pid(plant, control, WISHES, SCALES, initial=initial, seed=3, progress=progress.append, **SMALL)


def cost_of(plant, control, initial, position, stiffness) -> float:
    """What `simulate` and its metrics say of the gains, or of all of them half as high again, whichever is worse."""
    raised = [
        eqx.tree_at(lambda p: (p.kp, p.ki, p.kd), x, (1.5 * x.kp, 1.5 * x.ki, 1.5 * x.kd))
        for x in (position, stiffness)
    ]
    return max(errors_of(plant, control, initial, *loops) for loops in ((position, stiffness), raised))


def errors_of(plant, control, initial, position, stiffness) -> float:
    chosen = dataclasses.replace(control, position=position, stiffness=stiffness)
    total = 0.0
    for wish in WISHES:
        found = simulate(plant, chosen, wish, duration=0.2, control_period=2e-3, initial=initial).metrics()
        total += found["angle_rmse"] / (0.1 * deg) + found["stiffness_rmse"] / 0.1
    return total


def test_the_cost_is_that_of_the_metrics_of_simulate(plant, control, initial, tuned):
    before = cost_of(plant, control, initial, control.position, control.stiffness)
    assert tuned.cost_before == pytest.approx(before, rel=1e-6)
    after = cost_of(plant, control, initial, tuned.position, tuned.stiffness)
    assert tuned.cost == pytest.approx(after, rel=1e-6)


def test_it_got_better(tuned):
    assert tuned.cost < tuned.cost_before


def test_signs_stay_and_what_is_zero_stays_zero(control, tuned):
    for loop, start in ((tuned.position, control.position), (tuned.stiffness, control.stiffness)):
        for name in NAMES:
            found, first = getattr(loop, name), getattr(start, name)
            assert np.sign(found) == np.sign(first)
            if first:
                assert abs(math.log10(found / first)) <= 2.0 + 1e-9
    assert tuned.stiffness.kd == 0.0
    assert (tuned.position.filter_time, tuned.position.tracking_time) == (
        control.position.filter_time,
        control.position.tracking_time,
    )


def test_progress_rises_to_the_end(tuned, progress):
    assert progress == sorted(progress)
    assert progress[-1] == 1.0
    assert tuned.evaluated == 8 * 3 + 1  # the population, two generations, and the start


def test_the_same_seed_finds_the_same(plant, control, initial, tuned):
    again = tune_pid(plant, control, WISHES, SCALES, initial=initial, seed=3, **SMALL)
    assert (again.position, again.stiffness, again.cost) == (tuned.position, tuned.stiffness, tuned.cost)
    other = tune_pid(plant, control, WISHES, SCALES, initial=initial, seed=4, **SMALL)
    assert other.position != tuned.position


def test_it_never_gets_worse_even_where_all_else_is(plant, knee, tuned, initial):
    """From the gains that were found, with next to no search: the start is among the candidates."""
    control = PositionStiffnessControl(tuned.position, tuned.stiffness, model=knee)
    for seed in range(3):
        again = tune_pid(plant, control, WISHES, SCALES, initial=initial, seed=seed, **(SMALL | {"generations": 1}))
        assert again.cost_before == pytest.approx(tuned.cost, rel=1e-9)
        assert again.cost <= again.cost_before * (1 + 1e-12)


def test_negative_gains_stay_negative_and_a_narrow_search_says_that_it_ends_at_its_bound(plant, control, initial):
    reverse = eqx.tree_at(
        lambda c: (c.stiffness.kp, c.stiffness.ki, c.position.ki), control, (-0.001 * bar, -0.01 * bar, 0.0)
    )
    found = tune_pid(
        plant, reverse, WISHES, SCALES, initial=initial, seed=0, decades=1e-3, **(SMALL | {"generations": 60})
    )
    assert found.stiffness.kp < 0
    assert found.stiffness.ki < 0
    assert found.position.ki == 0.0
    names = {f"{loop}.{name}" for loop in ("position", "stiffness") for name in NAMES}
    assert set(found.at_bound) <= names - {"position.ki", "stiffness.kd"}
    for loop in ("position", "stiffness"):
        for name in NAMES:
            start, end = getattr(getattr(reverse, loop), name), getattr(getattr(found, loop), name)
            at_bound = bool(start) and abs(math.log10(end / start)) > 0.99e-3
            assert (f"{loop}.{name}" in found.at_bound) == at_bound, (loop, name)
    assert found.at_bound  # a thousandth of a decade is too little for any search


def test_it_takes_two_pids(plant, knee, control, initial):
    from mckibben.study.scenario import Scenario

    learning = Scenario.read("examples/pre-contracted-step-backprop.yaml").control()
    with pytest.raises(TypeError, match="two loops are PID"):
        tune_pid(plant, learning, WISHES, SCALES, initial=initial, **SMALL)


def test_times_that_simulate_refuses_are_refused_here(plant, control, initial):
    from mckibben.errors import SimulationError

    with pytest.raises(SimulationError):
        tune_pid(plant, control, WISHES, SCALES, initial=initial, **(SMALL | {"duration": 0.201}))


def test_gains_that_are_all_zero_are_nothing_to_tune(plant, knee, initial):
    from mckibben.errors import McKibbenError

    nothing = PositionStiffnessControl(PID(0.0, 0.0, 0.0), PID(0.0, 0.0, 0.0), model=knee)
    with pytest.raises(McKibbenError):
        tune_pid(plant, nothing, WISHES, SCALES, initial=initial, **SMALL)


def test_the_declared_scipy_knows_the_argument_rng():
    import re
    import tomllib
    from pathlib import Path

    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    scipy = next(d for d in project["dependencies"] if d.startswith("scipy"))
    major, minor = (int(x) for x in re.match(r"scipy>=(\d+)\.(\d+)", scipy).groups())
    assert (major, minor) >= (1, 15)
