"""A joint for MuJoCo: MJCF with tendons, and the C of an engine plugin for the forces of its muscles."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import mckibben
from mckibben.codegen.c import write_c
from mckibben.codegen.source_module import SourceModule
from mckibben.errors import ExportError
from mckibben.export.c_folder import filled
from mckibben.export.plant import is_real
from mckibben.export.targets import Exported
from mckibben.joint import Geometry, KneeGeometry, Load, PairedPaths, Pulley, RigidTendon, TwoBonePath
from mckibben.muscle import Muscle, MuscleState
from mckibben.numerics.calculus import derivative, value_and_derivative
from mckibben.numerics.compiled import numeric
from mckibben.plant import FirstOrderValve, IdealValve, JointPlant, PlantState
from mckibben.plant.air_valve import AirState, AirValve, AirVolume, SwitchingValves
from mckibben.realtime.compiled_step import FlatTree
from mckibben.study.scenario import Scenario

_GRAVITY = 9.81  # m/s^2


class Transmission(NamedTuple):
    """How a muscle is moved: sites and tendon of MJCF, path [m] beyond the length of the tendon, and its two points.

    Without a tendon the muscle turns the joint itself: its length is the angle, its force a torque.
    """

    fixed_sites: str = ""
    moving_sites: str = ""
    tendon: str = ""
    offset: Any = 0.0
    points: tuple[tuple[float, float], ...] = ()


def transmissions(geometry: Geometry) -> tuple[Transmission, Transmission]:
    """How MuJoCo moves both muscles of a geometry."""
    if isinstance(geometry, KneeGeometry):
        height, radius = float(geometry.joint_length), float(geometry.joint_radius)
        first, second = (
            _two_sites(i, (side * radius, height), (side * radius, 0.0), geometry.connector_length)
            for i, side in ((1, -1), (2, 1))
        )
    elif isinstance(geometry, PairedPaths):
        first, second = (_path(i, path, side) for i, path, side in ((1, geometry.path1, 1), (2, geometry.path2, -1)))
    else:
        first = second = Transmission()
    return first, second


def _path(number: int, path: Any, side: int) -> Transmission:
    if isinstance(path, TwoBonePath):
        ends = (path.proximal_x, path.proximal_y), (path.distal_x, path.distal_y)
        return _two_sites(number, *ends, path.connector_length)
    if isinstance(path, Pulley):
        coefficient = float(side * path.radius)
        tendon = f'<fixed name="muscle{number}"><joint joint="joint" coef="{coefficient!r}"/></fixed>'
        return Transmission(tendon=tendon, offset=path.rest_length)
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


class Activations(NamedTuple):
    """Activations of an actuator: arms of the creep [N], state of the valve, pressure [Pa] but for an ideal valve."""

    creep: Any
    valve: Any
    pressure: Any


class PluginMuscle(NamedTuple):
    """Numbers of activations and anchors, whether they slip, and whether MuJoCo's own filter is the valve."""

    activations: int
    anchors: int
    slips: bool
    filtered: bool


class JointModel(NamedTuple):
    """MJCF, the module of the plugin's forces, its muscles, and what is left out."""

    xml: str
    module: SourceModule
    muscles: tuple[PluginMuscle, PluginMuscle]
    left_out: tuple[str, ...]


