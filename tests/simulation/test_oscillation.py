"""Limit cycles: their amplitude and period, and what is none."""

import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.simulation.oscillation import find_limit_cycle
from mckibben.units import deg

PERIOD = 1e-3
TIMES = np.arange(3000) * PERIOD
STILL = np.zeros(3000)


def found(error, desired=STILL, resolution=0.0):
    amplitude, period = find_limit_cycle(jnp.asarray(error + desired), jnp.asarray(desired), PERIOD, resolution)
    return float(amplitude) / deg, float(period)


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


def test_an_oscillation_that_decays_is_none():
    assert found(8 * deg * np.exp(-4 * TIMES) * np.cos(2 * np.pi * 3 * TIMES))[0] == 0.0


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
