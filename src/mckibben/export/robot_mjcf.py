"""MuJoCo models of robots: MJCF, and the plugin for their muscles. x is forwards, y to the left, and z up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, SupportsFloat
from xml.sax.saxutils import quoteattr

from jaxtyping import Array, ArrayLike

from mckibben.export.mjcf import (
    Drive,
    MuscleModel,
    Scene,
    Transmission,
    beyond,
    cannot,
    check_valve,
    muscle_model,
    numbers_text,
    path_transmission,
    transmissions,
)
from mckibben.export.muscle_plugin import plugin_files
from mckibben.export.robot_compliance import FRICTION_RATIO, LIMIT_SPEED, TOUCH_SPEED, Compliance, compliance
from mckibben.export.targets import Exported, filled
from mckibben.joint import RigidTendon, Tendon
from mckibben.muscle import Muscle
from mckibben.numerics.spatial import Vector, X, Z
from mckibben.robot import Joint, RobotPlant, RobotScenario, RobotState
from mckibben.robot.dynamics import SLIDES, TURNS, Posture, Velocity

_LIGHT = 1e-12  # mass [kg] and inertia [kg*m^2] of a massless body: MuJoCo does not move bodies without mass


def robot_model(
    plant: RobotPlant,
    name: str = "robot",
    timestep: float = 2.5e-4,
    start: RobotState | None = None,
    *,
    plugin: bool = True,
) -> MuscleModel:
    """MJCF of a robot, and the functions of its muscles; `ExportError` for parts that MuJoCo cannot represent.

    Parameters
    ----------
    name
        Name of the model and of the plugin, an identifier of C.
    timestep
        Time step [s], of the classical Runge-Kutta method.
    start
        State of the keyframe "start". Default: all angles as close to 0 as possible, without pressure, the foot on the
        ground.
    plugin
        Whether the actuators are those of the plugin; otherwise, callbacks set their forces, as in MuJoCo Warp.
    """
    robot = plant.robot
    check_valve(plant.valve)
    if robot.spanning or robot.parents != tuple(range(len(robot.joints))) or any(joint.place for joint in robot.joints):
        raise cannot("spanning", "a tree of links, or muscles through points", "give a chain of links with pairs")
    if start is None:
        start = plant.init_state(robot.posture_angles({}), [0.0] * len(robot.muscles))
    rigging = _Rigging(plant)
    left_out = [
        *rigging.left_out,
        f"ground: MuJoCo's contact has the stiffness, the friction, and the restitution at {TOUCH_SPEED:g} m/s; its "
        "damper acts from the first touch",
        f"stops of the joints: likewise, at {LIMIT_SPEED:g} rad/s",
    ]
    if any(joint.friction is not None for joint in robot.joints):
        left_out.append("friction of the joints")
    scene = _scene(plant, rigging.bodies, start)
    return muscle_model(plant, name, timestep, rigging.drives, scene, start, left_out, plugin=plugin)


def robot_files(plant: RobotPlant, name: str = "robot", title: str = "a robot", **options: Any) -> Exported:
    """The model of a robot, and the plugin for its muscles; options as for `robot_model`."""
    model = robot_model(plant, name, **options)
    left_out = ("controller: set data.ctrl yourself", *model.left_out)
    return Exported(plugin_files(model.module, model.muscles, model.xml, title, left_out), left_out)


def mjcf_files(scenario: RobotScenario, name: str, folder: Path) -> Exported:
    """The robot of a scenario in its touchdown or squat posture, and the plugin for its muscles."""
    plant, start = plant_and_start(scenario)
    return robot_files(plant, name, scenario.name, timestep=scenario.step, start=start)


def plant_and_start(scenario: RobotScenario) -> tuple[RobotPlant, RobotState]:
    """Plant of a scenario, and its touchdown or squat posture without pressure."""
    plant = scenario.plant()
    angles: dict[str, float] = {} if scenario.jump is None else scenario.jump.squat
    if scenario.landing is not None:
        angles = scenario.landing.touchdown
    return plant, plant.init_state(plant.robot.posture_angles(angles), [0.0] * len(plant.robot.muscles))


class _Body:
    """A body under construction: its shapes in MJCF, points of muscles, and its attachment to the parent body."""

    def __init__(self, name: str, shapes: list[str], joint: Joint | None = None, origin: float = 0.0) -> None:
        """A body with shapes, on a joint at a distance below that of its parent."""
        self.name, self.shapes, self.joint, self.origin = name, shapes, joint, origin
        self.sites: dict[str, Vector] = {}

    @property
    def inside(self) -> str:
        """Contents of the body in MJCF."""
        sites = (f'<site name={quoteattr(name)} pos="{numbers_text(place)}"/>' for name, place in self.sites.items())
        return "".join((*self.shapes, *sites))

    def opened(self, limit: Compliance | None) -> str:
        """Opening text of the body, with its joint, which has a limit unless it is locked."""
        joint = self.joint
        assert joint is not None
        rest = float(joint.link_angle) + joint.sign * float(joint.locked or 0.0)
        turned = f"{numbers_text(joint.direction)} {rest!r}"
        text = f'<body name={quoteattr(self.name)} pos="0 0 {-self.origin!r}" axisangle="{turned}">'
        if limit is None:
            return text
        axis = numbers_text(joint.direction.scaled(joint.sign))
        return text + (
            f'<joint name={quoteattr(joint.name)} type="hinge" axis="{axis}" '
            f'range="{numbers_text((joint.lower, joint.upper))}" damping="{float(joint.damping)!r}" '
            f'armature="{float(joint.rotor_inertia or 0.0)!r}" '
            f'solreflimit="{limit.reference}" solimplimit="{limit.impedance}"/>'
        )


def _bodies(plant: RobotPlant) -> list[_Body]:
    """Trunk and links, with their masses and shapes."""
    robot, origin = plant.robot, 0.0
    bodies = [_Body("trunk", [_inertial(robot.trunk.mass, robot.trunk.centre, robot.trunk.inertias)])]
    for joint, link in zip(robot.joints, robot.links, strict=True):
        axle, length = joint.direction.scaled(0.016), float(link.length)
        shapes = [
            _inertial(link.mass, -link.centre, link.inertias),
            f'<geom class="axle" fromto="{numbers_text(-axle)} {numbers_text(axle)}"/>',
        ]
        shapes += [f'<geom class="bone" fromto="0 0 0 0 0 {-length!r}"/>'] if length else []
        bodies.append(_Body(joint.name + " link", shapes, joint, origin))
        origin = length
    radius = float(robot.foot_radius) or 1e-4
    bodies[-1].shapes.append(f'<geom name="foot" type="sphere" class="foot" pos="0 0 {-origin!r}" size="{radius!r}"/>')
    return bodies


def _inertial(mass: SupportsFloat, height: SupportsFloat, inertias: Sequence[SupportsFloat]) -> str:
    """Mass [kg], height of its centre [m] and moments of inertia [kg*m^2] in MJCF."""
    mass, *inertias = (max(float(number), _LIGHT) for number in (mass, *inertias))
    return f'<inertial pos="0 0 {float(height)!r}" mass="{mass!r}" diaginertia="{numbers_text(inertias)}"/>'


class _Rigging:
    """Bodies of a robot with the sites of its muscles, the muscles that MuJoCo can move, and the omitted parts."""

    def __init__(self, plant: RobotPlant) -> None:
        """Add all muscles of a robot."""
        self.bodies = _bodies(plant)
        self.drives: list[Drive] = []
        self.left_out: list[str] = []
        robot = plant.robot
        for index, joint in enumerate(robot.joints):
            for number, moved in enumerate(transmissions(joint.pair.geometry)):
                self._add_muscle(joint, index, number, moved)
        for number in range(len(robot.biarticular)):
            self._add_biarticular(plant, number)

    def _add_muscle(self, joint: Joint, index: int, number: int, moved: Transmission) -> None:
        """Add a muscle of the pair of a joint."""
        name = f"{joint.name}{number + 1}"
        if joint.locked is not None and not moved.points:
            self.left_out.append(f"muscle {name}: its joint is locked, and it has no tendon between points")
            return
        tendon = ""
        if moved.points:
            tendon = _spatial(name, [self._attach(name, index, joint, moved)])
        elif moved.coefficient:
            tendon = f"<fixed name={quoteattr(name)}>{_coupled(moved, joint)[0]}</fixed>"
        else:
            self.left_out.append(f"tendon of {name}: path not supported by MuJoCo; its torque acts on the joint")

        def muscle(plant: RobotPlant) -> tuple[Muscle, Tendon]:
            pair = plant.robot.joints[index].pair
            return (pair.muscle1, pair.muscle2)[number], pair.tendon

        def path(plant: RobotPlant, angle: Array) -> Array:
            return plant.robot.joints[index].pair.geometry.path_lengths(angle)[number]

        path_of = beyond(moved.offset) if tendon else path
        self.drives.append(Drive(name, tendon, joint.name, 2 * index + number, muscle, path_of))

    def _add_biarticular(self, plant: RobotPlant, number: int) -> None:
        """Add a muscle over two joints."""
        robot, biarticular = plant.robot, plant.robot.biarticular[number]
        name = biarticular.name
        indices = [robot.index(joint) for joint in (biarticular.joint1, biarticular.joint2)]
        joints = [robot.joints[index] for index in indices]
        paths = zip((biarticular.path1, biarticular.path2), biarticular.sides, strict=True)
        moved = [path_transmission(0, path, side) for path, side in paths]
        offset = sum(transmission.offset for transmission in moved)
        if all(transmission.points for transmission in moved):
            places = enumerate(zip(indices, joints, moved, strict=True), 1)
            tendon = _spatial(name, [self._attach(f"{name} {part}", *place) for part, place in places])
        elif all(transmission.coefficient for transmission in moved):
            texts, lengths = zip(*map(_coupled, moved, joints), strict=True)
            offset += sum(lengths)
            tendon = f"<fixed name={quoteattr(name)}>{''.join(texts)}</fixed>"
        else:
            raise cannot("path1", f"the paths of {name}", "give it a TwoBonePath or a Pulley over both joints")

        def muscle(plant: RobotPlant) -> tuple[Muscle, Tendon]:
            return plant.robot.biarticular[number].muscle, RigidTendon()

        index = 2 * len(robot.joints) + number
        self.drives.append(Drive(name, tendon, "", index, muscle, beyond(offset)))

    def _attach(self, path: str, index: int, joint: Joint, moved: Transmission) -> tuple[str, str]:
        """Add the sites of a straight path over a joint to its bodies; return their names."""
        parent, child = self.bodies[index : index + 2]
        names, (fixed, moving) = (f"{path} fixed", f"{path} moving"), anchors(joint, moved)
        parent.sites[names[0]] = fixed - Z.scaled(child.origin)
        child.sites[names[1]] = moving
        return names


def _coupled(moved: Transmission, joint: Joint) -> tuple[str, float]:
    """Text of a pulley in a tendon, and its length [m] at a locked joint."""
    if joint.locked is not None:
        return "", moved.coefficient * float(joint.locked)
    return f'<joint joint={quoteattr(joint.name)} coef="{moved.coefficient!r}"/>', 0.0


def anchors(joint: Joint, moved: Transmission) -> tuple[Vector, Vector]:
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


def coordinates(plant: RobotPlant, of: Posture | Velocity) -> list[ArrayLike]:
    """Posture or velocity of a robot, numbers or arrays of them, in the order of MuJoCo's joints."""
    robot = plant.robot
    moving = [angle for angle, joint in zip(of.angles, robot.joints, strict=True) if joint.locked is None]
    return [*(getattr(of, name) for name in robot.trunk.motions), *moving]


