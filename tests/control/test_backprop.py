import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.control import PID, BackpropPID
from mckibben.control.backprop import Network
from mckibben.numerics.compiled import numeric

PERIOD = 0.01
BASE = PID(3.0, 4.0, 0.2)
SCALES = {"signal_scale": 2.0, "error_scale": 0.5, "output_scale": 10.0}


@jax.jit
def run(loop, setpoint, measured, low=-1e9, high=1e9):
    """Outputs, telemetry and the last state, with measurements given."""

    def period(state, sample):
        state, output = loop.step(state, sample[0], sample[1], PERIOD)
        state = loop.track(state, output, jnp.clip(output, low, high), PERIOD)
        return state, (output, loop.telemetry(state))

    state, (output, telemetry) = lax.scan(period, loop.init(setpoint[0], measured[0], 0.7), (setpoint, measured))
    return output, telemetry, state


@jax.jit
def closed(loop, setpoint, gain):
    """The loop around y' = (gain u - y) / 0.5; errors and telemetry."""

    def period(carry, setpoint):
        state, y = carry
        state, output = loop.step(state, setpoint, y, PERIOD)
        y = y + PERIOD * (gain * output - y) / 0.5
        return (state, y), (setpoint - y, loop.telemetry(state))

    return lax.scan(period, (loop.init(0.0, 0.0, 0.0), jnp.asarray(0.0)), setpoint)[1]


def signals(count=400):
    rng = np.random.default_rng(3)
    return np.cumsum(rng.normal(size=count)) * 0.1, np.cumsum(rng.normal(size=count)) * 0.1


def backprop(base=BASE, **more):
    return numeric(BackpropPID(base, **SCALES | more))


@pytest.mark.slow
@pytest.mark.parametrize("limits", [(-1e9, 1e9), (-1.0, 1.5)])
@pytest.mark.parametrize("on_error", [False, True])
def test_without_learning_it_is_the_pid_with_its_base_gains(limits, on_error):
    base = numeric(dataclasses.replace(BASE, derivative_on_error=on_error))
    setpoint, measured = signals()
    learner, telemetry, _ = run(backprop(base, learning_rate=0.0), setpoint, measured, *limits)
    state, expected = base.init(setpoint[0], measured[0], 0.7), []
    step = jax.jit(lambda s, d, m: base.step(s, d, m, PERIOD))
    for d, m in zip(setpoint, measured, strict=True):
        state, output = step(state, d, m)
        state = base.track(state, output, min(max(float(output), limits[0]), limits[1]), PERIOD)
        expected.append(float(output))
    np.testing.assert_allclose(learner, expected, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(telemetry["kp"], 3.0, rtol=1e-15)


@pytest.mark.parametrize("sign", [1, -1])
def test_gains_stay_within_their_ratio_and_keep_their_sign_however_fast_it_learns(sign):
    base = PID(sign * 3.0, sign * 4.0, sign * 0.2)
    _, telemetry, state = run(backprop(base, learning_rate=1e4, momentum=0.9, gain_ratio=5.0), *signals())
    for name, gain in (("kp", 3.0), ("ki", 4.0), ("kd", 0.2)):
        factors = np.asarray(telemetry[name]) / (sign * gain)
        assert np.all((factors >= 0.2 - 1e-12) & (factors <= 5.0 + 1e-12))
        assert factors.max() > 4.9 or factors.min() < 0.21  # the bound was put to the test
    assert all(bool(jnp.all(jnp.isfinite(x))) for x in jax.tree.leaves(state))


def increment_by_hand(loop, network, state, setpoint, measured):
    """The change of output for a network, from the paper's scheme in plain NumPy."""
    error = setpoint - measured
    derivative = (0.005 * float(state.pid.derivative) + (float(state.pid.last.measured) - measured)) / (0.005 + PERIOD)
    parts = [3.0 * (error - float(state.error)), 4.0 * PERIOD * error, 0.2 * (derivative - float(state.pid.derivative))]
    inputs = np.array([setpoint / 2.0, measured / 2.0, error / 0.5, 1.0])
    hidden = np.append(np.tanh(np.asarray(network.hidden) @ inputs), 1.0)
    factors = 5.0 ** np.tanh(np.asarray(network.output) @ hidden)
    return float(factors @ parts)


@pytest.fixture(scope="module")
def stepped():
    """A learner after 20 periods, its state, and the state and output one period later."""
    loop = backprop(learning_rate=7.0, momentum=0.3)
    setpoint, measured = signals(20)
    state = run(loop, setpoint, measured)[2]
    following, output = jax.jit(lambda s: loop.step(s, 0.9, 0.4, PERIOD))(state)
    return loop, state, following, output


def test_the_output_grows_by_the_increment_of_the_network(stepped):
    loop, state, _, output = stepped
    expected = float(state.pid.integral) + increment_by_hand(loop, state.network, state, 0.9, 0.4)
    assert float(output) == pytest.approx(expected, rel=1e-12)


def test_the_weights_move_down_the_gradient_of_finite_differences_with_momentum(stepped):
    loop, state, following, _ = stepped
    leaves, structure = jax.tree.flatten(jax.tree.map(np.asarray, state.network))
    error, step = 0.5, 1e-6
    for which, weights in enumerate(leaves):
        slope = np.zeros_like(weights)
        for index in np.ndindex(weights.shape):
            sides = []
            for sign in (1, -1):
                changed = [w.copy() for w in leaves]
                changed[which][index] += sign * step
                network = Network(*jax.tree.leaves(jax.tree.unflatten(structure, changed)))
                sides.append(increment_by_hand(loop, network, state, 0.9, 0.4))
            slope[index] = (sides[0] - sides[1]) / (2 * step)
        moved = 7.0 * (error / 0.5) * 1.0 / 10.0 * slope + 0.3 * np.asarray(jax.tree.leaves(state.change)[which])
        assert np.abs(slope).max() > 1e-4
        got = np.asarray(jax.tree.leaves(following.network)[which]) - weights
        np.testing.assert_allclose(got, moved, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("gain", [2.0, -2.0])
def test_learning_lowers_the_error_of_direct_and_reverse_acting_loops_alike(gain):
    setpoint = np.sin(2 * np.pi * 0.5 * PERIOD * np.arange(1500))
    sign = math.copysign(1, gain)
    base = PID(sign * 0.5, sign * 1.0, 0.0)
    loop = lambda rate: backprop(base, learning_rate=rate, output_scale=1.0)  # noqa: E731
    frozen, learning = closed(loop(0.0), setpoint, gain)[0], closed(loop(10.0), setpoint, gain)[0]
    late = slice(1000, None)
    assert float(jnp.mean(learning[late] ** 2)) < 0.8 * float(jnp.mean(frozen[late] ** 2))
