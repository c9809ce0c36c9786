"""How a reference moves: angle and stiffness over time with their derivatives, jumps and corners rounded off."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.control import Constant, Multisine, Reference, Samples, Signal, Sine, Step
from mckibben.errors import ParameterError

Values = NDArray[np.float64]

_BOXES = 4
"""How many boxes in a row round a signal off: their convolution is a cubic spline, so that the third derivative of a
jump, which the valve has to follow, is still continuous but for steps of a bounded height."""


@dataclass(frozen=True)
class Motion:
    """A reference at moments, with what its motion asks for.

    Attributes
    ----------
    times
        Shape (moments,) [s].
    angle, velocity, acceleration, jerk
        The angle and its first three derivatives [rad], [rad/s], [rad/s^2], [rad/s^3].
    stiffness, stiffness_rate
        [N*m/rad], [N*m/(rad*s)].
    rounding
        The time [s] over which jumps and corners are rounded off.
    """

    times: Values
    angle: Values
    velocity: Values
    acceleration: Values
    jerk: Values
    stiffness: Values
    stiffness_rate: Values
    rounding: float


def motion_of(reference: Reference, times: Values, *, rounding: float) -> Motion:
    """Angle and stiffness of a reference with their derivatives.

    Constants, sines and sums of sines are differentiated exactly. Steps, samples and other signals have jumps or
    corners, where there is no derivative; they are rounded off first, see `rounded`.

    Parameters
    ----------
    reference
        The wish.
    times
        Evenly spaced, shape (moments,) [s].
    rounding
        The time [s] over which a jump or corner is spread.

    Examples
    --------
    >>> wish = Reference(angle=Sine(0.1, 0.5), stiffness=15.0)
    >>> motion = motion_of(wish, np.array([0.0, 0.5]), rounding=0.02)
    >>> motion.acceleration.round(4).tolist()  # -0.1 (2 pi 0.5)^2 at the crest
    [0.0, -0.987]
    """
    angle, velocity, acceleration, jerk = derivatives(reference.angle, times, 3, rounding=rounding)
    stiffness, stiffness_rate = derivatives(reference.stiffness, times, 1, rounding=rounding)
    return Motion(times, angle, velocity, acceleration, jerk, stiffness, stiffness_rate, rounding)


def is_smooth(signal: Signal) -> bool:
    """Whether a signal has all the derivatives that there are in closed form."""
    return isinstance(signal, Constant | Sine | Multisine)


def derivatives(signal: Signal, times: Values, order: int, *, rounding: float) -> list[Values]:
    """A signal and its derivatives up to an order, at evenly spaced times."""
    if isinstance(signal, Constant):
        return [np.full_like(times, float(signal.value)), *[np.zeros_like(times)] * order]
    if isinstance(signal, Sine):
        return _of_sine(signal, times, order)
    if isinstance(signal, Multisine):
        phases = signal.phases or (0.0,) * len(signal.amplitudes)
        parts = zip(signal.amplitudes, signal.frequencies, phases, strict=True)
        several = [_of_sine(Sine(a, f, 0.0, p), times, order) for a, f, p in parts]
        total = [np.sum([each[k] for each in several], axis=0) for k in range(order + 1)]
        return [total[0] + float(signal.offset), *total[1:]]
    return [rounded(signal, times, rounding, order=k) for k in range(order + 1)]


def _of_sine(sine: Sine, times: Values, order: int) -> list[Values]:
    a, w = float(sine.amplitude), 2 * math.pi * float(sine.frequency)
    phase = w * times + float(sine.phase)
    found = [a * w**k * np.sin(phase + k * math.pi / 2) for k in range(order + 1)]
    return [found[0] + float(sine.offset), *found[1:]]


def rounded(signal: Signal, times: Values, rounding: float, *, order: int = 0) -> Values:
    r"""A signal rounded off, or one of its first three derivatives.

    .. math:: \bar x(t) = \int x(t - s)\, B(s/w)/w\, ds, \quad w = R/4,

    with B the cubic B-spline: four moving averages over w in a row. What lies within R/2 of a jump or a corner is
    changed there; straight lines are not. A derivative is one moving average fewer and a difference over w in its
    place, which is exact but for the trapezoidal rule of the averages.

    Parameters
    ----------
    signal
        What to round off; beyond the first and last time it goes on as its reflection in the point there, so that
        the ends are no corners.
    times
        Evenly spaced, shape (moments,) [s].
    rounding
        R [s]; taken up to a multiple of four times the spacing.
    order
        0 for the value, up to 3 for a derivative.

    Examples
    --------
    >>> times = np.arange(401) * 1e-3
    >>> speed = rounded(Step(0.0, 1.0, 0.2), times, 0.1, order=1)
    >>> round(float(speed.max()), 1)  # 2/3 of the step in a quarter of the time
    26.6
    """
    values = np.asarray(signal(times), float)
    return rounded_values(values, _spacing(times), rounding, order=order)


def rounded_values(values: Values, step: float, rounding: float, *, order: int = 0) -> Values:
    """The same of values that are a step [s] apart."""
    if values.size < 2:
        return values if order == 0 else np.zeros_like(values)
    wide = window(rounding, step)
    values = np.pad(values, _BOXES * wide // 2, mode="reflect", reflect_type="odd")
    box = np.ones(wide + 1) / wide
    box[[0, -1]] /= 2
    difference = np.zeros(wide + 1)
    difference[0], difference[-1] = 1 / (wide * step), -1 / (wide * step)
    for k in range(_BOXES):
        values = np.convolve(values, difference if k < order else box, mode="valid")
    return values


def _spacing(times: Values) -> float:
    return float(times[-1] - times[0]) / max(len(times) - 1, 1)


def window(rounding: float, step: float) -> int:
    """The width of one moving average, in whole steps of time."""
    return max(math.ceil(rounding / (_BOXES * step) - 1e-9), 1)


def kinks(signal: Signal, times: Values) -> Values:
    """Where a signal has jumps or corners [s], between the first and the last time; all times if it is not known."""
    if is_smooth(signal):
        return np.empty(0)
    if isinstance(signal, Step):
        at = np.array([float(signal.at)]) if signal.before != signal.after else np.empty(0)
    elif isinstance(signal, Samples):
        at = _corners(np.asarray(signal.times, float), np.asarray(signal.values, float))
    else:
        at = times
    return at[(at > times[0]) & (at < times[-1])]


def _corners(times: Values, values: Values) -> Values:
    """Where the slope of straight lines between samples changes; there is none beyond them."""
    slopes = np.concatenate([[0.0], np.diff(values) / np.diff(times), [0.0]])
    change = np.abs(np.diff(slopes))
    return times[change > 1e-9 * max(float(np.abs(slopes).max()), 1e-30)]


def near(times: Values, at: ArrayLike, reach: float) -> NDArray[np.bool_]:
    """Which times lie within a reach of any of some moments."""
    at = np.sort(np.asarray(at, float))
    if not at.size:
        return np.zeros(times.shape, bool)
    after = np.searchsorted(at, times)
    before = np.abs(times - at[np.maximum(after - 1, 0)])
    return np.minimum(before, np.abs(at[np.minimum(after, at.size - 1)] - times)) <= reach


def centre_of(signal: Signal, times: Values) -> float:
    """About what a signal is made smaller.

    The offset of sines, the first value of a step, the value of a constant; of others the middle between the lowest
    and the highest.
    """
    match signal:
        case Sine() | Multisine():
            return float(signal.offset)
        case Step():
            return float(signal.before)
        case Constant():
            return float(signal.value)
    values = np.asarray(signal(times), float)
    return float(values.min() + values.max()) / 2


def scaled(signal: Signal, factor: float, about: float, centre: float, times: Values) -> Signal:
    """A centre plus a factor of what the signal is away from another, of the same kind wherever that can be.

    >>> scaled(Sine(0.2, 0.5, 0.1), 0.5, 0.1, 0.0, np.linspace(0.0, 1.0, 11))
    Sine(amplitude=0.1, frequency=0.5, offset=0.0)
    """

    def moved(value: float | Values) -> float | Values:
        return centre + factor * (value - about)

    match signal:
        case Constant():
            return Constant(float(moved(float(signal.value))))
        case Step():
            return Step(float(moved(float(signal.before))), float(moved(float(signal.after))), signal.at)
        case Sine():
            offset = float(moved(float(signal.offset)))
            return dataclasses.replace(signal, amplitude=factor * signal.amplitude, offset=offset)
        case Multisine():
            amplitudes = tuple(factor * amplitude for amplitude in signal.amplitudes)
            offset = float(moved(float(signal.offset)))
            return dataclasses.replace(signal, amplitudes=amplitudes, offset=offset)
        case Samples():
            return Samples(signal.times, moved(np.asarray(signal.values, float)))  # type: ignore[arg-type]
    return Samples(times, moved(np.asarray(signal(times), float)))  # type: ignore[arg-type]


def slowed(signal: Signal, factor: float) -> Signal:
    """The signal with its motion at a part of its speed: lower frequencies, samples further apart.

    Steps and constants stay as they are: a step has its moment, and no speed.

    Raises
    ------
    ParameterError
        For a signal of another kind.
    """
    match signal:
        case Constant() | Step():
            return signal
        case Sine():
            return dataclasses.replace(signal, frequency=factor * signal.frequency)
        case Multisine():
            return dataclasses.replace(signal, frequencies=tuple(factor * f for f in signal.frequencies))
        case Samples():
            times = np.asarray(signal.times, float)
            return Samples(times[0] + (times - times[0]) / factor, signal.values)  # type: ignore[arg-type]
    raise ParameterError(
        f"a {type(signal).__name__} cannot be slowed", value=signal, remedy="give it as sines or as samples"
    )
