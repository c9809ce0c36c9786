"""Ground: a plane with compliant contact and friction."""

from __future__ import annotations

from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.mechanism.bodies import Direction
from mckibben.mechanism.dynamics import Contact
from mckibben.numerics.spatial import Vector, Z, total, unit_vector
from mckibben.units import Distance, Quantity, Share, Speed, mm

Slope = Annotated[float, Quantity("rad", "deg", -60, 60)]
ContactDamping = Annotated[float, Quantity("s/m", "s/m", 0, 1e3)]
ContactStiffness = Annotated[float, Quantity("N/m", "kN/m", 0, 1e6, open_lower=True)]


def compliant_force(depth: ArrayLike, rate: ArrayLike, stiffness: ArrayLike, damping: ArrayLike) -> Array:
    """Return k d (1 + c d') at a depth d, 0 outside and never pulling.

    K. H. Hunt and F. R. E. Crossley, Coefficient of restitution interpreted as damping in vibroimpact, Journal of
    Applied Mechanics 42 (1975), with the exponent 1: continuous at the first touch, unlike a damper in parallel with a
    spring.
    """
    pressed = jnp.maximum(jnp.asarray(depth), 0.0)
    return jnp.asarray(stiffness) * pressed * jnp.maximum(1 + jnp.asarray(damping) * rate, 0.0)


class Ground(Component):
    """Plane ground below the start, or a wall: a compliant contact with friction.

    Parameters
    ----------
    stiffness, damping
        k [N/m] and c [s/m] of the normal force k d (1 + c d') at a depth d [m], never pulling (`compliant_force`).
    friction
        Coefficient of friction.
    slip_speed
        Speed [m/s] v0 that regularises it: the force is ``-mu N v / sqrt(|v|^2 + v0^2)``, with the velocity v along the
        ground.
    slope, side_slope
        Angles [rad] by which the ground rises forwards and to the left. Default: level.
    facing, distance
        Direction out of the plane in place of slopes, such as [-1, 0, 0] of a wall in front, and its distance [m] from
        the origin of the base, which then stays where it is. Default: the base starts above the ground.
    """

    stiffness: ContactStiffness = 20e3
    damping: ContactDamping = 0.5
    friction: Share = 0.8
    slip_speed: Speed = 100 * mm
    slope: Slope | None = None
    side_slope: Slope | None = None
    facing: tuple[Direction, ...] | None = eqx.field(static=True, default=None)
    distance: Distance | None = None

    def __check_init__(self) -> None:
        super().__check_init__()
        if (self.facing is None) != (self.distance is None):
            field = "distance" if self.distance is None else "facing"
            remedy = "give both, or leave both out"
            raise RangeError("a plane has its direction and its distance", field=field, value=None, remedy=remedy)
        if self.facing is not None and (len(self.facing) != 3 or not any(self.facing)):
            remedy = "give a direction in space, such as [-1, 0, 0] of a wall in front"
            raise RangeError("the plane has no direction", field="facing", value=self.facing, remedy=remedy)

    @property
    def normal(self) -> Vector:
        """Unit vector out of the ground; that of level ground, or a given one, is known when traced."""
        if self.facing is not None:
            return unit_vector(self.facing)
        forward, left = (0.0 if one is None else -jnp.tan(one) for one in (self.slope, self.side_slope))
        if self.slope is None and self.side_slope is None:
            return Z
        return Vector(forward, left, 1.0).scaled(1 / jnp.sqrt(1 + forward * forward + left * left))

    def force(self, point: Contact) -> Vector:
        """Return the force [N] on a sphere: forwards, to the left, and up."""
        normal = self.normal
        speed, height = point.velocity.dot(normal), point.position.dot(normal)
        depth = -height if self.distance is None else -height - self.distance
        pressed = compliant_force(depth, -speed, self.stiffness, self.damping)
        slip = point.velocity - normal.scaled(speed)
        drag = self.friction * pressed / jnp.sqrt(total(slip.dot(slip), self.slip_speed * self.slip_speed))
        return normal.scaled(pressed) - slip.scaled(drag)
