"""Program of a controller: its functions, and a recorded run for checking them.

The same functions are written as C and JavaScript, for a joint or a leg, and run in an FMU. They depend on parameters
and state alone, and do not accept samples that are not finite.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.source_module import SourceModule, element_names
from mckibben.component.base import Units, field_hints, field_quantities, units_of_part
from mckibben.control import Setpoint
from mckibben.export.plant import is_real
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import ForceLaw, PressureAffineLaw
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit_arrays, numeric
from mckibben.plant import Plant
from mckibben.scenario import Scenario
from mckibben.simulation.problem import sampled
from mckibben.units import SYMBOLS

_MOST_PERIODS = 10_000  # of a recording
_UNITS = {
    **dict.fromkeys(("angle", "angles"), "rad"),
    **dict.fromkeys(("stiffness", "stiffness_estimate"), "N*m/rad"),
    **dict.fromkeys(("command", "pressure", "pressures", "reservoir"), "Pa"),
    **dict.fromkeys(("force", "ground_force", "tension"), "N"),
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
    columns: tuple[str, ...]  # of the recording
    recording: NDArray[np.float64]  # setpoint, measurement, commands; the first row is the start, without commands
    left_out: tuple[str, ...]


class ControllerFunctions(NamedTuple):
    """Functions of a controller over its parameters, and examples of their arguments.

    The functions are pure, and take the parameters first: ``init(parameters, measurement)`` returns the ``state``, and
    whether the measurement is ``valid``; ``step(parameters, state, setpoint, measurement)`` the next ``state``, the
    ``commands`` [Pa] and the ``telemetry``; ``hold(parameters, state)`` the last commands, at first the measured
    pressures, for a sample that is not finite: it leaves the state as it is, and the telemetry is ``held``.
    """

    parameters: dict[str, PyTree]
    of: Callable[[PyTree], PyTree]  # the controller with these parameters
    init: Callable[[PyTree, PyTree], dict[str, PyTree]]
    step: Callable[[PyTree, PyTree, PyTree, PyTree], dict[str, PyTree]]
    hold: Callable[[PyTree, PyTree], dict[str, PyTree]]
    state: PyTree
    setpoint: PyTree
    measurement: PyTree  # the first one
    plant: Plant
    initial: PyTree  # state of the plant
    period: float  # s


class HeldState(NamedTuple):
    """State of a controller, and its last commands [Pa]."""

    controller: PyTree
    commands: tuple[Array, ...]


def controller_functions(scenario: Scenario) -> ControllerFunctions:
    """First and subsequent steps of a scenario's controller; all its real numbers are parameters."""
    period = scenario.control_period
    plant, controller = scenario.plant().with_period(period), scenario.control().with_period(period)
    plant, controller, initial = numeric((plant, controller, scenario.initial(plant)))
    setpoint = Setpoint(jnp.zeros(()), jnp.zeros(()))
    return functions_of(plant, controller, plant.complete_state(initial), period, setpoint)


def functions_of(
    plant: Plant,
    controller: PyTree,
    initial: PyTree,
    period: float,
    setpoint: PyTree,
    applied: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]] = lambda controller, setpoint: (controller, setpoint),
) -> ControllerFunctions:
    """Functions of a controller of a joint or a leg, all of whose real numbers but the period are parameters.

    Parameters
    ----------
    plant, initial
        Plant and its state at the start, for the first measurement.
    period
        Control period [s].
    setpoint
        Example of a setpoint.
    applied
        ``applied(controller, setpoint)`` returns the controller and the second argument of its `step`.
    """
    numbers, fixed = eqx.partition(controller, is_real)
    parameters = {"controller": numbers}

    def of(parameters: PyTree) -> PyTree:
        return eqx.combine(parameters["controller"], fixed)

    def init(parameters: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        finite = jax.tree.map(lambda number: jnp.where(jnp.isfinite(number), number, 0.0), measurement)
        state = HeldState(of(parameters).init(finite), tuple(map(jnp.asarray, finite.pressures)))
        valid = jnp.isfinite(sum(jax.tree.leaves(measurement)))  # none of which comes near the largest number
        return {"state": state, "valid": valid}

    def step(parameters: PyTree, state: HeldState, setpoint: PyTree, measurement: PyTree) -> dict[str, PyTree]:
        controller, second = applied(of(parameters), setpoint)
        state = HeldState(*controller.step(state.controller, second, measurement, np.asarray(period)))
        return {"state": state, **answer(parameters, state, held=False)}

    def hold(parameters: PyTree, state: HeldState) -> dict[str, PyTree]:
        return answer(parameters, state, held=True)

    def answer(parameters: PyTree, state: HeldState, *, held: bool) -> dict[str, PyTree]:
        pressures = {f"pressure{number}": command for number, command in enumerate(state.commands, 1)}
        telemetry = of(parameters).telemetry(state.controller)
        return {"commands": pressures, "telemetry": {**telemetry, "held": jnp.asarray(held)}}

    measurement = plant.sample(initial, 0.0)[1]
    state = jax.eval_shape(lambda measurement: init(parameters, measurement)["state"], measurement)
    state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), state)
    return ControllerFunctions(parameters, of, init, step, hold, state, setpoint, measurement, plant, initial, period)


