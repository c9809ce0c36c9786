"""A joint for MuJoCo: MJCF with tendons, and an engine plugin for the forces of its muscles."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import equinox as eqx
import numpy as np

import mckibben
from mckibben.actuator import Actuator
from mckibben.actuator.base import state_of_muscle
from mckibben.codegen.source_module import SourceModule
from mckibben.errors import ExportError
from mckibben.export.muscle_plugin import MuscleFunctions, PluginMuscle, is_filter, plugin_files
from mckibben.export.plant import is_real
from mckibben.export.targets import Exported
from mckibben.joint import (
    AntagonisticJoint,
    Geometry,
    KneeGeometry,
    Load,
    PairedPaths,
    Pulley,
    RigidTendon,
    Tendon,
    TwoBonePath,
)
from mckibben.muscle import Muscle
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.scenario import Scenario

_GRAVITY = 9.81  # m/s^2
COMMAND_DELAY = "delay of the commands"  # among the omitted parts


class Transmission(NamedTuple):
    """Transmission of a muscle; without a tendon it drives the joint: its length is the angle, its force a torque."""

    fixed_sites: str = ""  # in MJCF
    moving_sites: str = ""
    tendon: str = ""
    offset: Any = 0.0  # path length in excess of the tendon [m]
    points: tuple[tuple[float, float], ...] = ()  # that the tendon connects [m]
    coefficient: float = 0.0  # of the angle, in place of points [m/rad]


def transmissions(geometry: Geometry) -> tuple[Transmission, Transmission]:
    """Transmissions of both muscles of a geometry."""
    if isinstance(geometry, KneeGeometry):
        height, radius = float(geometry.joint_length), float(geometry.joint_radius)
        first, second = (
            _two_sites(i, (side * radius, height), (side * radius, 0.0), geometry.connector_length)
            for i, side in ((1, -1), (2, 1))
        )
    elif isinstance(geometry, PairedPaths):
        first, second = (
            path_transmission(i, path, side) for i, path, side in ((1, geometry.path1, 1), (2, geometry.path2, -1))
        )
    else:
        first = second = Transmission()
    return first, second


def path_transmission(number: int, path: Any, side: int) -> Transmission:
    """Transmission of a muscle with a path."""
    if isinstance(path, TwoBonePath):
        ends = (path.proximal_x, path.proximal_y), (path.distal_x, path.distal_y)
        return _two_sites(number, *ends, path.connector_length)
    if isinstance(path, Pulley):
        coefficient = float(side * path.radius)
        tendon = f'<fixed name="muscle{number}"><joint joint="joint" coef="{coefficient!r}"/></fixed>'
        return Transmission(tendon=tendon, offset=path.rest_length, coefficient=coefficient)
    return Transmission()


def _two_sites(number: int, fixed: tuple[Any, Any], moving: tuple[Any, Any], connector: Any) -> Transmission:
    points = tuple((float(x), float(y)) for x, y in (fixed, moving))
    first, last = (
        f'<site name="{name}{number}" pos="{x!r} {y!r} 0"/>'
        for name, (x, y) in zip(("fixed", "moving"), points, strict=True)
    )

    ends = f'<site site="fixed{number}"/><site site="moving{number}"/>'
    tendon = f'<spatial name="muscle{number}" width="0.008" rgba="0.8 0.2 0.15 1">{ends}</spatial>'
    return Transmission(first, last, tendon, -connector, points)


class MuscleModel(NamedTuple):
    """MJCF, the module of the forces of its muscles, their kinds and names, and the omitted parts."""

    xml: str
    module: SourceModule
    muscles: tuple[PluginMuscle, ...]
    names: tuple[str, ...]
    left_out: tuple[str, ...]


def joint_model(
    plant: JointPlant,
    name: str = "joint",
    timestep: float = 2.5e-4,
    start: PlantState | None = None,
    *,
    plugin: bool = True,
) -> MuscleModel:
    """MJCF of a plant with actuators of the plugin or of callbacks, and the functions of its muscles."""
    check_parts(plant)
    moved = transmissions(plant.joint.geometry)
    left_out = [] if plant.has_ideal_io else ["sensors and disturbance of the plant"]
    left_out += [] if plant.command_delay is None else [COMMAND_DELAY]
    left_out += [] if plant.friction is None else ["presliding of the joint's friction: MuJoCo has its own model"]
    for number, one in enumerate(moved, 1):
        if not one.tendon:
            left_out.append(f"tendon of muscle {number}: path not supported by MuJoCo; its torque acts on the joint")
    plant = dataclasses.replace(plant, command_delay=None)
    start = plant.init_state(0.0, (0.0, 0.0)) if start is None else start
    module, muscles, acts = muscle_module(plant, moved, start, name, filters=plugin)
    point = mass_point(plant.load)
    xml = _mjcf(plant, name, timestep, moved, muscles, point, start, acts, plugin=plugin)
    return MuscleModel(xml, module, muscles, ("muscle1", "muscle2"), (*left_out, *point.chosen))


def check_parts(plant: JointPlant) -> None:
    """Raise an error that lists all parts of a plant that MuJoCo does not support."""
    found: list[ExportError] = []
    for check in (lambda: check_valve(plant.valve), lambda: check_tendon(plant.joint), lambda: mass_point(plant.load)):
        try:
            check()
        except ExportError as error:
            found.append(error)
    if len(found) > 1:
        parts, remedies = "; ".join(one.message for one in found), ", ".join(one.remedy for one in found)
        raise ExportError(parts, field=found[0].field, remedy=remedies) from found[0]
    if found:
        raise found[0]


def check_valve(valve: Actuator) -> None:
    """Raise an error for a valve that the plugin does not support."""
    if valve.switches:
        raise cannot("valve", "valves that switch between steps", "give it a FlowValve")
    if valve.reservoir is not None:
        raise cannot("reservoir_volume", "a supply that drops, which couples the muscles", "leave it out")


def check_tendon(joint: AntagonisticJoint) -> None:
    """Raise an error for springs in series with the muscles."""
    if not isinstance(joint.tendon, RigidTendon):
        raise cannot("tendon", "springs in series with the muscles", "give the joint rigid tendons")


def muscle_module(
    plant: JointPlant, moved: tuple[Transmission, Transmission], start: PlantState, name: str, *, filters: bool = True
) -> tuple[SourceModule, tuple[PluginMuscle, PluginMuscle], list[Any]]:
    """The functions of both muscles, their kinds, and their activations at the start; `filters`: with MuJoCo's own."""
    numbers, fixed = eqx.partition(numeric(plant), is_real)
    module = SourceModule(name, {"plant": numbers}, "plant.")
    filtered = [filters and is_filter(plant.valve.for_muscle(index)) for index in (0, 1)]
    first, second = (_functions(fixed, index, one, start, filtered[index]) for index, one in enumerate(moved))
    for one in (first, second):
        one.add_to(module)
    return module, (first.summary, second.summary), [first.activations, second.activations]


