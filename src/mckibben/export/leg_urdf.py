"""A leg as URDF: links, joints with limits and damping, inertias and shapes. x is forwards, y to the left, and z up."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial.transform import Rotation

from mckibben.errors import ExportError
from mckibben.export.leg_mjcf import LIGHT, add_muscles, leg_bodies
from mckibben.export.mjcf import numbers_text
from mckibben.export.targets import Exported, check_name, write_exported
from mckibben.leg import Leg, LegPlant, LegScenario
from mckibben.leg.dynamics import SLIDES, TURNS
from mckibben.numerics.spatial import Vector

_FAR = 100.0
"""Limits that URDF requires and the leg does not have: travel of the trunk [m], and speeds [m/s, rad/s]."""
_ANGLES = 41  # of each joint, over which its largest torque is sought


def leg_urdf(plant: LegPlant, name: str = "leg", title: str = "a leg") -> Exported:
    """Bodies of a leg as `<name>.urdf`, and the omitted parts; `ExportError` for two joints or links of one name.

    The trunk moves from a link `world`, with the hip at its origin, by one joint for each of its coordinates
    (`trunk_z`, ...). Joints have the angles of the leg; those that are locked are fixed. The ends of straight muscle
    paths are links without mass, such as `knee1_fixed` and `knee1_moving`.
    """
    leg, left_out = plant.leg, _left_out(plant)
    robot = Element("robot", name=name)
    SubElement(robot, "link", name="world")
    above = "world"
    for number, motion in enumerate(leg.trunk.motions, 1):
        last = number == len(leg.trunk.motions)
        below, slides = "trunk" if last else f"trunk_{motion}_link", motion in SLIDES
        kind = "prismatic" if slides else "continuous"
        joint = _joint(robot, f"trunk_{motion}", kind, above, below, axis=(SLIDES if slides else TURNS)[motion])
        travel = {"lower": repr(-_FAR), "upper": repr(_FAR)} if slides else {}
        SubElement(joint, "limit", travel, effort="0.0", velocity=repr(_FAR))
        if not last:
            _inertial(SubElement(robot, "link", name=below), 0.0, 0.0, (0.0, 0.0, 0.0))
        above = below
    if not leg.trunk.motions:
        _joint(robot, "trunk_fixed", "fixed", "world", "trunk")
    trunk = SubElement(robot, "link", name="trunk")
    _inertial(trunk, leg.trunk.mass, leg.trunk.centre, leg.trunk.inertias)
    _shape(trunk, "visual", float(leg.trunk.centre), "box", size="0.14 0.12 0.06")
    above, bodies = "trunk", leg_bodies(plant)
    for frame, joint, link, effort in zip(bodies[1:], leg.joints, leg.links, _efforts(leg), strict=True):
        below, length, locked = f"{joint.name}_link", float(link.length), joint.locked is not None
        given = {"place": Vector(0.0, 0.0, -frame.origin), "turn": np.array(joint.direction, float) * frame.rest}
        axis = joint.direction.scaled(joint.sign)
        made = _joint(robot, joint.name, "fixed" if locked else "revolute", above, below, **given, axis=axis)
        if not locked:
            limits = {"lower": repr(float(joint.lower)), "upper": repr(float(joint.upper))}
            SubElement(made, "limit", limits, effort=repr(effort), velocity=repr(_FAR))
            SubElement(made, "dynamics", damping=repr(float(joint.damping)))
        body = SubElement(robot, "link", name=below)
        _inertial(body, link.mass, -link.centre, link.inertias)
        if length:
            _shape(body, "visual", -length / 2, "cylinder", radius="0.011", length=repr(length))
        above = below
    if float(leg.foot_radius):
        for what in ("visual", "collision"):
            _shape(robot[-1], what, -float(leg.links[-1].length), "sphere", radius=repr(float(leg.foot_radius)))
    try:
        add_muscles(plant, bodies)
    except ExportError as error:
        left_out = *left_out, error.message
    for body, owner in zip(bodies, ("trunk", *(f"{joint.name}_link" for joint in leg.joints)), strict=True):
        for site, place in body.sites.items():
            end = site.replace(" ", "_")
            SubElement(robot, "link", name=end)
            _joint(robot, f"{end}_joint", "fixed", owner, end, place=place)
    names = [(one.tag, one.get("name")) for one in robot]
    if len(set(names)) < len(names):
        tag, twice = next(one for one in names if names.count(one) > 1)
        raise ExportError(f"two of the {tag}s are named {twice}", field="name", remedy="rename a joint of the leg")
    ElementTree.indent(robot)
    comment = "\n".join(("", f"{title}: its bodies, without", *(f"- {one}" for one in left_out), ""))
    text = ElementTree.tostring(robot, encoding="unicode")
    header = f'<?xml version="1.0"?>\n<!--{re.sub("-(?=-)", "- ", comment)}-->\n'
    return Exported({f"{name}.urdf": f"{header}{text}\n"}, left_out)


def export_leg_urdf(
    scenario: LegScenario, out: str | os.PathLike[str], *, name: str = "leg", overwrite: bool = False
) -> Exported:
    """Write the leg of a scenario as URDF to a folder."""
    made = leg_urdf(scenario.plant(), check_name(name), scenario.name)
    write_exported(made, out, overwrite=overwrite)
    return made


def _left_out(plant: LegPlant) -> tuple[str, ...]:
    """Parts of a leg that URDF cannot hold."""
    leg = plant.leg
    found = [
        f"muscles ({', '.join(leg.muscle_names)}) and valves: the effort of a joint is the largest torque of muscles",
        "compliance of the stops: limits of the angles are rigid or ignored, as the reader of the file decides",
        "ground, with its stiffness, friction and slope",
    ]
    if any(not float(link.mass) for link in leg.links) or len(leg.trunk.motions) > 1:
        found.append(f"links without mass: they have {LIGHT:g} kg and kg*m^2, as some readers refuse 0")
    if any(joint.friction is not None for joint in leg.joints):
        found.append("friction of the joints")
    if not plant.has_ideal_io or plant.command_delay is not None:
        found.append("sensors, disturbances and command delay")
    found.append(
        f"limits of speed, which URDF requires: {_FAR:g} rad/s; the trunk can move by {_FAR:g} m, without effort"
    )
    return tuple(found)


def _efforts(leg: Leg) -> list[float]:
    """Largest torque [N*m] of the muscles on each joint over its range, with the others in the middle of theirs."""
    found = []
    ranges = [np.linspace(joint.lower, joint.upper, _ANGLES) for joint in leg.joints]
    middles = [float(np.mean(one)) for one in ranges]
    highest = [float(muscle.domain.pressure_max) for muscle in leg.muscles]
    for index, angles in enumerate(ranges):
        at = leg.held([*middles[:index], angles, *middles[index + 1 :]])
        signed = []
        for number, pressure in enumerate(highest):
            alone = [pressure if number == one else 0.0 for one in range(len(highest))]
            signed.append(np.broadcast_to(np.asarray(leg.torques(at, alone)[index]), angles.shape))
        both = [np.sum([side * np.maximum(side * one, 0.0) for one in signed], axis=0) for side in (1, -1)]
        found.append(float(np.abs(both).max()))
    return found


def _joint(
    robot: Element,
    name: str,
    kind: str,
    parent: str,
    child: str,
    *,
    place: Vector = Vector(0.0, 0.0, 0.0),  # noqa: B008
    turn: Any = (0.0, 0.0, 0.0),
    axis: Vector | None = None,
) -> Element:
    """A joint at a place [m] in the parent, turned by a rotation vector [rad]."""
    found = SubElement(robot, "joint", name=name, type=kind)
    angles = Rotation.from_rotvec(turn).as_euler("xyz")  # about fixed axes: roll, pitch and yaw
    SubElement(found, "origin", xyz=numbers_text(place), rpy=numbers_text(angles))
    SubElement(found, "parent", link=parent)
    SubElement(found, "child", link=child)
    if axis is not None and kind != "fixed":
        SubElement(found, "axis", xyz=numbers_text(axis))
    return found


def _inertial(link: Element, mass: Any, height: Any, inertias: Iterable[Any]) -> None:
    mass, *inertias = (max(float(one), LIGHT) for one in (mass, *inertias))
    found = SubElement(link, "inertial")
    SubElement(found, "origin", xyz=numbers_text((0.0, 0.0, height)), rpy=numbers_text((0.0, 0.0, 0.0)))
    SubElement(found, "mass", value=repr(mass))
    ixx, iyy, izz = map(repr, inertias)
    SubElement(found, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0.0", ixz="0.0", iyz="0.0")


def _shape(link: Element, what: str, height: float, kind: str, **sizes: str) -> None:
    found = SubElement(link, what)
    SubElement(found, "origin", xyz=numbers_text((0.0, 0.0, height)), rpy=numbers_text((0.0, 0.0, 0.0)))
    SubElement(SubElement(found, "geometry"), kind, sizes)