def joint_model(
    plant: JointPlant, name: str = "joint", timestep: float = 2.5e-4, start: PlantState | None = None
) -> JointModel:
    """MJCF of a plant, and the functions of its muscles; `start` is its keyframe. Raises `ExportError`."""
    valve = plant.valve
    if isinstance(valve, SwitchingValves):
        raise _cannot("valve", "valves that switch between steps", "give it a FlowValve")
    if isinstance(valve, AirValve) and valve.reservoir_volume is not None:
        raise _cannot("reservoir_volume", "a supply that drops, which couples the muscles", "leave it out")
    if not isinstance(plant.joint.tendon, RigidTendon):
        raise _cannot("tendon", "springs in series with the muscles", "give the joint rigid tendons")
    moved = transmissions(plant.joint.geometry)
    left_out = [] if plant.has_ideal_io else ["sensors and disturbance of the plant"]
    left_out += [] if plant.friction is None else ["presliding of the joint's friction: MuJoCo's has its own"]
    for number, one in enumerate(moved, 1):
        if not one.tendon:
            left_out.append(f"tendon of muscle {number}: MuJoCo has none with such a path; its torque turns the joint")
    start = plant.init_state(0.0, (0.0, 0.0)) if start is None else start
    module, muscles, acts = muscle_module(plant, moved, start, name)
    point = mass_point(plant.load)
    xml = _mjcf(plant, name, timestep, moved, muscles, point, _keyframe(plant, start, acts))
    return JointModel(xml, module, muscles, (*left_out, *point.chosen))


def muscle_module(
    plant: JointPlant, moved: tuple[Transmission, Transmission], start: PlantState, name: str
) -> tuple[SourceModule, tuple[PluginMuscle, PluginMuscle], list[Any]]:
    """The functions of both muscles, their kinds, and their activations at the start."""
    numbers, fixed = eqx.partition(numeric(plant), is_real)
    module = SourceModule(name, {"plant": numbers}, "plant.")
    first, second = (_Muscle(fixed, index, one, start) for index, one in enumerate(moved))
    for one in (first, second):
        one.add_to(module)
    return module, (first.summary, second.summary), [one.layout.pack(one.start) for one in (first, second)]


