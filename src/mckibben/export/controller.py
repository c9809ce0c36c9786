"""Program of a controller: its functions, and a recorded run for checking them.

The same functions are written as C and JavaScript, for a joint or a robot, and run in an FMU. They depend on parameters
and state alone; `containment` checks their samples.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.codegen.native import over_periods
from mckibben.codegen.source_module import SourceModule, element_names
from mckibben.component.base import Units, field_hints, field_quantities, units_of_part
from mckibben.control import Setpoint
from mckibben.control.robot_control import RobotController
from mckibben.errors import ExportError
from mckibben.export.containment.functions import ControllerFunctions, functions_of
from mckibben.export.containment.limits import Limits, containment_of
from mckibben.export.evaluation import find_function
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import ForceLaw, PressureAffineLaw
from mckibben.numerics.compiled import numeric
from mckibben.scenario import Scenario
from mckibben.scenario.robot import RobotScenario
from mckibben.simulation.problem import in_order, sampled, sampled_reference, sampling_times
from mckibben.units import HINGE, SYMBOLS, JointType, Quantity

_MOST_PERIODS = 10_000  # of a recording
_UNITS = {
    **dict.fromkeys(("angle", "angles"), "rad"),
    **dict.fromkeys(("stiffness", "stiffness_estimate"), "N*m/rad"),
    **dict.fromkeys(("command", "pressure", "pressures", "reservoir"), "Pa"),
    **dict.fromkeys(("force", "ground_force", "tension"), "N"),
    **dict.fromkeys(("frozen", "tolerated", "ramp", "held", "good", "unchanged"), "s"),
    **{"velocity": "rad/s", "torque": "N*m", "temperatures": "K", "contraction": "1"},
}
"""Units of arguments and results by the names of their quantities."""


class ControllerModule(NamedTuple):
    """Source of a controller, units of its members, a recorded run, and the parts omitted from the source.

    Attributes
    ----------
    units
        Units by structure and path, such as ``setpoint.angle``.
    columns
        Names of the columns of the recording, such as ``measurement.pressures_0``.
    recording
        Setpoint, measurement and commands in SI, shape (1 + periods, columns); the first row is the start, with a
        measurement alone.
    """

    module: SourceModule
    units: dict[str, str]
    columns: tuple[str, ...]
    recording: NDArray[np.float64]
    left_out: tuple[str, ...]


def controller_functions(scenario: Scenario | RobotScenario, limits: Limits | None = None) -> ControllerFunctions:
    """Contained steps of a scenario's controller; all its real numbers, and the limits, are parameters.

    Setpoints of a robot are ``angles`` and ``stiffness`` of all joints. Raises `ExportError` for a robot without a
    controller.
    """
    plant, controller, initial = parts_of(scenario)
    bounds, period = containment_of(scenario, limits or Limits()), scenario.control_period
    if isinstance(scenario, Scenario):
        reference = scenario.reference()
        return functions_of(plant, controller, initial, period, reference.finite(reference(0.0)), bounds)

    def stepped(controller: RobotController, state: PyTree, setpoint: PyTree, *sample: PyTree) -> PyTree:
        return controller.step(state, tuple(map(Setpoint, setpoint["angles"], setpoint["stiffness"])), *sample)

    references = scenario.references()
    setpoints = zip(*(references[name](0.0) for name in scenario.joint_names), strict=True)
    setpoint = dict(zip(("angles", "stiffness"), setpoints, strict=True))
    return functions_of(plant, controller, initial, period, setpoint, bounds, stepped)


def parts_of(scenario: Scenario | RobotScenario) -> tuple[PyTree, PyTree, PyTree]:
    """Plant, controller, and state of the plant at the start; `ExportError` for a robot without a controller."""
    if scenario.duration is None:
        remedy = "give it `controller` or `controllers`, `reference` and `duration`"
        raise ExportError("the robot has no controller", field="controller", remedy=remedy)
    period = scenario.control_period
    plant: PyTree = scenario.plant().with_period(period)
    controller = scenario.control().with_period(period)
    plant, controller, initial = numeric((plant, controller, scenario.initial(plant)))
    return plant, controller, plant.complete_state(initial)


def controller_module(
    scenario: Scenario | RobotScenario, name: str = "controller", limits: Limits | None = None
) -> ControllerModule:
    """Source module of a scenario's controller: first step, subsequent steps, and the laws and limits of its model.

    All its real numbers are adjustable parameters; numbers of hidden neurons, seeds and other integers are fixed.
    Raises `ExportError` for parts that cannot be expressed in another language.
    """
    source = controller_functions(scenario, limits)
    module, left_out = controller_program(source, name)
    if isinstance(scenario, Scenario):
        reference = scenario.reference()
        rows = reference.finite(sampled(reference, scenario.duration, source.period)[1])
        controller, substeps = source.of(source.parameters), scenario.needed_substeps()
    else:
        assert scenario.duration is not None  # else `controller_functions` raises
        controller = parts_of(scenario)[1]
        times = sampling_times(scenario.duration, source.period)
        rows = in_order(source.plant, sampled_reference(scenario.references(), times))
        substeps = scenario.substeps or source.plant.needed_substeps(source.initial.angle, None, source.period)
    rows = jax.tree.map(lambda x: x[:_MOST_PERIODS], rows)
    step = find_function(module.functions, "step")
    structures = step.arguments | step.results
    parts = "setpoint", "measurement", "commands"
    columns = [column for part in parts for column in element_names(part, structures[part])]
    run = source.plant, controller, over_periods(rows), source.initial, source.period, substeps
    first, *samples = _recorded(run)
    joints = [rows] if isinstance(rows, Setpoint) else rows
    table = [[joint.angle for joint in joints] + [joint.stiffness for joint in joints], *samples]
    start = [*([np.nan] * len(table[0])), *map(float, jax.tree.leaves(first)), *([np.nan] * len(table[2]))]
    recording = np.vstack([start, np.column_stack([column for part in table for column in part])])
    _check_limits(source, columns, recording[1:])
    return ControllerModule(
        module, units_of(module, "Pa, gauge", scenario.joint_type), tuple(columns), recording, left_out
    )


def controller_program(source: ControllerFunctions, name: str) -> tuple[SourceModule, tuple[str, ...]]:
    """First step, subsequent steps and model of a controller, and the parts that cannot be exported."""
    module, model = stepping_module(name, source), getattr(source.of(source.parameters), "model", None)
    return module, tuple(_add_model(module, source.of, model) if isinstance(model, AntagonisticJoint) else ())


def stepping_module(name: str, source: ControllerFunctions) -> SourceModule:
    """Source module of a controller: `init` calls `begin`, and `step` calls `check` and possibly `begin` or `hold`."""
    module, state = SourceModule(name, source.parameters, "controller."), {"state": source.state}
    number, measurement = np.zeros(()), {"measurement": source.measurement}
    sample = state | {"setpoint": source.setpoint} | measurement
    module.add("begin", "used by init and step: first state of the controller", source.begin, measurement)
    text = "first state, from the control period [s] and the first measurement; false, and vented, if one is not valid"
    module.add("init", text, source.init, {"period": number} | measurement, ("begin",))
    module.add("check", "used by step: 0 to use a sample, 1 to hold, 2 to begin again first", source.check, sample)
    module.add("hold", "one control period without a usable sample: the last commands, or the vent", source.hold, state)
    text = "one control period: new state, and commands from now on"
    if early := getattr(source.of(source.parameters), "samples_ahead", 0):
        text += f"; the setpoint is that of {early} periods later"
    module.add("step", text, source.step, sample, ("begin", "check", "hold"))
    return module


def _add_model(module: SourceModule, of: Callable[[PyTree], PyTree], model: AntagonisticJoint) -> list[str]:
    """Add functions of the controller's joint model; return the parts that cannot be exported."""
    number, kind = np.zeros(()), model.joint_type
    for muscle in ("muscle1", "muscle2"):

        def force(parameters: PyTree, contraction: Array, pressure: Array, muscle: str = muscle) -> dict[str, PyTree]:
            return {"force": getattr(of(parameters).model, muscle).force(contraction, pressure)}

        text = f"force [N] of {muscle} by the model, at a contraction [1] and a gauge pressure [Pa]"
        module.add(f"{muscle}_force", text, force, {"contraction": number, "pressure": number})

    def stiffness(parameters: PyTree, angle: Array, pressure1: Array, pressure2: Array) -> dict[str, PyTree]:
        return {"stiffness": of(parameters).model.stiffness(angle, (pressure1, pressure2))}

    angle, torque, stiff = (
        kind.words(f"{name} [{kind.unit(unit)}]")
        for name, unit in (("an angle", "rad"), ("a torque", "N*m"), ("stiffness", "N*m/rad"))
    )
    text = f"isobaric {stiff} by the model, at {angle} and gauge pressures [Pa]"
    module.add("stiffness", text, stiffness, dict.fromkeys(("angle", "pressure1", "pressure2"), number))
    if not all(isinstance(muscle.law, PressureAffineLaw) for muscle in (model.muscle1, model.muscle2)):
        return ["attainable_stiffness: the laws are not affine in pressure, and the program would be long"]

    def attainable(parameters: PyTree, angle: Array, torque: Array) -> dict[str, PyTree]:
        lowest, highest = of(parameters).model.attainable_stiffness(angle, torque)
        return {"lowest": lowest, "highest": highest}

    text = f"{stiff} that is attainable at rest, at {angle} under {torque}; NAN if none is"
    module.add("attainable_stiffness", text, attainable, {"angle": number, "torque": number})
    return []


