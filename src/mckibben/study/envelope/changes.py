"""The same reference smaller, about another centre, or slower: signals with other numbers."""

from __future__ import annotations

import dataclasses

import numpy as np

from mckibben.control import Constant, Multisine, Samples, Signal, Sine, Step
from mckibben.errors import ParameterError
from mckibben.study.envelope.motion import Values


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