class _Muscle:
    """Functions of one muscle: force, rates of its activations, and what slips after a step."""

    def __init__(self, fixed: Any, index: int, moved: Transmission, start: PlantState) -> None:
        self._fixed, self._index, self._moved = fixed, index, moved
        valve = fixed.valve
        air = start.air.valves[index] if isinstance(start.air, AirState) else ()
        pressure = () if isinstance(valve, IdealValve) else start.pressures[index]
        state = start.muscles[index]
        self.start = jax.tree.map(np.asarray, Activations(state.creep, air, pressure))
        self.layout = FlatTree(self.start)
        slips = bool(state.friction or state.creep)
        self.summary = PluginMuscle(self.layout.size, len(state.friction), slips, isinstance(valve, FirstOrderValve))

    def add_to(self, module: SourceModule) -> None:
        """Add the functions to a module."""
        number, (activations, anchors, slips, filtered) = self._index + 1, self.summary
        zero = np.zeros(())
        given = {"length": zero, "velocity": zero, "command": zero}
        given |= {"act": np.zeros(activations)} if activations else {}
        argument = f"input{number}"
        held = {argument: given | ({"anchors": np.zeros(anchors)} if anchors else {})}

        def force(parameters: Any, **arguments: Any) -> dict[str, Any]:
            return {"force": self._force(parameters, arguments[argument])}

        def rates(parameters: Any, **arguments: Any) -> dict[str, Any]:
            return {f"rate{number}": {"act": self._rates(parameters, arguments[argument])}}

        def settled(parameters: Any, **arguments: Any) -> dict[str, Any]:
            return {f"after{number}": self._settled(parameters, arguments[argument])}

        def unset(parameters: Any, **arguments: Any) -> dict[str, Any]:
            return {f"first{number}": {"anchors": self._unset(parameters, arguments[argument])}}

        module.add(f"force{number}", f"force of muscle {number}, 0 or below", force, held)
        if activations > filtered:
            module.add(f"rates{number}", f"rates of the activations of muscle {number}", rates, held)
        if slips:
            module.add(f"settled{number}", f"muscle {number} after a step; no force changes by it", settled, held)
        if anchors:
            module.add(f"unset{number}", f"unstressed anchors of muscle {number}", unset, {argument: given})

    def _at(self, parameters: Any, given: Any) -> tuple[JointPlant, Any, Any, Activations, MuscleState]:
        """Plant, path and its derivative, activations, and state of the muscle."""
        plant: JointPlant = eqx.combine(parameters["plant"], self._fixed)
        path, slope = value_and_derivative(lambda length: self._path(plant, length), given["length"])
        acts = self.layout.unpack(given["act"]) if "act" in given else self.start
        if isinstance(plant.valve, IdealValve):
            acts = acts._replace(pressure=given["command"])
        return plant, path, slope, acts, MuscleState(tuple(given.get("anchors", ())), acts.creep)

    def _path(self, plant: JointPlant, length: Any) -> Any:
        if self._moved.tendon:
            return length + float(self._moved.offset)
        return plant.joint.geometry.path_lengths(length)[self._index]

    def _of(self, plant: JointPlant) -> Muscle:
        return (plant.joint.muscle1, plant.joint.muscle2)[self._index]

    def _force(self, parameters: Any, given: Any) -> Any:
        plant, path, slope, (_, _, pressure), state = self._at(parameters, given)
        muscle = self._of(plant)
        contraction = plant.joint.tendon.contraction(muscle, path, pressure, state)
        viscous = muscle.viscous_force(contraction, pressure, slope * given["velocity"], state)
        return -(muscle.tension(contraction, pressure, state) + viscous) * slope

    def _rates(self, parameters: Any, given: Any) -> Any:
        plant, _, slope, (_, state, pressure), held = self._at(parameters, given)
        muscle, valve, command, velocity = self._of(plant), plant.valve, given["command"], given["velocity"]
        creep = muscle.state_rate(held, slope * velocity).creep
        if isinstance(valve, AirValve):

            def volume(length: Any) -> Any:
                return muscle.specimen.volume(muscle.specimen.contraction_at(self._path(plant, length)))

            size, growth = value_and_derivative(volume, given["length"])
            air = AirVolume(size + valve.dead_volume, growth * velocity)
            both = valve.air_rate((pressure, pressure), AirState((state, state)), (command, command), (air, air))
            rates = Activations(creep, both[1].valves[0], both[0][0])
        elif isinstance(valve, IdealValve):
            rates = Activations(creep, (), ())
        else:
            known: Any = valve
            after = lambda elapsed: known.pressure_after(pressure, command, elapsed)  # noqa: E731
            rates = Activations(creep, (), derivative(after, jnp.zeros(())))
        return self.layout.pack(rates, jnp)

    def _settled(self, parameters: Any, given: Any) -> dict[str, Any]:
        plant, path, _, acts, state = self._at(parameters, given)
        muscle = self._of(plant)
        friction, creep = muscle.update_state(state, muscle.specimen.contraction_at(path), acts.pressure)
        pressure = () if isinstance(plant.valve, IdealValve) else acts.pressure
        found = {"act": self.layout.pack(Activations(creep, acts.valve, pressure), jnp)} if self.layout.size else {}
        return found | ({"anchors": jnp.stack(friction)} if friction else {})

    def _unset(self, parameters: Any, given: Any) -> Any:
        plant, path, *_ = self._at(parameters, given)
        muscle = self._of(plant)
        return jnp.stack(muscle.init_state(muscle.specimen.contraction_at(path)).friction)


class MassPoint(NamedTuple):
    """Mass [kg] that hangs along -y at the angle 0, its distance [m], inertia about itself, and what was chosen."""

    mass: float
    distance: float
    inertia: float
    chosen: tuple[str, ...]


def mass_point(load: Load) -> MassPoint:
    """A body with the inertia and the torque of gravity of a load."""
    inertia, moment, gravity = float(load.total_inertia), float(load.gravity_moment), gravity_of(load)
    angles = np.linspace(-1, 1, 5)
    hanging = moment * np.sin(float(load.hanging_angle) - angles)
    if not np.allclose(load.gravity_torque(angles), hanging, rtol=0, atol=1e-9 * max(1.0, abs(moment))):
        raise _cannot("load", "a load with another torque than gravity's", "give a PendulumLoad or a GeneralLoad")
    mass, chosen = known_mass(load), ()
    if mass is None:
        mass = 2 * moment**2 / (inertia * gravity**2) or 1.0
        chosen = (f"mass of the load: {mass:.4g} kg is chosen, as only its inertia and torque are known",)
    distance = moment / (mass * gravity) if gravity else 0.0
    return MassPoint(mass, distance, max(inertia - mass * distance**2, 1e-12 * inertia), chosen)


