"""What is attainable in a posture: torques and stiffness of the joints, and the stiffness of a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from mckibben.errors import UnreachableError
from mckibben.result import Column, Listing
from mckibben.robot.bodies import BodyPoint, Foot
from mckibben.robot.mechanism import Robot
from mckibben.robot.point_stiffness import Floats, PointStiffness, movable, point_jacobian, stiffness_through
from mckibben.robot.posture import HeldPosture, is_affine
from mckibben.units import bar


class JointRange(NamedTuple):
    """Attainable torques and stiffnesses of a joint, with the torques of the others held, and the limiting muscles.

    Attributes
    ----------
    torque
        Least and greatest torque [N*m].
    stiffness
        Least and greatest stiffness [N*m/rad] at the torques that are held.
    limits
        Muscle and limit for each of these four: "lowest pressure", "highest pressure", "slack" or "rated force".
    """

    torque: tuple[float, float]
    stiffness: tuple[float, float]
    limits: tuple[str, str, str, str]


def attainable_statics(
    robot: Robot,
    angles: Sequence[float],
    *,
    torques: ArrayLike | None = None,
    supply: float = np.inf,
    minimum_tension: float = 1.0,
) -> dict[str, JointRange]:
    """Return the attainable torques and stiffness of each movable joint in a posture, by its name.

    Arguments and errors are those of `pressures_for_joint_stiffness`.

    Examples
    --------
    >>> from mckibben.robot import read_robot
    >>> knee = attainable_statics(read_robot("lei-leg-planar"), (0.0, 0.0))["knee"]
    >>> [round(number, 1) for number in knee.stiffness], knee.limits[3]
    ([9.5, 20.1], 'knee1 at highest pressure')
    """
    setting = HeldPosture.of(robot, angles, torques, supply, minimum_tension)
    offset, slopes = setting.stiffness()
    names = [joint.name for joint, free in zip(robot.joints, setting.free, strict=True) if free]
    found = {}
    for index, name in enumerate(names):
        others = np.arange(len(names)) != index
        row, own = setting.equal[index], float(setting.affine.torque[0][setting.free][index])
        rest = setting.equal[others], setting.held[others]
        goals = (row, *rest), (slopes[index, index], setting.equal, setting.held)
        ends = [setting.extreme(sign * goal, *equations) for goal, *equations in goals for sign in (1, -1)]
        (least, by1), (most, by2), (softest, by3), (stiffest, by4) = ends
        at = float(offset[index, index])
        found[name] = JointRange((own + least, own - most), (at + softest, at - stiffest), (by1, by2, by3, by4))
    return found


def attainable_listing(attainable: dict[str, JointRange]) -> Listing:
    """Return a table of what is attainable at each joint."""
    rows = list(attainable.values())

    def column(name: str, unit: str, title: str, values: list[float], limit: int) -> dict[str, tuple[Column, Any]]:
        by = [row.limits[limit] for row in rows]
        return {name: (Column(unit, title, digits=3), values), f"{name}_limit": (Column("", "limited by"), by)}

    columns: dict[str, tuple[Column, Any]] = {"joint": (Column(), list(attainable))}
    columns |= column("least_torque", "N*m", "least torque", [row.torque[0] for row in rows], 0)
    columns |= column("greatest_torque", "N*m", "greatest torque", [row.torque[1] for row in rows], 1)
    columns |= column("softest", "N*m/rad", "least stiffness", [row.stiffness[0] for row in rows], 2)
    columns |= column("stiffest", "N*m/rad", "greatest stiffness", [row.stiffness[1] for row in rows], 3)
    return Listing("Attainable at each joint", columns)


def attainable_point_stiffness(
    robot: Robot,
    angles: Sequence[float],
    torques: Sequence[float],
    *,
    levels: int = 9,
    force: Sequence[float] | None = None,
    point: BodyPoint | Foot | None = None,
) -> list[PointStiffness]:
    """Return stable values of the stiffness of a point over what the joints can attain.

    They are those of a grid, `levels` of each joint from the softest to the stiffest. With muscles over two joints, and
    laws that are affine in pressure, the attainable matrices are a polytope: half of as many values as the grid has are
    at its corners in random directions, found by linear programs with all muscles taut by 1 N, the others on lines
    between them. With other laws the grid is that of the pairs, and muscles over two joints are left out.

    Parameters
    ----------
    angles, torques
        Angles [rad] and static torques [N*m] of the joints.
    point
        Point of a body. Default: the foot.
    force
        Static force [N] on the point, as in `point_stiffness`. Default: none.

    Raises
    ------
    UnreachableError
        If the torque of a joint is not attainable, with its name and the attainable range; or if a muscle over two
        joints cannot be taut; or if none of the values is stable.
    """
    corners = len(robot.all_muscles) > 2 * len(robot.pairs) and is_affine(robot)
    count = levels ** min(len(robot.joints), 3)
    matrices = _between_corners(robot, angles, torques, count) if corners else _grid(robot, angles, torques, levels)
    (jacobian, geometric), free = point_jacobian(robot, angles, force, point), movable(robot)
    inner = np.ix_(free, free)
    stable = [one for one in matrices if np.linalg.eigvalsh((one - geometric)[inner]).min(initial=np.inf) > 0]
    if not stable:
        raise UnreachableError("the point is unstable at every stiffness of the joints that was tried")
    return [stiffness_through(jacobian, geometric, free, one) for one in stable]


def _grid(robot: Robot, angles: Sequence[float], torques: Sequence[float], levels: int) -> list[Floats]:
    """Diagonal stiffness matrices [N*m/rad] of the joints, from the softest to the stiffest."""
    ranges = []
    for index, (angle, torque) in enumerate(zip(angles, torques, strict=True)):
        low, high = (float(one) for one in robot.pair(index).attainable_stiffness(angle, torque))
        if not np.isfinite(low):
            robot.pressures_for(angles, torques, [None] * len(robot.joints))  # raises, with the name of the joint
        ranges.append(np.linspace(low, high, levels))
    return [np.diag(one) for one in np.stack(np.meshgrid(*ranges, indexing="ij")).reshape(len(ranges), -1).T]


def _between_corners(robot: Robot, angles: Sequence[float], torques: Sequence[float], count: int) -> list[Floats]:
    """Stiffness matrices [N*m/rad] of the joints at corners of what is attainable, and between them."""
    from scipy.optimize import linprog

    setting, rng = HeldPosture.of(robot, angles, np.asarray(torques)), np.random.default_rng(0)
    slopes = setting.stiffness()[1]
    corners = []
    aims = max(count // 2, 1)
    for direction in rng.normal(size=(aims, *slopes.shape[:2])):
        goal = np.einsum("ij,ijm->m", direction + direction.T, slopes)
        found = linprog(goal, A_eq=setting.equal, b_eq=setting.held, bounds=setting.bounds)
        corners.append(setting.affine.stiffness_at(found.x * bar))
    first, second = (rng.integers(aims, size=count - aims) for _ in range(2))
    parts = rng.uniform(size=first.size)
    return [*corners, *(p * corners[i] + (1 - p) * corners[j] for p, i, j in zip(parts, first, second, strict=True))]
