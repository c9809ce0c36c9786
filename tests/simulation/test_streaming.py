"""Measured on the way: what is folded moment by moment is what the whole trajectory gives."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control import Setpoint
from mckibben.plant import PlantState
from mckibben.simulation import Metrics, Trajectory, episode, measure, trajectory, without_last_change
from mckibben.simulation.loop import streaming_episode
from mckibben.simulation.metrics import MetricSample, last_change

PERIOD = 1e-3
FLAGS = ("saturated", "slack", "outside_domain", "overloaded")
NEVER_NEGATIVE = ("force1", "force2", "excursion", "air1", "air2")


def same(found: Metrics, expected: Metrics, rtol: float = 1e-12) -> None:
    for name in Metrics._fields:
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=rtol, atol=1e-300, err_msg=name)


def moved(size: int, **columns) -> Trajectory:
    zero = {name: np.zeros(size, bool if name in FLAGS else float) for name in Trajectory._fields}
    return Trajectory(**(zero | {name: np.asarray(value) for name, value in columns.items()}))


measured = jax.jit(lambda run: measure(run, PERIOD))


@pytest.mark.parametrize("at", range(12))
def test_a_step_anywhere_is_found(at):
    desired = np.where(np.arange(12) < at, 13.0, 17.0)
    stiffness = 13.0 + 4 * (np.arange(12) >= min(at + 3, 11))
    run = moved(12, desired_stiffness=desired, stiffness=stiffness, angle_without_step=np.linspace(0, 1, 12))
    found = measured(run)
    assert np.isfinite(found.coupling) == (0 < at < 11)
    settled = {0: 3e-3, 11: np.nan}.get(at, (min(at + 3, 11) - at) * PERIOD)
    assert float(found.stiffness_settling) == pytest.approx(settled, nan_ok=True)


@pytest.mark.parametrize("name", ["angle", "stiffness", "force1", "force2", "angle_without_step"])
@pytest.mark.parametrize("place", [0, 5, 11])
def test_one_moment_that_is_no_number_spoils_the_largest(name, place):
    column = np.ones(12)
    column[place] = np.nan
    run = moved(12, desired_stiffness=np.where(np.arange(12) < 5, 13.0, 17.0), **{name: column})
    found = measured(run)
    peak = {
        "force1": "force_max",
        "force2": "force_max",
        "angle_without_step": "coupling",
    }
    peak = peak.get(name, f"{name}_max")
    assert np.isnan(getattr(found, peak)) == (not (peak == "coupling" and place < 5))


def test_no_error_has_no_slope():
    def errors(size):
        run = moved(12, desired_stiffness=np.full(12, 13.0))
        steps = jnp.asarray(np.linspace(-1, 1, 12))
        run = run._replace(angle=size * steps, stiffness=13.0 + size * steps, stiffness_estimate=13.0 + size * steps)
        found = measure(run, PERIOD)
        return found.angle_rmse, found.stiffness_rmse, found.estimate_rmse

    forward, reverse = jax.jit(jax.jacfwd(errors)), jax.jit(jax.jacrev(errors))
    for slopes in (forward(0.0), reverse(0.0)):
        assert [float(slope) for slope in slopes] == [0.0] * 3
    assert float(reverse(1.0)[0]) == pytest.approx(np.sqrt(np.mean(np.linspace(-1, 1, 12) ** 2)))


# Whole episodes: the two halves of the reference are the commands of the muscles (see `Playback`).
SIZE = 60
START = PlantState(jnp.asarray(0.0), jnp.asarray(0.1), (jnp.asarray(3.2e5), jnp.asarray(3.3e5)))


def commands(*changes: tuple[int, float]) -> Setpoint:
    reference = np.full(SIZE, 3.3e5)
    for at, value in changes:
        reference[at:] = value
    return Setpoint(3.2e5 + 3e4 * np.sin(np.arange(SIZE) / 9), reference)


KEPT = ("angle", "angle_without_step", "command2", "slack")


@pytest.fixture(scope="module")
def on_the_way(plant, playback):
    @functools.partial(jax.jit, static_argnames=("keep", "coupled"))
    def run(setpoints, *, keep=KEPT, coupled=True):
        return streaming_episode(plant, playback, setpoints, START, PERIOD, 2, coupling=coupled, keep=keep)

    return run


@pytest.fixture(scope="module")
def afterwards(plant, playback):
    record_of = jax.jit(lambda setpoints: episode(plant, playback, setpoints, START, PERIOD, 2))

    @jax.jit
    def judged(setpoints, record, undisturbed):
        run = trajectory(plant, setpoints, record, undisturbed)
        return run, measure(run, PERIOD)

    def run(setpoints):
        final, record = record_of(setpoints)
        held = without_last_change(setpoints)
        undisturbed = record if held is None else record_of(held)[1]
        return final, *judged(setpoints, record, undisturbed.state.angle)

    return run


CASES = {
    "constant": commands(),
    "one step": commands((20, 3.6e5)),
    "two steps": commands((7, 3.7e5), (31, 3.1e5)),
    "in the second period": commands((1, 3.6e5)),
    "in the last but one": commands((SIZE - 2, 3.6e5)),
    "in the last": commands((SIZE - 1, 3.6e5)),
    "to the end": commands()._replace(stiffness=3.2e5 + 1e3 * np.arange(SIZE)),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.slow
def test_an_episode_measured_on_the_way_is_the_episode_measured_afterwards(on_the_way, afterwards, case):
    reference = CASES[case]
    change = last_change(reference.stiffness)
    final, _, expected = afterwards(reference)
    found = on_the_way(reference)
    same(found.metrics, expected, rtol=1e-11)
    np.testing.assert_allclose(jax.tree.leaves(found.final), jax.tree.leaves(final), rtol=1e-12)
    assert bool(found.metrics.coupling > 0) == bool(change.ends)


@pytest.mark.slow
def test_without_coupling_the_second_run_is_not_computed(on_the_way):
    reference = CASES["one step"]
    with_it, without = on_the_way(reference), on_the_way(reference, coupled=False)
    assert np.isnan(without.metrics.coupling)
    same(without.metrics, with_it.metrics._replace(coupling=jnp.asarray(np.nan)))
    texts = (str(jax.make_jaxpr(lambda c=c: on_the_way(reference, coupled=c))()) for c in (True, False))
    assert next(texts).count("cond[") == next(texts).count("cond[") + 1


@pytest.mark.parametrize("size", [5, 30, 47])
def test_the_end_of_a_run_begins_at_the_first_control_period_of_its_last_tenth(size):
    """As for a single run, whose outcome has the error of its last tenth."""
    error, change = np.arange(1.0, size + 1), last_change(np.full(size, 15.0))
    flown, zero = moved(size, angle=error), np.zeros(size)
    samples = MetricSample.of(flown, np.arange(size), size, change, 15.0, (zero,) * 4)
    first = size - max(size // 10, 1)
    np.testing.assert_array_equal(samples.angle_error_at_end, np.where(np.arange(size) < first, 0.0, error))
