"""Program of a plant: torque, stiffness and tensions of its joint, the rate of its state, and a control period."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, PyTree

from mckibben.codegen.source_module import SourceModule
from mckibben.joint.antagonistic import NO_STATES
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.plant.joint_plant import Motion

Commands = tuple[Array, Array]


class PlantModule(NamedTuple):
    """Source of a plant, its state at rest at 0 rad without pressure, and the parts omitted from the source."""

    module: SourceModule
    state: PlantState
    left_out: tuple[str, ...]


def plant_module(
    plant: JointPlant, control_period: float | None = None, substeps: int = 4, name: str = "plant"
) -> PlantModule:
    """Source module of a plant without sensors and disturbances.

    Functions: `torque`, `stiffness`, `tensions` of the muscles' laws at an angle and pressures; `rate` of the state;
    with a control period, `step`, the state after one period. All real numbers are parameters. Raises `ExportError` for
    parts that cannot be lowered.

    Parameters
    ----------
    control_period, substeps
        Period [s] of `step`, and its integration steps.
    name
        Name of the module, an identifier.

    Examples
    --------
    >>> import mckibben as mk
    >>> plant = mk.JointPlant(mk.catalog.joint("knee-table-2"), mk.catalog.load("knee-table-2"), mk.IdealValve())
    >>> [function.name for function in plant_module(plant, 1e-3).module.functions]
    ['torque', 'stiffness', 'tensions', 'rate', 'step']
    """
    left_out = [] if plant.has_ideal_io else ["sensors and disturbance of the plant"]
    left_out += [] if plant.command_delay is None else ["delay of the commands"]
    plant = numeric(plant.with_ideal_io())
    numbers, fixed = eqx.partition(plant, eqx.is_inexact_array_like)
    module = SourceModule(name, {"plant": numbers, "control_period": np.asarray(control_period or 0.0)}, "plant.")
    state = jax.tree.map(np.asarray, plant.init_state(0.0, (0.0, 0.0)))

    def of(parameters: PyTree) -> JointPlant:
        return eqx.combine(parameters["plant"], fixed)

    def torque(parameters: PyTree, angle: Array, pressures: tuple[Array, Array]) -> dict[str, PyTree]:
        return {"torque": of(parameters).joint.torque(angle, pressures)}

    def stiffness(parameters: PyTree, angle: Array, pressures: tuple[Array, Array]) -> dict[str, PyTree]:
        return {"stiffness": of(parameters).joint.stiffness(angle, pressures)}

    def tensions(parameters: PyTree, angle: Array, pressures: tuple[Array, Array]) -> dict[str, PyTree]:
        return {"tensions": of(parameters).joint.tensions(angle, pressures)}

    def rate(parameters: PyTree, state: PlantState, commands: Commands) -> dict[str, PyTree]:
        return {"rate": state_rate(of(parameters), state, commands)}

    def step(parameters: PyTree, state: PlantState, commands: Commands) -> dict[str, PyTree]:
        plant = of(parameters)
        following = plant.advance(state, plant.clip_commands(commands), parameters["control_period"], substeps)
        return {"following": following}

    number, pair = np.zeros(()), (np.zeros(()), np.zeros(()))
    static = {"angle": number, "pressures": pair}
    module.add("torque", "torque [N*m] of the muscles", torque, static)
    module.add("stiffness", "isobaric stiffness [N*m/rad] of the muscles", stiffness, static)
    module.add("tensions", "tension [N] of each muscle", tensions, static)
    moving = {"state": state, "commands": pair}
    if plant.slips:
        left_out.append("rate: friction and creep slip after each integration step; step includes them")
    elif plant.valve.switches:
        left_out.append("rate: the valves switch at integration steps; step includes them")
    else:
        module.add("rate", "time derivative of the state under commands", rate, moving)
    if control_period is not None:
        module.add("step", f"state after a control period, {substeps} Runge-Kutta steps", step, moving)
    return PlantModule(module, state, tuple(left_out))


def state_rate(plant: JointPlant, state: PlantState, commands: Commands) -> PlantState:
    """Time derivative of a state without friction and creep under commands within the limits of the valves."""
    limited = plant.clip_commands(commands)
    state = plant.apply_commands(state, limited)
    motion = plant.rate(state)
    (first, second), air = plant.valve.rates(state.pressures, state.air, limited, lambda: plant.air_volumes(state))
    pressures = first, second
    return Motion(motion.position, motion.velocity, ((), ()), pressures, air).applied_to(
        PlantState(state.angle, state.velocity, state.pressures, NO_STATES), pressures
    )
