"""Detection of limit cycles: sustained oscillations of the angle that the reference does not ask for."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.units import deg

Scalar = Float[Array, ""]

_AMPLITUDE = 0.1 * deg  # least; smaller ones are noise
_STEPS = 2  # steps of the sensor of the angle in the least amplitude: a loop hunts by one between two of them
_REGULAR_SIZE = 0.55  # least swing, relative to the one before
_SMALLER = 0.97  # of the swing before, at most, of one that has decayed
_DECAYED = 0.7  # share of such swings in an oscillation that decays, even if disturbances excite it again
_REGULAR = 2.0  # largest ratio of two consecutive half-periods
_HALF_PERIODS = 8  # of a limit cycle, in a row
_FASTER = 0.6  # largest period of a limit cycle, relative to the mean period of the reference


class Chain(NamedTuple):
    """Regular swings in a row: their number, and the sums of their sizes [rad] and durations [control periods]."""

    number: Scalar
    size: Scalar
    duration: Scalar
    smaller: Scalar  # number of those that are smaller than the one before


class Swings(NamedTuple):
    """Turning points of a signal so far; times in control periods."""

    direction: Scalar  # 1 upwards, -1 downwards
    extreme: Scalar  # since the last turning point
    extreme_at: Scalar
    last: Scalar  # turning point
    last_at: Scalar
    size: Scalar  # of the last swing
    duration: Scalar
    total: Scalar  # number of turning points
    chain: Chain
    longest: Chain

    @classmethod
    def empty(cls, like: Array) -> Swings:
        """Return the state before the first sample, with the float type of `like`."""
        zero = jnp.zeros_like(like)
        none = Chain(zero, zero, zero, zero)
        return cls(zero + 1, zero, zero, zero, zero, zero, zero, zero, none, none)

    def after(self, value: ArrayLike, index: ArrayLike, swing: ArrayLike) -> Swings:
        """Return the state after the sample of a control period, with the least distance of two turning points."""
        value, at = jnp.asarray(value), jnp.asarray(index, self.extreme.dtype)
        first = at == 0
        further = first | (self.direction * (value - self.extreme) >= 0)
        turned = ~first & (self.direction * (self.extreme - value) >= swing)
        size, duration = jnp.abs(self.extreme - self.last), self.extreme_at - self.last_at
        even = jnp.maximum(duration, self.duration) <= _REGULAR * jnp.minimum(duration, self.duration)
        goes_on = even & (size >= _REGULAR_SIZE * self.size)
        smaller = goes_on & (size < _SMALLER * self.size)
        before = Chain(*(jnp.where(goes_on, value, 0.0) for value in self.chain))
        chain = Chain(before.number + 1, before.size + size, before.duration + duration, before.smaller + smaller)
        longer = turned & (chain.number > self.longest.number)
        start = jnp.where(first, value, self.last)
        return Swings(
            direction=jnp.where(turned, -self.direction, self.direction),
            extreme=jnp.where(further | turned, value, self.extreme),
            extreme_at=jnp.where(further | turned, at, self.extreme_at),
            last=jnp.where(turned, self.extreme, start),
            last_at=jnp.where(turned, self.extreme_at, self.last_at),
            size=jnp.where(turned, size, self.size),
            duration=jnp.where(turned, duration, self.duration),
            total=self.total + turned,
            chain=Chain(*(jnp.where(turned, new, old) for new, old in zip(chain, self.chain, strict=True))),
            longest=Chain(*(jnp.where(longer, new, old) for new, old in zip(chain, self.longest, strict=True))),
        )


class LimitCycle(NamedTuple):
    """Amplitude [rad] and period [s] of a limit cycle; 0 and NaN if there is none."""

    amplitude: Scalar
    period: Scalar


class Oscillation(NamedTuple):
    """Swings of the angle error and of the reference of a run so far."""

    error: Swings
    reference: Swings

    @classmethod
    def empty(cls, like: Array) -> Oscillation:
        """Return the state before the first sample, with the float type of `like`."""
        return cls(Swings.empty(like), Swings.empty(like))

    def after(self, angle: ArrayLike, desired: ArrayLike, index: ArrayLike, resolution: ArrayLike = 0.0) -> Oscillation:
        """Return the state after angle, reference and resolution of the sensor [rad] of a control period."""
        swing = 2 * jnp.maximum(_AMPLITUDE, _STEPS * jnp.asarray(resolution))
        error = self.error.after(jnp.asarray(angle) - desired, index, swing)
        return Oscillation(error, self.reference.after(desired, index, 2 * _AMPLITUDE))

    def limit_cycle(self, periods: int, period: ArrayLike) -> LimitCycle:
        """Return the limit cycle of a run of so many control periods [s]."""
        # At least four periods in a row, of swings that do not decay and have similar durations, faster than the
        # reference: a streaming form of T. Hagglund, A control-loop performance monitor, Control Eng. Pract. 3, 1995.
        chain = self.error.longest
        cycle = 2 * chain.duration / jnp.maximum(chain.number, 1.0)
        of_reference = 2 * periods / jnp.maximum(self.reference.total, 1e-9)
        sustained = (
            (chain.number >= _HALF_PERIODS)
            & (cycle < _FASTER * of_reference)
            & (chain.smaller < _DECAYED * chain.number)
        )
        amplitude = chain.size / jnp.maximum(2 * chain.number, 1.0)
        return LimitCycle(jnp.where(sustained, amplitude, 0.0), jnp.where(sustained, cycle * period, jnp.nan))


def find_limit_cycle(
    angle: ArrayLike, desired: ArrayLike, period: ArrayLike, resolution: ArrayLike = 0.0
) -> LimitCycle:
    """Return the limit cycle of a run, from angle and reference [rad] of each control period [s]; shape (periods,)."""
    angle, desired = jnp.asarray(angle), jnp.asarray(desired)

    def following(so_far: Oscillation, at: tuple[Array, Array, Array]) -> tuple[Oscillation, None]:
        index, angle, desired = at
        return so_far.after(angle, desired, index, resolution), None

    rows = jnp.arange(angle.size), angle, desired
    return lax.scan(following, Oscillation.empty(angle[0]), rows)[0].limit_cycle(angle.size, period)
