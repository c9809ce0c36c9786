"""PID against a textbook loop in plain Python."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.control import PID, BackpropPID
from mckibben.errors import RangeError

PERIOD = 0.01


class Textbook:
    """Rectangular integral, filtered backward difference, back-calculation."""

    def __init__(self, kp, ki, kd, tf, tt, on_error, output):
        self.kp, self.ki, self.kd, self.tf, self.tt, self.on_error = kp, ki, kd, tf, tt, on_error
        self.i, self.d, self.last = output, 0.0, None

    def start(self, setpoint, measured):
        self.last, self.change = (setpoint, measured), 0.0

    def __call__(self, setpoint, measured, low, high):
        e = setpoint - measured
        change, before = setpoint - self.last[0], self.change
        minmod = min(change, before, key=abs) if self.on_error and change * before > 0 else 0.0
        self.d = (self.tf * self.d + minmod - (measured - self.last[1])) / (self.tf + PERIOD)
        self.last, self.change = (setpoint, measured), change
        self.i += self.ki * e * PERIOD
        u = self.kp * e + self.i + self.kd * self.d
        achieved = min(max(u, low), high)
        self.i += min(PERIOD / self.tt, 1.0) * (achieved - u) if self.tt > 0 else achieved - u
        return u, achieved


@jax.jit
def run(pid, setpoint, measured, start, low, high):
    """All outputs, and what was achieved of them."""

    def period(state, sample):
        state, output = pid.step(state, sample[0], sample[1], PERIOD)
        achieved = jnp.clip(output, low, high)
        return pid.track(state, output, achieved, PERIOD), (output, achieved)

    return lax.scan(period, pid.init(setpoint[0], measured[0], start), (setpoint, measured))[1]


def signals(seed=0, count=300):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=count)) * 0.1, np.cumsum(rng.normal(size=count)) * 0.1


@pytest.mark.parametrize("on_error", [False, True])
@pytest.mark.parametrize(
    ("gains", "limits"),
    [
        ((3.0, 4.0, 0.2, 0.02, 0.05), (-1e9, 1e9)),
        ((3.0, 4.0, 0.2, 0.02, 0.05), (-1.0, 1.5)),
        ((-3.0, -4.0, -0.2, 0.02, 0.05), (-1.0, 1.5)),
        ((2.0, 8.0, 0.0, 0.0, 0.001), (-1.0, 1.5)),  # tracks at once
        ((2.0, 8.0, 0.3, 0.0, 0.0), (-1.0, 1.5)),  # unfiltered
    ],
)
def test_it_is_the_textbooks_pid(gains, limits, on_error):
    setpoint, measured = signals()
    book = Textbook(*gains, on_error, 0.7)
    book.start(setpoint[0], measured[0])
    expected = [book(float(d), float(m), *limits) for d, m in zip(setpoint, measured, strict=True)]
    *direct, filter_time, tracking_time = (jnp.asarray(g) for g in gains)
    pid = PID(*direct, filter_time=filter_time, tracking_time=tracking_time, derivative_on_error=on_error)
    got = run(pid, setpoint, measured, 0.7, *limits)
    np.testing.assert_allclose(np.array(got).T, expected, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("tracking", [0.0, 0.05])
@pytest.mark.parametrize("learning", [False, True])
def test_without_integral_action_saturation_leaves_no_bias(tracking, learning):
    setpoint, measured = np.where(np.arange(60) < 30, 5.0, 0.0), np.zeros(60)
    pid = PID(2.0, 0.0, 0.0, tracking_time=tracking)
    scales = {"signal_scale": 1.0, "error_scale": 1.0, "output_scale": 1.0, "learning_rate": 0.0}
    output, achieved = run(BackpropPID(pid, **scales) if learning else pid, setpoint, measured, 0.3, -1.0, 1.0)
    assert np.all(np.asarray(achieved[:30]) == 1.0)
    # The initial output stays; the velocity form of BP starts from no error, so its first step is one of the error.
    np.testing.assert_allclose(output, 0.3 + 2.0 * setpoint, rtol=1e-12)


def test_gains_of_two_signs_in_one_run_are_refused_in_arrays_too():
    PID(np.array([1.0, -1.0]), np.array([2.0, -2.0]), 0.0)
    with pytest.raises(RangeError, match="kp is positive, ki is negative"):
        PID(np.array([1.0, 1.0]), np.array([2.0, -2.0]), 0.0)