def _functions(fixed: Any, index: int, moved: Transmission, start: PlantState, filtered: bool) -> MuscleFunctions:
    """Functions of one muscle."""

    def path(plant: JointPlant, length: Any) -> Any:
        return length + float(moved.offset) if moved.tendon else plant.joint.geometry.path_lengths(length)[index]

    def muscle(plant: JointPlant) -> tuple[Muscle, Tendon]:
        return (plant.joint.muscle1, plant.joint.muscle2)[index], plant.joint.tendon

    begun = start.muscles[index], start.pressures[index], state_of_muscle(start.air, index)
    return MuscleFunctions(fixed, index + 1, muscle, path, begun, filtered)


class MassPoint(NamedTuple):
    """Mass [kg] hanging along -y at angle 0, its distance [m], its own inertia, and a note on assumed values."""

    mass: float
    distance: float
    inertia: float
    chosen: tuple[str, ...]


def mass_point(load: Load) -> MassPoint:
    """A body with the inertia and the gravity torque of a load."""
    inertia, moment, gravity = float(load.total_inertia), float(load.gravity_moment), gravity_of(load)
    angles = np.linspace(-1, 1, 5)
    hanging = moment * np.sin(float(load.hanging_angle) - angles)
    if not np.allclose(load.gravity_torque(angles), hanging, rtol=0, atol=1e-9 * max(1.0, abs(moment))):
        raise cannot("load", "a load with a torque other than gravity", "give a PendulumLoad or a GeneralLoad")
    mass, chosen = known_mass(load), ()
    if mass is None:
        mass = 2 * moment**2 / (inertia * gravity**2) or 1.0
        chosen = (f"mass of the load: {mass:.4g} kg is assumed, as only its inertia and torque are known",)
    distance = moment / (mass * gravity) if gravity else 0.0
    return MassPoint(mass, distance, max(inertia - mass * distance**2, 1e-12 * inertia), chosen)