def _check_limits(source: ControllerFunctions, columns: Sequence[str], recording: NDArray[np.float64]) -> None:
    """Raise `ExportError` if the recorded samples leave the limits."""
    limits = source.parameters["limits"]
    low, high = (np.array(list(map(float, jax.tree.leaves(bounds)))) for bounds in (limits.lowest, limits.highest))
    samples = recording[:, : len(low)]
    for row, column in np.argwhere((samples < low) | (samples > high))[:1]:
        name, value, allowed = columns[column], samples[row, column], f"{low[column]:.6g}..{high[column]:.6g}"
        message = f"{name} is {value:.6g} after {row * source.period:g} s of the run, outside its limits {allowed}"
        remedy = "give other limits in the section limits of a file (command line: --hardware FILE)"
        raise ExportError(message, field=name, value=value, remedy=remedy)


@compiled
def _recorded(run: PyTree, _: None) -> tuple[PyTree, ...]:
    """First measurement; measurements and commands of a run, each of shape (periods,)."""
    plant, controller, rows, initial, period, substeps = run

    def next_period(states: PyTree, rows: PyTree) -> PyTree:
        plant_state, measurement = plant.sample(states[0], period)
        state, commands = controller.step(states[1], rows, measurement, period)
        commands = plant.clip_commands(commands)
        following = plant.follow(plant_state, commands, period, substeps)
        return (following, state), (tuple(jax.tree.leaves(measurement)), commands)

    measured = plant.sample(initial, 0.0)[1]
    return measured, *lax.scan(next_period, (initial, controller.init(measured)), rows)[1]


