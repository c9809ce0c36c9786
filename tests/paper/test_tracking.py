"""The runs behind Figs. 7 and 8: what is compared, how seeds are summed up, and that each run stands for itself."""

import dataclasses
import itertools
import math
import types

import numpy as np
import pytest

from mckibben import control
from mckibben.paper.settings import SETTINGS, STEP_TIME, Wish, bp_scenario, gains_of, pid_scenario
from mckibben.paper.tracking import BP, CONTROLLERS, FREE_TUNED_BP, PID, TUNED_BP, TUNED_PID, Run
from mckibben.simulation import Metrics, check_reference
from mckibben.study.parameters import with_values
from mckibben.study.scenario import Scenario
from mckibben.units import quantity

RUNS = list(itertools.product([s.key for s in SETTINGS], Wish))


def moved_by(amplitude: float, **metrics) -> types.SimpleNamespace:
    """As much of a result as a run looks at: the wish, a sine, and metrics."""
    wish = amplitude * np.sin(np.linspace(0, 2 * np.pi, 1000, endpoint=False))
    return types.SimpleNamespace(
        trajectory=types.SimpleNamespace(desired_angle=wish), metrics=lambda **_: {"angle_rmse": 0.5, **metrics}
    )


def seeded(**columns) -> Run:
    """A run of which the metrics over the seeds are known; zeros where they are not given."""
    size = len(next(iter(columns.values())))
    return Run(
        None, moved_by(1.0), Metrics(**{n: np.asarray(columns.get(n, np.zeros(size)), float) for n in Metrics._fields})
    )


def test_every_controller_runs_every_wish_in_every_geometry(tracking):
    assert set(tracking.runs) == set(itertools.product([s.key for s in SETTINGS], Wish, CONTROLLERS))
    assert tracking.seeds == 2


@pytest.mark.parametrize(("key", "wish"), RUNS)
def test_both_methods_have_the_same_plant_wish_start_and_base_gains(tracking, key, wish):
    for pid, learned in ((PID, (BP,)), (TUNED_PID, (TUNED_BP, FREE_TUNED_BP))):
        base = tracking.runs[key, wish, pid].scenario
        for name in learned:
            other = tracking.runs[key, wish, name].scenario
            assert other.joint == base.joint
            assert (other.load, other.valve, other.signals, other.start) == (
                base.load,
                base.valve,
                base.signals,
                base.start,
            )
            for loop in ("position", "stiffness"):
                one, two = getattr(base.control(), loop), getattr(other.control(), loop)
                assert isinstance(two, control.BackpropPID)
                assert (two.base.kp, two.base.ki, two.base.kd) == (one.kp, one.ki, one.kd)
    assert tracking.runs[key, wish, BP].scenario.control().position.gain_ratio == 2.0
    assert tracking.runs[key, wish, TUNED_BP].scenario.control().position.gain_ratio == 1.1
    assert tracking.runs[key, wish, FREE_TUNED_BP].scenario.control().position.gain_ratio == 2.0


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
def test_the_tuned_gains_are_those_of_the_tuning_to_the_last_bit(tracking, setting):
    tuned = tracking.tuned[setting.key]
    for wish in Wish:
        given = tracking.runs[setting.key, wish, TUNED_PID].scenario.control()
        for loop in ("position", "stiffness"):
            for gain in ("kp", "ki", "kd"):
                used = getattr(getattr(given, loop), gain)
                assert used == tuned.values.get(f"controller.{loop}.{gain}", 0.0)
    assert tuned.cost <= tuned.cost_before


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
def test_the_cost_of_the_tuning_is_that_of_the_runs_at_least(tracking, setting):
    """The larger of that of the gains and that of gains half as high again: for moderate gains the first."""
    tuned = tracking.tuned[setting.key]
    angle, stiffness = quantity(setting.angle_scale, "rad") / 10, quantity(setting.stiffness_scale, "N*m/rad") / 10
    total = dict.fromkeys((PID, TUNED_PID), 0.0)
    for name in total:
        for wish in Wish:
            found = tracking.runs[setting.key, wish, name].result.metrics
            total[name] += found["angle_rmse"] / angle + found["stiffness_rmse"] / stiffness
    assert tuned.cost_before == pytest.approx(total[PID] / len(Wish), rel=1e-6)
    assert tuned.cost >= total[TUNED_PID] / len(Wish) * (1 - 1e-6)


@pytest.mark.parametrize(("key", "wish"), RUNS)
def test_the_run_in_the_figures_is_that_of_the_first_seed(tracking, key, wish):
    run = tracking.runs[key, wish, BP]
    own = run.result.metrics
    for name in ("angle_rmse", "angle_max", "stiffness_rmse", "stiffness_settling"):
        assert float(getattr(run.seeds, name)[0]) == pytest.approx(own[name], rel=1e-6), name
    assert run.seeds.angle_rmse.shape == (2,)
    assert float(run.seeds.angle_rmse[0]) != float(run.seeds.angle_rmse[1])
    assert tracking.runs[key, wish, PID].seeds is None