def controller_module(scenario: Scenario, name: str = "controller") -> ControllerModule:
    """Source module of a scenario's controller: first step, subsequent steps, and the laws and limits of its model.

    All its real numbers are adjustable parameters; numbers of hidden neurons, seeds and other integers are fixed.
    Raises `ExportError` for parts that cannot be expressed in another language.
    """
    source = controller_functions(scenario)
    module, left_out = controller_program(source, name)
    _, setpoints = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    setpoints = jax.tree.map(lambda x: x[:_MOST_PERIODS], setpoints)
    made = recorded(source, module, source.of(source.parameters), setpoints, scenario.needed_substeps(), _setpoint_of)
    return made._replace(left_out=left_out)


def _setpoint_of(controller: PyTree, state: PyTree, setpoint: Setpoint, *_: object) -> Setpoint:
    """Setpoint of a joint, which is the row itself."""
    return setpoint


def controller_program(source: ControllerFunctions, name: str) -> tuple[SourceModule, tuple[str, ...]]:
    """First step, subsequent steps and model of a controller, and the parts that cannot be exported."""
    module, model = stepping_module(name, source), getattr(source.of(source.parameters), "model", None)
    return module, tuple(_add_model(module, source.of, model) if isinstance(model, AntagonisticJoint) else ())


def stepping_module(name: str, source: ControllerFunctions) -> SourceModule:
    """Source module of a controller: `init`, `hold` and `step`.

    `step` calls `hold` in place of itself if a number of the setpoint or the measurement is not finite.
    """
    module = SourceModule(name, source.parameters, "controller.")
    text = "first state, from the first measurement; false if that is not finite"
    module.add("init", text, source.init, {"measurement": source.measurement})
    module.add("hold", "the last commands, for a period without a valid sample", source.hold, {"state": source.state})
    arguments = {"state": source.state, "setpoint": source.setpoint, "measurement": source.measurement}
    text = "one control period: new state, and commands from now on; hold if a number is not finite"
    module.add("step", text, source.step, arguments, "hold")
    return module


def _add_model(module: SourceModule, of: Callable[[PyTree], PyTree], model: AntagonisticJoint) -> list[str]:
    """Add functions of the controller's joint model; return the parts that cannot be exported."""
    number = np.zeros(())
    for muscle in ("muscle1", "muscle2"):

        def force(parameters: PyTree, contraction: Array, pressure: Array, muscle: str = muscle) -> dict[str, PyTree]:
            return {"force": getattr(of(parameters).model, muscle).force(contraction, pressure)}

        text = f"force [N] of {muscle} by the model, at a contraction [1] and a gauge pressure [Pa]"
        module.add(f"{muscle}_force", text, force, {"contraction": number, "pressure": number})

    def stiffness(parameters: PyTree, angle: Array, pressure1: Array, pressure2: Array) -> dict[str, PyTree]:
        return {"stiffness": of(parameters).model.stiffness(angle, (pressure1, pressure2))}

    text = "isobaric stiffness [N*m/rad] by the model, at an angle [rad] and gauge pressures [Pa]"
    module.add("stiffness", text, stiffness, dict.fromkeys(("angle", "pressure1", "pressure2"), number))
    if not all(isinstance(muscle.law, PressureAffineLaw) for muscle in (model.muscle1, model.muscle2)):
        return ["attainable_stiffness: the laws are not affine in pressure, and the program would be long"]

    def attainable(parameters: PyTree, angle: Array, torque: Array) -> dict[str, PyTree]:
        lowest, highest = of(parameters).model.attainable_stiffness(angle, torque)
        return {"lowest": lowest, "highest": highest}

    text = "stiffness [N*m/rad] that is attainable at rest, at an angle [rad] under a torque [N*m]; NAN if none is"
    module.add("attainable_stiffness", text, attainable, {"angle": number, "torque": number})
    return []


