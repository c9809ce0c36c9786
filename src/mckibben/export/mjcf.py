"""MuJoCo models of joints: MJCF with tendons, and an engine plugin or callbacks for the forces of their muscles."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, SupportsFloat
from xml.sax.saxutils import quoteattr

import equinox as eqx
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.actuator import Actuator
from mckibben.actuator.base import state_of_muscle
from mckibben.codegen.source_module import SourceModule
from mckibben.errors import ExportError
from mckibben.export.muscle_plugin import MuscleFunctions, PluginMuscle, is_filter, plugin_files
from mckibben.export.targets import Exported, filled
from mckibben.joint import (
    Geometry,
    KneeGeometry,
    Load,
    PairedPaths,
    Pulley,
    Tendon,
    TwoBonePath,
)
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, Plant, PlantState
from mckibben.scenario import Scenario

_GRAVITY = 9.81  # m/s^2
COMMAND_DELAY = "delay of the commands"
"""Entry of the omitted parts for a plant with such a delay."""

Place = tuple[SupportsFloat, SupportsFloat]
"""Point in the plane of a joint [m]."""


class Transmission(NamedTuple):
    """Transmission of a muscle; without a tendon it drives the joint: its length is the angle, its force a torque.

    Attributes
    ----------
    tendon
        In MJCF, of a joint alone.
    offset
        Path length in excess of the tendon [m].
    points
        Points connected by the tendon, on the fixed and on the moving body [m].
    coefficient
        Length per angle [m/rad], in place of points.
    """

    tendon: str = ""  # in MJCF, of a joint alone
    offset: float = 0.0  # path length in excess of the tendon [m]
    points: tuple[tuple[float, float], ...] = ()  # connected by the tendon: on the fixed body, on the moving one [m]
    coefficient: float = 0.0  # of the angle, in place of points [m/rad]


def transmissions(geometry: Geometry) -> tuple[Transmission, Transmission]:
    """Transmissions of both muscles of a geometry."""
    if isinstance(geometry, KneeGeometry):
        height, radius = geometry.joint_length, geometry.joint_radius
        first, second = (
            _two_sites(i, (side * radius, height), (side * radius, 0.0), geometry.connector_length)
            for i, side in ((1, -1), (2, 1))
        )
        return first, second
    if isinstance(geometry, PairedPaths):
        return path_transmission(1, geometry.path1, 1), path_transmission(2, geometry.path2, -1)
    return Transmission(), Transmission()


def path_transmission(number: int, path: object, side: int) -> Transmission:
    """Transmission of muscle `number` over a path; `side` is the sign of its moment arm."""
    if isinstance(path, TwoBonePath):
        ends = (path.proximal_x, path.proximal_y), (path.distal_x, path.distal_y)
        return _two_sites(number, *ends, path.connector_length)
    if isinstance(path, Pulley):
        coefficient = float(side * path.radius)
        tendon = f'<fixed name="muscle{number}"><joint joint="joint" coef="{coefficient!r}"/></fixed>'
        return Transmission(tendon, float(path.rest_length), coefficient=coefficient)
    return Transmission()


def _two_sites(number: int, fixed: Place, moving: Place, connector: SupportsFloat) -> Transmission:
    """Transmission of a straight tendon between two points, with a connector [m] that is no part of the muscle."""
    ends = f'<site site="fixed{number}"/><site site="moving{number}"/>'
    tendon = f'<spatial name="muscle{number}" width="0.008" rgba="0.8 0.2 0.15 1">{ends}</spatial>'
    points = tuple((float(x), float(y)) for x, y in (fixed, moving))
    return Transmission(tendon, -float(connector), points)


class Drive(NamedTuple):
    """A muscle in MJCF: its tendon or the joint that it drives, and its selection from a plant."""

    name: str
    tendon: str  # in MJCF; empty if it drives the joint
    joint: str
    index: int  # among the muscles of the plant
    muscle: Callable[[PyTree], tuple[Muscle, Tendon]]  # of a plant
    path: Callable[[PyTree, Array], Array]  # length [m] of the path, of a plant at MuJoCo's length

    @property
    def target(self) -> str:
        """Attribute of an actuator for what it drives."""
        return f"tendon={quoteattr(self.name)}" if self.tendon else f"joint={quoteattr(self.joint)}"


class MuscleModel(NamedTuple):
    """MJCF, the module of the forces of its muscles, their kinds and names, and the omitted parts."""

    xml: str
    module: SourceModule
    muscles: tuple[PluginMuscle, ...]
    names: tuple[str, ...]
    left_out: tuple[str, ...]


class Scene(NamedTuple):
    """Parts of a model in MJCF other than its actuators, and the coordinates at the start."""

    text: str
    gravity: float  # m/s^2
    sensors: str
    position: Sequence[ArrayLike]
    velocity: Sequence[ArrayLike]


def muscle_functions(
    plant: Plant, name: str, drives: Sequence[Drive], start: PyTree, *, filters: bool = True
) -> tuple[SourceModule, list[MuscleFunctions]]:
    """The functions of all muscles of a plant in a module.

    Parameters
    ----------
    drives
        Muscles, by what they drive.
    start
        State of the plant at the start.
    filters
        Whether MuJoCo's own filter models first-order valves.
    """
    numbers, fixed = eqx.partition(numeric(plant), eqx.is_inexact_array_like)
    module, functions = SourceModule(name, {"plant": numbers}, "plant."), []
    for number, drive in enumerate(drives, 1):
        state = start.muscles[drive.index], start.pressures[drive.index], state_of_muscle(start.air, drive.index)
        filtered = filters and is_filter(plant.valve.for_muscle(drive.index))  # type: ignore[attr-defined]
        functions.append(MuscleFunctions(fixed, number, drive.muscle, drive.path, state, filtered))
        functions[-1].add_to(module)
    return module, functions


def muscle_model(
    plant: PyTree,
    name: str,
    timestep: float,
    drives: Sequence[Drive],
    scene: Scene,
    start: PyTree,
    left_out: Sequence[str],
    *,
    plugin: bool,
) -> MuscleModel:
    """MJCF of a scene with the muscles of a plant as actuators, and their functions.

    Parameters
    ----------
    timestep
        Time step of MuJoCo [s].
    drives, scene
        Muscles, and everything else of the model.
    start
        State at the start.
    left_out
        Parts that are omitted so far; sensors, disturbances and the delay of the commands are added.
    plugin
        Whether the actuators are those of the plugin; otherwise callbacks set their forces.
    """
    left_out = [*left_out, *([] if plant.has_ideal_io else ["sensors and disturbances of the plant"])]
    left_out += [] if plant.command_delay is None else [COMMAND_DELAY]
    plant = dataclasses.replace(plant, command_delay=None)
    module, functions = muscle_functions(plant, name, drives, start, filters=plugin)
    xml = mjcf(plant, name, timestep, drives, functions, scene, plugin=plugin)
    kinds = tuple(function.summary for function in functions)
    return MuscleModel(xml, module, kinds, tuple(drive.name for drive in drives), tuple(left_out))


def mjcf(
    plant: PyTree,
    name: str,
    timestep: float,
    drives: Sequence[Drive],
    functions: Sequence[MuscleFunctions],
    scene: Scene,
    *,
    plugin: bool = True,
) -> str:
    """MJCF of a scene with the tendons of its muscles and, if there are `functions`, their actuators."""
    moved = list(zip(drives, functions, strict=True)) if functions else []
    write = _plugin_actuators if plugin else _callback_actuators
    actuators, activations = write(plant, name, moved)
    commands = [0.0 if plant.valve.direct else function.pressure for _, function in moved]
    commands += [0.0] * (len(actuators) - len(commands))
    start = {"qpos": scene.position, "qvel": scene.velocity, "act": activations, "ctrl": commands}
    keys = " ".join(f'{key}="{numbers_text(numbers)}"' for key, numbers in start.items() if len(numbers))
    separator = "\n    "
    return filled(
        "model.xml",
        {
            "name": name,
            "extension": f'<plugin plugin="mckibben.{name}"/>' if moved and plugin else "",
            "timestep": repr(timestep),
            "gravity": repr(-scene.gravity),
            "scene": scene.text,
            "tendons": separator.join(drive.tendon for drive in drives if drive.tendon),
            "actuators": separator.join(actuators),
            "sensors": scene.sensors,
            "start": f'<key name="start" {keys}/>',
        },
    )


Driven = Sequence[tuple[Drive, MuscleFunctions]]
"""Muscles with their functions."""


def _plugin_actuators(plant: PyTree, name: str, muscles: Driven) -> tuple[list[str], list[float]]:
    """Actuators of the plugin, and their activations at the start."""
    actuators = [
        f'<plugin name={quoteattr(drive.name)} {drive.target} plugin="mckibben.{name}" '
        f"{function.summary.dynamics(plant.valve.for_muscle(drive.index))} {_limits(plant, drive)}>"
        f'<config key="muscle" value="{number}"/></plugin>'
        for number, (drive, function) in enumerate(muscles, 1)
    ]
    return actuators, [number for _, function in muscles for number in function.activations]


def _callback_actuators(plant: PyTree, name: str, muscles: Driven) -> tuple[list[str], list[float]]:
    """Actuators whose forces and rates callbacks set: one for each muscle, then one for each further activation."""
    # They are integrators, because MuJoCo Warp integrates no activations of the type ``user``.
    actuators = [
        f"<general name={quoteattr(drive.name)} {drive.target} "
        + 'dyntype="integrator" ' * (len(function.activations) > 0)
        + f'gaintype="user" biastype="user" {_limits(plant, drive)}/>'
        for drive, function in muscles
    ]
    actuators += [
        f'<general name={quoteattr(f"{drive.name}_state{place}")} {drive.target} dyntype="integrator" gainprm="0"/>'
        for drive, function in muscles
        for place in range(1, len(function.activations))
    ]
    first = [function.activations[:1] for _, function in muscles]
    rest = [function.activations[1:] for _, function in muscles]
    return actuators, [number for activations in (*first, *rest) for number in activations]


def _limits(plant: PyTree, drive: Drive) -> str:
    """Attributes for the range of commands, gauge pressures [Pa] or openings; a return spring has no limits."""
    muscle, _ = drive.muscle(plant)
    valve = plant.valve.for_muscle(drive.index)
    low, high = (float(np.asarray(limit)) for limit in valve.command_range(muscle.specimen.domain))
    return f'ctrllimited="true" ctrlrange="{numbers_text((low, high))}"' if low < high else 'ctrllimited="false"'


def numbers_text(numbers: Iterable[ArrayLike | SupportsFloat]) -> str:
    """Numbers of an attribute as text, with all digits, and without negative zeros.

    Examples
    --------
    >>> numbers_text((0.1, -0.0, 2))
    '0.1 0.0 2.0'
    """
    return " ".join(repr(float(np.asarray(number)) + 0.0) for number in numbers)


def beyond(offset: float) -> Callable[[PyTree, Array], Array]:
    """Length of a path that exceeds its tendon by an offset [m]."""
    return lambda plant, length: length + offset


def joint_drives(geometry: Geometry, moved: Sequence[Transmission] | None = None) -> list[Drive]:
    """Both muscles of a joint; `moved` are their transmissions (default: those of MuJoCo)."""

    def muscle(index: int) -> Callable[[JointPlant], tuple[Muscle, Tendon]]:
        return lambda plant: ((plant.joint.muscle1, plant.joint.muscle2)[index], plant.joint.tendon)

    def path(index: int) -> Callable[[JointPlant, Array], Array]:
        return lambda plant, angle: plant.joint.geometry.path_lengths(angle)[index]

    return [
        Drive(
            name=f"muscle{index + 1}",
            tendon=transmission.tendon,
            joint="joint",
            index=index,
            muscle=muscle(index),
            path=beyond(transmission.offset) if transmission.tendon else path(index),
        )
        for index, transmission in enumerate(moved or transmissions(geometry))
    ]


def joint_model(
    plant: JointPlant,
    name: str = "joint",
    timestep: float = 2.5e-4,
    start: PlantState | None = None,
    *,
    plugin: bool = True,
) -> MuscleModel:
    """MJCF of a joint with its load, valves and muscles, and the functions of the muscles.

    Raises `ExportError`, which lists all parts that MuJoCo cannot represent: valves that switch between steps, a supply
    that drops, and loads with a torque other than gravity.

    Parameters
    ----------
    name
        Name of the model and of the plugin, an identifier of C.
    timestep
        Time step [s], of the classical Runge-Kutta method.
    start
        State of the keyframe "start". Default: at 0 rad without pressure.
    plugin
        Whether the actuators are those of the plugin; otherwise, callbacks set their forces, as in MuJoCo Warp.
    """
    check_parts(plant)
    start = plant.init_state(0.0, (0.0, 0.0)) if start is None else start
    drives, point = joint_drives(plant.joint.geometry), mass_point(plant.load)
    left_out = [] if plant.friction is None else ["presliding of the joint's friction: MuJoCo has its own model"]
    left_out += [
        f"tendon of muscle {drive.index + 1}: path not supported by MuJoCo; its torque acts on the joint"
        for drive in drives
        if not drive.tendon
    ]
    left_out += point.assumed
    scene = _joint_scene(plant, point, start)
    return muscle_model(plant, name, timestep, drives, scene, start, left_out, plugin=plugin)


def _joint_scene(plant: JointPlant, point: MassPoint, start: PlantState) -> Scene:
    """The joint in a vertical plane: its x and y are turned so that gravity points to the hanging angle."""
    sine, cosine = math.sin(float(plant.load.hanging_angle)), math.cos(float(plant.load.hanging_angle))
    sites: dict[str, list[str]] = {"fixed": [], "moving": []}
    for number, transmission in enumerate(transmissions(plant.joint.geometry), 1):
        for body, (x, y) in zip(sites, transmission.points, strict=False):
            sites[body].append(f'<site name="{body}{number}" pos="{x!r} {y!r} 0"/>')
    friction = "" if plant.friction is None else f' frictionloss="{float(plant.friction.torque)!r}"'
    values = {
        "sine": repr(sine),
        "cosine": repr(cosine),
        "minus_sine": repr(-sine),
        "damping": repr(float(plant.load.damping)),
        "friction": friction,
        "centre": repr(-point.distance),
        "mass": repr(point.mass),
        "inertia": repr(point.inertia),
        "end": repr(-point.distance or -0.1),
        **{f"{body}_sites": "\n    ".join(texts) for body, texts in sites.items()},
    }
    sensors = '<jointpos name="angle" joint="joint"/><jointvel name="velocity" joint="joint"/>'
    text = filled("joint-scene.xml", values)
    return Scene(text, gravity_of(plant.load), sensors, [start.angle], [start.velocity])


def check_parts(plant: JointPlant) -> None:
    """Raise an error that lists all parts of a plant that MuJoCo does not support."""
    errors: list[ExportError] = []
    for check in (lambda: check_valve(plant.valve), lambda: mass_point(plant.load)):
        try:
            check()
        except ExportError as error:
            errors.append(error)
    if len(errors) > 1:
        parts, remedies = "; ".join(e.message for e in errors), ", ".join(e.remedy for e in errors)
        raise ExportError(parts, field=errors[0].field, remedy=remedies) from errors[0]
    if errors:
        raise errors[0]


def check_valve(valve: Actuator) -> None:
    """Raise an error for a valve that MuJoCo does not support."""
    if valve.switches:
        raise cannot("valve", "valves that switch between steps", "give it a FlowValve")
    if valve.reservoir is not None:
        raise cannot("reservoir_volume", "a supply that drops, which couples the muscles", "leave it out")


def cannot(field: str, part: str, remedy: str) -> ExportError:
    """Error for a part that MuJoCo does not support."""
    return ExportError(f"MuJoCo does not support {part}", field=field, remedy=remedy)


class MassPoint(NamedTuple):
    """Mass [kg] hanging along -y at angle 0, its distance [m], its own inertia [kg*m^2], and a note on assumptions."""

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
    angles = np.linspace(-1, 1, 5)
    hanging = moment * np.sin(float(load.hanging_angle) - angles)
    if not np.allclose(load.gravity_torque(angles), hanging, rtol=0, atol=1e-9 * max(1.0, abs(moment))):
        raise cannot("load", "a load with a torque other than gravity", "give a PendulumLoad or a GeneralLoad")
    mass, assumed = _known_mass(load), ()
    if mass is None:
        mass = 2 * moment**2 / (inertia * gravity**2) or 1.0
        assumed = (f"mass of the load: {mass:.4g} kg is assumed, as only its inertia and torque are known",)
    distance = moment / (mass * gravity) if gravity else 0.0
    return MassPoint(mass, distance, max(inertia - mass * distance**2, 1e-12 * inertia), assumed)


def gravity_of(load: Load) -> float:
    """Gravitational acceleration [m/s^2] of a load."""
    return float(getattr(load, "gravity", _GRAVITY))


def _known_mass(load: Load) -> float | None:
    """Mass [kg] of a load, if known."""
    if hasattr(load, "mass1"):
        return float(load.mass1 + load.mass2) or None
    return float(load.mass) if hasattr(load, "mass") else None


def mjcf_files(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The plant of a scenario as MJCF, and the plugin for its muscles.

    Raises `ExportError`, which lists all parts that MuJoCo cannot represent.
    """
    plant = scenario.plant()
    timestep = scenario.control_period / scenario.needed_substeps()
    model = joint_model(plant, name, timestep, plant.complete_state(scenario.initial(plant)))
    left_out = ("controller and reference of the scenario: set data.ctrl yourself", *model.left_out)
    title = f"the joint of the scenario {scenario.name!r}"
    files = plugin_files(model.module, model.muscles, model.xml, title, left_out)
    return Exported(files | {"scenario.yaml": scenario.dumps(folder=folder)}, left_out)
