"""References: signals over time, and derivatives from their samples."""

from __future__ import annotations

import abc
import math
from numbers import Real
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component, Inherited
from mckibben.component.checks import check_count, check_within, known_numbers
from mckibben.errors import RangeError
from mckibben.numerics.batching import RANK
from mckibben.numerics.elementary import floating, sin
from mckibben.storage.columns import read_columns
from mckibben.units import Duration, Frequency, Instant, Phase, PositiveTime, Seed, SignalValue


class Signal(Component):
    """Quantity over time [s], in SI."""

    @classmethod
    def from_file(cls, value: object) -> object:
        """Return a section of a constant for a quantity alone."""
        numeric = isinstance(value, int | float) or (isinstance(value, str) and value[:1] in "+-.0123456789")
        return {"class": "constant", "value": value} if numeric and value != "" else value

    @classmethod
    def to_file(cls, section: dict[str, object]) -> object:
        """Return a quantity alone for a constant."""
        return section["value"] if section.get("class") == "constant" else section

    @abc.abstractmethod
    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        """Value at each time."""


class Constant(Signal):
    """Constant value.

    Parameters
    ----------
    value
        Its value at all times.
    """

    short_name = "constant"

    value: SignalValue

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.full_like(floating(time), self.value)


class Step(Signal):
    """Step from one value to another.

    Parameters
    ----------
    before, after
        Value before the step, and from it on.
    at
        Time [s] of the step.
    """

    short_name = "step"

    before: SignalValue
    after: SignalValue
    at: Instant

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.where(floating(time) < self.at, self.before, self.after) * 1.0


class Ramp(Signal):
    """Constant rate from one value to another; then held.

    Parameters
    ----------
    before, after
        Value before and after the ramp.
    start, duration
        Time [s] at which the ramp begins, and how long [s] it takes.

    Examples
    --------
    >>> Ramp(0.0, 10.0, start=1.0, duration=2.0)(jnp.array([0.0, 1.5, 3.0, 4.0])).tolist()
    [0.0, 2.5, 10.0, 10.0]
    """

    short_name = "ramp"

    before: SignalValue
    after: SignalValue
    start: Instant
    duration: Duration

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        part = jnp.clip((floating(time) - self.start) / self.duration, 0.0, 1.0)
        return self.before + (jnp.asarray(self.after) - self.before) * part


class RandomSteps(Signal):
    """Random levels, uniformly distributed from `low` to `high`, each held for a dwell [s]; the seed selects the
    sequence.

    With `longest_dwell` the dwells lie between both: changes are at the multiples of their mean, moved by a uniformly
    distributed time (jittered sampling). The numbers are words of a counter-based generator (Threefry-2x32, Salmon et
    al. 2011), the same on every machine.

    >>> steps = RandomSteps(-1.0, 1.0, dwell=0.5, seed=3)
    >>> [round(float(steps(time)), 6) for time in (0.0, 0.499, 0.5, 1.0)]
    [0.730786, 0.730786, -0.093591, -0.522925]
    """

    short_name = "random_steps"

    low: SignalValue
    high: SignalValue
    dwell: PositiveTime
    longest_dwell: PositiveTime | None = None
    seed: Seed = 0

    def __check_init__(self) -> None:
        super().__check_init__()
        if isinstance(self.dwell, Real) and isinstance(self.longest_dwell, Real):
            check_within("RandomSteps", self.dwell, math.inf, "s", longest_dwell=self.longest_dwell)

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        time, shortest = floating(time), jnp.asarray(self.dwell)
        longest = shortest if self.longest_dwell is None else jnp.asarray(self.longest_dwell)
        mean, jitter = (longest + shortest) / 2, (longest - shortest) / 4
        nearest = jnp.maximum(jnp.round(time / mean), 0.0)
        change = nearest * mean + jitter * (2 * self._uniform(nearest, 1) - 1)
        rounding = 4 * jnp.finfo(time.dtype).eps * jnp.abs(time)  # a change is due at the start of a control period
        level = jnp.maximum(nearest - (time < change - rounding), 0.0)
        return self.low + (jnp.asarray(self.high) - self.low) * self._uniform(level, 0)

    def _uniform(self, index: Array, word: int) -> Array:
        """Uniformly distributed number in 0..1 for an index, from one of the two words that belong to it."""
        key = jax.random.key(self.seed, impl="threefry2x32")

        def draw(index: Array) -> Array:
            return jax.random.key_data(jax.random.fold_in(key, index))[word]

        words = jax.vmap(draw)(index.astype(jnp.uint32).ravel()).reshape(index.shape)
        return (words >> 8).astype(index.dtype) * 2.0**-24


