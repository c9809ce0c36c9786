"""Program of a controller: its functions, and a recorded run for checking them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from numpy.typing import NDArray

from mckibben.codegen.source_module import SourceModule
from mckibben.component.base import Units, field_hints, field_quantities, units_of_part
from mckibben.control import Controller, Setpoint
from mckibben.joint import AntagonisticJoint, Measurement
from mckibben.muscle import ForceLaw, PressureAffineLaw
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import compiled_as_given, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.scenario import Scenario
from mckibben.simulation.problem import sampled
from mckibben.units import SYMBOLS

UNITS = {
    "parameters.control_period": "s",
    "setpoint.angle": "rad",
    "setpoint.stiffness": "N*m/rad",
    "measurement.angle": "rad",
    "measurement.pressures.0": "Pa, gauge",
    "measurement.pressures.1": "Pa, gauge",
    "commands.pressure1": "Pa, gauge",
    "commands.pressure2": "Pa, gauge",
    "telemetry.stiffness_estimate": "N*m/rad",
}


class ControllerModule(NamedTuple):
    """Source of a controller, units of its members, a recorded run, and the parts omitted from the source."""

    module: SourceModule
    units: dict[str, str]
    columns: tuple[str, ...]  # of the recording
    recording: NDArray[
        np.float64
    ]  # rows: setpoint, measurement, commands; the first one is the start, without commands
    left_out: tuple[str, ...]


class ControllerFunctions(NamedTuple):
    """Functions of a controller over its parameters, and examples of their arguments."""

    parameters: dict[str, Any]
    of: Callable[[Any], Controller]  # parameters
    init: Callable[[Any, Measurement], dict[str, Any]]
    step: Callable[[Any, Any, Setpoint, Measurement], dict[str, Any]]
    state: Any
    setpoint: Setpoint
    measurement: Measurement  # the first one
    plant: JointPlant
    controller: Controller
    initial: PlantState


def controller_functions(scenario: Scenario) -> ControllerFunctions:
    """First and subsequent steps of a scenario's controller; all its real numbers are parameters."""
    period = scenario.control_period
    plant, controller = scenario.plant().with_period(period), scenario.control().with_period(period)
    plant, controller, initial = numeric((plant, controller, scenario.initial(plant)))
    initial = plant.complete_state(initial)
    numbers, fixed = eqx.partition(controller, is_real)
    parameters = {"controller": numbers, "control_period": np.asarray(scenario.control_period)}

    def of(parameters: Any) -> Controller:
        return eqx.combine(parameters["controller"], fixed)

    def init(parameters: Any, measurement: Measurement) -> dict[str, Any]:
        return {"state": of(parameters).init(measurement)}

    def step(parameters: Any, state: Any, setpoint: Setpoint, measurement: Measurement) -> dict[str, Any]:
        controller = of(parameters)
        state, commands = controller.step(state, setpoint, measurement, parameters["control_period"])
        pressures = {f"pressure{number}": one for number, one in enumerate(commands, 1)}
        return {"state": state, "commands": pressures, "telemetry": controller.telemetry(state)}

    measurement = plant.sample(initial, 0.0)[1]
    state = jax.eval_shape(controller.init, measurement)
    state = jax.tree.map(lambda one: np.zeros(one.shape, one.dtype), state)
    setpoint = Setpoint(jnp.zeros(()), jnp.zeros(()))
    return ControllerFunctions(parameters, of, init, step, state, setpoint, measurement, plant, controller, initial)


def controller_module(scenario: Scenario, name: str = "controller", most_periods: int = 10_000) -> ControllerModule:
    """Source module of a scenario's controller: first step, subsequent steps, and the laws and limits of its model.

    All its real numbers are adjustable parameters; numbers of hidden neurons, seeds and other integers are fixed.
    Raises `ExportError` for parts that cannot be expressed in another language.
    """
    source = controller_functions(scenario)
    module, left_out = controller_program(source, name)
    plant, controller, measurement = source.plant, source.controller, source.measurement
    _, setpoints = sampled(scenario.reference(), scenario.duration, scenario.control_period)
    setpoints = jax.tree.map(lambda x: x[:most_periods], setpoints)
    run = _recorded(plant, controller, setpoints, source.initial, scenario.control_period, scenario.needed_substeps())
    recording = np.column_stack(run)
    first = [np.nan, np.nan, *map(float, (measurement.angle, *measurement.pressures)), np.nan, np.nan]
    columns = ("setpoint.angle", "setpoint.stiffness", "measurement.angle", "measurement.pressures_0",
               "measurement.pressures_1", "commands.pressure1", "commands.pressure2")  # fmt: skip
    return ControllerModule(
        module, UNITS | units_of(source.parameters, "parameters"), columns, np.vstack([first, recording]), left_out
    )


