"""Simulate: a plant, a controller and a wish to a result."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import ReachabilityWarning, SimulationError
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import Record, compiled_episode, sampled, without_last_change
from mckibben.simulation.reach import Reach, check_reference
from mckibben.simulation.result import Result
from mckibben.simulation.trajectory import Trajectory, compiled_trajectory


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
    initial: PlantState | None = None,
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
        The state at the start; at rest at the first desired angle, amid the attainable stiffness, unless given.
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
    initial: PlantState | None,
    scenario: str,
) -> CheckedRun:
    """`simulate`, with the check of the reference as an answer instead of a warning."""
    if isinstance(substeps, bool) or not isinstance(substeps, int) or substeps < 1:
        raise SimulationError(
            f"{substeps} integration steps a control period", value=substeps, remedy="give a whole number from 1 up"
        )
    _, setpoints = sampled(reference, duration, control_period)
    start = plant.at_rest(float(setpoints.angle[0])) if initial is None else initial
    reach = check_reference(plant, reference, duration=duration, control_period=control_period)

    moved, record = run_episode(plant, controller, setpoints, start, control_period, substeps)
    telemetry = {name: np.asarray(value) for name, value in record.telemetry.items()}
    band = (reach.lowest, reach.highest)
    return CheckedRun(Result.of(moved, control_period, band=band, telemetry=telemetry, scenario=scenario), reach)


def run_episode(
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    start: PlantState,
    control_period: float,
    substeps: int,
) -> tuple[Trajectory, Record]:
    """The trajectory and the record of an episode; where the stiffness steps, against one without the step."""
    plant, controller, start, period = numeric((plant, controller, start, control_period))
    _, record = compiled_episode(plant, controller, setpoints, start, period, substeps)
    held = without_last_change(setpoints)
    undisturbed = record if held is None else compiled_episode(plant, controller, held, start, period, substeps)[1]
    return compiled_trajectory(plant, setpoints, record, undisturbed), record
