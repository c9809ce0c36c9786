"""MuJoCo models of joints and robots: MJCF with tendons, and an engine plugin for their muscles' forces.

x is forwards, y to the left, and z up; the joint of a scenario turns in the plane of x and z.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, SupportsFloat

import numpy as np
from jaxtyping import ArrayLike, PyTree

from mckibben.actuator import Actuator
from mckibben.errors import ExportError
from mckibben.export.compliance import FRICTION_RATIO, LIMIT_SPEED, TOUCH_SPEED, Compliance, compliance
from mckibben.export.drives import Drive, Transmission, muscle_drive, muscle_functions, path_transmission, transmissions
from mckibben.export.muscle_plugin import MuscleFunctions, MuscleModel, plugin_files
from mckibben.export.targets import Exported, filled
from mckibben.joint import Load
from mckibben.mechanism.bodies import Body, BodyPoint, Joint, PathElement
from mckibben.mechanism.dynamics import SLIDES, TURNS, Posture, Velocity
from mckibben.mechanism.muscles import TendonParts
from mckibben.mechanism.wrapping import TendonPulley, WrapCylinder, WrapSphere
from mckibben.numerics.spatial import Vector, X, Z
from mckibben.plant import JointPlant
from mckibben.plant.robot_plant import RobotPlant
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.units import GRAVITY, HINGE, SLIDE, JointType

_LIGHT = 1e-12  # mass [kg] and inertia [kg*m^2] of a massless body: MuJoCo does not move bodies without mass

UnitOf = Callable[[PyTree], PyTree]
"""Selection of a muscle or a pair from a plant."""
Attributes = dict[str, str]
"""Attributes of an element of MJCF."""
Element = tuple[str, Attributes]
"""Element of a tendon: its tag and attributes."""


def mujoco_model(
    plant: JointPlant | RobotPlant,
    name: str = "model",
    timestep: float = 2.5e-4,
    start: PyTree = None,
) -> MuscleModel:
    """MJCF of a joint or a robot with its valves and muscles, and the functions of the muscles.

    Raises `ExportError`, which lists all parts that MuJoCo cannot represent: valves that switch between steps, a supply
    that drops, loads with a torque other than gravity, and muscles over joints in ways that no tendon has.

    Parameters
    ----------
    name
        Name of the model and of the plugin, an identifier of C.
    timestep
        Time step [s], of the classical Runge-Kutta method.
    start
        State of the keyframe "start". Default: all angles as close to 0 as possible, without pressure, a foot on the
        ground.
    """
    assembly = assembled(plant, start)
    left_out = [*assembly.left_out, *([] if plant.has_ideal_io else ["sensors and disturbances of the plant"])]
    left_out += [] if plant.command_delay is None else ["delay of the commands"]
    plant = dataclasses.replace(plant, command_delay=None)
    module, functions = muscle_functions(plant, name, assembly.drives, assembly.start)
    xml = assembly.mjcf(name, timestep, functions)
    return MuscleModel(xml, module, tuple(function.summary for function in functions), tuple(left_out))


def assembled(plant: JointPlant | RobotPlant, start: PyTree = None) -> Assembly:
    """Bodies, tendons and contacts of a plant, whose muscles are not yet actuators; parameters as of `mujoco_model`."""
    return _joint(plant, start) if isinstance(plant, JointPlant) else _robot(plant, start)


@dataclass
class _Body:
    """Body of a joint, or the base, with the places of its sites, and the bodies on it."""

    attributes: Attributes
    inertial: Attributes
    joints: list[Attributes] = field(default_factory=list)
    shapes: list[Attributes] = field(default_factory=list)
    sites: dict[str, Vector] = field(default_factory=dict)
    below: list[_Body] = field(default_factory=list)

    def bone(self, end: Vector) -> None:
        """Draw a bone from the hinge to a point."""
        if any(end):
            self.shapes.append({"class": "bone", "fromto": f"0 0 0 {numbers_text(end)}"})


class _Tendon(NamedTuple):
    """A tendon: its element, attributes, and the elements in it."""

    tag: str
    attributes: Attributes
    parts: Sequence[Element]


class Assembly:
    """Bodies of a plant with the sites of its muscles, the muscles that MuJoCo can move, and the omitted parts.

    Parameters
    ----------
    plant, start
        The plant and its state at the start.
    bodies, joints, parents
        The base and the body on each joint; the joints, and the number of the body that carries each.
    """

    def __init__(
        self, plant: PyTree, start: PyTree, bodies: list[_Body], joints: Sequence[Joint], parents: Sequence[int]
    ) -> None:
        _raise(*_unsupported_valves(plant.valve))
        self.plant, self.start = plant, start
        self.bodies, self.joints, self.parents = bodies, joints, parents
        self.drives: list[Drive] = []
        self.left_out: list[str] = []
        self.gravity = -Z.scaled(GRAVITY)
        self.position: list[ArrayLike] = []
        self.velocity: list[ArrayLike] = []
        self.contacts: list[Attributes] = []
        self.floor: Attributes = {}
        self._tendons: list[_Tendon] = []
        for joint, parent, body in zip(joints, parents, bodies[1:], strict=True):
            bodies[parent].below.append(body)
            bodies[parent].bone(joint.place.vector)

    def add_pair(self, unit_of: UnitOf, names: Sequence[str], number: int, first: int) -> None:
        """Add the muscles of a pair over a joint.

        Parameters
        ----------
        unit_of
            Selection of the pair, or of an `AntagonisticJoint`, from a plant.
        names
            Names of its muscles.
        number, first
            Number of the joint, and of muscle 1 among all.
        """
        joint = self.joints[number]
        for place, (name, moved) in enumerate(zip(names, transmissions(unit_of(self.plant).geometry), strict=True)):
            if joint.locked is not None and not moved.points:
                self.left_out.append(f"muscle {name}: its joint is locked, and it has no tendon between points")
                continue
            if moved.points:
                self._spatial(name, [self._across(name, number, moved)])
            elif moved.coefficient:
                self._fixed(name, [moved], [joint])
            else:
                self.left_out.append(f"tendon of {name}: path not supported by MuJoCo; its torque acts on the joint")
            driven = "" if moved.has_tendon else joint.name
            self.drives.append(muscle_drive(name, first + place, unit_of, place, moved.offset, driven))

    def add_path(self, unit_of: UnitOf, name: str, muscle: TendonParts, first: int) -> None:
        """Add a muscle over joints and through points; parameters as of `add_pair`."""
        names = [joint.name for joint in self.joints]
        numbers = [names.index(part.joint) for part in muscle.over]
        moved = [path_transmission(part.path, part.side) for part in muscle.over]
        offset = sum(transmission.offset for transmission in moved) - float(muscle.connector_length)
        if all(transmission.points for transmission in moved):
            pairs = enumerate(zip(numbers, moved, strict=True), 1)
            parts = [self._across(f"{name} {part}", *pair) for part, pair in pairs]
            self._spatial(name, [*parts, list(self._through(name, muscle.through))] if muscle.through else parts)
        elif all(transmission.coefficient for transmission in moved) and not muscle.through:
            offset += self._fixed(name, moved, [self.joints[number] for number in numbers])
        else:
            raise _cannot(
                "over", f"the paths of {name}", "give it points, or a TwoBonePath or a Pulley over each joint"
            )
        self.drives.append(muscle_drive(name, first, unit_of, 0, offset))

    def _spatial(self, name: str, branches: Sequence[Sequence[Element]]) -> None:
        """Add a tendon; its length is the sum of its branches."""
        elements = [element for branch in branches for element in (("pulley", {"divisor": "1"}), *branch)]
        self._tendons.append(_Tendon("spatial", {"name": name, "class": "muscle"}, elements[1:]))

    def _through(self, name: str, elements: Sequence[PathElement]) -> Iterator[Element]:
        """Add sites and geoms of a path to its bodies; yield the elements of its tendon."""
        frames = self.plant.robot.frame_names
        for number, element in enumerate(elements, 1):
            label = f"{name} point {number}"
            if type(element) not in (BodyPoint, WrapSphere, WrapCylinder, TendonPulley):  # others may go another way
                remedy = "give points, spheres, cylinders and pulleys of mckibben"
                raise _cannot("through", f"the {type(element).__name__} of {name}", remedy)
            if isinstance(element, BodyPoint):
                yield self._site(frames.index(element.body), label, element.place.vector)
            elif isinstance(element, TendonPulley):
                yield "pulley", {"divisor": repr(float(element.divisor))}
            elif isinstance(element, WrapSphere):
                yield "geom", self._surface(frames.index(element.body), label, element)

    def _surface(self, body: int, name: str, surface: WrapSphere) -> Attributes:
        """Add a surface that a path touches, with its side."""
        shape = {"name": name, "class": "surface", "type": surface.short_name}
        shape |= {"size": numbers_text([surface.radius] * 2), "pos": numbers_text(surface.place.vector)}
        if isinstance(surface, WrapCylinder):
            shape["zaxis"] = numbers_text(surface.axis)
        self.bodies[body].shapes.append(shape)
        if surface.side is None:
            return {"geom": name}
        self._site(body, f"{name} side", surface.side.vector)
        return {"geom": name, "sidesite": f"{name} side"}

    def _fixed(self, name: str, moved: Sequence[Transmission], joints: Sequence[Joint]) -> float:
        """Add a tendon over pulleys; return its length [m] at locked joints."""
        pairs = list(zip(moved, joints, strict=True))
        parts = [
            ("joint", {"joint": joint.name, "coef": repr(transmission.coefficient)})
            for transmission, joint in pairs
            if joint.locked is None
        ]
        self._tendons.append(_Tendon("fixed", {"name": name}, parts))
        return sum(one.coefficient * float(joint.locked) for one, joint in pairs if joint.locked is not None)

    def _across(self, path: str, number: int, moved: Transmission) -> list[Element]:
        """Add the sites of a straight path over a joint to its bodies; return them as elements of a tendon."""
        joint = self.joints[number]
        fixed, moving = anchors(joint, moved)
        first = self._site(self.parents[number], f"{path} fixed", fixed + joint.place.vector)
        return [first, self._site(number + 1, f"{path} moving", moving)]

    def _site(self, body: int, name: str, place: Vector) -> Element:
        self.bodies[body].sites[name] = place
        return "site", {"site": name}

    def mjcf(self, name: str, timestep: float, functions: Sequence[MuscleFunctions] = ()) -> str:
        """MJCF with the tendons of the muscles and, if there are `functions`, their actuators."""
        muscles = list(zip(self.drives, functions, strict=True)) if functions else []
        actuators = [
            self._actuated(drive)
            | function.summary.dynamics(self.plant.valve.for_muscle(drive.index))
            | self._limits(drive)
            for drive, function in muscles
        ]
        activations = [number for _, function in muscles for number in function.activations]
        commands = [0.0 if self.plant.valve.direct else function.pressure for _, function in muscles]
        start = {"qpos": self.position, "qvel": self.velocity, "act": activations, "ctrl": commands}
        return filled(
            "model.xml",
            {
                "name": name,
                "timestep": repr(timestep),
                "gravity": numbers_text(self.gravity),
                "friction_ratio": repr(FRICTION_RATIO),
                "base": self.bodies[0],
                "floor": self.floor,
                "contacts": self.contacts,
                "tendons": self._tendons,
                "actuators": actuators,
                "sensed": [joint.name for joint in self.joints if joint.locked is None],
                "start": {key: numbers_text(numbers) for key, numbers in start.items() if len(numbers)},
                "text": numbers_text,
            },
        )

    @staticmethod
    def _actuated(drive: Drive) -> Attributes:
        return {"name": drive.name} | ({"joint": drive.joint} if drive.joint else {"tendon": drive.name})

    def _limits(self, drive: Drive) -> Attributes:
        """Range of commands, gauge pressures [Pa] or openings; a return spring has no limits."""
        muscle, _ = drive.muscle(self.plant)
        valve = self.plant.valve.for_muscle(drive.index)
        low, high = (float(np.asarray(limit)) for limit in valve.command_range(muscle.specimen.domain))
        if low < high:
            return {"ctrllimited": "true", "ctrlrange": numbers_text((low, high))}
        return {"ctrllimited": "false"}


def numbers_text(numbers: Iterable[ArrayLike | SupportsFloat]) -> str:
    """Numbers of an attribute as text, with all digits, and without negative zeros.

    Examples
    --------
    >>> numbers_text((0.1, -0.0, 2))
    '0.1 0.0 2.0'
    """
    return " ".join(repr(float(np.asarray(number)) + 0.0) for number in numbers)


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


def _hung(
    name: str, inertial: Attributes, joint: Joint, limit: Compliance | None, joint_type: JointType = HINGE
) -> _Body:
    """A body on its hinge or slide, which is none if locked; `limit` is the compliance of its stops."""
    neutral = float(joint.offset) + float(joint.locked or 0.0)
    axis = numbers_text(joint.direction)
    placed = {"name": name, "pos": numbers_text(joint.place.vector), "axisangle": f"{axis} {neutral!r}"}
    axle = joint.direction.scaled(0.016)
    body = _Body(placed, inertial, shapes=[{"class": "axle", "fromto": numbers_text((*-axle, *axle))}])
    if joint.locked is None:
        hinge = {"name": joint.name, "type": joint_type.name, "axis": axis, "damping": repr(float(joint.damping))}
        hinge["armature"] = repr(float(joint.rotor_inertia or 0.0))
        if joint.spring is not None:
            hinge |= {"stiffness": repr(float(joint.spring)), "springref": repr(float(joint.spring_angle))}
        if joint.friction is not None:
            hinge["frictionloss"] = repr(float(joint.friction.torque))
        if limit is not None:
            hinge |= {"range": numbers_text((joint.lower, joint.upper))}
            hinge |= {"solreflimit": limit.reference, "solimplimit": limit.impedance}
        body.joints.append(hinge)
    return body


def _inertial(mass: float, centre: Iterable[ArrayLike], *moments: float) -> Attributes:
    """Mass [kg], its centre [m], and moments of inertia [kg*m^2]: three, or six with the products xy, xz and yz."""
    kind = "diaginertia" if len(moments) == 3 else "fullinertia"
    return {"pos": numbers_text(centre), "mass": repr(mass), kind: numbers_text(moments)}


def _inertial_of(body: Body | None) -> Attributes:
    if body is None:
        return _inertial(_LIGHT, (0, 0, 0), _LIGHT, _LIGHT, _LIGHT)
    xx, xy, xz, yy, yz, zz = map(float, body.tensor)
    principal, products = (max(moment, _LIGHT) for moment in (xx, yy, zz)), (xy, xz, yz)
    return _inertial(
        max(float(body.mass), _LIGHT), body.centre.vector, *principal, *(products if any(products) else ())
    )


def _joint(plant: JointPlant, start: PyTree) -> Assembly:
    """The joint of a scenario: its base is turned so that gravity points to the hanging angle."""
    load, joint_type = plant.load, plant.joint.joint_type
    _raise(*_unsupported_valves(plant.valve), *_unsupported_load(load))
    point, axis, tilt = mass_point(load), tuple(np.asarray(load.axis, float).tolist()), -float(load.hanging_angle)
    damping = float(load.damping)
    hinge = Joint("joint", axis, -math.pi, math.pi, "limb", damping=damping, friction=plant.friction)
    base = _Body({"name": "base", "axisangle": f"{numbers_text(axis)} {tilt!r}"}, _inertial_of(None))
    inertial = _inertial(point.mass, (0, 0, -point.distance), point.inertia, point.inertia, point.inertia)
    limb = _hung("limb", inertial, hinge, None, joint_type)
    limb.bone(Vector(0.0, 0.0, -point.distance or -0.1))
    start = plant.unpressurised() if start is None else start
    assembly = Assembly(plant, start, [base, limb], [hinge], [0])
    assembly.add_pair(lambda plant: plant.joint, ("muscle1", "muscle2"), 0, 0)
    assembly.left_out += [*_presliding([hinge]), *point.assumed]
    assembly.gravity = -Z.scaled(gravity_of(plant.load))
    assembly.position, assembly.velocity = [start.angle], [start.velocity]
    return assembly


def _robot(plant: RobotPlant, start: PyTree) -> Assembly:
    """Ground, bodies and muscles of a robot."""
    robot, start = plant.robot, plant.unpressurised() if start is None else start
    softness = compliance(plant, start)
    frames = zip(robot.frame_names[1:], robot.frame_bodies[1:], robot.joints, strict=True)
    height = float(start.position.z) if robot.base == "fixed" else 0.0
    base = _Body({"name": robot.frame_names[0], "pos": numbers_text((0, 0, height))}, _inertial_of(robot.bodies[0]))
    kinds = {name: ("slide", axis) for name, axis in SLIDES.items()}
    kinds |= {name: ("hinge", axis) for name, axis in TURNS.items()}
    for name in robot.motions:
        kind, axis = kinds[name]
        base.joints.append({"name": name, "type": kind, "axis": numbers_text(axis)})
    bodies = [base, *(_hung(name, _inertial_of(body), joint, softness.get(joint.name)) for name, body, joint in frames)]
    assembly = Assembly(plant, start, bodies, robot.joints, robot.parents)
    first = 0
    for number, unit in enumerate(robot.muscles):

        def unit_of(plant: RobotPlant, number: int = number) -> PyTree:
            return plant.robot.muscles[number]

        if unit.pair is not None:
            assembly.add_pair(
                lambda plant, of=unit_of: of(plant).pair, unit.names, robot.index(unit.joint_names[0]), first
            )
        elif (parts := unit.tendon_parts) is not None:
            assembly.add_path(unit_of, unit.names[0], parts, first)
        else:
            remedy = "give it a path through points; a class with its own `routed` also needs `tendon_parts`"
            raise _cannot("muscles", f"{unit.names[0]} (a {type(unit).__name__})", remedy)
        first += len(unit.names)
    assembly.left_out.append(f"stops of the joints: MuJoCo's, with our restitution at {LIMIT_SPEED:g} rad/s")
    if robot.spheres:
        _add_contacts(assembly, plant, softness)
    assembly.left_out += _presliding(robot.joints)
    top = max([0.1, *(float(place.z) for place in base.sites.values())])
    base.bone(Vector(0.0, 0.0, top))
    base.shapes.append({"class": "trunk", "pos": numbers_text((0, 0, top + 0.03))})
    assembly.gravity = Vector(*robot.gravity).scaled(float(plant.gravity))
    assembly.position, assembly.velocity = (coordinates(plant, of) for of in (start.position, start.velocity))
    return assembly


def _add_contacts(assembly: Assembly, plant: RobotPlant, softness: dict[str, Compliance]) -> None:
    """Add the ground, and the spheres that touch it."""
    ground = plant.ground
    place = ground.normal.scaled(-float(ground.distance or 0.0))
    assembly.floor = {"name": "floor", "type": "plane", "size": "4 4 0.1", "zaxis": numbers_text(ground.normal)}
    assembly.floor |= {"material": "floor", "pos": numbers_text(place)}
    for number, sphere in enumerate(plant.robot.spheres):
        body, place = assembly.bodies[plant.robot.frame_names.index(sphere.body)], sphere.place.vector
        body.bone(place)
        name = f"foot {number + 1}" if number else "foot"
        body.shapes.append({"name": name, "class": "foot", "pos": numbers_text(place)})
        body.shapes[-1]["size"] = repr(float(sphere.radius) or 1e-4)
        contact, slip = softness[f"ground {number}"], softness[f"friction {number}"]
        friction = {"friction": f"{numbers_text([ground.friction] * 2)} 0 0 0", "solref": contact.reference}
        assembly.contacts.append({"geom2": name} | friction)
        assembly.contacts[-1] |= {"solreffriction": slip.reference, "solimp": contact.impedance}
    assembly.left_out.append(
        f"ground: MuJoCo's contact has the stiffness, the friction, and the restitution at {TOUCH_SPEED:g} m/s; "
        "its damper acts from the first touch"
    )


def _presliding(joints: Sequence[Joint]) -> list[str]:
    """Omitted part of the joints' friction."""
    if all(joint.friction is None for joint in joints):
        return []
    return ["presliding of the joint's friction: MuJoCo has its own model"]