def gravity_of(load: Load) -> float:
    """G [m/s^2] of a load."""
    return float(getattr(load, "gravity", _GRAVITY))


def known_mass(load: Load) -> float | None:
    """Mass [kg] of a load, if known."""
    if hasattr(load, "mass1"):
        return float(load.mass1 + load.mass2) or None
    return float(load.mass) if hasattr(load, "mass") else None


def command_range(valve: Actuator, muscle: Muscle) -> tuple[float, float]:
    """Lowest and highest command of a muscle: gauge pressures [Pa], or openings."""
    low, high = valve.command_range(muscle.specimen.domain)
    return float(np.asarray(low)), float(np.asarray(high))


def numbers_text(numbers: Any) -> str:
    """Numbers of an MJCF attribute as text."""
    return " ".join(repr(float(one) + 0.0) for one in numbers)  # no negative zeros


def plugin_actuator(
    module: str, number: int, name: str, target: str, dynamics: str, limits: tuple[float, float]
) -> str:
    """Actuator of a muscle; without a command range, as for a return spring, it has no limits."""
    return (
        f'<plugin name={quoteattr(name)} {target} plugin="mckibben.{module}" {dynamics} {_limited(limits)}>'
        f'<config key="muscle" value="{number}"/></plugin>'
    )


def _limited(limits: tuple[float, float]) -> str:
    """Attributes for the range of an actuator's commands."""
    return f'ctrllimited="true" ctrlrange="{numbers_text(limits)}"' if limits[0] < limits[1] else 'ctrllimited="false"'


def callback_actuators(
    names: Sequence[str],
    muscles: Sequence[PluginMuscle],
    targets: Sequence[str],
    limits: Sequence[tuple[float, float]],
) -> list[str]:
    """Actuators whose forces and rates callbacks set: one for each muscle, then one for each further activation."""
    # They are integrators, because MuJoCo Warp integrates no activations of the type ``user``.
    dynamics = ['dyntype="integrator" ' if muscle.activations else "" for muscle in muscles]
    main = [
        f'<general name={quoteattr(name)} {target} {kind}gaintype="user" biastype="user" {_limited(limited)}/>'
        for name, target, kind, limited in zip(names, targets, dynamics, limits, strict=True)
    ]
    rest = [
        f'<general name={quoteattr(f"{name}_state{place}")} {target} dyntype="integrator" gainprm="0"/>'
        for name, muscle, target in zip(names, muscles, targets, strict=True)
        for place in range(1, muscle.activations)
    ]
    return main + rest


def callback_states(acts: Sequence[Sequence[float]]) -> list[float]:
    """Activations of all muscles in the order of `callback_actuators`."""
    return [one for part in (slice(1), slice(1, None)) for each in acts for one in each[part]]


def keyframe(**numbers: Any) -> str:
    """Keyframe of the initial state, from numbers by MuJoCo's names; empty ones are not written."""
    given = " ".join(f'{key}="{numbers_text(one)}"' for key, one in numbers.items() if len(one))
    return f'<key name="start" {given}/>'


def mjcf_document(
    name: str,
    *,
    timestep: float,
    gravity: float,
    scene: str,
    tendons: Sequence[str],
    actuators: Sequence[str],
    sensors: str,
    start: str,
) -> str:
    """MJCF of a scene with muscles and the plugin for their forces, if there are actuators."""
    separator = "\n    "
    return f"""<!-- Written by mckibben {mckibben.__version__}. Angles in rad, pressures in Pa, gauge. -->
<mujoco model="{name}">
  <extension>{f'<plugin plugin="mckibben.{name}"/>' if any("<plugin" in one for one in actuators) else ""}</extension>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{timestep!r}" integrator="RK4" gravity="0 0 {-gravity!r}"/>
  {scene}
  <tendon>
    {separator.join(tendons)}
  </tendon>
  <actuator>
    {separator.join(actuators)}
  </actuator>
  <sensor>{sensors}</sensor>
  <keyframe>{start}</keyframe>
</mujoco>
"""