def controller_program(source: ControllerFunctions, name: str) -> tuple[SourceModule, tuple[str, ...]]:
    """First step, subsequent steps and model of a controller, and the parts that cannot be exported."""
    module = SourceModule(name, source.parameters, "controller.")
    given = {"setpoint": source.setpoint, "measurement": source.measurement}
    module.add("init", "first state, from the first measurement", source.init, {"measurement": source.measurement})
    text = "one control period: new state, and commands from now on"
    module.add("step", text, source.step, {"state": source.state, **given})
    model = getattr(source.controller, "model", None)
    return module, tuple(_add_model(module, source.of, model) if isinstance(model, AntagonisticJoint) else ())


def _add_model(module: SourceModule, of: Any, model: AntagonisticJoint) -> list[str]:
    """Add functions of the controller's joint model; return the parts that cannot be exported."""
    number = np.zeros(())
    for muscle in ("muscle1", "muscle2"):

        def force(parameters: Any, contraction: Any, pressure: Any, muscle: str = muscle) -> dict[str, Any]:
            return {"force": getattr(of(parameters).model, muscle).force(contraction, pressure)}

        text = f"force [N] of {muscle} by the model, at a contraction [1] and a gauge pressure [Pa]"
        module.add(f"{muscle}_force", text, force, {"contraction": number, "pressure": number})

    def stiffness(parameters: Any, angle: Any, pressure1: Any, pressure2: Any) -> dict[str, Any]:
        return {"stiffness": of(parameters).model.stiffness(angle, (pressure1, pressure2))}

    text = "isobaric stiffness [N*m/rad] by the model, at an angle [rad] and gauge pressures [Pa]"
    module.add("stiffness", text, stiffness, dict.fromkeys(("angle", "pressure1", "pressure2"), number))
    if not all(isinstance(muscle.law, PressureAffineLaw) for muscle in (model.muscle1, model.muscle2)):
        return ["attainable_stiffness: the laws are not affine in pressure, and the program would be long"]

    def attainable(parameters: Any, angle: Any, torque: Any) -> dict[str, Any]:
        lowest, highest = of(parameters).model.attainable_stiffness(angle, torque)
        return {"lowest": lowest, "highest": highest}

    text = "stiffness [N*m/rad] that is attainable at rest, at an angle [rad] under a torque [N*m]; NAN if none is"
    module.add("attainable_stiffness", text, attainable, {"angle": number, "torque": number})
    return []


@compiled_as_given
def _recorded(
    plant: JointPlant, controller: Controller, setpoints: Setpoint, initial: PlantState, period: Any, substeps: Any
) -> tuple[Any, ...]:
    """Setpoints, measurements and commands of a run, each of shape (periods,)."""

    def next_period(states: Any, setpoint: Setpoint) -> Any:
        plant_state, measurement = plant.sample(states[0], period)
        state, commands = controller.step(states[1], setpoint, measurement, period)
        following = plant.follow(plant_state, plant.clip_commands(commands), period, substeps)
        return (following, state), (*setpoint, measurement.angle, *measurement.pressures, *commands)

    start = initial, controller.init(plant.sample(initial, 0.0)[1])
    with batched_program():  # compiles a third faster
        return lax.scan(next_period, start, setpoints)[1]


def is_real(leaf: Any) -> bool:
    """Whether a leaf is a parameter of a program."""
    return eqx.is_array_like(leaf) and np.asarray(leaf).dtype.kind == "f"


def units_of(tree: Any, prefix: str) -> dict[str, str]:
    """Units of the leaves of a tree by path, from the metadata of the fields."""
    return {f"{prefix}.{path}": unit for path, unit in _units(tree, "") if unit}


def _units(tree: Any, path: str, symbols: Units = Units()) -> Iterator[tuple[str, str]]:  # noqa: B008
    """Path and unit of each field below; `symbols` are the units of symbolic ones."""
    parts: dict[str, Any]
    units: dict[str, str] = {}
    hints: dict[str, Any] = {}
    if isinstance(tree, dict):
        parts = tree
    elif isinstance(tree, tuple | list):
        parts = {str(number): one for number, one in enumerate(tree)}
    elif dataclasses.is_dataclass(tree):
        parts = {field.name: getattr(tree, field.name) for field in dataclasses.fields(tree)}
        hints = field_hints(type(tree))
        units = {name: symbols.get(mark.unit, mark).unit for name, mark in field_quantities(type(tree)).items()}
        units = {name: unit for name, unit in units.items() if unit not in SYMBOLS}
        if isinstance(tree, ForceLaw):
            units |= {one.name: one.unit for one in tree.parameters()}
    else:
        return
    for name, part in parts.items():
        here = f"{path}.{name}" if path else name
        yield here, units.get(name, "")
        yield from _units(part, here, units_of_part(hints.get(name)) or symbols)
