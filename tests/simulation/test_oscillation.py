"""Limit cycles: their amplitude and period, and what is none."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from mckibben.simulation.oscillation import Signals, find_limit_cycle, find_oscillations
from mckibben.units import bar, deg

PERIOD = 1e-3
TIMES = np.arange(3000) * PERIOD
STILL = np.zeros(3000)


def found(error, desired=STILL, resolution=0.0):
    amplitude, period = find_limit_cycle(jnp.asarray(error + desired), jnp.asarray(desired), PERIOD, resolution)
    return float(amplitude) / deg, float(period)


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.0, 1.5])
def test_its_amplitude_and_period_are_found(start):
    error = np.where(TIMES < start, 0.0, 2 * deg * np.sin(2 * np.pi * 7 * TIMES))
    amplitude, period = found(error)
    assert amplitude == pytest.approx(2.0, rel=0.08)
    assert period == pytest.approx(1 / 7, rel=0.05)


def test_beside_a_moving_reference_it_is_found_too():
    desired = 8 * deg * np.sin(2 * np.pi * TIMES)
    error = 1.5 * deg * np.sin(2 * np.pi * TIMES + 1) + 2 * deg * np.sin(2 * np.pi * 6 * TIMES)
    amplitude, period = found(error, desired)
    assert amplitude == pytest.approx(2.0, rel=0.3)
    assert period == pytest.approx(1 / 6, rel=0.1)


@pytest.mark.parametrize("frequency", [1.0, 4.0])
def test_the_error_of_a_late_joint_is_none(frequency):
    wave = 2 * np.pi * frequency * TIMES
    assert found(2 * deg * np.sin(wave + 1) + 0.3 * deg * np.sin(3 * wave), 8 * deg * np.sin(wave))[0] == 0.0


def test_that_of_a_joint_late_on_a_small_reference_is_none_either():
    wave = 2 * np.pi * 4 * TIMES
    assert found(0.3 * deg * np.sin(wave + 1), 0.15 * deg * np.sin(wave))[0] == 0.0  # the least amplitude is 0.1 deg


@pytest.mark.parametrize("ratio", [0.8, 0.93])
def test_a_joint_that_swings_after_each_disturbance_has_none(ratio):
    since = np.mod(TIMES, 0.8)  # of the last disturbance
    swings = ratio ** (since / 0.06) * np.sin(2 * np.pi * since / 0.12)
    assert found(np.sin(2 * np.pi * TIMES / 0.12) * deg)[0] > 0
    assert found(swings * deg)[0] == 0.0


def test_one_is_found_although_its_swings_vary_and_a_transient_precedes_it():
    size = 1 + 0.3 * np.random.default_rng(1).uniform(-1, 1, 50)[np.searchsorted(np.arange(50) * 0.1, TIMES) % 50]
    error = (size + 4 * np.exp(-6 * TIMES)) * np.sin(2 * np.pi * 5 * TIMES)
    assert found(error * deg)[1] == pytest.approx(0.2, rel=0.1)


def test_noise_and_single_swings_are_none():
    noise = np.random.default_rng(0).normal(size=3000) * 0.02 * deg
    pulses = 3 * deg * (np.sin(2 * np.pi * TIMES / 0.8) > 0.9)
    assert found(noise)[0] == 0.0
    assert found(noise + pulses)[0] == 0.0


def test_one_that_grows_is_found():
    amplitude, period = found(0.1 * deg * np.exp(TIMES) * np.sin(2 * np.pi * 10 * TIMES))
    assert amplitude > 0.1 and period == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize(("step", "is_one"), [(0.022, True), (0.14, True), (0.16, False), (0.35, False)])
def test_the_least_amplitude_is_two_steps_of_the_encoder(step, is_one):
    error = 0.3 * deg * np.sin(2 * np.pi * 7 * TIMES)
    assert (found(error, resolution=step * deg)[0] > 0) == is_one


# Commands
searched = jax.jit(lambda signals: find_oscillations(signals, PERIOD))


def oscillations(command, angle=STILL):
    return searched(Signals(angle, STILL, (STILL, command)))


def travel_with_play(command, play):
    """Travel of what is pushed by a command that has this play between two stops."""
    position, travel = command[0] - play / 2, 0.0
    for value in command:
        pushed = min(max(position, value - play / 2), value + play / 2)
        position, travel = pushed, travel + abs(pushed - position)
    return travel


def test_a_command_that_reverses_209_times_a_second_is_counted_though_the_angle_is_quiet():
    found = oscillations(3 * bar + 0.36 * bar * np.sin(2 * np.pi * 104.5 * TIMES))
    assert float(found.angle) == 0.0
    assert float(found.reversals) == pytest.approx(209, rel=0.01)
    assert float(found.travel) == pytest.approx(209 * (2 * 0.36 - 0.1) * bar, rel=0.03)


@pytest.mark.parametrize("shape", ["white", "filtered", "sine", "steps"])
@pytest.mark.parametrize("size", [0.01, 0.1, 1.0])
def test_a_valve_follows_its_command_with_a_play_of_its_hysteresis(shape, size):
    noise = np.random.default_rng(0).normal(size=3000)
    signals = {
        "white": noise,
        "filtered": 10 * np.convolve(noise, np.ones(10) / 10, mode="same"),
        "sine": np.sin(2 * np.pi * 3 * TIMES),
        "steps": np.round(2 * np.sin(2 * np.pi * TIMES)),
    }
    command = 3 * bar + size * bar * signals[shape]
    found = oscillations(command)
    assert float(found.travel) * 3 == pytest.approx(travel_with_play(command, 0.1 * bar), rel=1e-9, abs=1.0)
    assert float(found.travel) * 3 <= np.abs(np.diff(command)).sum()


def test_noise_within_the_hysteresis_of_a_valve_neither_moves_it_nor_reverses_it():
    noise = np.random.default_rng(0).uniform(-0.049, 0.049, size=3000) * bar
    found = oscillations(3 * bar + noise)
    assert float(found.reversals) == 0.0 and float(found.travel) * 3 < 0.1 * bar


def test_a_relay_has_the_limit_cycle_of_its_describing_function():
    """1 / (s (s + 1)^2) has the phase -180 deg and the gain 1/2 at 1 rad/s: 4 / pi / 2 of the relay's amplitude."""
    plant = [[-2.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[1.0], [0.0], [0.0]], [[0.0, 0.0, 1.0]], [[0.0]]
    a, b, c, *_ = cont2discrete(tuple(map(np.array, plant)), rate := 0.02)
    state, relay, angles = np.array([0.0, 0.0, 0.1]), 1.0, []
    for _ in range(3000):
        angle = float((c @ state)[0])
        relay = -1.0 if angle > 0 else 1.0
        angles.append(angle)
        state = a @ state + b[:, 0] * relay
    scale = 5 * deg  # of the relay's torque
    found = oscillations(STILL, angle=scale * np.array(angles))
    assert float(found.angle) == pytest.approx(scale * 2 / np.pi, rel=0.1)
    assert float(found.period) * rate / PERIOD == pytest.approx(2 * np.pi, rel=0.05)


@pytest.mark.parametrize("damping", [0.0, 0.01, 0.03, 0.1, 0.3])
@pytest.mark.parametrize("frequency", [5.0, 40.0])
def test_a_free_vibration_of_a_damped_oscillator_decays_and_is_no_cycle(damping, frequency):
    rate = 2 * np.pi * frequency
    swing = solve_ivp(
        lambda _, y: [y[1], -2 * damping * rate * y[1] - rate**2 * y[0]],
        (0, TIMES[-1]),
        [1.0, 0.0],
        t_eval=TIMES,
        rtol=1e-6,
    ).y[0]
    assert (float(oscillations(STILL, angle=5 * deg * swing).angle) > 0) == (damping == 0.0)