def coordinates(plant: RobotPlant, of: Posture | Velocity) -> list[ArrayLike]:
    """Posture or velocity of a robot, numbers or arrays of them, in the order of MuJoCo's joints."""
    robot = plant.robot
    moving = [of.angles[number] for number in _depth_first(robot.parents) if robot.joints[number].locked is None]
    return [*(getattr(of, name) for name in robot.motions), *moving]


def _depth_first(parents: Sequence[int], above: int = 0) -> list[int]:
    """Numbers of the joints in MuJoCo's order."""
    below = (number for number, parent in enumerate(parents) if parent == above)
    return [place for number in below for place in (number, *_depth_first(parents, number + 1))]


def _unsupported_valves(valve: Actuator) -> Iterator[ExportError]:
    """Errors for valves that MuJoCo does not support."""
    if valve.switches:
        yield _cannot("valve", "valves that switch between steps", "give it a FlowValve")
    if valve.reservoir is not None:
        yield _cannot("reservoir_volume", "a supply that drops, which couples the muscles", "leave it out")


def _unsupported_load(load: Load) -> Iterator[ExportError]:
    """Error for a load with a torque other than that of gravity on a mass that turns or slides."""
    angles, moment = np.linspace(-1, 1, 5), float(load.gravity_moment)
    hanging = moment * np.sin(float(load.hanging_angle) - angles)
    if load.joint_type is SLIDE:
        moment = float(load.total_inertia) * gravity_of(load)
        hanging = np.full_like(angles, -moment * np.asarray(load.axis, float)[2])
    if not np.allclose(load.gravity_torque(angles), hanging, rtol=0, atol=1e-9 * max(1.0, abs(moment))):
        remedy = "give a PendulumLoad or a GeneralLoad, or on a slide a SlidingMass"
        yield _cannot("load", "a load with a torque other than gravity", remedy)


