"""Detection of limit cycles, hunting and chatter: sustained oscillations that the reference does not ask for.

Sought in the errors of angle and stiffness, and in both commands. An oscillation is sustained if at least four periods
in a row have swings of similar size and duration that do not decay, faster than the reference: a streaming form of
T. Hagglund, A control-loop performance monitor, Control Eng. Pract. 3, 1995. The least swings are those that sensors,
valves and muscles resolve, see `least_swings`.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.mechanism.base import joints_in, over_joints
from mckibben.units import bar, deg

Scalar = Float[Array, ""]

AMPLITUDE = 0.1 * deg  # least of a hinge; smaller ones are noise
_STEPS = 2  # steps of the sensor of the angle in the least amplitude: a loop hunts by one between two of them
_COMMAND = 0.1 * bar
_STIFFNESS = 0.02
_REGULAR_SIZE = 0.55  # least swing, relative to the one before
_SMALLER = 0.97  # of the swing before, at most, of one that has decayed
_DECAYED = 0.7  # share of such swings in an oscillation that decays, even if disturbances excite it again
_REGULAR = 2.0  # largest ratio of two consecutive half-periods
_HALF_PERIODS = 8  # of a limit cycle, in a row
_FASTER = 0.6  # largest period of a limit cycle of the angle, relative to the mean period of the reference
_HARMONIC = 0.25  # of stiffness and commands, where the third harmonic of the reference is still due to it
_SHARE = 0.25  # of the run in which stiffness or a command oscillates without a break, or
_MANY = 40  # half-periods; white or differentiated noise has at most some 30 in a row in 10,000 control periods
_RECENT = 8  # swings of the moving average of their size
_FALLEN = 0.85  # of the mean size, at least, of this average in an oscillation that does not decay slowly


class Signals(NamedTuple):
    """Signals of a control period [rad], [N*m/rad], [Pa], or of all, of shape (periods,).

    Those of an unnamed joint, or tuples over joints; the commands are those of all muscles.
    """

    angle: PyTree
    desired_angle: PyTree
    stiffness: PyTree
    desired_stiffness: PyTree
    command: tuple[Array, ...]


def least_swings(now: Signals, resolution: ArrayLike, scale: float = 1.0) -> tuple[PyTree, PyTree, ArrayLike]:
    """Least swings, from peak to peak, of angle [rad], stiffness [N*m/rad] of each joint, and command [Pa].

    That of the angle is 0.2 deg, of a slide 0.2 mm (by the scale of its `JointType`), or four steps of its sensor
    [rad]; that of a command 0.1 bar, the hysteresis and repeatability of proportional pressure regulators (0.5 % each
    of 10 bar: Festo VPPE, SMC ITV), within which a valve need not move; that of the stiffness 2 % of it, its change by
    such a change of the pressure at 5 bar.
    """
    angle = 2 * jnp.maximum(AMPLITUDE * scale, _STEPS * jnp.asarray(resolution))

    def of_stiffness(stiffness: ArrayLike, desired: ArrayLike) -> Array:
        return _STIFFNESS * jnp.maximum(jnp.abs(jnp.asarray(stiffness)), jnp.abs(jnp.asarray(desired)))

    return (
        over_joints(lambda _: angle, now.angle),
        over_joints(of_stiffness, now.stiffness, now.desired_stiffness),
        _COMMAND,
    )


class Turns(NamedTuple):
    """Turning points of a signal so far; times in control periods."""

    direction: Scalar  # 1 upwards, -1 downwards
    reached: Scalar  # in this direction since the last turning point
    reached_at: Scalar
    total: Scalar  # number of turning points

    @property
    def extreme(self) -> Array:
        """Extreme since the last turning point."""
        return self.direction * self.reached

    def after(self, value: ArrayLike, index: ArrayLike, swing: ArrayLike) -> tuple[Array, Turns, Turns]:
        """Whether the sample of a control period is a swing from the extreme; the state if it is, and if it is not."""
        signed, at = self.direction * value, jnp.asarray(index, self.reached.dtype)
        further = signed >= self.reached
        reached, reached_at = jnp.where(further, signed, self.reached), jnp.where(further, at, self.reached_at)
        turned = Turns(-self.direction, -signed, at, self.total + 1)
        return self.reached - signed >= swing, turned, self._replace(reached=reached, reached_at=reached_at)

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
        return cls(Turns(zero + 1, zero - jnp.inf, zero, zero), zero + jnp.nan, zero, zero, zero, none, none)

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

    def cycle(self, longest: ArrayLike, least: ArrayLike = 0.0) -> LimitCycle:
        """Return the limit cycle with a longest period, and a least duration or many swings [control periods]."""
        chain = self.longest
        period = 2 * chain.duration / jnp.maximum(chain.number, 1.0)
        lasts = (chain.duration >= least) | (chain.number >= _MANY)
        cycles = chain.sustained & lasts & (period < longest)
        amplitude = chain.size / jnp.maximum(2 * chain.number, 1.0)
        return LimitCycle(jnp.where(cycles, amplitude, 0.0), jnp.where(cycles, period, jnp.nan))


class LimitCycle(NamedTuple):
    """Amplitude and period of a limit cycle, in the units of its signal and [s]; 0 and NaN if there is none."""

    amplitude: Scalar
    period: Scalar


class Oscillations(NamedTuple):
    """Limit cycles of a run, and its reversals of commands."""

    angle: PyTree  # amplitude [rad] of each joint; 0 without a limit cycle
    period: PyTree  # of the angle [s]; NaN without one
    stiffness: PyTree  # amplitude [N*m/rad]
    command: Scalar  # larger amplitude [Pa]
    reversals: Scalar  # of the command that reverses more often [1/s]


class Oscillation(NamedTuple):
    """Swings of a run so far: of the errors of angle and stiffness and of the commands, and turns of the references."""

    angle: PyTree  # `Swings` of each joint
    stiffness: PyTree
    command: tuple[Swings, ...]
    desired_angle: PyTree  # `Turns` of each joint
    desired_stiffness: PyTree

    @classmethod
    def empty(cls, first: Signals) -> Oscillation:
        """Return the state before the first sample, with the float types of its signals."""
        swings = Swings.empty(jax.tree.leaves(first.stiffness)[0])
        swinging, turning = (over_joints(lambda _, own=own: own, first.angle) for own in (swings, swings.turns))
        return cls(swinging, swinging, (swings,) * len(first.command), turning, turning)

    def after(self, now: Signals, index: ArrayLike, resolution: ArrayLike = 0.0, scale: float = 1.0) -> Oscillation:
        """Return the state after the signals of a control period, and a resolution of the sensor of the angle [rad].

        The scale is that of the `JointType`.
        """
        angle, stiffness, command = least_swings(now, resolution, scale)

        def of_error(value: ArrayLike, desired: ArrayLike, swing: ArrayLike, swings: Swings) -> Swings:
            return swings.after(jnp.asarray(value) - desired, index, swing)

        def counted(value: ArrayLike, swing: ArrayLike, turns: Turns) -> Turns:
            return turns.counted(value, index, swing)

        return Oscillation(
            over_joints(of_error, now.angle, now.desired_angle, angle, self.angle),
            over_joints(of_error, now.stiffness, now.desired_stiffness, stiffness, self.stiffness),
            tuple(swings.after(value, index, command) for swings, value in zip(self.command, now.command, strict=True)),
            over_joints(
                lambda x, turns: turns.counted(x, index, 2 * AMPLITUDE * scale), now.desired_angle, self.desired_angle
            ),
            over_joints(
                lambda x, swing, turns: turns.counted(x, index, swing),
                now.desired_stiffness,
                stiffness,
                self.desired_stiffness,
            ),
        )

    def found(self, periods: ArrayLike, period: ArrayLike) -> Oscillations:
        """Return the oscillations of a run of so many control periods [s]."""
        periods, angles, stiffnesses = jnp.asarray(periods), self.desired_angle, self.desired_stiffness

        def mean_period(*turns: Turns) -> Array:
            """Mean period [control periods] of references, of the one that turns most often."""
            return 2 * periods / jnp.maximum(functools.reduce(jnp.maximum, [own.total for own in turns]), 1e-9)

        cycles = over_joints(lambda own, to: own.cycle(_FASTER * mean_period(to)), self.angle, angles)
        stiffness = over_joints(
            lambda own, *to: own.cycle(_HARMONIC * mean_period(*to), _SHARE * periods).amplitude,
            self.stiffness,
            angles,
            stiffnesses,
        )
        all_turns = mean_period(*joints_in(angles), *joints_in(stiffnesses))
        commands = [own.cycle(_HARMONIC * all_turns, _SHARE * periods).amplitude for own in self.command]
        reversals = functools.reduce(jnp.maximum, [own.turns.total for own in self.command])
        return Oscillations(
            over_joints(lambda cycle: cycle.amplitude, cycles),
            over_joints(lambda cycle: cycle.period * period, cycles),
            stiffness,
            functools.reduce(jnp.maximum, commands),
            reversals / (periods * period),
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
    >>> found = find_oscillations(Signals(rest, rest, rest + 70, rest + 70, (command, rest)), 1e-3)
    >>> float(found.angle), round(float(found.command) / 1e5, 2), round(float(found.reversals))
    (0.0, 0.5, 20)
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
    angle = jnp.asarray(angle)
    still = jnp.zeros_like(angle)
    signals = Signals(angle, jnp.asarray(desired), still, still, (still,))
    oscillations = find_oscillations(signals, period, resolution, scale)
    return LimitCycle(oscillations.angle, oscillations.period)
