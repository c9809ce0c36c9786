"""Simulate: a plant, a controller and a wish to a result."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import ParameterError, ReachabilityWarning, SimulationError
from mckibben.joint.attainable import solve_static_and_range
from mckibben.numerics.batching import by_name
from mckibben.numerics.compiled import compiled, numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.feasibility import Reach, attainable_band
from mckibben.simulation.loop import (
    AtRest,
    Record,
    Run,
    check_substeps,
    compiled_episode,
    described,
    sampling_times,
    wishes_at,
    without_last_change,
)
from mckibben.simulation.metrics import Trajectory, compiled_trajectory
from mckibben.simulation.result import Result


class CheckedRun(NamedTuple):
    """A result, and what was known before the run of the reach of its reference."""

    result: Result
    reach: Reach


def simulate(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    *,
    duration: float = 10.0,
    control_period: float = 1e-3,
    substeps: int = 4,
    initial: PlantState | AtRest | None = None,
    scenario: str = "",
) -> Result:
    """Run a controller on a plant.

    Commands are held over each control period while the plant is integrated by the classical Runge-Kutta method. The
    plant limits commands to the pressures that its specimens are rated for; where a law holds for less, a result says
    for how long its domain was left.

    Parameters
    ----------
    plant, controller, reference
        What is moved, what moves it, and where to.
    duration
        Of the run [s]; a whole number of control periods.
    control_period
        The time between two steps of the controller [s].
    substeps
        Integration steps a control period.
    initial
        The state at the start, or `AtRest`; at rest at the first desired angle, amid the attainable stiffness, unless
        given.
    scenario
        Text to keep with the result: what made it.

    Warns
    -----
    ReachabilityWarning
        If the joint cannot hold all of the reference: when, and by how much.

    Raises
    ------
    SimulationError
        If the times make no sense together.
    UnreachableError, RangeError
        If no pressures hold the joint at the start, or a muscle would leave its domain there.
    """
    result, reach = checked_run(
        plant,
        controller,
        reference,
        duration=duration,
        control_period=control_period,
        substeps=substeps,
        initial=initial,
        scenario=scenario,
    )
    if not reach.reachable:
        warnings.warn(reach.describe(), ReachabilityWarning, stacklevel=2)
    return result


def checked_run(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    *,
    duration: float,
    control_period: float,
    substeps: int,
    initial: PlantState | AtRest | None,
    scenario: str,
) -> CheckedRun:
    """`simulate`, with the check of the reference as an answer instead of a warning."""
    check_substeps(substeps)
    times = sampling_times(duration, control_period)
    lanes, run, count = described(plant, controller, reference, initial, {})
    if count is not None:
        varying = ", ".join(by_name(lanes._asdict()))
        raise ParameterError(f"{varying}: an array in place of a number", remedy="use `simulate_many` for many runs")
    before = _before(run._replace(controller=None), times)  # whose kind would only compile it anew
    if not before.exists:
        _tell_why(plant, initial, float(before.wishes.angle[0]))
    reach = Reach(times, *(np.asarray(x) for x in (*before.wishes, *before.band)))

    moved, record = run_episode(run.plant, run.controller, before.wishes, before.start, control_period, substeps)
    telemetry = {name: np.asarray(value) for name, value in record.telemetry.items()}
    if plant.joint.has_friction:
        telemetry["friction_torque"] = np.asarray(_friction_torque(run.plant, record.state))
    if plant.joint.has_creep:
        telemetry["creep_torque"] = np.asarray(_creep_torque(run.plant, record.state))
    band = (reach.lowest, reach.highest)
    return CheckedRun(Result.of(moved, control_period, band=band, telemetry=telemetry, scenario=scenario), reach)


class _Before(NamedTuple):
    """What is known before a run: the wishes, the start and whether it exists, and the attainable stiffness."""

    wishes: Setpoint
    start: PlantState
    exists: Array
    band: tuple[Array, Array]


@compiled
def _before(run: Run, times: ArrayLike) -> _Before:
    """Of a run; the controller does not matter."""
    wishes = wishes_at(run.reference, times)
    if isinstance(run.initial, PlantState):
        return _Before(wishes, *run.start(wishes), attainable_band(run.plant, wishes.angle))
    # Start and band from one look at the joint: what they share is worked out once.
    angle, stiffness = run.rest(wishes)
    angles = jnp.concatenate([angle[None], wishes.angle])
    torques = -run.plant.load.gravity_torque(angles)
    found, (lowest, highest) = solve_static_and_range(run.plant.joint, angles, torques, stiffness)
    start = run.plant.init_state(angle, found.pressures)
    return _Before(wishes, start, found.exists, (lowest[1:], highest[1:]))


@compiled
def _friction_torque(plant: JointPlant, state: PlantState) -> Array:
    return plant.joint.friction_torque(state.angle, state.velocity, state.pressures, state.muscles)


@compiled
def _creep_torque(plant: JointPlant, state: PlantState) -> Array:
    return plant.joint.creep_torque(state.angle, state.pressures, state.muscles)


def _tell_why(plant: JointPlant, initial: PlantState | AtRest | None, first_angle: float) -> None:
    """Raise what `JointPlant.equilibrium` has to say of a start that does not exist."""
    angle, stiffness = map(np.asarray, initial if isinstance(initial, AtRest) else AtRest(first_angle))
    angle = first_angle if np.isnan(angle) else float(angle)
    plant.equilibrium(angle, stiffness=None if np.isnan(stiffness) else float(stiffness))
    raise SimulationError(f"the joint cannot start at {angle:g} rad", value=angle, unit="rad")


def run_episode(
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    start: PlantState,
    control_period: float,
    substeps: int,
) -> tuple[Trajectory, Record]:
    """The trajectory and the record of an episode; where the stiffness steps, against one without the step."""
    plant, controller, start, period = numeric((plant, controller, plant.complete_state(start), control_period))
    _, record = compiled_episode(plant, controller, setpoints, start, period, substeps)
    held = without_last_change(setpoints)
    undisturbed = record if held is None else compiled_episode(plant, controller, held, start, period, substeps)[1]
    return compiled_trajectory(plant, setpoints, record, undisturbed.state.angle), record
