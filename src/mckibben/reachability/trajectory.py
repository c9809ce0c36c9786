"""Reference trajectories: derivatives, smoothing of jumps and corners, scaling of amplitude and speed."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.control import Constant, Multisine, Ramp, Reference, Samples, Signal, Sine, Step
from mckibben.numerics.compiled import jit

Values = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceTrajectory:
    """A sampled reference with its derivatives, each of shape (samples,).

    Times [s], angle and its first three derivatives [rad], [rad/s], ..., stiffness [N*m/rad] and its rate, and the
    width [s] of the kernel that smooths jumps and corners.
    """

    times: Values
    angle: Values
    velocity: Values
    acceleration: Values
    jerk: Values
    stiffness: Values
    stiffness_rate: Values
    smoothing: float

    def scaled(self, *, amplitude: float = 1.0, speed: float = 1.0) -> ReferenceTrajectory:
        """The trajectory with factors on the amplitude of the angle, about its midrange, and on the speed."""
        centre = (self.angle.min() + self.angle.max()) / 2
        return dataclasses.replace(
            self,
            times=self.times / speed,
            angle=centre + amplitude * (self.angle - centre),
            velocity=amplitude * speed * self.velocity,
            acceleration=amplitude * speed**2 * self.acceleration,
            jerk=amplitude * speed**3 * self.jerk,
            stiffness_rate=speed * self.stiffness_rate,
        )


def reference_trajectory(reference: Reference, times: Values, *, smoothing: float) -> ReferenceTrajectory:
    """Sample a reference and its derivatives at evenly spaced times [s].

    Constants, sines and sums of sines are differentiated exactly; steps, samples and other signals are first smoothed
    by a kernel of the given width [s].

    Examples
    --------
    >>> reference = Reference(angle=Sine(0.1, 0.5), stiffness=15.0)
    >>> trajectory = reference_trajectory(reference, np.array([0.0, 0.5]), smoothing=0.02)
    >>> trajectory.acceleration.round(4).tolist()  # -0.1 (2 pi 0.5)^2 at the crest
    [0.0, -0.987]
    """
    angle, velocity, acceleration, jerk = derivatives(reference.angle, times, 3, smoothing=smoothing)
    stiffness, stiffness_rate = derivatives(reference.stiffness, times, 1, smoothing=smoothing)
    return ReferenceTrajectory(times, angle, velocity, acceleration, jerk, stiffness, stiffness_rate, smoothing)


def derivatives(signal: Signal, times: Values, order: int, *, smoothing: float) -> list[Values]:
    """A signal and its derivatives up to an order, at evenly spaced times."""
    if isinstance(signal, Constant):
        return [np.full_like(times, float(signal.value)), *[np.zeros_like(times)] * order]
    if isinstance(signal, Sine):
        return _sine_derivatives(signal, times, order)
    if isinstance(signal, Multisine):
        phases = signal.phases or (0.0,) * len(signal.amplitudes)
        parts = zip(signal.amplitudes, signal.frequencies, phases, strict=True)
        terms = [_sine_derivatives(Sine(a, f, 0.0, p), times, order) for a, f, p in parts]
        total = [np.sum([term[k] for term in terms], axis=0) for k in range(order + 1)]
        return [total[0] + float(signal.offset), *total[1:]]
    return [smoothed(signal, times, smoothing, order=k) for k in range(order + 1)]


def _sine_derivatives(sine: Sine, times: Values, order: int) -> list[Values]:
    a, w = float(sine.amplitude), 2 * math.pi * float(sine.frequency)
    phase = w * times + float(sine.phase)
    derivatives = [a * w**k * np.sin(phase + k * math.pi / 2) for k in range(order + 1)]
    return [derivatives[0] + float(sine.offset), *derivatives[1:]]


def smoothed(signal: Signal, times: Values, width: float, *, order: int = 0) -> Values:
    """A signal convolved with a cubic B-spline of a width [s], or a derivative; continued by point reflection."""
    period = float(times[-1] - times[0]) / max(len(times) - 1, 1)
    values = np.asarray(_at(signal, times) if isinstance(signal, Signal) else signal(times), float)
    return smoothed_values(values, period, width, order=order)


@jit
def _at(signal: Signal, times: Values) -> object:
    return signal(times)


def smoothed_values(values: Values, period: float, width: float, *, order: int = 0, averages: int = 4) -> Values:
    """Return smoothed samples at a period [s], or a derivative of them, of the same shape (samples,).

    The kernel of four successive moving averages is a cubic B-spline: the third derivative of a smoothed jump is
    bounded.

    A straight line stays as it is, up to its ends:

    >>> smoothed_values(np.arange(6.0), 0.1, 0.2, order=1).round(9)
    array([10., 10., 10., 10., 10., 10.])
    """
    if values.size < 2:
        return values if order == 0 else np.zeros_like(values)
    window = max(math.ceil(width / (averages * period) - 1e-9), 1)
    values = np.pad(values, averages * window // 2, mode="reflect", reflect_type="odd")
    average = np.ones(window + 1) / window
    average[[0, -1]] /= 2
    difference = np.zeros(window + 1)
    difference[0], difference[-1] = 1 / (window * period), -1 / (window * period)
    for k in range(averages):
        values = np.convolve(values, difference if k < order else average, mode="valid")
    return values


def breakpoints(signal: Signal, times: Values) -> Values:
    """Return jumps and corners of a signal [s] between the first and the last time; all times if unknown.

    >>> breakpoints(Ramp(0.0, 1.0, start=0.5, duration=1.0), np.linspace(0.0, 2.0, 5))
    array([0.5, 1.5])
    """
    match signal:
        case Constant() | Sine() | Multisine():
            return np.empty(0)
        case Step():
            at = np.array([float(signal.at)]) if signal.before != signal.after else np.empty(0)
        case Ramp():
            at = np.array([float(signal.start), float(signal.start) + float(signal.duration)])
        case Samples():
            at = _corners(np.asarray(signal.times, float), np.asarray(signal.values, float))
        case _:
            at = times
    return at[(at > times[0]) & (at < times[-1])]


def _corners(times: Values, values: Values) -> Values:
    """Samples at which the slope of the linear interpolation changes; it is 0 beyond the ends."""
    slopes = np.concatenate([[0.0], np.diff(values) / np.diff(times), [0.0]])
    change = np.abs(np.diff(slopes))
    return times[change > 1e-9 * max(float(np.abs(slopes).max()), 1e-30)]


def is_near(times: Values, at: ArrayLike, tolerance: float) -> NDArray[np.bool_]:
    """Return the mask of the times [s] within a tolerance of any of the times `at`.

    >>> is_near(np.array([0.0, 0.1, 0.2]), [0.11], 0.02)
    array([False,  True, False])
    """
    at = np.concatenate([[-np.inf], np.sort(np.asarray(at, float)), [np.inf]])
    after = np.searchsorted(at, times)
    return np.minimum(times - at[after - 1], at[after] - times) <= tolerance
