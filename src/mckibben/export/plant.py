"""Program of a plant: its state after a duration, the rate of its state, forces and stiffness."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, PyTree

from mckibben.codegen.source_module import SourceModule
from mckibben.component.columns import attributes
from mckibben.export.controller import units_of
from mckibben.export.functional_unit import FunctionalUnit, per_second
from mckibben.muscle import MuscleState
from mckibben.numerics.compiled import numeric
from mckibben.plant import IOState, Plant


def plant_unit(plant: Plant, initial: PyTree, name: str, period: float, substeps: int) -> FunctionalUnit:
    """Program of a plant without sensors and disturbances, from an initial state.

    Functions: `init`, the state at positions, velocities and pressures; `evaluate`, stiffness and tensions; `advance`,
    the state after a duration; `differentiate`, its rate, unless the valves switch at integration steps; and `project`,
    where friction or creep slip after a step. All real numbers are parameters. Raises `ExportError` for parts that
    cannot be lowered.

    Parameters
    ----------
    initial
        State at the start; its muscles begin relaxed. Coordinates of the base that are held stay as they are there.
    period, substeps
        Longest step [s] of `advance`, by `Plant.advance`, and its integration steps.
    """
    plant, initial = numeric((plant.with_ideal_io(), initial))
    valve, position, velocity = plant.valve, *initial._fields[:2]
    numbers, fixed = eqx.partition(plant, eqx.is_inexact_array_like)
    relaxed = {"muscles": (MuscleState((), ()),) * len(plant.muscles), "air": (), "friction": (), "sent": ()}
    bare = initial._replace(**relaxed, io=(), last=())
    held = valve.holds_pressure

    def moving(state: PyTree) -> PyTree:
        coordinates = {field: plant.mechanism.moving(getattr(state, field)) for field in (position, velocity)}
        return state._replace(**coordinates)

    whole = plant.complete_state(bare)
    state = moving(whole)
    start = {field: getattr(state, field) for field in (position, velocity, *(["pressures"] if held else []))}
    opened = [jnp.zeros(())] * len(plant.muscles) if valve.direct else initial.pressures
    inputs = {f"command{number}": command for number, command in enumerate(opened, 1)}
    inputs["torque"] = plant.mechanism.like_joints([jnp.zeros(())] * len(plant.disturbances))
    module = SourceModule(name, numbers)

    def commanded(parameters: PyTree, state: PyTree, inputs: PyTree) -> tuple[Plant, PyTree, tuple[Array, ...]]:
        """Plant, state under the torque and right after the commands, and these within their limits."""
        plant = eqx.combine(parameters, fixed)
        commands = clipped(plant, inputs)
        state = eqx.combine(state, whole)._replace(io=IOState(jnp.zeros(()), inputs["torque"], ()))
        return plant, plant.apply_commands(state, commands), commands

    def clipped(plant: Plant, inputs: PyTree) -> tuple[Array, ...]:
        return plant.clip_commands([inputs[f"command{number}"] for number, _ in enumerate(plant.muscles, 1)])

    def init(parameters: PyTree, start: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        plant = eqx.combine(parameters, fixed)
        begun = bare._replace(**{"pressures": clipped(plant, inputs)} | start)
        return {"state": moving(plant.complete_state(eqx.combine(begun, bare)))}

    def advance(parameters: PyTree, state: PyTree, inputs: PyTree, duration: Array) -> dict[str, PyTree]:
        plant, at, commands = commanded(parameters, state, inputs)
        at = at._replace(pressures=state.pressures)
        return {"state": moving(plant.advance(at, commands, duration, substeps)._replace(io=()))}

    def results(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        plant, state, _ = commanded(parameters, state, inputs)
        mechanism, tensions = plant.mechanism, plant.forces(state).tensions
        numbers = {"stiffness": mechanism.like_joints(mechanism.stiffness(state[0], state.pressures))}
        numbers |= {f"tension{number}": tension for number, tension in enumerate(tensions, 1)}
        numbers |= plant.outputs(state)
        if not held:
            numbers |= {f"pressure{number}": pressure for number, pressure in enumerate(state.pressures, 1)}
        return {"results": numbers}

    def rates(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        plant, state, commands = commanded(parameters, state, inputs)
        motion, valve = plant.rate(state), plant.valve  # type: ignore[attr-defined]  # of each plant
        pressures, air = (), ()
        if held:
            pressures, air = valve.rates(state.pressures, state.air, commands, lambda: plant.air_volumes(state))
        muscles = tuple(MuscleState((), creep) for creep in motion.creep)
        changes = {position: motion.position, velocity: motion.velocity, "muscles": muscles}
        return {"rates": moving(bare._replace(**changes, pressures=tuple(pressures), air=air))}

    def project(parameters: PyTree, state: PyTree, inputs: PyTree) -> dict[str, PyTree]:
        plant, at, _ = commanded(parameters, state, inputs)
        return {"state": moving(plant.project(at)._replace(io=(), pressures=state.pressures))}

    both = {"state": jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)), state), "inputs": inputs}
    text = "state at positions, velocities and pressures, its muscles relaxed"
    module.add("init", text, init, {"start": start, "inputs": inputs})
    module.add("advance", "state after a duration [s]", advance, both | {"duration": np.zeros(())})
    module.add("evaluate", "forces and stiffness", results, both)
    if not valve.switches:
        module.add("differentiate", "time derivatives of the state", rates, both)
        if plant.slips:
            module.add("project", "state after a step of an integrator", project, both)
    kind = plant.mechanism.joint_type
    units = units_of(module, joint_type=kind)
    units |= {
        f"state.muscles.{i}.creep.{k}": unit
        for i, muscle in enumerate(plant.muscles)
        for k, unit in enumerate(muscle.creep.state_units)
    }
    coordinates = (member.path for member in module.state if member.path.startswith(f"{position}."))
    for at, name in ((path.removeprefix(position), path.rpartition(".")[2]) for path in coordinates):
        unit = units.setdefault(f"state.{position}{at}", attributes(name, kind).get("units", ""))
        units[f"state.{velocity}{at}"] = per_second(unit)
    if valve.direct:
        units |= {f"inputs.command{number}": "" for number, _ in enumerate(plant.muscles, 1)}
    title = "Joints with pneumatic muscles, loads and valves"
    return FunctionalUnit(module, title, period, units, model_exchange=not valve.switches)
