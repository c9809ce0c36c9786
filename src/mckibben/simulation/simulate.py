"""Simulate: a plant, a controller and a wish to a result."""

from __future__ import annotations

import math
import warnings

import numpy as np

from mckibben.control.base import Controller, Reference
from mckibben.errors import ReachabilityWarning, SimulationError
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import compiled_episode, sampled
from mckibben.simulation.reach import check_reference
from mckibben.simulation.result import Result
from mckibben.simulation.trajectory import compiled_trajectory


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
    plant limits commands to the pressures of its muscles' domains.

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
        The state at the start; at rest at the first desired angle, in the middle of the attainable stiffness, unless
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
    UnreachableError
        If no pressures hold the joint at the start.
    """
    periods = whole_periods(duration, control_period, substeps)
    _, setpoints = sampled(reference, periods, control_period)
    start = plant.at_rest(float(setpoints.angle[0])) if initial is None else initial

    reach = check_reference(plant, reference, duration=duration, control_period=control_period)
    if not reach.reachable:
        warnings.warn(reach.describe(), ReachabilityWarning, stacklevel=2)

    plant, controller, start = numeric((plant, controller, start))
    _, record = compiled_episode(plant, controller, setpoints, start, numeric(control_period), substeps)
    moved = compiled_trajectory(plant, setpoints, record)
    telemetry = {name: np.asarray(value) for name, value in record.telemetry.items()}
    return Result.of(moved, control_period, band=(reach.lowest, reach.highest), telemetry=telemetry, scenario=scenario)


def whole_periods(duration: float, control_period: float, substeps: int) -> int:
    """The number of control periods in a duration.

    Raises
    ------
    SimulationError
        If it is no whole number, or a number is not positive.
    """
    for name, value in (("duration", duration), ("control period", control_period)):
        if not (math.isfinite(value) and value > 0):
            raise SimulationError(f"the {name} is {value:g} s", value=value, unit="s", remedy="give a positive time")
    if substeps < 1:
        raise SimulationError(f"{substeps} integration steps a control period", value=substeps, remedy="give 1 or more")
    periods = round(duration / control_period)
    if periods < 1 or abs(periods * control_period - duration) > 1e-9 * duration:
        raise SimulationError(
            f"a duration of {duration:g} s is no whole number of control periods of {control_period:g} s",
            value=duration,
            unit="s",
            remedy=f"{max(periods, 1) * control_period:g} s would be",
        )
    return periods
