"""Outline of a robot in a posture: lines of bodies and muscles in space, for drawings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.joint import Geometry
from mckibben.mechanism.bodies import BodyPoint, Foot, PathElement
from mckibben.mechanism.dynamics import at_rest, frames, posture_of
from mckibben.mechanism.muscles import MuscleUnit
from mckibben.mechanism.point_stiffness import point_stiffness
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.tree import Frame
from mckibben.mechanism.wrapping import WrapSphere, branches
from mckibben.numerics.spatial import Vector

Floats = NDArray[np.float64]
BASE = ("x", "y", "z", "pitch", "yaw", "roll")
"""Position [m] and angles [rad] of a base, by their columns."""


class Outline(NamedTuple):
    """Lines in the axes of the base.

    Attributes
    ----------
    bodies
        Ends [m] of each line of a body: from its hinge to those that it carries, or to its tip; (2, 3) each.
    hinges
        Place [m] of each joint.
    muscles
        Points [m] of each muscle's path by its name, (points, 3) each. Those of a pair over a joint run beside the
        bodies at their moment arms.
    """

    bodies: list[Floats]
    hinges: list[Floats]
    muscles: dict[str, Floats]


class Ellipsoid(NamedTuple):
    """Displacements of a point under forces of one size in all directions.

    Attributes
    ----------
    force
        Size of the forces [N].
    centre
        Place [m] of the point.
    axes, lengths
        Principal axes as columns, right-handed, and half the length [m] along each; 0 across the plane of a planar one.
    """

    force: float
    centre: Floats
    axes: Floats
    lengths: Floats


def stiffness_ellipsoid(
    robot: Robot, angles: Sequence[float], stiffness: Floats, point: BodyPoint | Foot, longest: float
) -> Ellipsoid:
    """Return the ellipsoid of a point by the stiffness matrix [N*m/rad] of the joints.

    Raises `RangeError` if the posture is not stable.

    Parameters
    ----------
    longest
        Most that half its length may be [m]; the force has one digit.
    """
    found = point_stiffness(robot, angles, stiffness, point=point)
    axes, compliance = found.axes, 1 / np.array(found.principal)
    if robot.is_planar:
        axes, compliance = np.insert(axes, 1, 0.0, axis=0), np.append(compliance, 0.0)
    axes = np.column_stack([axes[:, :2], np.cross(axes[:, 0], axes[:, 1])])
    exact = longest / max(float(compliance.max()), np.finfo(float).tiny)
    digit = 10.0 ** np.floor(np.log10(exact))
    force = float(np.floor(exact / digit) * digit)
    posture = posture_of(robot, angles)
    return Ellipsoid(force, point_of(point, robot, frames(robot, posture, at_rest(posture))), axes, force * compliance)


def outline(robot: Robot, angles: Sequence[float], base: Sequence[float] = ()) -> Outline:
    """Return the outline of a robot at angles [rad], and its `BASE` if that moves.

    Examples
    --------
    >>> from mckibben.robot import read_robot
    >>> leg = outline(read_robot("lei-leg-planar"), (0.0, 0.0))
    >>> [line[1].round(2).tolist() for line in leg.bodies], len(leg.muscles)
    ([[0.01, 0.0, -0.74], [0.1, 0.0, -0.39]], 4)
    """
    still = posture_of(robot, angles)
    moved: dict[str, PyTree] = dict(zip(BASE, base, strict=False))
    posture = still._replace(**{name: value for name, value in moved.items() if getattr(still, name) is not None})
    placed = frames(robot, posture, at_rest(posture))
    at = [_numbers(frame.position) for frame in placed]
    tips = {sphere.body: point_of(sphere, robot, placed) for sphere in robot.spheres[::-1]}
    bodies, beyond = [], at.copy()
    for number, (name, body) in reversed([*enumerate(zip(robot.frame_names, robot.frame_bodies, strict=True))]):
        carried = [child for child, parent in enumerate(robot.parents, 1) if parent == number]
        ends = [at[child] for child in carried]
        if not carried and body is not None:  # its centre is in the middle
            centre = _numbers(placed[number].point(body.centre.vector)[0])
            ends = [tips.get(name, 2 * centre - at[number])]
        lines = [np.stack([at[number], end]) for end in ends if (end - at[number]).any()]
        bodies += lines
        beyond[number] = lines[0][1] if lines else beyond[carried[0]] if carried else at[number]
    muscles: dict[str, Floats] = {}
    for unit in robot.muscles:
        if (pair := unit.pair) is not None:
            muscles |= _pair(pair.geometry, unit, robot, angles, placed, beyond)
        elif unit.elements:
            muscles[unit.names[0]] = _path(unit.elements, robot, placed)
    return Outline(bodies, at[1:], muscles)


def _path(elements: Sequence[PathElement], robot: Robot, placed: Sequence[Frame]) -> Floats:
    """Points of a path, with arcs over surfaces; NaN between its branches."""
    lines: list[Floats] = []
    for _, branch in branches(elements):
        places = [point_of(element, robot, placed) for element in branch if isinstance(element, BodyPoint | WrapSphere)]
        for number, (element, at) in enumerate(zip(branch, places, strict=True)):
            if isinstance(element, WrapSphere):
                frame = placed[robot.frame_names.index(element.body)]
                before, after = (Vector(*(places[number + step] - at)) for step in (-1, 1))
                path = element.wrap(before, after, frame.axes)
                if float(path.turn):
                    lines += [at + _numbers(point) for point in element.arc(path, frame.axes)]
            else:
                lines.append(at)
        lines.append(np.full(3, np.nan))
    return np.stack(lines[:-1])


def point_of(point: BodyPoint | Foot | WrapSphere, robot: Robot, placed: Sequence[Frame]) -> Floats:
    """Return a point of a body [m] in given frames."""
    return _numbers(placed[robot.frame_names.index(point.body)].point(point.place.vector)[0])


def _pair(
    geometry: Geometry,
    unit: MuscleUnit,
    robot: Robot,
    angles: Sequence[float],
    placed: Sequence[Frame],
    tips: Sequence[Floats],
) -> dict[str, Floats]:
    """Lines beside the bodies at the moment arms: muscle 1 where turning lengthens it. None along the axis."""
    index = robot.index(unit.joint_names[0])
    frame, above = placed[index + 1], placed[robot.parents[index]]
    at, axis, beyond = _numbers(frame.position), _numbers(frame.axis), tips[index + 1]
    side = np.cross(beyond - at, axis)
    if not np.linalg.norm(side):
        return {}
    side /= np.linalg.norm(side)
    part = 0.2 * (beyond - at)
    start = _numbers(above.position)
    if not np.linalg.norm(at - start):  # the hinge is at the origin of the body above
        start = at - part
    arms = (float(arm) for arm in geometry.paths_and_arms(angles[index])[1])
    offsets = (arm * side * sign for arm, sign in zip(arms, (1, -1), strict=True))
    return {name: np.stack([start, at + part]) + offset for name, offset in zip(unit.names, offsets, strict=True)}


def _numbers(vector: Sequence[object]) -> Floats:
    return np.array([float(part) for part in vector])  # type: ignore[arg-type]