class Sine(Signal):
    """offset + amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    amplitude, offset
        Half of the range from the lowest to the highest value, and the middle.
    frequency, phase
        Frequency [Hz], and phase [rad] at time 0.
    """

    short_name = "sine"

    amplitude: SignalValue
    frequency: Frequency
    offset: SignalValue = 0.0
    phase: Phase = 0.0

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        cycles = self.frequency * floating(time)
        part = cycles - jnp.round(cycles)  # sin is accurate for small arguments
        return self.offset + self.amplitude * sin(2 * jnp.pi * part + self.phase)


class Multisine(Signal):
    """offset + a sum of sines, each with an amplitude, a frequency [Hz] and a phase [rad]."""

    short_name = "multisine"

    amplitudes: tuple[SignalValue, ...]
    frequencies: tuple[Frequency, ...]
    phases: tuple[Phase, ...] = ()
    offset: SignalValue = 0.0

    def __check_init__(self) -> None:
        if not self.amplitudes:
            raise RangeError("a multisine of no sines", field="amplitudes", remedy="give at least one of each")
        check_count("frequencies", len(self.frequencies), len(self.amplitudes), "sine")
        check_count("phases", len(self.phases or self.amplitudes), len(self.amplitudes), "sine")

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        total = jnp.full_like(floating(time), self.offset)
        phases = self.phases or (0.0,) * len(self.amplitudes)
        for amplitude, frequency, phase in zip(self.amplitudes, self.frequencies, phases, strict=True):
            total = total + Sine(amplitude, frequency, 0.0, phase)(time)
        return total


class Samples(Signal):
    """Linear interpolation between values at increasing times [s]; constant beyond the first and last."""

    short_name = "samples"

    times: tuple[Instant, ...] | Any = eqx.field(converter=lambda x: floating(x), metadata={RANK: 1})
    values: tuple[SignalValue, ...] | Any = eqx.field(converter=lambda x: floating(x), metadata={RANK: 1})

    def __check_init__(self) -> None:
        times, values = (shape[-1] if shape else 0 for shape in (np.shape(self.times), np.shape(self.values)))
        if times != values or times == 0:
            raise RangeError(f"{times} times do not match {values} values; give one value per time")
        if not bool(jnp.all(self.times[1:] > self.times[:-1])):
            raise RangeError("the times of a sampled signal must increase", remedy="sort them and remove repeats")

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.interp(floating(time), jnp.asarray(self.times), jnp.asarray(self.values))


class SamplesFile(Samples):
    """Samples in a CSV file with a header of names and units, such as ``time_s,angle_deg,stiffness_N*m/rad``.

    Parameters
    ----------
    file
        Path of the file.
    column
        Name of the column; in a scenario by default that of the signal, "angle" or "stiffness".
    """

    short_name = "samples_file"

    file: Path = eqx.field(static=True, kw_only=True)
    column: Annotated[str, Inherited(lambda scope: scope["key"])] = eqx.field(static=True, kw_only=True)

    def __init__(self, file: Path, column: str) -> None:
        unit = {"angle": "rad", "stiffness": "N*m/rad"}.get(column)
        if unit is None:
            raise RangeError(f"SamplesFile: the column is {column!r}", field="column", remedy="give angle or stiffness")
        self.file, self.column = Path(file), column
        times, values = read_columns(self.file, lambda _: {column: unit})
        self.times, self.values = floating(times), floating(values[column])


