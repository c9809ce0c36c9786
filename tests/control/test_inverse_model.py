"""A learned inverse in parallel with two loops: what it gives, how it learns, and that it does not run away."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.actuator import FirstOrderValve
from mckibben.control import PID, InverseModelControl, Measurement, PositionStiffnessControl, Sine, Step
from mckibben.control.backprop import Network
from mckibben.control.inverse_model import FilteredSignal, InitialOffset, MeasuredMotion
from mckibben.control.reference import ReferenceDerivatives
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.units import deg
from tests.control.conftest import PERIOD, off

CYCLE = 1000  # periods
SINE = Sine(8 * deg, 1.0, 0.0, np.pi / 2)  # it starts at rest
SOFT = PID(3e5, 4e6, 5e4), PID(3e4, 1.1e6, 0.0)


def loops(knee, tension=None):
    return PositionStiffnessControl(*SOFT, model=knee, minimum_tension=tension)


@pytest.fixture(scope="module")
def alone(knee):
    return InverseModelControl(loops(knee))


@pytest.fixture(scope="module")
def modelled(knee, load):
    return InverseModelControl(loops(knee, 5.0), load)


@pytest.fixture(scope="module")
def run(follow):
    def run(plant, control, angle=SINE, stiffness=15.0, start=15.0):
        return follow(10.0, plant, control, angle, stiffness, start)

    return run


def by_cycle(answer):
    """The RMSE of the angle in each cycle of the sine [deg]."""
    return np.sqrt(np.mean(off(answer).reshape(-1, CYCLE) ** 2, axis=1))


@jax.jit
def tensions_of(joint, record):
    return jnp.stack(joint.tensions(record.state.angle, record.state.pressures))


def tensions(joint, record):
    """Of both muscles [N]."""
    return np.asarray(tensions_of(jax.tree.map(np.asarray, joint), record))


def rated(control, rate):
    return dataclasses.replace(control, learning_rate=rate)


def other(plant, load, scales=(0.92, 1.08), mass2=0.75, lag=0.02):
    """The plant, each muscle pulling so many times as hard, with another mass and other valves."""
    laws = [muscle.law for muscle in (plant.joint.muscle1, plant.joint.muscle2)]
    names = ("a1", "a2", "b1", "b2", "c1", "c2")
    joint = eqx.tree_at(
        lambda j: [getattr(m.law, name) for m in (j.muscle1, j.muscle2) for name in names],
        plant.joint,
        [getattr(law, name) * scale for law, scale in zip(laws, scales, strict=True) for name in names],
    )
    load = numeric(dataclasses.replace(load, mass2=mass2))
    return JointPlant(joint, load, FirstOrderValve(np.asarray(lag)))


@pytest.mark.slow
def test_the_error_of_a_repeated_sine_falls(run, plant, alone):
    """From nothing; without learning it stays what it is."""
    learnt, before = by_cycle(run(plant, alone)), by_cycle(run(plant, rated(alone, 0.0)))
    assert before[-1] == pytest.approx(before[2], rel=1e-3)
    assert learnt[-1] < 0.3 * before[-1]
    assert (np.diff(learnt) < 0).all()


def test_no_rate_makes_it_run_away_where_nothing_is_as_believed(run, plant, load, modelled):
    """Mass, valves and each muscle's law are off; rates go up to one per control period."""
    rng = np.random.default_rng(3)
    for _ in range(6):
        wrong = other(plant, load, rng.uniform(0.9, 1.1, 2), rng.uniform(0.25, 0.75), rng.uniform(0.01, 0.05))
        without = by_cycle(run(wrong, rated(modelled, 0.0)))
        for rate in (3.0, 1000.0):
            record, setpoints = run(wrong, rated(modelled, rate))
            assert by_cycle((record, setpoints)).max() < 1.1 * without.max()
            assert tensions(wrong.joint, record).min() > 0.0
            assert float(jnp.abs(record.telemetry["feedforward_differential"]).max()) < 3e5


@pytest.fixture(scope="module")
def replayed(barely_compiled):
    """The commands to measurements as they were, without the plant that they came from."""

    @barely_compiled
    def told(control, setpoints, seen, period):
        def one(state, at):
            return control.step(state, *at, period)

        return lax.scan(one, control.init(jax.tree.map(lambda x: x[0], seen)), (setpoints, seen))[1]

    def replayed(control, answer, kind=jnp.float64):
        record, setpoints = answer
        seen = Measurement(record.state.angle, record.state.pressures)
        return told(*cast((numeric(control), setpoints, seen, np.asarray(PERIOD)), kind))

    return replayed


def test_without_learning_and_load_it_is_the_loops_alone(run, replayed, plant, alone):
    """But for rounding, where the setpoint stands or jumps."""
    record, setpoints = run(plant, rated(alone, 0.0), Step(0.05, 0.1, 0.5), Step(14.0, 16.0, 1.0))
    expected = replayed(alone.loops, (record, setpoints))
    np.testing.assert_allclose(record.commands[0], expected[0], rtol=1e-9)
    np.testing.assert_allclose(record.commands[1], expected[1], rtol=1e-9)
    assert np.ptp(np.asarray(record.commands[0])) > 1e4


def test_it_takes_over_the_pressures_as_they_are(run, plant, load, modelled):
    """Also where the model would have others: a plant at rest stays so."""
    wrong = other(plant, load)
    rest = run(wrong, modelled, 0.1, 15.0)[0]
    estimated = tensions(modelled.loops.model, rest)[:, 0] / tensions(wrong.joint, rest)[:, 0]
    assert np.abs(estimated - 1.0).min() > 0.05
    record, _ = run(wrong, modelled, 0.1, float(rest.telemetry["stiffness_estimate"][0]))
    for command, pressure in zip((record.commands[0], record.commands[1]), rest.state.pressures, strict=True):
        np.testing.assert_allclose(command, float(pressure[0]), rtol=1e-6)