def _raise(*errors: ExportError) -> None:
    """Raise one error for all parts that MuJoCo does not support."""
    if errors:
        parts, remedies = "; ".join(e.message for e in errors), ", ".join(e.remedy for e in errors)
        raise ExportError(parts, field=errors[0].field, remedy=remedies)


def _cannot(field: str, part: str, remedy: str) -> ExportError:
    """Error for a part that MuJoCo does not support."""
    return ExportError(f"MuJoCo does not support {part}", field=field, remedy=remedy)


class MassPoint(NamedTuple):
    """Mass [kg] hanging below the hinge at angle 0, its distance [m], own inertia [kg*m^2], and what is assumed."""

    mass: float
    distance: float
    inertia: float
    assumed: tuple[str, ...]


def mass_point(load: Load) -> MassPoint:
    """A body with the inertia and the gravity torque of a load; `ExportError` for one with another torque.

    With the largest torque of gravity G = m g d, the body hangs at d = G / (m g) and has the inertia J - m d^2. If only
    G and the inertia J are known, m = 2 G^2 / (J g^2), for which half of J is that of the point.

    Examples
    --------
    >>> from mckibben.joint import GeneralLoad
    >>> point = mass_point(GeneralLoad(inertia=0.02, greatest_gravity_torque=0.981))
    >>> round(point.mass, 6), round(point.distance, 6), round(point.inertia, 6)
    (1.0, 0.1, 0.01)
    """
    inertia, moment, gravity = float(load.total_inertia), float(load.gravity_moment), gravity_of(load)
    _raise(*_unsupported_load(load))
    mass, assumed = _known_mass(load), ()
    if mass is None and load.joint_type is SLIDE:
        mass = inertia
    elif mass is None:
        mass = 2 * moment**2 / (inertia * gravity**2) or 1.0
        assumed = (f"mass of the load: {mass:.4g} kg is assumed, as only its inertia and torque are known",)
    distance = moment / (mass * gravity) if gravity else 0.0
    return MassPoint(mass, distance, max(inertia - mass * distance**2, 1e-12 * inertia), assumed)