class Sum(Signal):
    """Sum of signals.

    >>> angle = Sum((Step(13.0, 17.0, at=5.0), Sine(0.5, frequency=1.0)))
    >>> round(float(angle(5.25)), 9)
    17.5
    """

    short_name = "sum"

    parts: tuple[Signal, ...]

    def __check_init__(self) -> None:
        if not self.parts:
            raise RangeError("a sum of no signals", remedy="give at least one")

    def __call__(self, time: ArrayLike) -> Float[Array, "..."]:
        total = self.parts[0](time)
        for part in self.parts[1:]:
            total = total + part(time)
        return total


def as_signal(value: Signal | ArrayLike | None) -> Signal:
    """Signal of a number (or one per run), or the signal itself."""
    if isinstance(value, str):
        known_numbers("Reference", "signal", value)
    return Constant(value) if isinstance(value, Real | np.ndarray | Array) else value  # type: ignore[arg-type]


Scalar = Float[Array, ""]

_JUMP = 1000.0  # rad/s^2: a faster change is a jump; a sine of 10 deg at 4 Hz needs 110
_JERK_PERIODS = 3.0  # time constant of the jerk's filter, in periods, against rounding


class ReferenceDerivatives(NamedTuple):
    """Derivatives of the reference angle, by backward differences of its samples."""

    angle: Scalar  # last sample [rad]
    velocity: Scalar
    acceleration: Scalar
    jerk: Scalar
    samples_since_jump: Scalar  # 3 at most: the order of the differences available; -1 before the first sample

    @classmethod
    def init(cls, angle: ArrayLike) -> ReferenceDerivatives:
        """Constant reference [rad] before the first sample."""
        angle = floating(angle)
        zero = jnp.zeros_like(angle)
        return cls(angle, zero, zero, zero, zero - 1.0)

    def update(self, angle: ArrayLike, period: ArrayLike) -> ReferenceDerivatives:
        """Derivatives after a further sample [rad], a control period [s] after the last."""
        # Where the reference or its velocity jumps, there is no acceleration that a joint could follow: it is 0, and
        # the velocity is kept for one period and then taken from the samples after the jump.
        difference = (angle - self.angle) / period
        change = (difference - self.velocity) / period
        jumps = (jnp.abs(change) > _JUMP) & (self.samples_since_jump >= 1.0)
        samples = jnp.where(jumps, 0.0, jnp.minimum(self.samples_since_jump + 1.0, 3.0))
        acceleration = jnp.where(samples >= 2.0, change, 0.0)
        jerk = self.jerk + ((acceleration - self.acceleration) / period - self.jerk) / (1 + _JERK_PERIODS)
        return ReferenceDerivatives(
            angle=floating(angle),
            velocity=jnp.where(samples >= 1.0, difference, self.velocity),
            acceleration=acceleration,
            jerk=jnp.where(samples >= 3.0, jerk, 0.0),
            samples_since_jump=samples,
        )

    def after(self, time: ArrayLike) -> ReferenceDerivatives:
        """Derivatives extrapolated over a time [s]."""
        time = jnp.asarray(time)
        return self._replace(
            angle=self.angle + time * (self.velocity + time / 2 * self.acceleration),
            velocity=self.velocity + time * (self.acceleration + time / 2 * self.jerk),
            acceleration=self.acceleration + time * self.jerk,
        )

    def acceleration_after(self, time: ArrayLike, period: ArrayLike) -> Scalar:
        """Acceleration [rad/s^2] a time [s] after the last sample; the differences themselves lag by one period."""
        return self.acceleration + (time + period) * self.jerk