def recorded(
    source: ControllerFunctions,
    module: SourceModule,
    controller: PyTree,
    rows: PyTree,
    substeps: int,
    setpoint_of: Callable[..., PyTree],
) -> ControllerModule:
    """A module with the recording of a run of its controller.

    Parameters
    ----------
    controller, rows
        The controller in the simulation, and the second arguments of its steps, a row for each period.
    substeps
        Integration steps per period.
    setpoint_of
        Setpoint in a period; takes controller, its state, the row, the measurement and the period.
    """
    step = next(function for function in module.functions if function.name == "step")
    structures = step.arguments | step.results
    parts = "setpoint", "measurement", "commands"
    columns = [column for part in parts for column in element_names(part, structures[part])]
    timing = source.period, substeps
    first, *table = _recorded(source.plant, controller, rows, source.initial, *timing, setpoint_of)
    start = [*([np.nan] * len(table[0])), *map(float, jax.tree.leaves(first)), *([np.nan] * len(table[2]))]
    recording = np.vstack([start, np.column_stack([column for part in table for column in part])])
    return ControllerModule(module, units_of(module, "Pa, gauge"), tuple(columns), recording, ())


@jit_arrays
def _recorded(
    plant: Plant,
    controller: PyTree,
    rows: PyTree,
    initial: PyTree,
    period: ArrayLike,
    substeps: int,
    setpoint_of: Callable[..., PyTree],
) -> tuple[PyTree, ...]:
    """First measurement; setpoints, measurements and commands of a run, each of shape (periods,)."""

    def next_period(states: PyTree, rows: PyTree) -> PyTree:
        plant_state, measurement = plant.sample(states[0], period)
        wanted = setpoint_of(controller, states[1], rows, measurement, period)
        state, commands = controller.step(states[1], rows, measurement, period)
        following = plant.follow(plant_state, plant.clip_commands(commands), period, substeps)
        return (following, state), (tuple(wanted), tuple(jax.tree.leaves(measurement)), commands)

    with batched_program():  # compiles a third faster
        measured = plant.sample(initial, 0.0)[1]
        return measured, *lax.scan(next_period, (initial, controller.init(measured)), rows)[1]


def units_of(module: SourceModule, pressure: str = "Pa") -> dict[str, str]:
    """Units of a module by structure and path: of parameters from the metadata of the fields, else by quantity.

    `pressure` is the text for pressures, which may say to what they refer.
    """
    units = {f"parameters.{path}": unit for path, unit in _units(module.parameters, "") if unit}
    for structure, members in (module.structures() | {"state": module.state}).items():
        for member in members:
            quantity = re.sub(r"[\d._]+$", "", member.path).rpartition(".")[2]
            if quantity in _UNITS:
                unit = _UNITS[quantity]
                units[f"{structure}.{member.path}"] = pressure if unit == "Pa" else unit
    return units


def _units(tree: PyTree, path: str, symbols: Units = Units()) -> Iterator[tuple[str, str]]:  # noqa: B008
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
        units = {name: symbols.get(mark.unit, mark).unit for name, mark in field_quantities(type(tree)).items()}
        units = {name: unit for name, unit in units.items() if unit not in SYMBOLS}
        if isinstance(tree, ForceLaw):
            units |= {parameter.name: parameter.unit for parameter in tree.parameters()}
    else:
        return
    for name, part in parts.items():
        here = f"{path}.{name}" if path else name
        yield here, units.get(name, "")
        yield from _units(part, here, units_of_part(hints.get(name)) or symbols)
