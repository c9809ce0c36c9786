"""FMUs of the plant, of a muscle, and of the controller of a scenario.

Each is a `FunctionalUnit`: functions of a state and of inputs, from which `fmi` makes the archive.
"""

from __future__ import annotations

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from mckibben.codegen.source_module import SourceModule
from mckibben.component.columns import attributes
from mckibben.containment.limits import Limits
from mckibben.export.controller import controller_functions, units_of
from mckibben.export.fmi import fmu
from mckibben.export.functional_unit import FunctionalUnit
from mckibben.export.targets import Exported
from mckibben.joint import Measurement
from mckibben.muscle import Muscle, MuscleState
from mckibben.numerics.compiled import numeric
from mckibben.plant import IOState, JointPlant, PlantState
from mckibben.scenario import Scenario
from mckibben.simulation.problem import sampled

_NUMBER = np.zeros(())
_STATE_NAMES = {
    "pressures.0": "pressure1",
    "pressures.1": "pressure2",
    "air.temperatures.0": "temperature1",
    "air.temperatures.1": "temperature2",
}


def plant_fmu(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The plant for model exchange and co-simulation: commands and an external torque in, motion and forces out.

    Raises `ExportError` for parts that C cannot express, and without FMPy. Sensors, disturbances and the delay of the
    commands are omitted.
    """
    real = scenario.plant()
    plant, initial = numeric((real.with_ideal_io(), scenario.initial(real)))
    unit, left_out = plant_unit(plant, initial, name, scenario.control_period, scenario.needed_substeps())
    if not real.has_ideal_io:
        left_out.append("sensors and disturbance: connect your own to the angle, the pressures and the torque")
    if real.command_delay is not None:
        left_out.append("delay of the commands: give one to the signals of the inputs")
    content, missing = fmu(unit, scenario.dumps(folder=folder))
    return Exported({f"{name}.fmu": content}, (*left_out, *missing))


def plant_unit(
    plant: JointPlant, initial: PlantState, name: str, period: float, substeps: int
) -> tuple[FunctionalUnit, list[str]]:
    """Program of a plant from an initial state, and the omitted parts.

    Parameters
    ----------
    initial
        State at the start; its muscles begin relaxed.
    period, substeps
        Longest step [s] of `advance`, by `JointPlant.advance`, and its integration steps.
    """
    valve = plant.valve
    numbers, fixed = eqx.partition(plant, eqx.is_inexact_array_like)
    initial = plant.complete_state(initial._replace(muscles=(MuscleState((), ()),) * 2, io=(), air=(), friction=()))
    held = valve.holds_pressure
    start = {"angle": initial.angle, "velocity": initial.velocity, **({"pressures": initial.pressures} if held else {})}
    inputs = {"command1": _NUMBER, "command2": _NUMBER, "torque": _NUMBER}
    module = SourceModule(name, numbers)

    def commanded(
        parameters: PyTree, state: PlantState, inputs: PyTree
    ) -> tuple[JointPlant, PlantState, tuple[Array, Array]]:
        """Plant, state under the torque and right after the commands, and these within their limits."""
        plant = eqx.combine(parameters, fixed)
        commands = plant.clip_commands((inputs["command1"], inputs["command2"]))
        state = state._replace(io=IOState(jnp.zeros(()), inputs["torque"], ()))
        return plant, plant.apply_commands(state, commands), commands

    def init(parameters: PyTree, start: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        plant = eqx.combine(parameters, fixed)
        pressures = start["pressures"] if held else plant.clip_commands((inputs["command1"], inputs["command2"]))
        return {"state": plant.complete_state(PlantState(start["angle"], start["velocity"], tuple(pressures)))}

    def advance(parameters: PyTree, state: PlantState, inputs: PyTree, duration: Array) -> dict[str, PyTree]:
        plant, at, commands = commanded(parameters, state, inputs)
        at = at._replace(pressures=state.pressures)
        return {"state": plant.advance(at, commands, duration, substeps)._replace(io=())}

    def results(parameters: PyTree, state: PlantState, inputs: PyTree) -> dict[str, PyTree]:
        plant, state, _ = commanded(parameters, state, inputs)
        forces = plant.joint.forces(state.angle, state.velocity, state.pressures, state.muscles)
        numbers = {"stiffness": plant.joint.stiffness(state.angle, state.pressures)}
        numbers |= {f"tension{number}": tension for number, tension in enumerate(forces.tensions, 1)}
        if not held:
            numbers |= {f"pressure{number}": pressure for number, pressure in enumerate(state.pressures, 1)}
        return {"results": numbers}

    def rates(parameters: PyTree, state: PlantState, inputs: PyTree) -> dict[str, PyTree]:
        plant, state, commands = commanded(parameters, state, inputs)
        motion, valve = plant.rate(state), plant.valve
        pressures, air = (), ()
        if held:
            pressures, air = valve.rates(state.pressures, state.air, commands, lambda: plant.air_volumes(state))
        muscles = tuple(MuscleState((), creep) for creep in motion.creep)
        return {"rates": PlantState(motion.position, motion.velocity, tuple(pressures), muscles, (), air)}  # type: ignore

    def project(parameters: PyTree, state: PlantState, inputs: PyTree) -> dict[str, PyTree]:
        plant, at, _ = commanded(parameters, state, inputs)
        return {"state": plant.project(at)._replace(io=(), pressures=state.pressures)}

    state = jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)), initial)
    both = {"state": state, "inputs": inputs}
    text = "state at an angle, a velocity and pressures, its muscles relaxed"
    module.add("init", text, init, {"start": start, "inputs": inputs})
    module.add("advance", "state after a duration [s]", advance, both | {"duration": _NUMBER})
    module.add("evaluate", "forces and stiffness", results, both)
    if not valve.switches:
        module.add("differentiate", "time derivatives of the state", rates, both)
        if plant.slips:
            module.add("project", "state after a step of an integrator", project, both)
    starts = {"angle": initial.angle, "velocity": initial.velocity, "torque": 0.0}
    for i, pressure in enumerate(initial.pressures):
        starts |= {f"command{i + 1}": 0.0 if valve.direct else pressure}
        starts |= {f"pressures.{i}": pressure} if held else {}
    creep = {
        f"state.muscles.{i}.creep.{k}": unit
        for i, muscle in enumerate(plant.muscles)
        for k, unit in enumerate(muscle.creep.state_units)
    }
    units = units_of(module) | creep
    if valve.direct:
        units |= {"inputs.command1": "", "inputs.command2": ""}
    unit = FunctionalUnit(
        module,
        "Joint of two pneumatic muscles with load and valves",
        period,
        {path: float(value) for path, value in starts.items()},
        units,
        _STATE_NAMES,
        model_exchange=not valve.switches,
    )
    why = [f"model exchange: a {type(valve).__name__} switches at steps of the integration"] if valve.switches else []
    return unit, why


def muscle_fmu(scenario: Scenario, name: str, folder: Path) -> Exported:
    """The force of a muscle over contraction and pressure; two FMUs if the muscles of the joint differ.

    Its state is that of the friction. Creep and viscous friction, which follow the rate of the contraction, are
    omitted.
    """
    joint = numeric(scenario.plant().joint)
    muscles = {name: joint.muscle1}
    if not eqx.tree_equal(joint.muscle1, joint.muscle2):
        muscles = {f"{name}1": joint.muscle1, f"{name}2": joint.muscle2}
    contents, left_out = {}, list[str]()
    for title, muscle in muscles.items():
        unit = _muscle_unit(muscle, title, scenario.control_period)
        contents[f"{title}.fmu"], missing = fmu(unit, scenario.dumps(folder=folder))
        left_out += missing
        if muscle.has_creep or muscle.friction.follows_rate:
            left_out.append(f"{title}: creep and viscous friction, which follow the rate of the contraction")
    return Exported(contents, tuple(dict.fromkeys(left_out)))


def _muscle_unit(muscle: Muscle, name: str, period: float) -> FunctionalUnit:
    """Program of a muscle: its law and the friction of its threads."""
    numbers, fixed = eqx.partition(muscle, eqx.is_inexact_array_like)
    module = SourceModule(name, numbers)
    inputs = {"contraction": _NUMBER, "pressure": _NUMBER}
    state = jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)), muscle.init_state(0.0, 0.0)._replace(creep=()))

    def of(parameters: PyTree) -> Muscle:
        return eqx.combine(parameters, fixed)

    def init(parameters: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": of(parameters).init_state(inputs["contraction"], inputs["pressure"])._replace(creep=())}

    def project(parameters: PyTree, state: MuscleState, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": of(parameters).update_state(state, inputs["contraction"], inputs["pressure"])}

    def results(parameters: PyTree, state: MuscleState, inputs: PyTree) -> dict[str, PyTree]:
        return {"results": {"force": of(parameters).force(inputs["contraction"], inputs["pressure"], state)}}

    both = {"state": state, "inputs": inputs}
    module.add("evaluate", "force", results, both)
    if muscle.has_friction:
        module.add("init", "state without stress of friction", init, {"inputs": inputs})
        module.add("advance", "state after a move", project, both)
        module.add("project", "state after a move", project, both)
    start = {"contraction": 0.0, "pressure": 0.0}
    title = f"Force of the pneumatic muscle {muscle.specimen.name}"
    return FunctionalUnit(module, title, period, start, units_of(module), model_exchange=True)


def controller_fmu(scenario: Scenario, name: str, folder: Path, *, limits: Limits | None = None) -> Exported:
    """The controller for co-simulation with steps of the control period.

    Inputs that are not finite, out of range or frozen leave the state as it is, and end in a vent.
    """
    source = controller_functions(scenario, limits)
    module = SourceModule(name, source.parameters, "controller.")
    inputs = {
        "setpoint": {"angle": _NUMBER, "stiffness": _NUMBER},
        "measurement": {"angle": _NUMBER, "pressure1": _NUMBER, "pressure2": _NUMBER},
    }

    def measured(inputs: PyTree) -> Measurement:
        at = inputs["measurement"]
        return source.measurement._replace(angle=at["angle"], pressures=(at["pressure1"], at["pressure2"]))

    def step(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        setpoint = source.setpoint._replace(**inputs["setpoint"])
        return source.contained(parameters, state, setpoint, measured(inputs))

    def results(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        done = step(parameters, state, inputs)
        commands = {f"command{number}": done["commands"][f"pressure{number}"] for number in (1, 2)}
        return {"results": jax.tree.map(lambda number: number.astype(float), commands | done["telemetry"])}

    def init(parameters: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": source.start(parameters, measured(inputs))}

    def advance(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        return {"state": step(parameters, state, inputs)["state"]}

    both = {"state": source.state, "inputs": inputs}
    module.add("init", "first state, from the first measurement", init, {"inputs": inputs})
    module.add("evaluate", "commands from now on", results, both)
    module.add("advance", "state after a control period", advance, both)
    setpoints = sampled(scenario.reference(), scenario.duration, scenario.control_period)[1]
    pressure1, pressure2 = source.measurement.pressures
    starts = {
        "setpoint.angle": setpoints.angle[0],
        "setpoint.stiffness": setpoints.stiffness[0],
        "measurement.angle": source.measurement.angle,
        "measurement.pressure1": pressure1,
        "measurement.pressure2": pressure2,
    }
    columns = next(f for f in module.functions if f.name == "evaluate").results["results"]
    telemetry = {f"results.{member.path}": attributes(member.path).get("units", "") for member in columns}
    unit = FunctionalUnit(
        module,
        f"Controller of the scenario {scenario.name!r}",
        scenario.control_period,
        {path: float(value) for path, value in starts.items()},
        units_of(module) | telemetry,
        sampled=True,
    )
    content, missing = fmu(unit, scenario.dumps(folder=folder))
    return Exported({f"{name}.fmu": content}, tuple(missing))