START = InitialOffset(*map(jnp.asarray, (14.0, 0.1e5, 1e5)))


def moved(angle=0.05, stiffness=15.0, pressures=(4.0e5, 4.4e5), velocity=0.4):
    return MeasuredMotion(
        *(FilteredSignal(jnp.asarray(x), None) for x in (angle, stiffness, *pressures)), jnp.asarray(velocity)
    )


def network(seed=0, hidden=8):
    rng = np.random.default_rng(seed)
    return Network(jnp.asarray(rng.normal(size=(hidden, 5))), jnp.asarray(0.2 * rng.normal(size=(2, hidden + 1))))


@jax.jit
def taught(control, network, moved, acceleration):
    return numeric(control)._train(network, moved, acceleration, START, PERIOD)


def test_it_steps_down_the_gradient_by_no_more_than_it_may(alone):
    """Against finite differences of the network in NumPy; a part of the error goes, at most rate x period of it."""
    seen = np.array([0.05 / 0.15, 0.4, 3.0 / 8.0, (15.0 - 14.0) / 3.0, 1.0])
    target = np.array([0.2 - 0.1, 4.2 - 1.0])  # bar: beyond what it starts from

    def answers(hidden, output):
        return output @ np.append(np.tanh(hidden @ seen), 1.0)

    before = [np.asarray(each) for each in network()]
    errors = np.clip(target - answers(*before), -1.0, 1.0)
    slopes = []
    for layer in (0, 1):
        slope = np.zeros((2, *before[layer].shape))
        for at in np.ndindex(before[layer].shape):
            up, down = ([each.copy() for each in before] for _ in range(2))
            up[layer][at] += 1e-6
            down[layer][at] -= 1e-6
            slope[(slice(None), *at)] = (answers(*up) - answers(*down)) / 2e-6
        slopes.append(slope)
    size = np.sum(slopes[1][0] ** 2) + np.sum(slopes[0] ** 2)
    after, off = taught(numeric(alone), network(), moved(), jnp.asarray(3.0))
    for mine, old, slope in zip(after, before, slopes, strict=True):
        gradient = np.tensordot(errors, slope, axes=1)
        np.testing.assert_allclose(mine - old, alone.learning_rate * PERIOD / (1 + size) * gradient, atol=1e-11)
    np.testing.assert_allclose(off, (target - answers(*before)) * 1e5, rtol=1e-9)
    fast, _ = taught(numeric(rated(alone, 1e6)), network(), moved(), jnp.asarray(3.0))
    assert np.linalg.norm(np.clip(target - answers(*map(np.asarray, fast)), -1, 1)) < np.linalg.norm(errors)


def test_nothing_is_learned_from_a_slack_muscle(alone):
    for pressures, learns in (((0.0, 4.4e5), False), ((4.0e5, 4.4e5), True)):
        after, off = taught(numeric(alone), network(), moved(pressures=pressures), jnp.asarray(0.0))
        assert bool(np.any(after.output != network().output)) == learns
        assert (float(off[0]) != 0.0) == learns


def test_the_inverse_is_that_of_the_reference_after_the_lag_of_the_valves(knee):
    """Of a reference with constant acceleration, exactly."""
    lag, acceleration = 0.03, 1.5
    control = InverseModelControl(loops(knee), valve=FirstOrderValve(lag))
    reference = jax.tree.map(jnp.asarray, ReferenceDerivatives(0.1, 0.2, acceleration, 0.0, 3.0))
    ahead = control._preview(reference, jnp.asarray(15.0), PERIOD)
    assert float(ahead.angle) == pytest.approx(0.1 + 0.2 * lag + acceleration * lag**2 / 2, rel=1e-12)
    assert float(ahead.velocity) == pytest.approx(0.2 + acceleration * lag, rel=1e-12)
    assert float(ahead.acceleration) == pytest.approx(acceleration, rel=1e-12)


def test_motion_and_pressures_are_of_one_moment(alone):
    """Behind the same filters a constant acceleration is one, and what is affine in the motion stays so."""

    def angle(k):
        return 0.5 * 2.0 * (PERIOD * k) ** 2 - 0.05

    still = [FilteredSignal(jnp.asarray(x), jnp.asarray(x)) for x in (angle(0), 14.95, 2e5, 3e5)]

    def one(state, k):
        now = Measurement(angle(k), (2e5 + 1e5 * angle(k), 3e5 - 1e5 * angle(k)))
        return alone._filter(state, now, 15.0 + angle(k), PERIOD)

    state, acceleration = jax.jit(lambda state: lax.scan(one, state, jnp.arange(1.0, 501.0)))(
        MeasuredMotion(*still, jnp.asarray(0.0))
    )
    assert float(acceleration[-1]) == pytest.approx(2.0, rel=1e-6)
    delay = 2 / 60.0  # of two filters, but for half a period each
    assert float(state.velocity) == pytest.approx(2.0 * (0.5 - delay), abs=2.0 * 2 * PERIOD)
    seen = float(state.angle.value)
    assert float(state.pressure1.value) == pytest.approx(2e5 + 1e5 * (seen + 0.05) - 5e3, abs=1e-3)
    assert float(state.stiffness.value) == pytest.approx(15.0 + (seen + 0.05) - 0.05, abs=0.06)
