"""Metrics of trajectories made by hand, whose answers are known without the code."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben import simulation
from mckibben.control import Setpoint
from mckibben.simulation import Trajectory, without_last_change
from mckibben.simulation.metrics import first_of_end, last_change
from mckibben.simulation.trajectories import column_names, trajectory_of

PERIOD = 1e-3
measure = jax.jit(simulation.measure)  # one program a length
FLAGS = ("saturated", "slack", "outside_domain", "overloaded")


def moved(size: int, **given) -> Trajectory:
    """A trajectory that is zero but for what is given."""
    columns = {name: jnp.zeros(size, bool if name in FLAGS else float) for name in column_names(())}
    return trajectory_of(columns | {name: jnp.asarray(value) for name, value in given.items()}, ())


def answer(desired, stiffness) -> float:
    run = moved(len(desired), desired_stiffness=desired, stiffness=stiffness)
    return float(measure(run, PERIOD).stiffness_settling)


def lag(tau: float, *, at: float = 2.0, before: float = 13.0, after: float = 17.0, duration: float = 6.0):
    """A reference that steps and a stiffness that follows it to first order."""
    times = np.arange(round(duration / PERIOD)) * PERIOD
    done = -np.expm1(-np.maximum(times - at, 0.0) / tau)
    return times, np.where(times < at - PERIOD / 2, before, after), before + (after - before) * done


def test_root_mean_square_and_largest_error_of_angle_and_stiffness():
    run = moved(
        4,
        angle=[1.0, 2.0, 3.0, 4.0],
        desired_angle=[1.0, 2.0, 6.0, 0.0],  # errors 0, 0, -3, 4
        stiffness=[10.0, 10.0, 10.0, 10.0],
        desired_stiffness=[10.0, 10.0, 10.0, 18.0],  # errors 0, 0, 0, -8
        stiffness_estimate=[10.0, 12.0, 10.0, 10.0],  # errors 0, 2, 0, 0
    )
    found = measure(run, PERIOD)
    assert float(found.angle_rmse) == pytest.approx(2.5, rel=1e-15)
    assert float(found.angle_max) == 4.0
    assert float(found.stiffness_rmse) == pytest.approx(4.0, rel=1e-15)
    assert float(found.stiffness_max) == 8.0
    assert float(found.estimate_rmse) == pytest.approx(1.0, rel=1e-15)


def test_air_is_what_is_taken_in_and_not_what_is_let_out():
    first, second = [1.0, 3.0, 2.0, 2.0, 2.5], [4.0, 2.0, 3.0, 3.0, 2.5]
    assert float(measure(moved(5, air1=first), PERIOD).air) == 2.5
    assert float(measure(moved(5, air1=first, air2=second), PERIOD).air) == 3.5  # the other cannot use it


@pytest.mark.parametrize("size", [5, 20_000])
def test_air_of_volumes_that_are_not_known_is_not_known(size):
    assert np.isnan(measure(moved(size, air1=np.full(size, np.nan), air2=np.full(size, np.nan)), PERIOD).air)


def test_times_are_counts_of_periods():
    flags = {name: np.arange(50) < count for name, count in zip(FLAGS, (3, 7, 11), strict=False)}
    found = measure(moved(50, **flags), 0.02)
    assert [float(found.time_saturated), float(found.time_slack), float(found.time_outside_domain)] == pytest.approx(
        [0.06, 0.14, 0.22]
    )


@pytest.mark.parametrize(("before", "after"), [(13.0, 17.0), (17.0, 13.0)])
def test_a_first_order_lag_settles_when_its_exponential_has_died_down_to_the_band(before, after):
    tau = 0.1
    _, desired, stiffness = lag(tau, before=before, after=after)
    assert 0 <= answer(desired, stiffness) - tau * np.log(10) <= PERIOD * 1.001


def test_the_band_is_a_part_of_the_change_and_not_of_the_setpoint():
    _, desired, _ = lag(0.1)
    stiffness = np.where(desired == 17.0, 17.0 - 0.39, 13.0)  # within 10 % of the change of 4, at once
    stiffness[2000] = 13.0  # but for the very start
    assert answer(desired, stiffness) == pytest.approx(PERIOD)
    assert np.isnan(answer(desired, np.where(desired == 17.0, 17.0 - 0.41, 13.0)))  # 0.41 of 17 would be 2.4 %


def test_what_is_outside_at_the_end_has_never_settled():
    _, desired, stiffness = lag(0.1)
    stiffness[-1] = 16.0
    assert np.isnan(answer(desired, stiffness))
    assert np.isnan(answer(desired, np.full_like(stiffness, 13.0)))


@pytest.mark.parametrize(("inside", "settles"), [(399, False), (400, True)])
def test_settled_is_what_stays_in_the_band_for_the_last_tenth_of_the_time_since_the_change(inside, settles):
    _, desired, _ = lag(0.1)  # 4000 periods after the change
    stiffness = np.where(np.arange(6000) < 6000 - inside, 13.0, 17.0)
    expected = (4000 - inside) * PERIOD if settles else np.nan
    assert answer(desired, stiffness) == pytest.approx(expected, nan_ok=True)


@pytest.mark.slow
def test_the_end_of_a_ramp_is_no_step():
    times = np.arange(3000) * PERIOD
    step = last_change(np.where(times < 0.9995, 14.0, 16.0))
    assert (int(step.at), bool(step.ends)) == (1000, True)
    ramp = np.interp(times, [0.5, 1.0], [14.0, 16.0])
    assert not bool(last_change(ramp).ends)
    assert without_last_change(Setpoint(np.zeros(3000), ramp)) is None
    assert np.isnan(answer(ramp, ramp))


def test_a_stiffness_that_is_not_a_number_is_not_settled():
    times, desired, stiffness = lag(0.1)
    gap = np.where((times > 2.9995) & (times < 3.4995), np.nan, stiffness)
    assert answer(desired, gap) == pytest.approx(1.5)
    assert np.isnan(answer(desired, np.where(times > 5, np.nan, stiffness)))


def coupled(difference: dict[float, float], at: float | None = 3.0) -> float:
    """The coupling where the run differs from the one without the step at given times."""
    times = np.arange(6000) * PERIOD
    undisturbed = np.sin(times)
    angle = undisturbed.copy()
    for when, size in difference.items():
        angle[round(when / PERIOD)] += size
    desired = np.full(6000, 15.0) if at is None else np.where(times < at - PERIOD / 2, 13.0, 17.0)
    undisturbed = np.full(6000, np.nan) if at is None else undisturbed
    run = moved(6000, angle=angle, angle_without_step=undisturbed, desired_stiffness=desired)
    return float(measure(run, PERIOD).coupling)


def test_coupling_is_the_largest_difference_that_the_step_makes():
    assert coupled({3.5: -0.05, 4.0: 0.02}) == pytest.approx(0.05)
    assert coupled({3.0: 0.01}) == pytest.approx(0.01)
    assert coupled({2.999: 0.1}) == 0.0  # before the step nothing can be its doing
    assert coupled({}) == 0.0  # a moving angle alone is no coupling
    assert np.isnan(coupled({3.5: -0.05}, at=None))


def test_a_setpoint_that_never_stops_changing_has_no_settling_time():
    times = np.arange(5000) * PERIOD
    desired = 15 + np.sin(times)
    stiffness = np.where(times == times[-1], desired, 12.0)  # far off throughout, but for the last sample
    assert np.isnan(answer(desired, stiffness))


@pytest.mark.parametrize("at", range(12))
def test_a_step_anywhere_is_found(at):
    desired = np.where(np.arange(12) < at, 13.0, 17.0)
    stiffness = 13.0 + 4 * (np.arange(12) >= min(at + 3, 11))
    run = moved(12, desired_stiffness=desired, stiffness=stiffness, angle_without_step=np.linspace(0, 1, 12))
    found = measure(run, PERIOD)
    assert np.isfinite(found.coupling) == (0 < at < 11)
    settled = {0: 3e-3, 11: np.nan}.get(at, (min(at + 3, 11) - at) * PERIOD)
    assert float(found.stiffness_settling) == pytest.approx(settled, nan_ok=True)


@pytest.mark.parametrize("name", ["angle", "stiffness", "force1", "force2", "angle_without_step"])
@pytest.mark.parametrize("place", [0, 5, 11])
def test_one_moment_that_is_no_number_spoils_the_largest(name, place):
    column = np.ones(12)
    column[place] = np.nan
    run = moved(12, desired_stiffness=np.where(np.arange(12) < 5, 13.0, 17.0), **{name: column})
    found = measure(run, PERIOD)
    peak = {"force1": "force_max", "force2": "force_max", "angle_without_step": "coupling"}
    peak = peak.get(name, f"{name}_max")
    assert np.isnan(getattr(found, peak)) == (not (peak == "coupling" and place < 5))


@pytest.mark.slow
def test_no_error_has_no_slope():
    def errors(size):
        run = moved(12, desired_stiffness=np.full(12, 13.0))
        steps = jnp.asarray(np.linspace(-1, 1, 12))
        run = run._replace(angle=size * steps, stiffness=13.0 + size * steps, stiffness_estimate=13.0 + size * steps)
        found = simulation.measure(run, PERIOD)
        return found.angle_rmse, found.stiffness_rmse, found.estimate_rmse

    forward, reverse = jax.jit(jax.jacfwd(errors)), jax.jit(jax.jacrev(errors))
    for slopes in (forward(0.0), reverse(0.0)):
        assert [float(slope) for slope in slopes] == [0.0] * 3
    assert float(reverse(1.0)[0]) == pytest.approx(np.sqrt(np.mean(np.linspace(-1, 1, 12) ** 2)))


def test_the_end_of_a_run_is_its_last_tenth_and_one_control_period_at_least():
    assert [first_of_end(periods) for periods in (1, 5, 10, 30, 47)] == [0, 4, 9, 27, 43]