def gravity_of(load: Load) -> float:
    """G [m/s^2] of a load."""
    return float(getattr(load, "gravity", _GRAVITY))


def known_mass(load: Load) -> float | None:
    """Mass [kg] of a load, where it is known."""
    if hasattr(load, "mass1"):
        return float(load.mass1 + load.mass2) or None
    return float(load.mass) if hasattr(load, "mass") else None


def command_ranges(plant: JointPlant) -> list[tuple[float, float]]:
    """Lowest and highest command of each muscle: gauge pressures [Pa], or openings."""
    if getattr(plant.valve, "direct", False):
        return [(-1.0, 1.0)] * 2
    joint = plant.supplied_joint
    domains = joint.muscle1.specimen.domain, joint.muscle2.specimen.domain
    return [(float(one.pressure_min), float(one.pressure_max)) for one in domains]


def _keyframe(plant: JointPlant, start: PlantState, acts: list[Any]) -> str:
    numbers = [float(one) for each in acts for one in each]
    act = f' act="{_text(numbers)}"' if numbers else ""
    direct = getattr(plant.valve, "direct", False)
    control = [0.0, 0.0] if direct else [float(one) for one in start.pressures]
    position, velocity = float(start.angle), float(start.velocity)
    return f'<key name="start" qpos="{position!r}" qvel="{velocity!r}"{act} ctrl="{_text(control)}"/>'


def _text(numbers: Any) -> str:
    return " ".join(repr(float(one)) for one in numbers)


def _mjcf(
    plant: Any,
    name: str,
    timestep: float,
    moved: tuple[Transmission, Transmission],
    muscles: tuple[PluginMuscle, ...],
    point: MassPoint,
    keyframe: str,
) -> str:
    """MJCF of the joint in a vertical plane: its x and y are turned so that gravity points to the hanging angle."""
    sine, cosine = math.sin(float(plant.load.hanging_angle)), math.cos(float(plant.load.hanging_angle))
    mass, distance, rest, _ = point
    inertial = f'pos="0 {-distance!r} 0" mass="{mass!r}" diaginertia="{rest!r} {rest!r} {rest!r}"'
    actuators = []
    for number, (one, muscle, limits) in enumerate(zip(moved, muscles, command_ranges(plant), strict=True), 1):
        target = f'tendon="muscle{number}"' if one.tendon else 'joint="joint"'
        dynamics, limited = "", 'ctrllimited="false"'  # a return spring has no pressure
        if limits[0] < limits[1]:
            limited = f'ctrllimited="true" ctrlrange="{_text(limits)}"'
        if muscle.activations:
            lag = f'dynprm="{float(plant.valve.time_constant)!r}"' if muscle.filtered else ""
            dynamics = f' actdim="{muscle.activations}" dyntype="{"filter" if lag else "none"}" {lag}'
        actuators.append(
            f'<plugin name="muscle{number}" {target} plugin="mckibben.{name}"{dynamics} {limited}>'
            f'<config key="muscle" value="{number}"/></plugin>'
        )
    fixed, moving, tendons = (
        "\n    ".join(filter(None, (getattr(one, part) for one in moved)))
        for part in ("fixed_sites", "moving_sites", "tendon")
    )
    lost = "" if plant.friction is None else f' frictionloss="{float(plant.friction.torque)!r}"'
    return f"""<!-- Written by mckibben {mckibben.__version__}. Angles in rad, pressures in Pa, gauge. -->
<mujoco model="{name}">
  <extension><plugin plugin="mckibben.{name}"/></extension>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{timestep!r}" integrator="RK4" gravity="0 0 {-gravity_of(plant.load)!r}">
    <flag contact="disable"/>
  </option>
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
  </worldbody>
  <tendon>
    {tendons}
  </tendon>
  <actuator>
    {"".join(actuators)}
  </actuator>
  <sensor><jointpos name="angle" joint="joint"/><jointvel name="velocity" joint="joint"/></sensor>
  <keyframe>{keyframe}</keyframe>
</mujoco>
"""


