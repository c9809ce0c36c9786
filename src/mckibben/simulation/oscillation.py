"""Limit cycles and hunting of the angle, which its reference does not ask for, and the motion of the valves.

An oscillation of the angle's error is sustained if at least four periods in a row have swings of similar size and
duration that do not decay, faster than the reference: a streaming form of T. Hagglund, A control-loop performance
monitor, Control Eng. Pract. 3, 1995. A valve follows its command with play, its hysteresis.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.mechanism.base import over_joints
from mckibben.units import bar, deg

Scalar = Float[Array, ""]

HYSTERESIS = 0.1 * bar
"""Swing of a command within which a valve need not move: hysteresis and repeatability of proportional pressure
regulators, 0.5 % each of 10 bar (Festo VPPE, SMC ITV)."""
AMPLITUDE = 0.1 * deg  # least of a hinge; smaller ones are noise
_STEPS = 2  # steps of the sensor of the angle in the least amplitude: a loop hunts by one between two of them
_REGULAR_SIZE = 0.55  # least swing, relative to the one before
_SMALLER = 0.97  # of the swing before, at most, of one that has decayed
_DECAYED = 0.7  # share of such swings in an oscillation that decays, even if disturbances excite it again
_REGULAR = 2.0  # largest ratio of two consecutive half-periods
_HALF_PERIODS = 8  # of a limit cycle, in a row
_FASTER = 0.6  # largest period of a limit cycle of the angle, relative to the mean period of the reference
_RECENT = 8  # swings of the moving average of their size
_FALLEN = 0.85  # of the mean size, at least, of this average in an oscillation that does not decay slowly


class Signals(NamedTuple):
    """Signals of a control period [rad], [Pa], or of all, of shape (periods,).

    Angles are those of an unnamed joint, or tuples over joints; the commands are those of all muscles.
    """

    angle: PyTree
    desired_angle: PyTree
    command: tuple[Array, ...]


class Turns(NamedTuple):
    """Turning points and travel of a signal so far; times in control periods."""

    direction: Scalar  # 1 upwards, -1 downwards
    reached: Scalar  # in this direction since the last turning point
    reached_at: Scalar
    total: Scalar  # number of turning points
    travel: Scalar  # of what follows the signal with a play, the least swing

    @property
    def extreme(self) -> Array:
        """Extreme since the last turning point."""
        return self.direction * self.reached

    def after(self, value: ArrayLike, index: ArrayLike, swing: ArrayLike) -> tuple[Array, Turns, Turns]:
        """Whether the sample of a control period is a swing from the extreme; the state if it is, and if it is not."""
        signed, at = self.direction * value, jnp.asarray(index, self.reached.dtype)
        further = signed >= self.reached
        reached, reached_at = jnp.where(further, signed, self.reached), jnp.where(further, at, self.reached_at)
        back, ahead = self.reached - signed, jnp.where(at == 0, 0.0, reached - self.reached)
        turned = Turns(-self.direction, -signed, at, self.total + 1, self.travel + back - swing)
        going = self._replace(reached=reached, reached_at=reached_at, travel=self.travel + ahead)
        return back >= swing, turned, going

    def counted(self, value: ArrayLike, index: ArrayLike, swing: ArrayLike) -> Turns:
        """Return the state after the sample of a control period, with the least distance of two turning points."""
        turns, turned, further = self.after(value, index, swing)
        return lax.cond(turns, lambda: turned, lambda: further)


class Chain(NamedTuple):
    """Regular swings in a row: their number, and the sums of their sizes and durations [control periods]."""

    number: Scalar
    size: Scalar
    duration: Scalar
    smaller: Scalar  # number of those that are smaller than the one before
    recent: Scalar  # moving average of the size

    @property
    def sustained(self) -> Array:
        """Whether they are enough, and do not decay."""
        falls = (self.smaller >= _DECAYED * self.number) | (self.recent * self.number < _FALLEN * self.size)
        return (self.number >= _HALF_PERIODS) & ~falls


class Swings(NamedTuple):
    """Swings of a signal between its turning points so far; times in control periods."""

    turns: Turns
    last: Scalar  # turning point
    last_at: Scalar
    size: Scalar  # of the last swing
    duration: Scalar
    chain: Chain
    longest: Chain

    @classmethod
    def empty(cls, like: Array) -> Swings:
        """Return the state before the first sample, with the float type of `like`."""
        zero = jnp.zeros_like(like)
        none = Chain(zero, zero, zero, zero, zero)
        turns = Turns(zero + 1, zero - jnp.inf, zero, zero, zero)
        return cls(turns, zero + jnp.nan, zero, zero, zero, none, none)

    def after(self, value: ArrayLike, index: ArrayLike, swing: ArrayLike) -> Swings:
        """Return the state after the sample of a control period, with the least swing that counts."""
        turns, turned, further = self.turns.after(value, index, swing)
        # A branch: turning points are rare.
        return lax.cond(turns, lambda: self._turned(turned), lambda: self._replace(turns=further))

    def _turned(self, turns: Turns) -> Swings:
        """Return the state after a swing that ends at the present extreme."""
        size, duration = jnp.abs(self.turns.extreme - self.last), self.turns.reached_at - self.last_at
        even = jnp.maximum(duration, self.duration) <= _REGULAR * jnp.minimum(duration, self.duration)
        goes_on = even & (size >= _REGULAR_SIZE * self.size)
        smaller = goes_on & (size < _SMALLER * self.size)
        before = Chain(*(jnp.where(goes_on, value, 0.0) for value in self.chain))
        recent = jnp.where(goes_on, before.recent + (size - before.recent) / _RECENT, size)
        sums = before.number + 1, before.size + size, before.duration + duration, before.smaller + smaller
        chain = Chain(*sums, recent)
        longer = chain.number > self.longest.number
        longest = Chain(*(jnp.where(longer, new, old) for new, old in zip(chain, self.longest, strict=True)))
        return Swings(turns, self.turns.extreme, self.turns.reached_at, size, duration, chain, longest)

    def cycle(self, longest: ArrayLike) -> LimitCycle:
        """Return the limit cycle with a longest period [control periods]."""
        chain = self.longest
        period = 2 * chain.duration / jnp.maximum(chain.number, 1.0)
        cycles = chain.sustained & (period < longest)
        amplitude = chain.size / jnp.maximum(2 * chain.number, 1.0)
        return LimitCycle(jnp.where(cycles, amplitude, 0.0), jnp.where(cycles, period, jnp.nan))


class LimitCycle(NamedTuple):
    """Amplitude and period of a limit cycle, in the units of its signal and [s]; 0 and NaN if there is none."""

    amplitude: Scalar
    period: Scalar


class Oscillations(NamedTuple):
    """Limit cycles of a run, and the motion of its valves."""

    angle: PyTree  # amplitude [rad] of each joint; 0 without a limit cycle
    period: PyTree  # of the angle [s]; NaN without one
    reversals: Scalar  # of the command that reverses more often [1/s]
    travel: Scalar  # of the valve that travels further [Pa/s]


class Oscillation(NamedTuple):
    """Swings of a run so far: of the errors of the angles, and turns of their references and of the commands."""

    angle: PyTree  # `Swings` of each joint
    desired_angle: PyTree  # `Turns` of each joint
    command: tuple[Turns, ...]

    @classmethod
    def empty(cls, first: Signals) -> Oscillation:
        """Return the state before the first sample, with the float types of its signals."""
        swings = Swings.empty(jax.tree.leaves(first.angle)[0])
        swinging, turning = (over_joints(lambda _, own=own: own, first.angle) for own in (swings, swings.turns))
        return cls(swinging, turning, (swings.turns,) * len(first.command))

    def after(self, now: Signals, index: ArrayLike, resolution: ArrayLike = 0.0, scale: float = 1.0) -> Oscillation:
        """Return the state after the signals of a control period, and a resolution of the sensor of the angle [rad].

        The scale is that of the `JointType`.
        """
        least = 2 * jnp.maximum(AMPLITUDE * scale, _STEPS * jnp.asarray(resolution))

        def of_error(value: ArrayLike, desired: ArrayLike, swings: Swings) -> Swings:
            return swings.after(jnp.asarray(value) - desired, index, least)

        return Oscillation(
            over_joints(of_error, now.angle, now.desired_angle, self.angle),
            over_joints(
                lambda value, turns: turns.counted(value, index, 2 * AMPLITUDE * scale),
                now.desired_angle,
                self.desired_angle,
            ),
            tuple(
                turns.counted(value, index, HYSTERESIS) for turns, value in zip(self.command, now.command, strict=True)
            ),
        )

    def found(self, periods: ArrayLike, period: ArrayLike) -> Oscillations:
        """Return the oscillations of a run of so many control periods [s]."""
        periods = jnp.asarray(periods)

        def of_joint(swings: Swings, reference: Turns) -> LimitCycle:
            return swings.cycle(_FASTER * 2 * periods / jnp.maximum(reference.total, 1e-9))

        cycles = over_joints(of_joint, self.angle, self.desired_angle)
        reversals, travel = (
            functools.reduce(jnp.maximum, values) / (periods * period)
            for values in ([own.total for own in self.command], [own.travel for own in self.command])
        )
        return Oscillations(
            over_joints(lambda cycle: cycle.amplitude, cycles),
            over_joints(lambda cycle: cycle.period * period, cycles),
            reversals,
            travel,
        )


def find_oscillations(
    signals: Signals, period: ArrayLike, resolution: ArrayLike = 0.0, scale: float = 1.0
) -> Oscillations:
    """Return the oscillations of a run.

    Parameters
    ----------
    signals
        Signals of each control period, shape (periods,).
    period
        Control period [s].
    resolution
        Step of the sensor of the angle [rad].
    scale
        That of the `JointType`.

    Examples
    --------
    A command that swings by 0.5 bar ten times a second, while the joint is at rest:

    >>> import numpy as np
    >>> rest = np.zeros(2000)
    >>> command = 3e5 + 0.5e5 * np.sin(2 * np.pi * 10 * 1e-3 * np.arange(2000))
    >>> found = find_oscillations(Signals(rest, rest, (command, rest)), 1e-3)
    >>> float(found.angle), round(float(found.reversals)), round(float(found.travel) / 1e5)
    (0.0, 20, 18)
    """
    signals = jax.tree.map(jnp.asarray, signals)

    def following(so_far: Oscillation, at: tuple[Array, Signals]) -> tuple[Oscillation, None]:
        return so_far.after(at[1], at[0], resolution, scale), None

    count, first = jax.tree.leaves(signals)[0].size, jax.tree.map(lambda values: values[0], signals)
    so_far, _ = lax.scan(following, Oscillation.empty(first), (jnp.arange(count), signals))
    return so_far.found(count, period)


def find_limit_cycle(
    angle: ArrayLike, desired: ArrayLike, period: ArrayLike, resolution: ArrayLike = 0.0, scale: float = 1.0
) -> LimitCycle:
    """Return the limit cycle of the angle, from angle and reference [rad] of each control period [s]."""
    signals = Signals(jnp.asarray(angle), jnp.asarray(desired), (jnp.zeros_like(jnp.asarray(angle)),))
    oscillations = find_oscillations(signals, period, resolution, scale)
    return LimitCycle(oscillations.angle, oscillations.period)
