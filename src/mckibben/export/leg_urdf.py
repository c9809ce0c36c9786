"""A leg as URDF: bodies, joints and the points of its muscles. x is forwards, y to the left, and z up."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from mckibben.export.leg_mjcf import LIGHT, Frame, add_muscles, leg_bodies
from mckibben.export.targets import Exported, check_name, write_exported
from mckibben.leg import LegPlant, LegScenario
from mckibben.leg.dynamics import SLIDES, TURNS
from mckibben.numerics.spatial import Vector

_TRAVEL = 100.0  # [m] of the trunk: a prismatic joint must have limits
_SPEED = 100.0  # [m/s] or [rad/s]: so must the speed of each joint
_ANGLES = 41  # at which the largest torque of a joint is sought


def leg_urdf(plant: LegPlant, name: str = "leg") -> Exported:
    """Return a leg as URDF, and the parts that the format cannot express.

    Coordinates are those of the leg: the trunk moves by joints named after its motions, relative to the fixed link
    "world", and the angles of the joints are its own. The points of straight muscle paths are links without mass, named
    as in MJCF. The limit of the effort of a joint is the largest torque of its muscles within their domains.
    """
    leg, bodies = plant.leg, leg_bodies(plant)
    add_muscles(plant, bodies)
    robot, parent = Element("robot", name=name), "world"
    SubElement(robot, "link", name=parent)
    for motion in leg.trunk.motions or ("fixed",):
        child = "trunk" if motion == (leg.trunk.motions or ("fixed",))[-1] else f"trunk {motion}"
        if motion == "fixed":
            _joint(robot, "trunk", "fixed", parent, child)
        elif motion in TURNS:
            _joint(robot, motion, "continuous", parent, child, axis=TURNS[motion])
        else:
            moved = _joint(robot, motion, "prismatic", parent, child, axis=SLIDES[motion])
            _limit(moved, -_TRAVEL, _TRAVEL, 0.0)
        if child != "trunk":
            _link(robot, child, 0.0, 0.0, (0.0, 0.0, 0.0))
        parent = child
    last = _link(robot, "trunk", leg.trunk.mass, leg.trunk.centre, leg.trunk.inertias)
    for frame, link in zip(bodies[1:], leg.links, strict=True):
        _leg_joint(robot, frame, parent)
        last = _link(robot, frame.name, link.mass, -link.centre, link.inertias)
        parent = frame.name
    foot = SubElement(last, "collision", name="foot")
    SubElement(foot, "origin", xyz=_numbers((0.0, 0.0, -leg.links[-1].length)))
    SubElement(SubElement(foot, "geometry"), "sphere", radius=repr(float(leg.foot_radius) or 1e-4))
    for frame in bodies:
        for site, place in frame.sites.items():
            SubElement(robot, "link", name=site)
            _joint(robot, site, "fixed", frame.name, site, place)
    indent(robot)
    left_out = (
        "muscles, which URDF does not have: the points of straight paths are links",
        "ground, friction of joints, sensors and command delay",
    )
    return Exported({f"{name}.urdf": tostring(robot, encoding="unicode") + "\n"}, left_out)


def export_leg_urdf(
    scenario: LegScenario, out: str | os.PathLike[str], *, name: str = "leg", overwrite: bool = False
) -> Exported:
    """Write the leg of a scenario as URDF to a folder."""
    made = leg_urdf(scenario.plant(), check_name(name))
    write_exported(made, out, overwrite=overwrite)
    return made


def _leg_joint(robot: Element, frame: Frame, parent: str) -> None:
    """Joint of a leg, from a parent link to the link of a frame."""
    joint = frame.joint
    assert joint is not None
    turn = np.asarray(joint.direction, float) * frame.rest
    made = _joint(
        robot,
        joint.name,
        "fixed" if joint.locked is not None else "revolute",
        parent,
        frame.name,
        Vector(0.0, 0.0, -frame.origin),
        turn,
        None if joint.locked is not None else joint.direction.scaled(joint.sign),
    )
    if joint.locked is None:
        muscles = joint.muscles
        highest = [float(muscle.domain.pressure_max) for muscle in (muscles.muscle1, muscles.muscle2)]
        angles = np.linspace(float(joint.lower), float(joint.upper), _ANGLES)
        torques = [muscles.torque(angles, pressures) for pressures in ((highest[0], 0.0), (0.0, highest[1]))]
        _limit(made, joint.lower, joint.upper, np.abs(torques).max())
        SubElement(made, "dynamics", damping=repr(float(joint.damping)))


def _joint(
    robot: Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    place: Vector = Vector(0.0, 0.0, 0.0),  # noqa: B008
    turn: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    axis: Vector | None = None,
) -> Element:
    """Joint of a kind at a place, turned by a rotation vector [rad]."""
    from scipy.spatial.transform import Rotation

    joint = SubElement(robot, "joint", name=name, type=kind)
    angles = Rotation.from_rotvec(turn).as_euler("xyz")
    SubElement(joint, "origin", xyz=_numbers(place), rpy=_numbers(angles))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    if axis is not None:
        SubElement(joint, "axis", xyz=_numbers(axis))
    return joint


def _limit(joint: Element, lower: Any, upper: Any, effort: Any) -> None:
    numbers = {"lower": lower, "upper": upper, "effort": effort, "velocity": _SPEED}
    SubElement(joint, "limit", {name: repr(float(one)) for name, one in numbers.items()})


def _link(robot: Element, name: str, mass: Any, height: Any, inertias: Sequence[Any]) -> Element:
    """Link with its inertia; a massless one has almost none, since readers refuse links that move without mass."""
    link = SubElement(robot, "link", name=name)
    inertial = SubElement(link, "inertial")
    mass, *own = (max(float(one), LIGHT) for one in (mass, *inertias))
    SubElement(inertial, "origin", xyz=_numbers((0.0, 0.0, height)))
    SubElement(inertial, "mass", value=repr(mass))
    principal = {axis: repr(one) for axis, one in zip(("ixx", "iyy", "izz"), own, strict=True)}
    SubElement(inertial, "inertia", principal | dict.fromkeys(("ixy", "ixz", "iyz"), "0"))
    return link


def _numbers(values: Iterable[Any]) -> str:
    return " ".join(repr(float(one) + 0.0) for one in values)  # not -0.0