def plugin_source(model: JointModel, name: str) -> str:
    """C of the plugin around the functions of the muscles."""
    values = {"name": name, "plugin": f"mckibben.{name}"}
    parts = []
    for number, (activations, anchors, slips, filtered) in enumerate(model.muscles, 1):
        load, rates = [], []
        if activations:
            load.append("memcpy(given.act, act, sizeof given.act);")
        if anchors:
            load += [
                "if (state[0] == UNSET) {",
                f"    {name}_first{number} first;",
                f"    {name}_unset{number}(model, &given, &first);",
                "    memcpy(state + 2, first.anchors, sizeof first.anchors);",
                "}",
                "memcpy(given.anchors, state + 2, sizeof given.anchors);",
            ]
        if slips:
            store = [("act", "act")] if activations else []
            store += [("state + 2", "anchors")] if anchors else []
            copied = [f"    memcpy({to}, after.{part}, sizeof after.{part});" for to, part in store]
            again = [f"    memcpy(given.{part}, after.{part}, sizeof after.{part});" for _, part in store]
            load += [
                "if (state[0] == STEPPED) {",
                f"    {name}_after{number} after;",
                "    given.command = state[1];",
                f"    {name}_settled{number}(model, &given, &after);",
                *copied,
                *again,
                "    given.command = command(m, d, i);",
                "}",
                "state[0] = SETTLED;",
            ]
        if activations > filtered:
            rates += [
                f"{name}_rate{number} found;",
                f"{name}_rates{number}(model, &given, &found);",
                f"memcpy(d->act_dot + m->actuator_actadr[i], found.act, {activations - filtered} * sizeof(mjtNum));",
            ]
        values[f"anchors{number}"] = str(anchors)
        text = {"load": load, "rates": rates}
        body = {key: "\n".join(f"    {line}" for line in lines) for key, lines in text.items()}
        parts.append(filled("plugin_muscle.c", values | body | {"k": str(number)}))
    return filled("plugin.c", values | {"muscles": "".join(parts)})


def mjcf_files(scenario: Scenario, name: str, folder: Path, single: bool) -> Exported:
    """The plant of a scenario as MJCF, and the plugin for its muscles."""
    plant = scenario.plant()
    timestep = scenario.control_period / scenario.substeps
    model = joint_model(plant, name, timestep, plant.complete_state(scenario.initial(plant)))
    comment = f"Muscles of the scenario {scenario.name!r}, written by mckibben {mckibben.__version__}."
    sources = write_c(model.module, comment.replace("*/", "* /"), single=False)
    left_out = ("controller and reference of the scenario: data.ctrl is yours", *model.left_out)
    if single:
        left_out = (*left_out, "32-bit numbers: MuJoCo has 64")
    listed = "".join(f"- {one}\n" for one in left_out)
    files = {
        f"{name}.xml": model.xml,
        f"{name}.h": sources.header,
        f"{name}.c": sources.source,
        "plugin.c": plugin_source(model, name),
        "Makefile": filled("plugin.mk", {"name": name}),
        "scenario.yaml": scenario.dumps(folder=folder),
        "README.md": filled("mujoco.md", {"name": name, "title": scenario.name, "left_out": listed}),
    }
    return Exported(files, left_out)


def _cannot(field: str, what: str, remedy: str) -> ExportError:
    return ExportError(f"MuJoCo cannot hold {what}", field=field, remedy=remedy)