def test_progress_rises_to_the_end(tracking, reported):
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
@pytest.mark.parametrize("wish", Wish)
def test_the_wishes_are_within_reach(setting, wish):
    scenario = pid_scenario(setting, wish)
    reach = check_reference(scenario.plant(), scenario.reference(), control_period=1e-2)
    assert reach.feasible, reach.describe()


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
def test_the_wishes_are_what_is_declared(setting):
    times = np.array([0.0, 0.5, 4.999, 5.0, 9.9])
    constant, step = (pid_scenario(setting, wish).reference()(times) for wish in (Wish.CONSTANT, Wish.STEP))
    amplitude = quantity(setting.amplitude, "rad")
    np.testing.assert_allclose(constant.angle, amplitude * np.sin(np.pi * times), atol=1e-12)
    np.testing.assert_allclose(constant.angle, step.angle)
    np.testing.assert_allclose(constant.stiffness, quantity(setting.constant, "N*m/rad"))
    before, after = quantity(setting.before, "N*m/rad"), quantity(setting.after, "N*m/rad")
    np.testing.assert_allclose(step.stiffness, np.where(times < quantity(STEP_TIME, "s"), before, after))


def test_gains_as_text_read_back_to_the_last_bit():
    position, stiffness = control.PID(1 / 3, 2e5 / 7, 0.1 + 0.2), control.PID(-1e5 / 9, -math.pi * 1e7, 0.0)
    values = {
        f"controller.{name}.{gain}": getattr(loop, gain)
        for name, loop in (("position", position), ("stiffness", stiffness))
        for gain in ("kp", "ki", "kd")
    }
    text = gains_of(with_values(pid_scenario(SETTINGS[0], Wish.STEP), values))
    for scenario in (pid_scenario(SETTINGS[1], Wish.STEP, text), bp_scenario(SETTINGS[1], Wish.STEP, text)):
        again = Scenario.parse(scenario.dumps()).control()
        for given, loop in ((position, again.position), (stiffness, again.stiffness)):
            base = getattr(loop, "base", loop)
            assert (base.kp, base.ki, base.kd) == (given.kp, given.ki, given.kd)


@pytest.mark.parametrize("setting", SETTINGS, ids=lambda s: s.key)
def test_coupling_is_what_the_runs_show(tracking, setting):
    found = tracking.coupling[setting.key]
    table = tracking.runs[setting.key, Wish.CONSTANT, PID].result
    late = table.times >= 5.0 - 1e-9
    error = (table["stiffness"] - table["desired_stiffness"])[late]
    assert found.stiffness_by_motion == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)
    assert found.stiffness_at_rest < 1e-3 * found.stiffness_by_motion

    scenario = tracking.runs[setting.key, Wish.STEP, PID].scenario
    level = pid_scenario(dataclasses.replace(setting, after=setting.before), Wish.STEP)
    assert level.start == scenario.start
    from mckibben.study.scenario.running import run_scenario

    with_step = tracking.runs[setting.key, Wish.STEP, PID].result["angle"]
    without = run_scenario(level).result
    assert np.ptp(without["desired_stiffness"].to_numpy()) == 0
    assert found.angle_by_step == pytest.approx(np.abs(with_step - without["angle"].to_numpy())[late].max(), rel=1e-6)


def test_medians_and_worsts_over_seeds():
    run = seeded(angle_rmse=[3.0, 1.0, 2.0], stiffness_settling=[0.5, np.nan, 0.1])
    assert run.median("angle_rmse") == 2.0
    assert run.worst("angle_rmse") == 3.0
    assert run.median("stiffness_settling") == 0.5  # one that never settles is the longest
    assert math.isnan(run.worst("stiffness_settling"))
    assert math.isnan(seeded(stiffness_settling=[np.nan, np.nan, 0.1]).median("stiffness_settling"))


def test_a_run_that_is_worse_than_not_moving_or_not_finite_is_lost():
    still = math.sqrt(0.5)  # the RMS of a sine of 1 rad
    assert seeded(angle_rmse=[0.1, still * 1.001, np.nan, np.inf, still * 0.999]).lost == 3
    assert Run(None, moved_by(1.0), None).lost == 0
    single = Run(None, moved_by(0.1), None)
    assert single.lost == 1
    assert single.median("angle_rmse") == single.worst("angle_rmse") == 0.5


@pytest.mark.parametrize("size", [2, 4, 20])
def test_the_median_of_an_even_number_of_seeds_is_the_median(size):
    values = np.arange(size, dtype=float) ** 2
    assert seeded(angle_rmse=values).median("angle_rmse") == np.median(values)
