"""Attainable sets in a posture: torques and stiffness of the joints, and stiffness of a point."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from mckibben.errors import UnreachableError
from mckibben.mechanism.bodies import BodyPoint, Foot
from mckibben.mechanism.point_stiffness import PointStiffness, movable, point_jacobian, stiffness_through
from mckibben.mechanism.robot import Robot
from mckibben.result import Column, Listing
from mckibben.statics.posture import HeldPosture
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
    return held_statics(HeldPosture.of(robot, angles, torques, supply, minimum_tension))


def held_statics(setting: HeldPosture, only: Collection[str] | None = None) -> dict[str, JointRange]:
    """Return the attainable torques and stiffness of each movable joint of a posture, or only of some, by its name."""
    robot, (offset, slopes) = setting.robot, setting.stiffness()
    names = [joint.name for joint, free in zip(robot.joints, setting.free, strict=True) if free]
    found = {}
    for index, name in enumerate(names):
        if only is not None and name not in only:
            continue
        others = np.arange(len(names)) != index
        row, passive = setting.equal[index], float(setting.affine.torque[0][setting.free][index])
        turned = setting._replace(equal=setting.equal[others], held=setting.held[others])
        goals = (turned, row), (setting, slopes[index, index])
        ends = [posture.extreme(sign * goal) for posture, goal in goals for sign in (1, -1)]
        (least, by1), (most, by2), (softest, by3), (stiffest, by4) = ends
        at = float(offset[index, index])
        found[name] = JointRange((passive + least, passive - most), (at + softest, at - stiffest), (by1, by2, by3, by4))
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

    The attainable stiffness matrices of the joints are a polytope: half of as many values as a grid of `levels` for
    each of up to three joints has are at its corners in random directions, found by linear programs with all muscles
    taut by 1 N, the others are means of four corners with random weights.

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
    RangeError, UnreachableError
        As for `pressures_for_joint_stiffness`; if none of the values is stable.
    """
    setting, rng = HeldPosture.of(robot, angles, np.asarray(torques)), np.random.default_rng(0)
    slopes, count = setting.stiffness()[1], levels ** min(len(robot.joints), 3)
    aims = rng.normal(size=(max(count // 2, 1), *slopes.shape[:2]))
    goals = np.einsum("nij,ijm->nm", aims + aims.swapaxes(1, 2), slopes)
    corners = np.array([setting.affine.stiffness_at(setting.program(goal).x * bar) for goal in goals])
    chosen, shares = (
        rng.integers(len(corners), size=(count - len(corners), 4)),
        rng.dirichlet(np.ones(4), count - len(corners)),
    )
    matrices = [*corners, *np.einsum("nk,nkij->nij", shares, corners[chosen])]
    (jacobian, geometric), free = point_jacobian(robot, angles, force, point), movable(robot)
    inner = np.ix_(free, free)
    stable = [one for one in matrices if np.linalg.eigvalsh((one - geometric)[inner]).min(initial=np.inf) > 0]
    if not stable:
        raise UnreachableError("the point is unstable at every stiffness of the joints that was tried")
    return [stiffness_through(jacobian, geometric, free, one) for one in stable]
