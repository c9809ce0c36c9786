"""MuJoCo models of robots: MJCF, and the plugin for their muscles. x is forwards, y to the left, and z up."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
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
from mckibben.joint import Tendon
from mckibben.muscle import Muscle
from mckibben.numerics.spatial import Vector, X, Z
from mckibben.robot import Body, Joint, MusclePair, PathMuscle, RobotPlant, RobotScenario, RobotState
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
    if start is None:
        start = plant.init_state(robot.posture_angles({}), [0.0] * len(robot.all_muscles))
    rigging = _Rigging(plant)
    left_out = [*rigging.left_out, f"stops of the joints: MuJoCo's, with our restitution at {LIMIT_SPEED:g} rad/s"]
    if robot.foot is not None:
        left_out.append(
            f"ground: MuJoCo's contact has the stiffness, the friction, and the restitution at {TOUCH_SPEED:g} m/s; "
            "its damper acts from the first touch"
        )
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
    """The robot of a scenario at its start, or in touchdown or squat posture, and the plugin for its muscles."""
    plant, start, timestep = plant_and_start(scenario)
    return robot_files(plant, name, scenario.name, timestep=timestep, start=start)


def plant_and_start(scenario: RobotScenario) -> tuple[RobotPlant, RobotState, float]:
    """Plant of a scenario, start of its run or, without a controller, touchdown or squat, and a time step [s]."""
    plant = scenario.plant()
    if scenario.duration is not None:
        start, period = plant.begin(scenario.initial()), scenario.control_period
        return plant, start, period / (scenario.substeps or plant.needed_substeps(start.posture.angles, None, period))
    angles: dict[str, float] = {} if scenario.jump is None else scenario.jump.squat
    if scenario.landing is not None:
        angles = scenario.landing.touchdown
    start = plant.init_state(plant.robot.posture_angles(angles), [0.0] * len(plant.robot.all_muscles))
    return plant, start, scenario.control_period


class _Body:
    """Body of a joint, or the base: its shapes in MJCF, points of muscles, and children."""

    def __init__(self, name: str, body: Body | None, joint: Joint | None) -> None:
        self.name, self.joint, self.below = name, joint, list[_Body]()
        self.shapes = [_inertial(body)]
        if joint is not None:
            axle = joint.direction.scaled(0.016)
            self.shapes.append(f'<geom class="axle" fromto="{numbers_text(-axle)} {numbers_text(axle)}"/>')
        self.sites: dict[str, Vector] = {}

    def bone(self, end: Vector) -> None:
        """Draw a bone from the hinge to a point."""
        if any(end):
            self.shapes.append(f'<geom class="bone" fromto="0 0 0 {numbers_text(end)}"/>')

    def attach(self, name: str, place: Vector) -> str:
        """Add a site; return its name."""
        self.sites[name] = place
        return name

    def text(self, softness: dict[str, Compliance]) -> str:
        """Contents of the body in MJCF, with the bodies on it."""
        sites = (f'<site name={quoteattr(name)} pos="{numbers_text(place)}"/>' for name, place in self.sites.items())
        return "".join((*self.shapes, *sites, *(f"\n    {body.hung(softness)}" for body in self.below)))

    def hung(self, softness: dict[str, Compliance]) -> str:
        """The body on its joint, which has a limit unless it is locked."""
        joint = self.joint
        assert joint is not None
        rest = float(joint.offset) + float(joint.locked or 0.0)
        turned = f"{numbers_text(joint.direction)} {rest!r}"
        place = numbers_text(joint.place.vector)
        opened = f'<body name={quoteattr(self.name)} pos="{place}" axisangle="{turned}">'
        if limit := softness.get(joint.name):
            opened += (
                f'<joint name={quoteattr(joint.name)} type="hinge" axis="{numbers_text(joint.direction)}" '
                f'range="{numbers_text((joint.lower, joint.upper))}" damping="{float(joint.damping)!r}" '
                f'armature="{float(joint.rotor_inertia or 0.0)!r}" '
                f'solreflimit="{limit.reference}" solimplimit="{limit.impedance}"/>'
            )
        return f"{opened}{self.text(softness)}</body>"


def _bodies(plant: RobotPlant) -> list[_Body]:
    """The base and what each joint carries, with their masses and shapes."""
    robot = plant.robot
    joints = (None, *robot.joints)
    bodies = [_Body(*parts) for parts in zip(robot.frame_names, robot.frame_bodies, joints, strict=True)]
    for joint, parent, body in zip(robot.joints, robot.parents, bodies[1:], strict=True):
        bodies[parent].below.append(body)
        bodies[parent].bone(joint.place.vector)
    if robot.foot is not None:
        body, place = bodies[robot.frame_names.index(robot.foot.body)], robot.foot.place.vector
        radius = float(robot.foot.radius) or 1e-4
        body.bone(place)
        body.shapes.append(
            f'<geom name="foot" type="sphere" class="foot" pos="{numbers_text(place)}" size="{radius!r}"/>'
        )
    return bodies


def _inertial(body: Body | None) -> str:
    """Mass [kg], its centre [m] and moments of inertia [kg*m^2] in MJCF."""
    if body is None:
        return f'<inertial pos="0 0 0" mass="{_LIGHT!r}" diaginertia="{_LIGHT!r} {_LIGHT!r} {_LIGHT!r}"/>'
    xx, xy, xz, yy, yz, zz = map(float, body.tensor)
    xx, yy, zz = (max(moment, _LIGHT) for moment in (xx, yy, zz))
    mass, inertia = max(float(body.mass), _LIGHT), f'diaginertia="{numbers_text((xx, yy, zz))}"'
    if any((xy, xz, yz)):
        inertia = f'fullinertia="{numbers_text((xx, yy, zz, xy, xz, yz))}"'
    return f'<inertial pos="{numbers_text(body.centre.vector)}" mass="{mass!r}" {inertia}/>'


class _Rigging:
    """Bodies of a robot with the sites of its muscles, the muscles that MuJoCo can move, and the omitted parts."""

    def __init__(self, plant: RobotPlant) -> None:
        self.robot, self.bodies = plant.robot, _bodies(plant)
        self.drives: list[Drive] = []
        self.left_out: list[str] = []
        first = 0
        for number, unit in enumerate(self.robot.muscles):
            if isinstance(unit, MusclePair):
                for of_pair, moved in enumerate(transmissions(unit.geometry)):
                    self._add_of_pair(number, unit, of_pair, first + of_pair, moved)
            elif isinstance(unit, PathMuscle):
                self._add(number, unit, first)
            else:
                raise cannot("muscles", f"a {type(unit).__name__}", "give it a path through points")
            first += len(unit.names)

    def _add_of_pair(self, unit: int, pair: MusclePair, number: int, index: int, moved: Transmission) -> None:
        """Add a muscle of a pair."""
        name, joint = pair.names[number], self.robot.joints[self.robot.index(pair.over)]
        if joint.locked is not None and not moved.points:
            self.left_out.append(f"muscle {name}: its joint is locked, and it has no tendon between points")
            return
        tendon = ""
        if moved.points:
            tendon = _spatial(name, [self._across(name, joint, moved)])
        elif moved.coefficient:
            tendon = f"<fixed name={quoteattr(name)}>{_coupled(moved, joint)[0]}</fixed>"
        else:
            self.left_out.append(f"tendon of {name}: path not supported by MuJoCo; its torque acts on the joint")

        def path(plant: RobotPlant, angle: Array) -> Array:
            return plant.robot.muscles[unit].geometry.path_lengths(angle)[number]  # type: ignore[attr-defined]

        path_of = beyond(moved.offset) if tendon else path
        self.drives.append(Drive(name, tendon, joint.name, index, _muscle_of(unit, number), path_of))

    def _add(self, unit: int, muscle: PathMuscle, index: int) -> None:
        """Add a muscle over joints and through points."""
        joints = [self.robot.joints[self.robot.index(part.joint)] for part in muscle.over]
        moved = [path_transmission(0, part.path, part.side) for part in muscle.over]
        offset = sum(transmission.offset for transmission in moved) - float(muscle.connector_length)
        name = muscle.name
        if all(transmission.points for transmission in moved):
            pairs = enumerate(zip(joints, moved, strict=True), 1)
            parts = [self._across(f"{name} {part}", *pair) for part, pair in pairs]
            frames = [self.robot.frame_names.index(point.body) for point in muscle.through]
            places = [point.place.vector for point in muscle.through]
            sites = [
                self.bodies[frame].attach(f"{name} point {number}", place)
                for number, (frame, place) in enumerate(zip(frames, places, strict=True), 1)
            ]
            tendon = _spatial(name, [*parts, *([sites] if sites else [])])
        elif all(transmission.coefficient for transmission in moved) and not muscle.through:
            texts, lengths = zip(*map(_coupled, moved, joints), strict=True)
            offset += sum(lengths)
            tendon = f"<fixed name={quoteattr(name)}>{''.join(texts)}</fixed>"
        else:
            raise cannot("over", f"the paths of {name}", "give it points, or a TwoBonePath or a Pulley over each joint")
        self.drives.append(Drive(name, tendon, "", index, _muscle_of(unit, 0), beyond(offset)))

    def _across(self, path: str, joint: Joint, moved: Transmission) -> list[str]:
        """Add the sites of a straight path over a joint to its bodies; return their names."""
        number = self.robot.index(joint.name)
        fixed, moving = anchors(joint, moved)
        above, below = self.bodies[self.robot.parents[number]], self.bodies[number + 1]
        first = above.attach(f"{path} fixed", fixed + joint.place.vector)
        return [first, below.attach(f"{path} moving", moving)]


def _muscle_of(unit: int, number: int) -> Callable[[Any], tuple[Muscle, Tendon]]:
    """Selection of a muscle and its tendon from a plant."""

    def muscle(plant: RobotPlant) -> tuple[Muscle, Tendon]:
        of = plant.robot.muscles[unit]
        return of.muscles[number], of.tendon  # type: ignore[attr-defined]

    return muscle


def _coupled(moved: Transmission, joint: Joint) -> tuple[str, float]:
    """Text of a pulley in a tendon, and its length [m] at a locked joint."""
    if joint.locked is not None:
        return "", moved.coefficient * float(joint.locked)
    return f'<joint joint={quoteattr(joint.name)} coef="{moved.coefficient!r}"/>', 0.0


def anchors(joint: Joint, moved: Transmission) -> tuple[Vector, Vector]:
    """Points [m] of a path in the plane across a joint, from its hinge, in the axes of its parent and of its body."""
    axis = joint.direction
    across = Z.cross(axis) if axis.x or axis.y else X  # to where a hanging body swings
    across = across.scaled(1 / math.sqrt(across.dot(across)))
    up = axis.cross(across)
    (x, z), (along, beyond) = moved.points
    sine, cosine = math.sin(float(joint.offset)), math.cos(float(joint.offset))
    moving = along * cosine + beyond * sine, beyond * cosine - along * sine
    return across.scaled(x) + up.scaled(z), across.scaled(moving[0]) + up.scaled(moving[1])


def _spatial(name: str, parts: Sequence[Sequence[str]]) -> str:
    """A tendon of straight parts; its length is their sum."""
    sites = ("".join(f"<site site={quoteattr(site)}/>" for site in part) for part in parts)
    joined = '<pulley divisor="1"/>'.join(sites)
    return f'<spatial name={quoteattr(name)} class="muscle">{joined}</spatial>'


def coordinates(plant: RobotPlant, of: Posture | Velocity) -> list[ArrayLike]:
    """Posture or velocity of a robot, numbers or arrays of them, in the order of MuJoCo's joints."""
    robot = plant.robot
    moving = [of.angles[number] for number in _depth_first(robot.parents) if robot.joints[number].locked is None]
    return [*(getattr(of, name) for name in robot.motions), *moving]


