"""Program of a plant: its state after a duration, the rate of its state, forces and stiffness."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from mckibben.codegen.source_module import SourceModule
from mckibben.export.controller import units_of
from mckibben.export.functional_unit import FunctionalUnit
from mckibben.muscle import MuscleState
from mckibben.numerics.compiled import numeric
from mckibben.plant import IOState, JointPlant, PlantState

_NUMBER = np.zeros(())
_STATE_NAMES = {
    "pressures.0": "pressure1",
    "pressures.1": "pressure2",
    "air.temperatures.0": "temperature1",
    "air.temperatures.1": "temperature2",
}


def plant_unit(plant: JointPlant, initial: PlantState, name: str, period: float, substeps: int) -> FunctionalUnit:
    """Program of a plant without sensors and disturbances, from an initial state.

    Functions: `init`, the state at an angle, a velocity and pressures; `evaluate`, stiffness and tensions; `advance`,
    the state after a duration; `differentiate`, its rate, unless the valves switch at integration steps; and `project`,
    where friction or creep slip after a step. All real numbers are parameters. Raises `ExportError` for parts that
    cannot be lowered.

    Parameters
    ----------
    initial
        State at the start; its muscles begin relaxed.
    period, substeps
        Longest step [s] of `advance`, by `JointPlant.advance`, and its integration steps.
    """
    plant, initial = numeric((plant.with_ideal_io(), initial))
    valve = plant.valve
    numbers, fixed = eqx.partition(plant, eqx.is_inexact_array_like)
    relaxed = {"muscles": (MuscleState((), ()),) * 2, "io": (), "air": (), "friction": (), "sent": ()}
    initial = plant.complete_state(initial._replace(**relaxed))
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
    return FunctionalUnit(
        module,
        "Joint of two pneumatic muscles with load and valves",
        period,
        {path: float(value) for path, value in starts.items()},
        units,
        _STATE_NAMES,
        model_exchange=not valve.switches,
    )
