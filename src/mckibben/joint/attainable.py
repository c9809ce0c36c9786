"""What a joint can hold: the torques and stiffnesses that pressures within limits can give.

Each muscle's tension can be anything between its tension at the lowest and at the highest pressure. A torque leaves one
freedom, co-contraction: along T2 d2 - T1 d1 = torque both tensions rise together. Two taut muscles with affine laws and
rigid tendons have a stiffness that is affine along that line, so its extremes are the two ends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.joint.geometry import Pair
from mckibben.joint.tendon import RigidTendon
from mckibben.muscle import Muscle, PressureAffineLaw
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.compiled import compiled
from mckibben.numerics.elementary import floating

if TYPE_CHECKING:
    from mckibben.joint.antagonistic import AntagonisticJoint

_SCANNED = 401
_MET = 1e-6  # how near a stiffness has to come to the wish, as a part of it
_INSIDE = 1e-9  # how far inside its ends a segment is looked at, as a part of it: at the very end a muscle is slack


def torque_range(
    joint: AntagonisticJoint,
    angle: ArrayLike,
    pressure_limits: tuple[float, float] | None,
    minimum_tension: float,
) -> Pair:
    """See `AntagonisticJoint.attainable_torque`."""
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(floating(angle))
    low, high = _tension_ranges(joint, paths, pressure_limits, minimum_tension)
    lowest, highest = low[1] * arm2 - high[0] * arm1, high[1] * arm2 - low[0] * arm1
    holdable = (low[0] <= high[0]) & (low[1] <= high[1])
    return jnp.where(holdable, lowest, jnp.nan), jnp.where(holdable, highest, jnp.nan)


def stiffness_range(
    joint: AntagonisticJoint,
    angle: ArrayLike,
    torque: ArrayLike,
    pressure_limits: tuple[float, float] | None,
    minimum_tension: float,
) -> Pair:
    """See `AntagonisticJoint.attainable_stiffness`."""
    segment = segment_of(joint, angle, torque, pressure_limits, minimum_tension)
    return _range(segment, segment.along())


class Hold(NamedTuple):
    """An answer to `hold`: the pressures [Pa], whether they exist, and the attainable stiffness [N*m/rad]."""

    pressures: Pair
    exists: Array
    lowest: Array
    highest: Array


@compiled
def hold(joint: AntagonisticJoint, angle: ArrayLike, torque: ArrayLike, stiffness: ArrayLike) -> Hold:
    """The pressures that give a torque and a stiffness at an angle; amid the co-contractions for a stiffness of NaN."""
    segment = segment_of(joint, angle, torque, None, 0.0)
    return _held(segment.along(), segment.holdable, stiffness, _places(joint))


def hold_and_range(joint: AntagonisticJoint, angle: Array, torque: Array, stiffness: ArrayLike) -> tuple[Hold, Pair]:
    """`hold` at the first of several angles, and `stiffness_range` at all of them, from one pass.

    Parameters
    ----------
    joint
        What holds.
    angle, torque
        Shape (n,): [rad], [N*m].
    stiffness
        At the first of them [N*m/rad].
    """
    segment = segment_of(joint, angle, torque, None, 0.0)
    along = segment.along()
    return _held(along.first(), segment.holdable[0], stiffness, _places(joint)), _range(segment, along)


def _held(along: Along, holdable: Array, stiffness: ArrayLike, places: Array) -> Hold:
    """The place along a segment where the stiffness is as wished."""

    def stiffness_at(place: ArrayLike) -> Array:
        return along(place)[1]

    scanned = stiffness_at(places)
    lowest, highest = jnp.min(scanned), jnp.max(scanned)

    # The wish lies between neighbours; a spring that meets a stop makes the stiffness jump: the smallest step is best.
    wanted = jnp.where(jnp.isnan(stiffness), lowest, stiffness)
    between = (scanned[1:] - wanted) * (scanned[:-1] - wanted) <= 0
    first = jnp.argmin(jnp.where(between, jnp.abs(scanned[1:] - scanned[:-1]), jnp.inf))
    rising = scanned[first + 1] > scanned[first]

    def halve(_: int, bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = (low + high) / 2
        beyond = (stiffness_at(middle) >= wanted) == rising
        return jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)

    low, high = lax.fori_loop(0, 60, halve, (places[first], places[first + 1]))
    anywhere = jnp.isnan(stiffness)
    found = lax.stop_gradient((low + high) / 2)
    # Bisection finds the place but not how it moves with the joint's numbers; one step of Newton's method does.
    value, slope = value_and_derivative(stiffness_at, found)
    newton = (value - wanted) / jnp.where(slope == 0, jnp.inf, lax.stop_gradient(slope))
    place = jnp.where(anywhere, 0.5, found - (newton - lax.stop_gradient(newton)))
    pressures, reached = along(place)
    met = jnp.abs(reached - wanted) <= _MET * jnp.abs(wanted)
    return Hold(
        pressures,
        holdable & (anywhere | (jnp.any(between) & met)),
        jnp.where(holdable, lowest, jnp.nan),
        jnp.where(holdable, highest, jnp.nan),
    )


def _range(segment: Segment, along: Along) -> Pair:
    """The lowest and the highest stiffness of each segment."""
    _, stiffness = along(_over(_places(segment.joint), segment.angle))
    return (
        jnp.where(segment.holdable, jnp.min(stiffness, axis=0), jnp.nan),
        jnp.where(segment.holdable, jnp.max(stiffness, axis=0), jnp.nan),
    )


def _places(joint: AntagonisticJoint) -> Array:
    """Where to look at a segment: at its ends, or all along it."""
    return jnp.linspace(_INSIDE, 1 - _INSIDE, 2 if is_affine(joint) else _SCANNED)


class _Straight(NamedTuple):
    """Pressures and stiffness along a segment where all are affine in the place, from those at the first and last."""

    starts: tuple[Array, Array, Array]
    ends: tuple[Array, Array, Array]

    def __call__(self, place: ArrayLike) -> tuple[Pair, Array]:
        part = (place - _INSIDE) / (1 - 2 * _INSIDE)
        pressure1, pressure2, stiffness = (
            start + (end - start) * part for start, end in zip(self.starts, self.ends, strict=True)
        )
        return (pressure1, pressure2), stiffness

    def first(self) -> _Straight:
        return jax.tree.map(lambda values: values[0], self)


class _Bent(NamedTuple):
    """Pressures and stiffness along a segment, worked out at each place."""

    segment: Segment

    def __call__(self, place: ArrayLike) -> tuple[Pair, Array]:
        return self.segment.at(place)

    def first(self) -> _Bent:
        joint, *numbers = self.segment
        return _Bent(Segment(joint, *jax.tree.map(lambda values: values[0], numbers)))


Along = _Straight | _Bent
"""Pressures and stiffness as a function of the place on a segment; `first` is that of the first of several segments."""


class Segment(NamedTuple):
    """The states that give one torque at one angle, from the slackest (place 0) to the tightest (place 1)."""

    joint: AntagonisticJoint
    angle: Array
    torque: Array
    paths: Pair
    arms: Pair
    first: Array  # tension of muscle 1 [N] at place 0
    last: Array  # and at place 1
    holdable: Array

    def pressures(self, place: ArrayLike) -> Pair:
        joint = self.joint
        tension1 = self.first + (self.last - self.first) * place
        tension2 = (self.torque + tension1 * self.arms[0]) / self.arms[1]
        return (
            joint.tendon.pressure_for(joint.muscle1, self.paths[0], tension1),
            joint.tendon.pressure_for(joint.muscle2, self.paths[1], tension2),
        )

    def at(self, place: ArrayLike) -> tuple[Pair, Array]:
        pressures = self.pressures(place)
        return pressures, self.joint.stiffness(jnp.broadcast_to(self.angle, pressures[0].shape), pressures)

    def along(self) -> Along:
        """Pressures and stiffness over the place: both muscles are taut, so with affine laws all is affine in it."""
        if not is_affine(self.joint):
            return _Bent(self)
        # A loop over the two ends, though they would vectorise: XLA then computes what goes into it once, not once more
        # in each fusion that uses it, and makes a third of the code to compile and to load.
        pressures, stiffness = lax.map(self.at, _places(self.joint))
        return _Straight(*((pressures[0][end], pressures[1][end], stiffness[end]) for end in (0, 1)))


def _over(values: Array, angle: Array) -> Array:
    """Values along an axis of their own, before those of the angle."""
    return values.reshape(-1, *[1] * angle.ndim)


def segment_of(
    joint: AntagonisticJoint,
    angle: ArrayLike,
    torque: ArrayLike,
    pressure_limits: tuple[float, float] | None,
    minimum_tension: float,
) -> Segment:
    """The states that give torques [N*m] at angles [rad]; limits as for `AntagonisticJoint.attainable_stiffness`."""
    angle, torque = jnp.broadcast_arrays(floating(angle), floating(torque))
    paths, (arm1, arm2) = joint.geometry.paths_and_arms(angle)
    low, high = _tension_ranges(joint, paths, pressure_limits, minimum_tension)
    first = jnp.maximum(low[0], (low[1] * arm2 - torque) / arm1)
    last = jnp.minimum(high[0], (high[1] * arm2 - torque) / arm1)
    holdable = (first <= last) & (low[0] <= high[0]) & (low[1] <= high[1])
    return Segment(joint, angle, torque, paths, (arm1, arm2), first, last, holdable)


def pressure_limits_of(joint: AntagonisticJoint) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """The lowest and the highest gauge pressure [Pa] of each muscle's domain: ((low1, low2), (high1, high2))."""
    domains = joint.muscle1.domain, joint.muscle2.domain
    low1, low2 = (floating(domain.pressure_min) for domain in domains)
    high1, high2 = (floating(domain.pressure_max) for domain in domains)
    return (low1, low2), (high1, high2)


