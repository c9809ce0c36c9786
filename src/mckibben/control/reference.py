"""References: signals over time, and their derivatives from samples."""

from __future__ import annotations

import abc
from numbers import Real
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.errors import RangeError
from mckibben.numerics.batching import RANK
from mckibben.numerics.elementary import floating, sin
from mckibben.units import Frequency, Instant, Phase, SignalValue


class Signal(eqx.Module):
    """A quantity over time [s], in SI."""

    @abc.abstractmethod
    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        """The value at each time."""


class Constant(Signal):
    """The same value always."""

    value: SignalValue

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.full_like(floating(time), self.value)


class Step(Signal):
    """One value before a time [s], another from then on."""

    before: SignalValue
    after: SignalValue
    at: Instant

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.where(floating(time) < self.at, self.before, self.after) * 1.0


class Sine(Signal):
    """offset + amplitude sin(2 pi frequency t + phase); frequency in Hz, phase in rad."""

    amplitude: SignalValue
    frequency: Frequency
    offset: SignalValue = 0.0
    phase: Phase = 0.0

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        cycles = self.frequency * floating(time)
        part = cycles - jnp.round(cycles)  # a fast sine is good for small angles, and whole cycles change nothing
        return self.offset + self.amplitude * sin(2 * jnp.pi * part + self.phase)


class Multisine(Signal):
    """offset + a sum of sines; one amplitude, frequency [Hz] and phase [rad] each."""

    amplitudes: tuple[SignalValue, ...]
    frequencies: tuple[Frequency, ...]
    phases: tuple[Phase, ...] = ()
    offset: SignalValue = 0.0

    def __check_init__(self) -> None:
        counts = {len(self.amplitudes), len(self.frequencies), len(self.phases or self.amplitudes)}
        if len(counts) != 1:
            raise RangeError(
                f"a multisine has {len(self.amplitudes)} amplitudes, {len(self.frequencies)} frequencies and "
                f"{len(self.phases)} phases",
                remedy="give one of each for every sine",
            )

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        total = jnp.full_like(floating(time), self.offset)
        phases = self.phases or (0.0,) * len(self.amplitudes)
        for amplitude, frequency, phase in zip(self.amplitudes, self.frequencies, phases, strict=True):
            total = total + Sine(amplitude, frequency, 0.0, phase)(time)
        return total


class Samples(Signal):
    """Straight lines between samples; the first and last value beyond them.

    Parameters
    ----------
    times
        Rising times [s].
    values
        One value for each.
    """

    times: Float[Array, " n"] = eqx.field(converter=lambda x: floating(x), metadata={RANK: 1})
    values: Float[Array, " n"] = eqx.field(converter=lambda x: floating(x), metadata={RANK: 1})

    def __check_init__(self) -> None:
        times, values = (shape[-1] if shape else 0 for shape in (self.times.shape, self.values.shape))
        if times != values or times == 0:
            raise RangeError(f"{times} times do not go with {values} values; give one value a time")
        if not bool(jnp.all(jnp.diff(self.times) > 0)):
            raise RangeError("the times of a sampled signal must rise", remedy="sort them and remove repeats")

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.interp(floating(time), self.times, self.values)


class Sum(Signal):
    """Several signals added up.

    >>> wish = Sum((Step(13.0, 17.0, at=5.0), Sine(0.5, frequency=1.0)))
    >>> round(float(wish(5.25)), 9)
    17.5
    """

    parts: tuple[Signal, ...]

    def __check_init__(self) -> None:
        if not self.parts:
            raise RangeError("a sum of no signals", remedy="give at least one")

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        total = self.parts[0](time)
        for part in self.parts[1:]:
            total = total + part(time)
        return total


def as_signal(wish: Signal | ArrayLike) -> Signal:
    """A signal as it is, a number (or one a run) as a constant."""
    return Constant(wish) if isinstance(wish, Real | np.ndarray | Array) else wish  # type: ignore[arg-type]


Scalar = Float[Array, ""]

_SUDDEN = 1000.0  # rad/s^2: above it a wish does not move but jump; 10 deg at 4 Hz take 110
_SMOOTHED = 3.0  # periods: the time constant of the jerk, so that rounding does not come through


class Course(NamedTuple):
    """Where a wish is and how it moves.

    Attributes
    ----------
    angle
        The last sample [rad].
    velocity, acceleration, jerk
        Of the wish, [rad/s], [rad/s^2] and [rad/s^3]: backward differences.
    since
        Control periods since the wish jumped, 3 at most: so many differences are of one piece. -1 before the first.
    """

    angle: Scalar
    velocity: Scalar
    acceleration: Scalar
    jerk: Scalar
    since: Scalar

    def ahead(self, time: ArrayLike, period: ArrayLike) -> Scalar:
        """The acceleration [rad/s^2] so long [s] after the last sample; differences are one period old themselves."""
        return self.acceleration + (time + period) * self.jerk


def standing(angle: ArrayLike) -> Course:
    """Before the first sample of a wish: it stands at an angle [rad]."""
    angle = floating(angle)
    nothing = jnp.zeros_like(angle)
    return Course(angle, nothing, nothing, nothing, nothing - 1.0)


def followed(course: Course, angle: ArrayLike, period: ArrayLike) -> Course:
    """The course with one more sample [rad], a control period [s] after the last.

    A wish that jumps, or whose velocity does, has no acceleration that a joint could follow. There the velocity stays
    what it was for one period, and is taken anew from what comes after.
    """
    difference = (angle - course.angle) / period
    change = (difference - course.velocity) / period
    jumps = (jnp.abs(change) > _SUDDEN) & (course.since >= 1.0)
    since = jnp.where(jumps, 0.0, jnp.minimum(course.since + 1.0, 3.0))
    acceleration = jnp.where(since >= 2.0, change, 0.0)
    jerk = course.jerk + ((acceleration - course.acceleration) / period - course.jerk) / (1 + _SMOOTHED)
    return Course(
        angle=floating(angle),
        velocity=jnp.where(since >= 1.0, difference, course.velocity),
        acceleration=acceleration,
        jerk=jnp.where(since >= 3.0, jerk, 0.0),
        since=since,
    )