def gravity_of(load: Load) -> float:
    """Gravitational acceleration [m/s^2] of a load."""
    return float(getattr(load, "gravity", GRAVITY))


def _known_mass(load: Load) -> float | None:
    """Mass [kg] of a load, if known."""
    if hasattr(load, "mass1"):
        return float(load.mass1 + load.mass2) or None
    return float(load.mass) if hasattr(load, "mass") else None


def plant_and_start(scenario: Scenario | RobotScenario) -> tuple[JointPlant | RobotPlant, PyTree, float]:
    """Plant of a scenario, its state at the start of the run, or of a robot without one in the posture of its study,
    and a time step [s].
    """
    period = scenario.control_period
    if isinstance(scenario, Scenario):
        joint = scenario.plant()
        return joint, joint.complete_state(scenario.initial(joint)), period / scenario.needed_substeps()
    plant = scenario.plant()
    if scenario.duration is not None:
        start = scenario.initial(plant)
        return plant, start, period / (scenario.substeps or plant.needed_substeps(start.position.angles, None, period))
    angles: dict[str, float] = {} if scenario.jump is None else scenario.jump.squat
    if scenario.landing is not None:
        angles = scenario.landing.touchdown
    pressures = [0.0] * len(plant.robot.all_muscles)
    return plant, plant.init_state(plant.robot.posture_angles(angles), pressures), period


def mjcf_files(scenario: Scenario | RobotScenario, name: str, folder: Path) -> Exported:
    """The plant of a scenario as MJCF, and the plugin for its muscles; `ExportError` as by `mujoco_model`."""
    plant, start, timestep = plant_and_start(scenario)
    plugin = plugin_files(mujoco_model(plant, name, timestep, start), f"the plant of {scenario.name!r}")
    return Exported({**plugin.contents, "scenario.yaml": scenario.dumps(folder=folder)}, plugin.left_out)