def _mjcf(
    plant: Any,
    name: str,
    timestep: float,
    moved: tuple[Transmission, Transmission],
    muscles: tuple[PluginMuscle, ...],
    point: MassPoint,
    start: PlantState,
    acts: list[Any],
    *,
    plugin: bool,
) -> str:
    """MJCF of the joint in a vertical plane: its x and y are turned so that gravity points to the hanging angle."""
    sine, cosine = math.sin(float(plant.load.hanging_angle)), math.cos(float(plant.load.hanging_angle))
    mass, distance, rest, _ = point
    inertial = f'pos="0 {-distance!r} 0" mass="{mass!r}" diaginertia="{rest!r} {rest!r} {rest!r}"'
    both = plant.joint.muscle1, plant.joint.muscle2
    valves = [plant.valve.for_muscle(index) for index in (0, 1)]
    targets = [f'tendon="muscle{number}"' if one.tendon else 'joint="joint"' for number, one in enumerate(moved, 1)]
    limits = [command_range(valve, muscle) for valve, muscle in zip(valves, both, strict=True)]
    if plugin:
        actuators = [
            plugin_actuator(name, number, f"muscle{number}", target, summary.dynamics(valve), limited)
            for number, (target, summary, valve, limited) in enumerate(
                zip(targets, muscles, valves, limits, strict=True), 1
            )
        ]
        states = [*acts[0], *acts[1]]
    else:
        actuators = callback_actuators(("muscle1", "muscle2"), muscles, targets, limits)
        states = callback_states(acts)
    fixed, moving = (
        "\n    ".join(filter(None, (getattr(one, part) for one in moved))) for part in ("fixed_sites", "moving_sites")
    )
    lost = "" if plant.friction is None else f' frictionloss="{float(plant.friction.torque)!r}"'
    scene = f"""<option><flag contact="disable"/></option>
  <default><geom contype="0" conaffinity="0"/><site size="0.006"/></default>
  <worldbody>
    <body name="base" xyaxes="{cosine!r} 0 {-sine!r} {sine!r} 0 {cosine!r}">
    {fixed}
      <body name="limb">
        <joint name="joint" type="hinge" axis="0 0 1" damping="{float(plant.load.damping)!r}"{lost}/>
        <inertial {inertial}/>
        <geom type="capsule" fromto="0 0 0 0 {-distance or -0.1!r} 0" size="0.01" rgba="0.4 0.45 0.5 1"/>
    {moving}
      </body>
    </body>
  </worldbody>"""
    commands = [*([0.0, 0.0] if plant.valve.direct else start.pressures), *[0.0] * (len(actuators) - 2)]
    return mjcf_document(
        name,
        timestep=timestep,
        gravity=gravity_of(plant.load),
        scene=scene,
        tendons=[one.tendon for one in moved if one.tendon],
        actuators=actuators,
        sensors='<jointpos name="angle" joint="joint"/><jointvel name="velocity" joint="joint"/>',
        start=keyframe(qpos=[start.angle], qvel=[start.velocity], act=states, ctrl=commands),
    )


def mjcf_files(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The plant of a scenario as MJCF, and the plugin for its muscles."""
    plant = scenario.plant()
    timestep = scenario.control_period / scenario.needed_substeps()
    model = joint_model(plant, name, timestep, plant.complete_state(scenario.initial(plant)))
    left_out = ("controller and reference of the scenario: set data.ctrl yourself", *model.left_out)
    files = plugin_files(
        model.module, model.muscles, model.xml, f"the joint of the scenario {scenario.name!r}", left_out
    )
    return Exported(files | {"scenario.yaml": scenario.dumps(folder=folder)}, left_out)


def cannot(field: str, what: str, remedy: str) -> ExportError:
    """Error for a part that MuJoCo does not support."""
    return ExportError(f"MuJoCo does not support {what}", field=field, remedy=remedy)
