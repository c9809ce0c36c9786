"""A leg for MuJoCo: MJCF, and the plugin for its muscles. x is forwards, y to the left, and z up."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import equinox as eqx

from mckibben.actuator.base import state_of_muscle
from mckibben.codegen.source_module import SourceModule
from mckibben.export.leg_compliance import FRICTION_RATIO, LIMIT_SPEED, TOUCH_SPEED, Compliance, compliance
from mckibben.export.mjcf import (
    COMMAND_DELAY,
    MuscleModel,
    Transmission,
    callback_actuators,
    callback_states,
    cannot,
    check_tendon,
    check_valve,
    command_range,
    keyframe,
    mjcf_document,
    numbers_text,
    path_transmission,
    plugin_actuator,
    transmissions,
)
from mckibben.export.muscle_plugin import MuscleFunctions, is_filter, plugin_files
from mckibben.export.plant import is_real
from mckibben.export.targets import Exported, check_name, write_exported
from mckibben.joint import RigidTendon, Tendon
from mckibben.leg import LegJoint, LegPlant, LegScenario, LegState
from mckibben.leg.dynamics import SLIDES, TURNS
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import numeric
from mckibben.numerics.spatial import Vector, X, Z

LIGHT = 1e-12
"""Mass [kg] and inertia [kg*m^2] of a massless body: MuJoCo does not move bodies without mass."""


class LegFrame:
    """A body under construction: its shapes in MJCF, points of muscles, and its attachment to the parent body."""

    def __init__(self, name: str, joint: LegJoint | None = None, origin: float = 0.0) -> None:
        self.name, self.joint, self.origin = name, joint, origin
        self.shapes: list[str] = []
        self.sites: dict[str, Vector] = {}

    @property
    def inside(self) -> str:
        """Contents of the body in MJCF."""
        sites = (f'<site name={quoteattr(name)} pos="{numbers_text(place)}"/>' for name, place in self.sites.items())
        return "".join((*self.shapes, *sites))

    @property
    def rest(self) -> float:
        """Angle [rad] from the parent body about the axis at joint angle 0, or at the locked angle."""
        joint = self.joint
        assert joint is not None
        return float(joint.link_angle) + joint.sign * float(joint.locked or 0.0)

    def opened(self, limit: Compliance | None) -> str:
        """Opening text of the body, with its joint."""
        assert self.joint is not None
        axis, sign = self.joint.direction, self.joint.sign
        turned = f"{numbers_text(axis)} {self.rest!r}"
        text = f'<body name={quoteattr(self.name)} pos="0 0 {-self.origin!r}" axisangle="{turned}">'
        if self.joint.locked is None:
            axis, limits = axis.scaled(sign), (self.joint.lower, self.joint.upper)
            assert limit is not None
            text += (
                f'<joint name={quoteattr(self.joint.name)} type="hinge" axis="{numbers_text(axis)}" '
                f'range="{numbers_text(limits)}" '
                f'damping="{float(self.joint.damping)!r}" solreflimit="{limit.reference}" '
                f'solimplimit="{limit.impedance}"/>'
            )
        return text


class _Driven(NamedTuple):
    """A muscle in MJCF: its tendon or the joint that it drives, and the functions that select it from a plant."""

    name: str
    tendon: str
    target: str
    parts: tuple[tuple[str, str], ...]  # sites of its straight parts
    muscle: Callable[[LegPlant], tuple[Muscle, Tendon]]
    path: Callable[[LegPlant, Any], Any]
    limits: Muscle


def leg_model(
    plant: LegPlant,
    name: str = "leg",
    timestep: float = 2.5e-4,
    start: LegState | None = None,
    *,
    plugin: bool = True,
) -> MuscleModel:
    """MJCF of a leg for steps [s], and the functions of its muscles; `ExportError` for what MuJoCo cannot express.

    `start` is the keyframe "start". Default: all angles as close to 0 as possible, without pressure, the foot on the
    ground. The actuators are those of the plugin, or of callbacks.
    """
    leg = plant.leg
    check_valve(plant.valve)
    for joint in leg.joints:
        check_tendon(joint.muscles)
    if start is None:
        start = plant.init_state(leg.posture_angles({}), [0.0] * len(leg.muscles))
    found = compliance(plant, start)
    bodies = leg_bodies(plant)
    driven, left_out = add_muscles(plant, bodies)
    alone = dataclasses.replace(plant, command_delay=None)
    module, functions = _functions(alone, name, driven, start, filters=plugin)
    left_out += [
        f"ground: MuJoCo's contact has the stiffness, the friction, and the restitution at {TOUCH_SPEED:g} m/s; its "
        "damper acts from the first touch",
        f"stops of the joints: likewise, at {LIMIT_SPEED:g} rad/s",
    ]
    if any(joint.friction is not None for joint in leg.joints):
        left_out.append("friction of the joints")
    left_out += [] if plant.has_ideal_io else ["sensors and disturbances"]
    left_out += [] if plant.command_delay is None else [COMMAND_DELAY]
    xml = _mjcf(plant, module.name, timestep, bodies, driven, functions, found, start, plugin=plugin)
    return MuscleModel(xml, module, tuple(x.summary for x in functions), tuple(x.name for x in driven), tuple(left_out))


class LegScene(NamedTuple):
    """MJCF of a leg without muscle forces, and the sites of the straight parts of the muscles."""

    xml: str
    parts: dict[str, tuple[tuple[str, str], ...]]


def leg_scene(plant: LegPlant, start: LegState) -> LegScene:
    """A leg for display in MuJoCo, moved by its coordinates; without a plugin."""
    bodies = leg_bodies(plant)
    driven, _ = add_muscles(plant, bodies)
    xml = _mjcf(plant, "leg", 1e-3, bodies, driven, [], compliance(plant, start), start)
    return LegScene(xml, {one.name: one.parts for one in driven if one.parts})


def leg_files(
    plant: LegPlant, name: str = "leg", title: str = "a leg", *, timestep: float = 2.5e-4, start: LegState | None = None
) -> Exported:
    """The model of a leg, and the plugin for its muscles; arguments as for `leg_model`."""
    model = leg_model(plant, name, timestep, start)
    left_out = ("controller: set data.ctrl yourself", *model.left_out)
    return Exported(plugin_files(model.module, model.muscles, model.xml, title, left_out), left_out)


def export_leg(
    scenario: LegScenario,
    out: str | os.PathLike[str],
    *,
    name: str = "leg",
    overwrite: bool = False,
    files: Callable[..., Exported] = leg_files,
) -> Exported:
    """Write the leg of a scenario for MuJoCo to a folder, in its touchdown or squat posture, as `files` makes it."""
    check_name(name)
    plant = scenario.plant()
    angles: dict[str, float] = {} if scenario.jump is None else scenario.jump.squat
    if scenario.landing is not None:
        angles = scenario.landing.touchdown
    start = plant.init_state(plant.leg.posture_angles(angles), [0.0] * len(plant.leg.muscles))
    made = files(plant, name, scenario.name, timestep=scenario.step, start=start)
    write_exported(made, out, overwrite=overwrite)
    return made


def leg_bodies(plant: LegPlant) -> list[LegFrame]:
    """Trunk and links, with their masses and shapes."""
    leg = plant.leg
    trunk = LegFrame("trunk")
    trunk.shapes.append(_inertial(leg.trunk.mass, leg.trunk.centre, leg.trunk.inertias))
    found = [trunk]
    origin = 0.0
    for joint, link in zip(leg.joints, leg.links, strict=True):
        frame, length = LegFrame(joint.name + " link", joint, origin), float(link.length)
        axle = joint.direction.scaled(0.016)
        frame.shapes += [
            _inertial(link.mass, -link.centre, link.inertias),
            f'<geom class="axle" fromto="{numbers_text(-axle)} {numbers_text(axle)}"/>',
        ]
        if length:
            frame.shapes.append(f'<geom class="bone" fromto="0 0 0 0 0 {-length!r}"/>')
        found.append(frame)
        origin = length
    radius = float(leg.foot_radius) or 1e-4
    found[-1].shapes.append(f'<geom name="foot" type="sphere" class="foot" pos="0 0 {-origin!r}" size="{radius!r}"/>')
    return found


def _inertial(mass: Any, height: Any, inertias: Sequence[Any]) -> str:
    mass, *inertias = (max(float(one), LIGHT) for one in (mass, *inertias))
    return f'<inertial pos="0 0 {float(height)!r}" mass="{mass!r}" diaginertia="{numbers_text(inertias)}"/>'


def add_muscles(plant: LegPlant, bodies: list[LegFrame]) -> tuple[list[_Driven], list[str]]:
    """All muscles that MuJoCo can move, with their sites added to the bodies, and the omitted parts."""
    leg = plant.leg
    found, left_out = [], []
    places = {frame.joint.name: number for number, frame in enumerate(bodies) if frame.joint is not None}

    def attach(path: str, joint: LegJoint, moved: Transmission) -> tuple[str, str]:
        """Add the sites of a straight path over a joint to its bodies; return their names."""
        child = bodies[places[joint.name]]
        parent = bodies[places[joint.name] - 1]
        names = f"{path} fixed", f"{path} moving"
        fixed, moving = anchors(joint, moved)
        for frame, name, place in zip((parent, child), names, (fixed - Z.scaled(child.origin), moving), strict=True):
            frame.sites[name] = place
        return names

    def coupled(moved: Transmission, joint: LegJoint) -> tuple[str, float]:
        """Text of a pulley in a tendon, and its length [m] at a locked joint."""
        if joint.locked is not None:
            return "", moved.coefficient * float(joint.locked)
        return f'<joint joint={quoteattr(joint.name)} coef="{moved.coefficient!r}"/>', 0.0

    for index, joint in enumerate(leg.joints):
        pair = transmissions(joint.muscles.geometry)
        for number, moved in enumerate(pair):
            name = f"{joint.name}{number + 1}"
            spatial = bool(moved.points)
            if joint.locked is not None and not spatial:
                left_out.append(f"muscle {name}: its joint is locked, and it has no tendon between points")
                continue
            parts = (attach(name, joint, moved),) if spatial else ()
            if spatial:
                tendon = _spatial(name, parts)
            elif moved.coefficient:
                tendon = f"<fixed name={quoteattr(name)}>{coupled(moved, joint)[0]}</fixed>"
            else:
                tendon = ""
                left_out.append(f"tendon of {name}: path not supported by MuJoCo; its torque acts on the joint")
            target = f"tendon={quoteattr(name)}" if tendon else f"joint={quoteattr(joint.name)}"
            own = (joint.muscles.muscle1, joint.muscles.muscle2)[number]
            found.append(
                _Driven(name, tendon, target, parts, _of_pair(index, number), _path(index, number, moved), own)
            )
    for index, one in enumerate(leg.biarticular):
        both = [leg.joints[leg.index(name)] for name in (one.joint1, one.joint2)]
        moved = [path_transmission(0, *each) for each in zip((one.path1, one.path2), one.sides, strict=True)]
        offset, parts = sum(float(each.offset) for each in moved), ()
        if all(each.points for each in moved):
            parts = tuple(
                attach(f"{one.name} {number}", joint, each)
                for number, (joint, each) in enumerate(zip(both, moved, strict=True), 1)
            )
            tendon = _spatial(one.name, parts)
        elif all(each.coefficient for each in moved):
            pieces = [coupled(each, joint) for each, joint in zip(moved, both, strict=True)]
            offset += sum(length for _, length in pieces)
            tendon = f"<fixed name={quoteattr(one.name)}>{''.join(text for text, _ in pieces)}</fixed>"
        else:
            raise cannot("path1", f"the paths of {one.name}", "give it a TwoBonePath or a Pulley over both joints")
        own = _of_biarticular(index)
        target = f"tendon={quoteattr(one.name)}"
        found.append(_Driven(one.name, tendon, target, parts, own, _beyond(offset), one.muscle))
    return found, left_out


def anchors(joint: LegJoint, moved: Transmission) -> tuple[Vector, Vector]:
    """Points [m] of a path in the plane across a joint, in the axes of its parent body and of its hanging link."""
    axis = joint.direction
    across = Z.cross(axis) if axis.x or axis.y else X  # to where a hanging link swings
    across = across.scaled(1 / math.sqrt(across.dot(across)))
    up = axis.cross(across)
    (x, z), (along, beyond) = ((joint.sign * x, y) for x, y in moved.points)
    sine, cosine = math.sin(float(joint.link_angle)), math.cos(float(joint.link_angle))
    moving = along * cosine + beyond * sine, beyond * cosine - along * sine
    return across.scaled(x) + up.scaled(z), across.scaled(moving[0]) + up.scaled(moving[1])


def _spatial(name: str, parts: Sequence[tuple[str, str]]) -> str:
    """A tendon of straight parts; its length is their sum."""
    sites = ("".join(f"<site site={quoteattr(site)}/>" for site in part) for part in parts)
    joined = '<pulley divisor="1"/>'.join(sites)
    return f'<spatial name={quoteattr(name)} class="muscle">{joined}</spatial>'


def _of_pair(index: int, number: int) -> Callable[[LegPlant], tuple[Muscle, Tendon]]:
    def found(plant: LegPlant) -> tuple[Muscle, Tendon]:
        pair = plant.leg.joints[index].muscles
        return (pair.muscle1, pair.muscle2)[number], pair.tendon

    return found


def _of_biarticular(index: int) -> Callable[[LegPlant], tuple[Muscle, Tendon]]:
    return lambda plant: (plant.leg.biarticular[index].muscle, RigidTendon())


def _path(index: int, number: int, moved: Transmission) -> Callable[[LegPlant, Any], Any]:
    if moved.tendon:
        return _beyond(float(moved.offset))
    return lambda plant, angle: plant.leg.joints[index].muscles.geometry.path_lengths(angle)[number]


def _beyond(offset: float) -> Callable[[LegPlant, Any], Any]:
    return lambda plant, length: length + offset


def _functions(
    plant: LegPlant, name: str, driven: list[_Driven], start: LegState, *, filters: bool
) -> tuple[SourceModule, list[MuscleFunctions]]:
    """The functions of all muscles in a module; `filters`: with MuJoCo's own."""
    numbers, fixed = eqx.partition(numeric(plant), is_real)
    module = SourceModule(name, {"plant": numbers}, "plant.")
    valves = [state_of_muscle(start.air, i) for i in range(len(start.pressures))]
    known = dict(zip(plant.leg.muscle_names, zip(start.muscles, start.pressures, valves, strict=True), strict=True))
    found, filtered = [], filters and is_filter(plant.valve)
    for number, one in enumerate(driven, 1):
        found.append(MuscleFunctions(fixed, number, one.muscle, one.path, known[one.name], filtered))
        found[-1].add_to(module)
    return module, found