def units_of(module: SourceModule, pressure: str = "Pa", joint_type: JointType = HINGE) -> dict[str, str]:
    """Units of a module by structure and path: of parameters from the metadata of the fields, else by quantity.

    Those of a joint of a type; `pressure` is the text for pressures, which may say to what they refer.
    """
    units = {f"parameters.{path}": unit for path, unit in _units(module.parameters, "", joint_type) if unit}
    limits = [member for member in module.members if member.path.startswith("limits.")]
    for structure, members in (module.structures() | {"state": module.state, "parameters": limits}).items():
        for member in members:
            quantity = re.sub(r"[\d._]+$", "", member.path).rpartition(".")[2]
            if quantity in _UNITS:
                unit = joint_type.unit(_UNITS[quantity])
                units[f"{structure}.{member.path}"] = pressure if unit == "Pa" else unit
    return units


def _units(
    tree: PyTree,
    path: str,
    joint_type: JointType,
    symbols: Units = Units(),  # noqa: B008
) -> Iterator[tuple[str, str]]:
    """Path and unit of each field below; `symbols` are the units of symbolic ones."""
    parts: dict[str, PyTree]
    units: dict[str, str] = {}
    hints: dict[str, type] = {}
    if isinstance(tree, dict):
        parts = tree
    elif isinstance(tree, tuple | list):
        parts = {str(number): part for number, part in enumerate(tree)}
    elif dataclasses.is_dataclass(tree):
        parts = {field.name: getattr(tree, field.name) for field in dataclasses.fields(tree)}
        hints = field_hints(type(tree))
        marks = {name: symbols.get(mark.unit, mark) for name, mark in field_quantities(type(tree)).items()}
        units = {name: mark.for_joint(joint_type).unit for name, mark in marks.items() if isinstance(mark, Quantity)}
        units = {name: unit for name, unit in units.items() if unit not in SYMBOLS}
        if isinstance(tree, ForceLaw):
            units |= {parameter.name: parameter.unit for parameter in tree.parameters()}
    else:
        return
    for name, part in parts.items():
        here = f"{path}.{name}" if path else name
        yield here, units.get(name, "")
        yield from _units(part, here, joint_type, units_of_part(hints.get(name)) or symbols)
