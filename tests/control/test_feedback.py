"""Feedback that brakes in time, against the motion of a triple integrator with a limited jerk."""

import jax
import numpy as np
import pytest

from mckibben.control.feedback import braked

KP, KD, JERK = 40.0**2 / 2.5, 40.0, 2000.0
program = jax.jit(lambda error, rate: braked(error, rate, KP, KD, JERK))


def test_for_small_errors_it_is_linear():
    error, rate = np.array([1e-3, -2e-3, 0.0]), np.array([0.0, 0.01, -0.02])
    np.testing.assert_allclose(program(error, rate), KD * rate + KP * error, rtol=1e-12)


def test_it_is_smooth_where_it_leaves_the_line():
    """By error and by rate: no jump of the value, nor of the slope, which nowhere exceeds that of the line."""
    step = 1e-5
    for values, steepest in (
        (program(np.arange(0.0, 0.5, step), np.zeros(50_000)), KP),
        (program(np.zeros(50_000), np.arange(0.0, 5.0, 10 * step)), 10 * KD),
    ):
        slopes = np.diff(np.asarray(values)) / step
        assert np.all((slopes > 0) & (slopes < steepest * (1 + 1e-6)))
        assert np.abs(np.diff(slopes)).max() < 2e-3 * steepest


def test_the_acceleration_can_be_taken_off_within_the_velocity():
    rates = np.array([2.0, -5.0, 100.0])
    acceleration = np.asarray(program(np.zeros(3), rates))
    assert np.all(acceleration * rates > 0) and np.all(acceleration**2 / (2 * JERK) < np.abs(rates))


@pytest.mark.parametrize("error", [1.0, -20.0])
def test_far_away_the_velocity_can_be_taken_off_within_the_distance(error):
    """The acceleration vanishes at the velocity from which the integrator needs the distance to the end of the line."""
    linear = 4 / 9 * JERK / (KP / KD) ** 3
    velocity = -np.sign(error) * np.cbrt(JERK * (abs(error) - linear / 3) ** 2)
    assert float(program(error, velocity)) == pytest.approx(0.0, abs=1e-6)
    assert abs(velocity) ** 1.5 / np.sqrt(JERK) < abs(error)