def _tension_ranges(
    joint: AntagonisticJoint,
    paths: Pair,
    pressure_limits: tuple[float, float] | None,
    minimum_tension: float,
) -> tuple[Pair, Pair]:
    """The lowest and the highest tension of each muscle.

    Pressures are within limits, contractions within the domain, tensions below the specimen's rating. A muscle that is
    slack at the highest pressure, and so at all, cannot be taut: its highest tension is -inf, and nothing is holdable.
    """
    if pressure_limits is None:
        lowest, highest = pressure_limits_of(joint)
    else:
        lowest, highest = ((limit, limit) for limit in pressure_limits)

    def tension_range(muscle: Muscle, path: Array, low: ArrayLike, high: ArrayLike) -> Pair:
        least, most = joint.tendon.permitted(muscle, path)
        tensions = joint.tendon.tension(muscle, path, _over(jnp.stack([floating(low), floating(high)]), path))
        slackest = jnp.maximum(tensions[0], minimum_tension)
        tightest = jnp.where(tensions[1] > 0, jnp.minimum(tensions[1], muscle.specimen.rated_force), -jnp.inf)
        return jnp.maximum(slackest, least), jnp.minimum(tightest, most)

    low1, high1 = tension_range(joint.muscle1, paths[0], lowest[0], highest[0])
    low2, high2 = tension_range(joint.muscle2, paths[1], lowest[1], highest[1])
    return (low1, low2), (high1, high2)


def is_affine(joint: AntagonisticJoint) -> bool:
    """Whether torque and stiffness are affine in the two pressures."""
    laws_affine = all(isinstance(m.law, PressureAffineLaw) for m in (joint.muscle1, joint.muscle2))
    return laws_affine and isinstance(joint.tendon, RigidTendon)
