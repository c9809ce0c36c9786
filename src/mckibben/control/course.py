"""How fast a wish moves, told from its samples: a controller is given no derivatives."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.arrays import floating

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
