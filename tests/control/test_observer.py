"""Observers: their poles, what they find, and what they cannot."""

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from mckibben.control import ExtendedStateObserver, PressureObserver, VelocityObserver

PERIOD = 1e-3
ORDER = {VelocityObserver: 2, ExtendedStateObserver: 3}


@pytest.mark.parametrize("kind", ORDER)
def test_all_poles_of_the_error_lie_where_the_bandwidth_says(kind):
    gains = np.array([float(g) for g in kind(bandwidth=120.0).gains(PERIOD)])
    move = np.array([[1, PERIOD, PERIOD**2 / 2], [0, 1, PERIOD], [0, 0, 1]])
    n = ORDER[kind]
    error = ((np.eye(3) - np.outer(gains, [1, 0, 0])) @ move)[:n, :n]
    expected = np.poly([np.exp(-120.0 * PERIOD)] * n)  # compared as polynomials: multiple roots are ill-conditioned
    np.testing.assert_allclose(np.poly(error), expected, rtol=1e-12, atol=1e-14)


def test_with_a_damping_of_two_it_is_the_steady_kalman_filter():
    """For white noise of the angle and a disturbance of independent increments; SciPy, in continuous time."""
    bandwidth, period = 120.0, 1e-6
    move, white, jerk = np.diag([1.0, 1.0], 1), np.eye(1), np.diag([0.0, 0.0, 1.0])
    covariance = solve_continuous_are(move.T, np.eye(3)[:, :1], jerk, white)  # for a bandwidth of 1
    gains = [float(gain) / period for gain in ExtendedStateObserver(bandwidth, damping=2.0).gains(period)]
    np.testing.assert_allclose(gains, covariance[:, 0] * bandwidth ** np.arange(1, 4), rtol=1e-3)


def watched(observer, missing, periods=400):
    """What is estimated of an angle that moves by a known acceleration and one that the model misses; and the truth."""
    times = PERIOD * np.arange(periods)
    angle, velocity = (
        0.1 - 0.02 * np.cos(10 * times) + missing * times**2 / 2,
        0.2 * np.sin(10 * times) + missing * times,
    )
    motion = observer.init(angle[0], 2.0)
    for k in range(1, periods):
        motion = observer.step(motion, angle[k], 2.0 * np.cos(10 * times[k]), PERIOD)
    return motion, angle[-1], velocity[-1]


@pytest.mark.slow
def test_it_finds_velocity_and_disturbance():
    motion, angle, velocity = watched(ExtendedStateObserver(bandwidth=100.0), missing=3.0)
    assert float(motion.disturbance) == pytest.approx(3.0, abs=1e-3)
    assert float(motion.velocity) == pytest.approx(velocity, abs=1e-5)
    assert float(motion.angle) == pytest.approx(angle, abs=1e-7)
    assert float(motion.acceleration) == pytest.approx(2.0 * np.cos(10 * 0.399) + 3.0, abs=1e-3)


def test_without_disturbance_it_reads_the_velocity_wrong_by_what_it_says():
    motion, _, velocity = watched(VelocityObserver(bandwidth=100.0), missing=3.0)
    assert float(motion.velocity) - velocity == pytest.approx(-2 * 3.0 / 100.0, rel=0.05)
    assert float(motion.disturbance) == 0.0


@pytest.mark.slow
def test_pressures_lose_their_noise_and_nothing_else():
    observer, rng = PressureObserver(bandwidth=200.0), np.random.default_rng(1)
    share = 1 - np.exp(-PERIOD / 0.02)
    pressure, estimated, off = np.array([1e5, 2e5]), (1e5, 2e5), []
    for k in range(2000):
        command = np.array([3e5, 1e5]) if (k // 100) % 2 else np.array([1e5, 2e5])
        pressure = pressure + share * (command - pressure)
        sensed = pressure + rng.normal(size=2) * 4e3
        predicted = np.asarray(estimated) + share * (command - np.asarray(estimated))
        estimated = observer.step(tuple(predicted), tuple(sensed), PERIOD)
        off.append(np.asarray(estimated) - pressure)
    trust = 1 - np.exp(-0.2)
    assert np.std(off[100:]) == pytest.approx(4e3 * np.sqrt(trust / (2 - trust)), rel=0.1)


def test_a_wrong_valve_is_forgotten_with_the_bandwidth():
    observer, estimated = PressureObserver(bandwidth=200.0), (2e5, 2e5)
    for _ in range(50):  # the valve is stuck; it is estimated to follow
        predicted = tuple(one + 0.05 * (u - one) for one, u in zip(estimated, (3e5, 1e5), strict=True))
        estimated = observer.step(predicted, (2e5, 2e5), PERIOD)
    pull = 0.05 * np.exp(-0.2)
    assert float(estimated[0]) == pytest.approx(2e5 + 1e5 * pull / (1 - np.exp(-0.2) * 0.95), rel=1e-6)