def _trunk_joints(motions: Sequence[str]) -> str:
    """Joints of the trunk for its translations and rotations."""
    slides = {name: f'type="slide" axis="{numbers_text(axis)}"' for name, axis in SLIDES.items()}
    hinges = {name: f'type="hinge" axis="{numbers_text(axis)}"' for name, axis in TURNS.items()}
    return "".join(f'<joint name="{name}" {(slides | hinges)[name]}/>' for name in motions)


def coordinates(plant: LegPlant, of: Any) -> list[Any]:
    """Posture or velocity of a leg, numbers or arrays of them, in the order of MuJoCo's joints."""
    leg = plant.leg
    moving = [angle for angle, joint in zip(of.angles, leg.joints, strict=True) if joint.locked is None]
    return [*(getattr(of, name) for name in leg.trunk.motions), *moving]


def _mjcf(
    plant: LegPlant,
    name: str,
    timestep: float,
    bodies: list[LegFrame],
    driven: list[_Driven],
    functions: list[MuscleFunctions],
    found: dict[str, Compliance],
    start: LegState,
    *,
    plugin: bool = True,
) -> str:
    leg, contact, friction = plant.leg, found["ground"], found["friction"]
    tendons = [one.tendon for one in driven if one.tendon]
    driven = driven if functions else []  # a scene has no functions
    limits, kinds = [command_range(plant.valve, one.limits) for one in driven], [one.summary for one in functions]
    acts = [list(one.activations) for one in functions]
    if plugin:
        each = enumerate(zip(driven, kinds, limits, strict=True), 1)
        actuators = [
            plugin_actuator(name, i, one.name, one.target, kind.dynamics(plant.valve), limited)
            for i, (one, kind, limited) in each
        ]
        states = [one for each in acts for one in each]
    else:
        names, targets = [one.name for one in driven], [one.target for one in driven]
        actuators = callback_actuators(names, kinds, targets, limits)
        states = callback_states(acts)
    controls = [0.0 if plant.valve.direct else one.pressure for one in functions]
    controls += [0.0] * (len(actuators) - len(controls))
    posture, velocity = (coordinates(plant, of) for of in (start.posture, start.velocity))
    fixed = leg.trunk.freedom == "fixed"
    body = (
        f'<body name="trunk" pos="0 0 {float(start.posture.z) if fixed else 0.0!r}">{_trunk_joints(leg.trunk.motions)}'
    )
    top = max([0.1, *(float(place.z) for place in bodies[0].sites.values())])
    body += f'<geom class="bone" fromto="0 0 0 0 0 {top!r}"/><geom class="trunk" pos="0 0 {top + 0.03!r}"/>'
    body += bodies[0].inside
    for frame in bodies[1:]:
        assert frame.joint is not None
        body += "\n    " + frame.opened(found.get(frame.joint.name)) + frame.inside
    body += "</body>" * len(bodies)
    joints = [frame.joint.name for frame in bodies[1:] if frame.joint is not None and frame.joint.locked is None]
    sensors = "".join(f"<jointpos name={quoteattr(one)} joint={quoteattr(one)}/>" for one in joints)
    mu = float(plant.ground.friction)
    scene = f"""<option cone="elliptic" impratio="{FRICTION_RATIO!r}"/>
  <visual>
    <global offwidth="1280" offheight="1280"/><map znear="0.01"/><quality shadowsize="4096" offsamples="8"/>
    <headlight ambient="0.55 0.55 0.55" diffuse="0.25 0.25 0.25" specular="0.1 0.1 0.1"/><rgba haze="1 1 1 1"/>
  </visual>
  <default>
    <geom contype="0" conaffinity="0"/><site size="0.004" rgba="0.3 0.32 0.35 1"/>
    <default class="bone"><geom type="capsule" size="0.011" rgba="0.72 0.74 0.77 1"/></default>
    <default class="axle"><geom type="cylinder" size="0.028" rgba="0.30 0.33 0.37 1"/></default>
    <default class="foot"><geom rgba="0.13 0.14 0.16 1"/></default>
    <default class="trunk"><geom type="box" size="0.07 0.06 0.03" rgba="0.13 0.36 0.56 1"/></default>
    <default class="muscle"><tendon width="0.003" rgba="0.3 0.32 0.35 1"/></default>
  </default>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="0.93 0.95 0.97" rgb2="1 1 1" width="32" height="256"/>
    <texture name="floor" type="2d" builtin="checker" rgb1="0.97 0.97 0.97" rgb2="0.87 0.89 0.91"
      width="256" height="256"/>
    <material name="floor" texture="floor" texrepeat="40 40" texuniform="false"/>
  </asset>
  <worldbody>
    <light pos="-0.5 -1.0 3" dir="0.15 0.3 -1" diffuse="0.45 0.45 0.45" specular="0.2 0.2 0.2"/>
    <geom name="floor" type="plane" size="4 4 0.1" zaxis="{numbers_text(plant.ground.normal)}" material="floor"/>
    {body}
  </worldbody>
  <contact>
    <pair geom1="floor" geom2="foot" condim="3" friction="{mu!r} {mu!r} 0 0 0" solref="{contact.reference}"
      solreffriction="{friction.reference}" solimp="{contact.impedance}"/>
  </contact>"""
    return mjcf_document(
        name,
        timestep=timestep,
        gravity=float(plant.gravity),
        scene=scene,
        tendons=tendons,
        actuators=actuators,
        sensors=sensors,
        start=keyframe(qpos=posture, qvel=velocity, act=states, ctrl=controls),
    )
