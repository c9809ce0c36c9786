# ruff: noqa: E501 - tables of cases
"""Derivatives of references against finite differences; smoothing against the signal."""

import numpy as np
import pytest

from mckibben.control import Constant, Multisine, Ramp, Reference, Samples, Sine, Step
from mckibben.reachability.trajectory import breakpoints, derivatives, reference_trajectory, smoothed, smoothed_values

TIMES = np.arange(1001) * 1e-3


@pytest.mark.parametrize("signal", [Constant(3.0), Sine(0.2, 1.7, 0.1, 0.4), Multisine((0.2, 0.1), (1.0, 3.0), (0.0, 1.0), 0.3), Multisine((1.0,), (2.0,))])  # fmt: skip
@pytest.mark.slow
def test_smooth_signals_are_differentiated_exactly(signal):
    found = derivatives(signal, TIMES, 3, smoothing=0.1)
    np.testing.assert_allclose(found[0], np.asarray(signal(TIMES)), atol=1e-12)
    for k in range(3):
        steps = (found[k][2:] - found[k][:-2]) / 2e-3
        size = max(np.abs(found[k + 1]).max(), 1e-9)
        np.testing.assert_allclose(found[k + 1][1:-1], steps, atol=1e-4 * size)


def test_a_sampled_sine_has_the_derivatives_of_the_sine():
    sine = Sine(0.1, 2.0, 0.3, 0.5)
    exact = derivatives(sine, TIMES, 3, smoothing=0.1)
    found = derivatives(Samples(TIMES, np.asarray(sine(TIMES))), TIMES, 3, smoothing=0.008)
    for k in range(4):
        inner = np.abs(found[k] - exact[k])[20:-20].max()
        assert inner < 2e-4 * np.abs(exact[k] - exact[k].mean()).max(), k


def test_a_step_changes_within_the_smoothing_width_only():
    step = Step(1.0, 3.0, 0.5)
    value, speed, acceleration, jerk = (smoothed(step, TIMES, 0.2, order=k) for k in range(4))
    assert np.all(value[TIMES < 0.4 - 1e-9] == 1.0)
    np.testing.assert_allclose(value[TIMES > 0.6], 3.0, atol=1e-12)
    assert np.all(np.diff(value) > -1e-12)
    assert speed.max() == pytest.approx(2 * (2 / 3) / 0.05, rel=5e-3)  # of the cubic spline, 2/3 in the middle
    np.testing.assert_allclose(np.gradient(value, 1e-3)[1:-1], speed[1:-1], atol=0.1)
    np.testing.assert_allclose(np.gradient(speed, 1e-3)[1:-1], acceleration[1:-1], atol=0.01 * acceleration.max())
    area = np.cumsum(jerk) * 1e-3
    np.testing.assert_allclose(area, acceleration, atol=0.03 * acceleration.max())


def test_straight_lines_stay_and_ends_are_no_corners():
    ramp = Samples(np.array([0.0, 1.0]), np.array([0.0, 2.0]))
    np.testing.assert_allclose(smoothed(ramp, TIMES, 0.3), 2 * TIMES, atol=1e-12)
    np.testing.assert_allclose(smoothed(ramp, TIMES, 0.3, order=1), 2.0, atol=1e-9)
    np.testing.assert_allclose(smoothed(ramp, TIMES, 0.3, order=2), 0.0, atol=1e-6)


def test_one_moment_stands_still():
    assert smoothed_values(np.array([2.0]), 1.0, 0.1).tolist() == [2.0]
    motion = reference_trajectory(Reference(Step(0.0, 1.0, 0.0), 15.0), np.array([0.0]), smoothing=0.1)
    assert (motion.velocity.tolist(), motion.stiffness.tolist()) == ([0.0], [15.0])


def test_jumps_and_corners_are_found():
    assert breakpoints(Sine(1.0, 1.0), TIMES).size == 0
    assert breakpoints(Step(0.0, 1.0, 0.25), TIMES).tolist() == [0.25]
    assert breakpoints(Step(1.0, 1.0, 0.25), TIMES).size == 0
    assert breakpoints(Step(0.0, 1.0, 2.0), TIMES).size == 0, "after the run"
    bent = Samples(np.array([0.0, 0.2, 0.4, 0.6]), np.array([0.0, 1.0, 2.0, 2.0]))
    assert breakpoints(bent, TIMES).tolist() == [0.4]
    assert breakpoints(Ramp(0.0, 1.0, start=0.1, duration=0.4), TIMES).tolist() == [0.1, 0.5]
    held = Samples(np.array([0.1, 0.5]), np.array([0.0, 1.0]))
    assert breakpoints(held, TIMES).tolist() == [0.1, 0.5], "before and after its samples a signal stands still"
