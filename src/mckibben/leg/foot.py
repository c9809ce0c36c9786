"""Stiffness of the foot: the ellipse of a posture and of the stiffness of its joints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.leg.dynamics import at_rest, frames, posture_of
from mckibben.leg.mechanism import Leg
from mckibben.numerics.compiled import compiled

Floats = NDArray[np.float64]


class FootStiffness(NamedTuple):
    """Stiffness of the foot with the trunk held.

    Attributes
    ----------
    compliance
        Displacement per force [m/N], shape (2, 2), forwards and up.
    principal
        Principal stiffness [N/m], the lower first; infinite where no movable joint yields.
    direction
        Angle [rad] of the axis of the lower one from the forward direction, -pi/2 to pi/2.
    """

    compliance: Floats
    principal: tuple[float, float]
    direction: float

    def ellipse(self, force: float = 1.0, points: int = 181) -> Floats:
        """Return the displacements [m] that forces of one size [N] in all directions cause, shape (2, points)."""
        angle = np.linspace(0, 2 * np.pi, points)
        return self.compliance @ (force * np.stack([np.cos(angle), np.sin(angle)]))


def foot_stiffness(
    leg: Leg, angles: Sequence[float], stiffness: Sequence[float], *, force: tuple[float, float] = (0.0, 0.0)
) -> FootStiffness:
    r"""Return the stiffness of the foot from that of the joints.

    .. math:: C = J K_q^{-1} J^\top, \qquad K_q = \mathrm{diag}(K) - \frac{\partial}{\partial q} J^\top f

    with the Jacobian J of the foot, and the force f of the ground on it: N. Hogan, "The mechanics of multi-joint
    posture and movement control", Biological Cybernetics 52 (1985).

    Parameters
    ----------
    angles, stiffness
        Angles [rad] and stiffness [N*m/rad] of the joints; locked ones do not yield.
    force
        Force of the ground [N], forwards and up.

    Raises
    ------
    RangeError
        If there is not one angle and one stiffness for each joint, or the posture is not stable under the force.

    Examples
    --------
    Along the leg, which is nearly stretched, the foot is 70 times as stiff as across:

    >>> from mckibben.leg import read_leg
    >>> leg = read_leg("lei-leg-planar")
    >>> found = foot_stiffness(leg, (0.0, 0.0), (20.0, 15.0))
    >>> [round(one) for one in found.principal], round(found.direction, 3)
    ([28, 1988], -0.056)
    """
    if len(angles) != len(leg.joints) or len(stiffness) != len(leg.joints):
        raise RangeError(
            f"{len(angles)} angles and {len(stiffness)} values of stiffness for {len(leg.joints)} joints",
            field="stiffness",
            value=len(stiffness),
            remedy="give one of each for each joint, from the hip down",
        )
    jacobian, geometric = (np.asarray(one) for one in _jacobian(leg, tuple(angles), force))
    free = np.array([joint.locked is None for joint in leg.joints])
    joints = np.diag(np.asarray(stiffness, float)) - geometric
    if free.any() and np.linalg.eigvalsh(joints[np.ix_(free, free)]).min() <= 0:
        raise RangeError(
            "the posture is not stable under the force",
            field="stiffness",
            value=list(stiffness),
            remedy="give more stiffness, a straighter leg or less force",
        )
    moved = jacobian[:, free]
    compliance = moved @ np.linalg.solve(joints[np.ix_(free, free)], moved.T) if free.any() else np.zeros((2, 2))
    values, vectors = np.linalg.eigh(compliance)
    soft = vectors[:, 1] * np.sign(vectors[0, 1] or 1.0)
    with np.errstate(divide="ignore"):
        principal = 1 / np.where(values > 1e-15, values, 0.0)[::-1]
    return FootStiffness(compliance, (float(principal[0]), float(principal[1])), float(np.arctan2(soft[1], soft[0])))


def attainable_foot_stiffness(
    leg: Leg, angles: Sequence[float], torques: Sequence[float], *, levels: int = 9
) -> list[FootStiffness]:
    """Return the stiffness of the foot over the attainable stiffness of the joints, `levels` of each.

    Parameters
    ----------
    angles, torques
        Angles [rad] and static torques [N*m] of the joints.

    Raises
    ------
    UnreachableError
        If the torque of a joint is not attainable; with its name and the attainable range.
    """
    ranges = []
    for joint, angle, torque in zip(leg.joints, angles, torques, strict=True):
        low, high = (float(one) for one in joint.muscles.attainable_stiffness(angle, torque))
        if not np.isfinite(low):
            leg.pressures_for(angles, torques, [None] * len(leg.joints))  # raises, with the name of the joint
        ranges.append(np.linspace(low, high, levels))
    grid = np.stack(np.meshgrid(*ranges, indexing="ij")).reshape(len(ranges), -1)
    return [foot_stiffness(leg, angles, column) for column in grid.T]  # type: ignore[arg-type]


@compiled
def _jacobian(
    leg: Leg, angles: tuple[ArrayLike, ...], force: tuple[ArrayLike, ArrayLike]
) -> tuple[Float[Array, "2 n"], Float[Array, "n n"]]:
    """Jacobian of the foot, and the derivative of the torques that balance a force."""

    def foot(q: Array) -> Array:
        posture = posture_of(leg, tuple(q))
        place, _ = frames(leg, posture, at_rest(posture))[-1].point(-leg.links[-1].length)
        return jnp.stack([place.x, place.z])

    q = jnp.stack([jnp.asarray(one) for one in angles])
    pushed = jnp.stack([jnp.asarray(one) for one in force])
    return jax.jacfwd(foot)(q), jax.jacfwd(lambda x: jax.jacfwd(foot)(x).T @ pushed)(q)