def _depth_first(parents: Sequence[int], above: int = 0) -> list[int]:
    """Numbers of the joints in MuJoCo's order."""
    below = (number for number, parent in enumerate(parents) if parent == above)
    return [place for number in below for place in (number, *_depth_first(parents, number + 1))]


def _scene(plant: RobotPlant, bodies: Sequence[_Body], start: RobotState) -> Scene:
    """Ground and bodies of a robot, with the posture at the start."""
    softness = compliance(plant, start)
    base = bodies[0]
    height = float(start.posture.z) if plant.robot.base == "fixed" else 0.0
    top = max([0.1, *(float(place.z) for place in base.sites.values())])
    base.shapes += [
        f'<geom class="bone" fromto="0 0 0 0 0 {top!r}"/>',
        f'<geom class="trunk" pos="0 0 {top + 0.03!r}"/>',
    ]
    kinds = {name: ("slide", axis) for name, axis in SLIDES.items()}
    kinds |= {name: ("hinge", axis) for name, axis in TURNS.items()}
    moves = ((name, *kinds[name]) for name in plant.robot.motions)
    joints = "".join(f'<joint name="{name}" type="{kind}" axis="{numbers_text(axis)}"/>' for name, kind, axis in moves)
    text = f'<body name={quoteattr(base.name)} pos="0 0 {height!r}">{joints}{base.text(softness)}</body>'
    values = {
        "friction_ratio": repr(FRICTION_RATIO),
        "normal": numbers_text(plant.ground.normal),
        "body": text,
        "foot": plant.robot.foot is not None,
        "friction": repr(float(plant.ground.friction)),
    }
    if plant.robot.foot is not None:
        contact = softness["ground"]
        values |= {"contact_reference": contact.reference, "contact_impedance": contact.impedance}
        values["friction_reference"] = softness["friction"].reference
    names = [joint.name for joint in plant.robot.joints if joint.locked is None]
    sensors = "".join(f"<jointpos name={quoteattr(name)} joint={quoteattr(name)}/>" for name in names)
    position, velocity = (coordinates(plant, of) for of in (start.posture, start.velocity))
    return Scene(filled("robot-scene.xml", values), float(plant.gravity), sensors, position, velocity)