def _scene(plant: RobotPlant, bodies: Sequence[_Body], start: RobotState) -> Scene:
    """Ground and bodies of a robot, with the posture at the start."""
    softness = compliance(plant, start)
    contact = softness["ground"]
    values = {
        "friction_ratio": repr(FRICTION_RATIO),
        "normal": numbers_text(plant.ground.normal),
        "body": _trunk(plant, bodies[0], start) + "".join(_links(bodies[1:], softness)) + "</body>" * len(bodies),
        "friction": repr(float(plant.ground.friction)),
        "contact_reference": contact.reference,
        "contact_impedance": contact.impedance,
        "friction_reference": softness["friction"].reference,
    }
    joints = [joint.name for joint in plant.robot.joints if joint.locked is None]
    sensors = "".join(f"<jointpos name={quoteattr(name)} joint={quoteattr(name)}/>" for name in joints)
    position, velocity = (coordinates(plant, of) for of in (start.posture, start.velocity))
    return Scene(filled("robot-scene.xml", values), float(plant.gravity), sensors, position, velocity)


def _trunk(plant: RobotPlant, body: _Body, start: RobotState) -> str:
    """Opening text of the trunk, with joints for its translations and rotations."""
    trunk = plant.robot.trunk
    kinds = {name: ("slide", axis) for name, axis in SLIDES.items()}
    kinds |= {name: ("hinge", axis) for name, axis in TURNS.items()}
    moves = ((name, *kinds[name]) for name in trunk.motions)
    joints = "".join(f'<joint name="{name}" type="{kind}" axis="{numbers_text(axis)}"/>' for name, kind, axis in moves)
    height = float(start.posture.z) if trunk.freedom == "fixed" else 0.0
    top = max([0.1, *(float(place.z) for place in body.sites.values())])
    shapes = f'<geom class="bone" fromto="0 0 0 0 0 {top!r}"/><geom class="trunk" pos="0 0 {top + 0.03!r}"/>'
    return f'<body name="trunk" pos="0 0 {height!r}">{joints}{shapes}{body.inside}'


def _links(bodies: Sequence[_Body], softness: dict[str, Compliance]) -> list[str]:
    """Opening texts of the links, each inside the one before."""
    return [f"\n    {body.opened(softness.get(body.joint.name))}{body.inside}" for body in bodies if body.joint]
