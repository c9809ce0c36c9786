"""Stiffness of a point: the ellipse or ellipsoid of a posture and of the stiffness of the joints."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.component.checks import check_count
from mckibben.errors import RangeError
from mckibben.mechanism.bodies import BodyPoint, Foot
from mckibben.mechanism.dynamics import at_rest, frames, posture_of
from mckibben.mechanism.robot import Robot
from mckibben.numerics.compiled import jit

Floats = NDArray[np.float64]

SINGULAR = 1e-6
"""Least singular value of what can turn or move independently, relative to the largest."""


class PointStiffness(NamedTuple):
    """Stiffness of a point with the base held.

    Attributes
    ----------
    compliance
        Displacement per force [m/N], shape (2, 2), forwards and up, or in space (3, 3), forwards, to the left and up.
    principal
        Principal stiffness [N/m], the lowest first; infinite where no movable joint yields.
    axes
        Directions of the principal stiffness as columns; they point forwards.
    """

    compliance: Floats
    principal: tuple[float, ...]
    axes: Floats

    @property
    def direction(self) -> float:
        """Angle [rad] of the axis that is softest in the plane of walking from the forward direction, -pi/2 to pi/2."""
        plane = stiffness_of(self.compliance[np.ix_([0, -1], [0, -1])])
        return float(np.arctan2(plane.axes[1, 0], plane.axes[0, 0]))

    def ellipse(self, force: float = 1.0, points: int = 181, plane: tuple[int, int] = (0, -1)) -> Floats:
        """Return the displacements [m] by forces of one size [N] in a plane, shape (2 or 3, points).

        The plane is that of walking, or of two of 0, forwards, 1, to the left, and -1, up.
        """
        angle = np.linspace(0, 2 * np.pi, points)
        return self.compliance[:, plane] @ (force * np.stack([np.cos(angle), np.sin(angle)]))


def stiffness_of(compliance: NDArray[np.floating]) -> PointStiffness:
    """Return the principal stiffness and axes of a compliance [m/N]."""
    values, vectors = np.linalg.eigh(compliance)
    values, axes = values[::-1], vectors[:, ::-1]
    with np.errstate(divide="ignore"):
        principal = 1 / np.where(values > 1e-15, values, 0.0)
    own: Floats = np.asarray(compliance, np.float64)
    return PointStiffness(own, tuple(principal.tolist()), axes * np.where(axes[0] < 0, -1.0, 1.0))


def point_stiffness(
    robot: Robot,
    angles: Sequence[float],
    stiffness: ArrayLike | Sequence[float],
    *,
    point: BodyPoint | Foot | None = None,
    force: Sequence[float] | None = None,
) -> PointStiffness:
    r"""Return the stiffness of a point from that of the joints.

    .. math:: C = J K_q^{-1} J^\top, \qquad K_q = K - \frac{\partial}{\partial q} J^\top f

    with the Jacobian J of the point, and the force f on it: N. Hogan, "The mechanics of multi-joint
    posture and movement control", Biological Cybernetics 52 (1985).

    Parameters
    ----------
    angles
        Angles [rad] of the joints.
    stiffness
        Stiffness [N*m/rad] of the joints, or their stiffness matrix, with the coupling by muscles over several joints;
        locked joints do not yield.
    point
        Point of a body. Default: the foot.
    force
        Force on it [N], forwards and up, or in space forwards, to the left and up. Default: none.

    Raises
    ------
    RangeError
        If there is not one angle and one stiffness for each joint, or the posture is not stable under the force.

    Examples
    --------
    Along the robot, which is nearly stretched, the foot is 70 times as stiff as across:

    >>> from mckibben.robot import read_robot
    >>> robot = read_robot("lei-leg-planar")
    >>> found = point_stiffness(robot, (0.0, 0.0), (20.0, 15.0))
    >>> [round(one) for one in found.principal], round(found.direction, 3)
    ([28, 1988], -0.056)

    In space it is softest to the side:

    >>> found = point_stiffness(read_robot("lei-leg"), (0.0, 0.0, 0.0), (15.0, 20.0, 15.0))
    >>> [round(one) for one in found.principal], [round(abs(one), 3) for one in found.axes[:, 0].tolist()]
    ([27, 28, 1988], [0.0, 1.0, 0.0])
    """
    given, count = np.asarray(stiffness, float), len(robot.joints)
    check_count("angles", len(angles), count, "joint, in their order")
    joints = np.diag(given) if given.ndim == 1 else given
    for size in joints.shape:
        check_count("stiffness", size, count, "joint, in their order, or the stiffness matrix")
    return stiffness_through(*point_jacobian(robot, angles, force, point), movable(robot), joints)


def stiffness_through(
    jacobian: Floats, geometric: Floats, free: NDArray[np.bool_], stiffness: Floats
) -> PointStiffness:
    """Return the stiffness of a point by the stiffness matrix [N*m/rad] of the joints, of which some are free."""
    yielding = (stiffness - geometric)[np.ix_(free, free)]
    if free.any() and np.linalg.eigvalsh((yielding + yielding.T) / 2).min() <= 0:
        raise RangeError(
            "the posture is not stable under the force",
            field="stiffness",
            value=stiffness.tolist(),
            remedy="give more stiffness, a straighter robot or less force",
        )
    moved = jacobian[:, free]
    compliance = moved @ np.linalg.solve(yielding, moved.T) if free.any() else np.zeros((len(moved), len(moved)))
    return stiffness_of(compliance)


def movable(robot: Robot) -> NDArray[np.bool_]:
    """Return whether each joint can move."""
    return np.array([joint.locked is None for joint in robot.joints])


def point_jacobian(
    robot: Robot,
    angles: Sequence[float],
    force: Sequence[float] | None = None,
    point: BodyPoint | Foot | None = None,
) -> tuple[Floats, Floats]:
    """Return the Jacobian [m/rad] of a point, and the derivative [N*m/rad] of the torques by a force [N] on it.

    It moves in the plane, or in space. `RangeError` unless the force has one number per direction, and for a point of
    an unknown body, or none if the robot has no foot.
    """
    point = point_of(robot, point)
    directions = 2 if robot.is_planar else 3
    pushed = (0.0,) * directions if force is None else tuple(force)
    each = "direction: forwards and up" if robot.is_planar else "direction: forwards, to the left and up"
    check_count("force", len(pushed), directions, each)
    jacobian, geometric = _jacobian(robot, point, tuple(angles), pushed)
    return np.asarray(jacobian), np.asarray(geometric)


def point_of(robot: Robot, point: BodyPoint | Foot | None) -> BodyPoint:
    """Return a point, or the foot; `RangeError` for one of an unknown body, or none if the robot has no foot."""
    point = point or robot.foot
    if point is None or point.body not in robot.frame_names:
        remedy = f"name a point of {', '.join(robot.frame_names)}"
        value = None if point is None else point.body
        raise RangeError("the robot has no such point, and no foot", field="point.body", value=value, remedy=remedy)
    return BodyPoint(point.body, point.place)


def place_of(robot: Robot, point: BodyPoint, angles: Array) -> Array:
    """Return the place [m] of a point from the base, in the plane or in space, at angles [rad] of shape (joints,)."""
    posture = posture_of(robot, tuple(angles))
    frame = frames(robot, posture, at_rest(posture))[robot.frame_names.index(point.body)]
    place, _ = frame.point(point.place.vector)
    return jnp.stack([jnp.asarray(each) for each in ((place.x, place.z) if robot.is_planar else place)])


@jit
def _jacobian(
    robot: Robot, point: BodyPoint, angles: tuple[ArrayLike, ...], force: tuple[ArrayLike, ...]
) -> tuple[Float[Array, "d n"], Float[Array, "n n"]]:
    """Jacobian of a point, and the derivative of the torques that balance a force."""
    placed = functools.partial(place_of, robot, point)
    q = jnp.stack([jnp.asarray(one) for one in angles])
    pushed = jnp.stack([jnp.asarray(one) for one in force])
    return jax.jacfwd(placed)(q), jax.jacfwd(lambda x: jax.jacfwd(placed)(x).T @ pushed)(q)


def stiffness_matrix(principal: Sequence[float], direction: float, sideways: float | None = None) -> Floats:
    """Return the stiffness matrix [N/m] of a point with principal stiffness [N/m] in the plane of x and z.

    Parameters
    ----------
    principal
        Along the first axis, and across it.
    direction
        Angle [rad] of the first axis from the forward direction.
    sideways
        Stiffness to the side [N/m], for a robot in space.
    """
    along = np.array([np.cos(direction), np.sin(direction)])
    across = np.array([-along[1], along[0]])
    plane = principal[0] * np.outer(along, along) + principal[1] * np.outer(across, across)
    if sideways is None:
        return plane
    matrix = np.diag([0.0, sideways, 0.0])
    matrix[np.ix_([0, 2], [0, 2])] = plane
    return matrix


def check_point(
    robot: Robot,
    angles: Sequence[float],
    wanted: ArrayLike,
    point: BodyPoint | Foot | None = None,
    force: Sequence[float] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Return a wanted stiffness matrix [N/m] of a point, and both of `point_jacobian`.

    Raises `RangeError` unless the matrix is positive definite and has the directions in which the point moves, and for
    a posture beyond stops, or in which the joints do not move the point in all directions.
    """
    robot.check_posture(angles)
    jacobian, geometric = point_jacobian(robot, angles, force, point)
    matrix, directions = np.asarray(wanted, float), ("forwards", "to the left", "up")
    if robot.is_planar:
        directions = directions[::2]
    if matrix.shape != (len(directions),) * 2 or not np.allclose(matrix, matrix.T):
        message = f"the robot moves in {len(directions)} directions, and the stiffness of the point in {len(matrix)}"
        remedy = f"give a symmetric matrix: {', '.join(directions)}; in a file, `sideways` for a robot in space alone"
        raise RangeError(message, field="wanted", value=matrix.tolist(), remedy=remedy)
    if not np.linalg.eigvalsh(matrix).min() > 0:
        message, remedy = "the stiffness of the point is not positive in all directions", "give a positive definite one"
        raise RangeError(message, field="wanted", value=matrix.tolist(), remedy=remedy)
    axes, sizes, _ = np.linalg.svd(jacobian[:, movable(robot)])
    if len(sizes) < len(directions) or sizes[-1] < SINGULAR * sizes[0]:
        along = ", ".join(f"{part:.2g} {name}" for part, name in zip(axes[:, -1], directions, strict=True))
        message = f"the posture is singular: no joint moves the point along ({along})"
        remedy = "bend the robot, unlock joints, name another point, or give the stiffness of the joints"
        raise RangeError(message, field="angles", value=list(angles), remedy=remedy)
    return matrix, jacobian, geometric
