"""The attainable stiffness of the foot at a posture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mckibben.errors import UnreachableError
from mckibben.robot.foot import Floats, FootStiffness, foot_jacobian, movable, stiffness_through
from mckibben.robot.foot_pressures import check_torques, pressure_ranges
from mckibben.robot.mechanism import Robot
from mckibben.robot.stiffness_map import is_affine, map_at
from mckibben.units import bar


def attainable_foot_stiffness(
    robot: Robot,
    angles: Sequence[float],
    torques: Sequence[float],
    *,
    levels: int = 9,
    force: Sequence[float] | None = None,
) -> list[FootStiffness]:
    """Return stable values of the stiffness of the foot over what the joints can attain.

    They are those of a grid, `levels` of each joint from the softest to the stiffest. With muscles over two joints, and
    laws that are affine in pressure, the attainable matrices are a polytope: half of as many values as the grid has are
    at its corners in random directions, found by linear programs with all muscles taut by 1 N, the others on lines
    between them. With other laws the grid is that of the pairs, and muscles over two joints are left out.

    Parameters
    ----------
    angles, torques
        Angles [rad] and static torques [N*m] of the joints.
    force
        Static force [N] of the ground on the foot, as in `foot_stiffness`. Default: none.

    Raises
    ------
    UnreachableError
        If the torque of a joint is not attainable, with its name and the attainable range; or if a muscle over two
        joints cannot be taut; or if none of the values is stable.
    """
    corners = len(robot.all_muscles) > 2 * len(robot.pairs) and is_affine(robot)
    count = levels ** len(robot.joints)
    matrices = _between_corners(robot, angles, torques, count) if corners else _grid(robot, angles, torques, levels)
    (jacobian, geometric), free = foot_jacobian(robot, angles, force), movable(robot)
    inner = np.ix_(free, free)
    stable = [one for one in matrices if np.linalg.eigvalsh((one - geometric)[inner]).min(initial=np.inf) > 0]
    if not stable:
        raise UnreachableError("the foot is unstable at every stiffness of the joints that was tried")
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

    affine, free, rng = map_at(robot, angles), movable(robot), np.random.default_rng(0)
    low, high, _ = pressure_ranges(robot, affine, [one.domain for one in robot.all_muscles], np.inf, 1.0)
    equal, held = affine.torque[1][free] * bar, np.asarray(torques, float)[free] - affine.torque[0][free]
    check_torques(robot, equal, held, low / bar, high / bar)
    slopes = affine.stiffness[1][np.ix_(free, free)] * bar
    corners = []
    aims = max(count // 2, 1)
    for direction in rng.normal(size=(aims, *slopes.shape[:2])):
        goal = np.einsum("ij,ijm->m", direction + direction.T, slopes)
        found = linprog(goal, A_eq=equal, b_eq=held, bounds=np.stack([low, high], axis=-1) / bar)
        corners.append(affine.stiffness_at(found.x * bar))
    first, second = (rng.integers(aims, size=count - aims) for _ in range(2))
    parts = rng.uniform(size=first.size)
    return [*corners, *(p * corners[i] + (1 - p) * corners[j] for p, i, j in zip(parts, first, second, strict=True))]
