"""Simulation of a plant, a controller and a reference."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array

from mckibben.codegen.engine import check_engine
from mckibben.component.calls import checked_call, user_level
from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import DomainWarning, McKibbenWarning, ReachabilityWarning, SimulationError
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import Domain
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.result import Remark
from mckibben.simulation.accuracy import (
    ACCURACY,
    Positions,
    Refinement,
    Resolution,
    Runs,
    check_accuracy,
    refine,
    resolution_of,
)
from mckibben.simulation.engine import run_alone
from mckibben.simulation.feasibility import Feasibility, feasibility, static_band
from mckibben.simulation.loop import of_any_length
from mckibben.simulation.outcome import SWUNG_OVER_AT
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    sampled,
    sampled_reference,
    sampling_times,
    single_run,
    starts_of,
    without_last_change,
)
from mckibben.simulation.result import BAND, Columns, SimulationResult, compute_trajectory, path_columns
from mckibben.simulation.trajectories import Record, Trajectory
from mckibben.units import deg

_BYTES = 456  # of a control period, as measured with all columns


@checked_call
def simulate(
    plant: JointPlant,
    controller: Controller | None = None,
    reference: Reference | None = None,
    *,
    duration: float = 10.0,
    control_period: float = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    initial: PlantState | AtRest | None = None,
    engine: str = "auto",
    scenario: str = "",
    warn_infeasible: bool = True,
) -> SimulationResult:
    """Run a controller on a plant.

    Commands are constant over each control period, in which the plant is integrated by the two-point Hermite method
    if it is smooth (`JointPlant.with_last_step`), else by the classical one of Runge and Kutta. The run is computed
    with one integration step per period, with two, with four and so on, until the angles of the last two solutions
    agree within the accuracy; the result is the coarser one, with the steps that it needs, and their distance its
    error, within a factor of 2 where motions are smooth. The plant limits commands to the rated pressures of its
    specimens; the result reports for how long a law was outside its domain.

    Parameters
    ----------
    plant, controller, reference
        The joint with its load and valves, its controller, and the desired angle and stiffness.
    duration, control_period
        Time of the run, a multiple of that between two steps of the controller [s].
    accuracy
        Accuracy of the angle [rad].
    substeps
        Integration steps per control period. Default: as many as the accuracy needs; a given number is used as it is,
        and the error is not estimated.
    initial
        The initial state, or `AtRest`. Default: at rest at the first desired angle, at mid co-contraction.
    engine
        "native": emitted as C and compiled by the machine's compiler; "xla"; or "auto", native if possible.
        The result's `engine` names the one used. Their results differ by rounding.
    scenario
        Text to store with the result.
    warn_infeasible
        Whether to warn of a reference that is not feasible; the result has its feasibility.

    Warns
    -----
    ReachabilityWarning
        If the joint cannot statically hold all of the reference, or not with the controller's minimum tension: when,
        and by how much.
    McKibbenWarning
        If the run is not resolved, with the time from which: it is chaotic, or needs more than 64 times the fewest
        steps; or if it takes more than 1 GB of memory.

    Raises
    ------
    SimulationError
        If an argument is of the wrong type, a number is NaN, the times do not fit together, a frequency of the
        reference is at or above half the control rate, the plant needs more substeps than are given, or the accuracy
        cannot be reached.
    UnreachableError, RangeError
        If no pressures hold the joint at the start, or a muscle would leave its domain there.
    """
    if controller is None or reference is None:
        remedy = "write simulate(plant, controller, reference), or scenario.simulate()"
        raise SimulationError("a plant, a controller and a reference are needed", remedy=remedy)
    times = sampling_times(duration, control_period)
    if (size := times.size * _BYTES) > 1e9:
        text = f"the run takes some {size / 1e9:.1f} GB of memory; `simulate_many` with `keep` and `every` takes less"
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())
    check_accuracy(accuracy, substeps)
    check_engine(engine)
    problem = single_run(SimulationProblem.of(plant, controller, reference, initial), control_period, "simulate_many")
    amplitude = problem.controller.stiffness_amplitude
    setpoints = sampled_reference(problem.reference, times)
    start, exists = starts_of(None, problem, setpoints, engine=engine)
    band = static_band(problem.plant, setpoints.angle, amplitude, engine=engine)
    reach = feasibility(plant, times, setpoints, band)
    if not exists:
        _raise_why(plant, initial, float(setpoints.angle[0]))
    if substeps is not None:
        plant.check_substeps(*setpoints, control_period, substeps)
    run = _Run(problem.plant, problem.controller, setpoints, start, control_period, engine)
    record, used, resolution = run.solved(accuracy, substeps)
    notes = functools.partial(_remarks, plant.joint)
    result = _result(run, record, used, resolution, scenario, reach, notes)
    if not resolution.resolved:
        warnings.warn(resolution.describe(), McKibbenWarning, stacklevel=user_level())
    low, high = plant.joint.geometry.angle_range
    if math.isfinite(high - low) and (np.any(result["angle"] < low) or np.any(result["angle"] > high)):
        text = f"the angle leaves the table of the geometry, {low / deg:.4g}..{high / deg:.4g} deg"
        warnings.warn(
            f"{text}, outside of which the moment arm is assumed constant", DomainWarning, stacklevel=user_level()
        )
    tension = controller.minimum_tension
    if not reach.feasible and warn_infeasible:
        warnings.warn(reach.verdict(), ReachabilityWarning, stacklevel=user_level())
    if tension and reach.feasible:
        limited = feasibility(
            plant, times, setpoints, static_band(problem.plant, setpoints.angle, amplitude, tension, engine=engine)
        )
        if not limited.feasible:
            text = f"with the controller's minimum tension of {float(tension):g} N {limited.verdict()}"
            warnings.warn(f"{text}; lower minimum_tension", ReachabilityWarning, stacklevel=user_level())
    return result


def _remarks(joint: AntagonisticJoint) -> list[Remark]:
    """Remarks on a joint, and on an unknown use of air."""
    unknown = unknown_air(joint)
    return joint.remarks + ([Remark.note("joint", unknown)] if unknown else [])


def unknown_air(joint: AntagonisticJoint) -> str:
    """Message that the use of air is unknown, with the remedy; empty if both muscles have a volume."""
    specimens = joint.muscle1.specimen, joint.muscle2.specimen
    names = [*dict.fromkeys(specimen.name for specimen in specimens if not specimen.has_volume)]
    if not names:
        return ""
    return (
        f"air is unknown: {' and '.join(names)} {'have' if len(names) > 1 else 'has'} no volume; give the specimen "
        "initial_diameter and braid_angle, or volume_terms, or identify the muscle with its inner diameter"
    )


def run_episode(
    plant: JointPlant,
    controller: Controller,
    setpoints: Setpoint,
    start: PlantState,
    control_period: float,
    substeps: int | None = None,
    *,
    accuracy: float = ACCURACY,
) -> SimulationResult:
    """The result of an episode from a start that exists, without the attainable stiffness."""
    run = _Run.of(plant, controller, setpoints, start, control_period)
    record, used, resolution = run.solved(accuracy, substeps)
    return _result(run, record, used, resolution)


def needed_substeps(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    initial: PlantState,
    *,
    duration: float,
    control_period: float,
    accuracy: float = ACCURACY,
) -> int:
    """Return the integration steps per control period that a run needs for an accuracy of its angle [rad].

    Raises `SimulationError` if the accuracy cannot be reached. It is 4 or more if the run is chaotic.
    """
    check_accuracy(accuracy)
    _, setpoints = sampled(reference, duration, control_period)
    return episode_substeps(*_Run.of(plant, controller, setpoints, initial, control_period), accuracy=accuracy)


def episode_substeps(*parts: Any, accuracy: float) -> int:
    """`needed_substeps` of an episode of `numeric` plant, controller, setpoints, start and control period [s]."""
    refined = _Run(*parts).refined(accuracy, {})
    return resolution_of(refined, accuracy).batch_substeps(refined.first)


class _Run(NamedTuple):
    """`numeric` parts of a run."""

    plant: JointPlant
    controller: Controller
    setpoints: Setpoint
    start: PlantState
    control_period: float
    engine: str = "auto"

    @classmethod
    def of(cls, plant: Any, controller: Any, setpoints: Setpoint, start: PlantState, period: float) -> _Run:
        """From parts that are neither `numeric` nor completed."""
        plant, controller = plant.with_period(period), controller.with_period(period)
        plant, controller, setpoints, start = numeric((plant, controller, setpoints, plant.complete_state(start)))
        return cls(plant, controller, setpoints, start, period)

    def record(self, substeps: int) -> tuple[Record, str]:
        """The record with a number of integration steps per period, and the engine that computed it."""
        setpoints = of_any_length(self.controller, self.setpoints)
        parts = self.plant, self.controller, setpoints, self.start, np.asarray(self.control_period)
        (_, record), used = run_alone(self.engine, (*parts, np.asarray(substeps)))
        return record, used

    def refined(self, accuracy: float, solutions: dict[int, tuple[Record, str]]) -> Refinement:
        """Step doubling; `solutions` keeps the last three, by their numbers of steps."""
        desired = np.asarray(self.setpoints.angle)[:, None]

        def solve(substeps: int, _: Runs) -> Positions:
            solutions[substeps] = self.record(substeps)
            solutions.pop(substeps // 8, None)
            return np.asarray(solutions[substeps][0].state.angle)[None, :, None]

        return refine(
            solve,
            1,
            accuracy=accuracy,
            spacing=self.control_period,
            first=self.plant.needed_substeps(*self.setpoints, self.control_period),
            meaningful=lambda angles, _: np.abs(angles[0] - desired) <= SWUNG_OVER_AT,
        )

    def solved(self, accuracy: float, substeps: int | None) -> tuple[Record, str, Resolution]:
        """The record, and the engine that computed it, with the given steps or as many as the accuracy needs."""
        if substeps is not None:
            return *self.record(substeps), Resolution(substeps)
        solutions: dict[int, tuple[Record, str]] = {}
        resolution = resolution_of(self.refined(accuracy, solutions), accuracy)
        return *solutions[resolution.substeps], resolution


def _result(
    run: _Run,
    record: Record,
    used: str,
    resolution: Resolution,
    scenario: str = "",
    reach: Feasibility | None = None,
    notes: Callable[[], list[Remark]] = list,
) -> SimulationResult:
    """Result of a run; much is computed when it is first asked for."""
    plant, setpoints, amplitude = run.plant, run.setpoints, run.controller.stiffness_amplitude
    state = record.state

    @functools.cache
    def derived() -> Trajectory:
        return compute_trajectory(plant, setpoints, record, state.angle, amplitude, engine=run.engine)

    def without_step() -> Array:
        constant = without_last_change(setpoints)
        if constant is None:
            return state.angle
        return run._replace(setpoints=constant).record(resolution.substeps)[0].state.angle

    columns = {name: functools.partial(lambda name: getattr(derived(), name), name) for name in Trajectory._fields}
    columns |= dict(zip(BAND, (reach.lowest, reach.highest), strict=True)) if reach else {}
    columns |= {name: value for name, value in record.telemetry.items() if name != "saturated"}
    columns |= path_columns(plant.joint, state, amplitude)
    columns |= {
        "angle": state.angle,
        "velocity": state.velocity,
        "pressure1": state.pressures[0],
        "pressure2": state.pressures[1],
        "desired_angle": setpoints.angle,
        "desired_stiffness": setpoints.stiffness,
        "command1": record.commands[0],
        "command2": record.commands[1],
        "angle_without_step": without_step,
    }
    return SimulationResult(
        Columns(columns),
        run.control_period,
        scenario,
        used,
        resolution,
        angle_resolution=float(plant.sensors.angle_resolution),
        domains=functools.partial(_domains, plant),
        feasibility=reach,
        notes=notes,
    )


def _domains(plant: JointPlant) -> tuple[Domain, ...]:
    """Domains of the muscles, whose computation takes a sixth of a run."""
    return tuple(jax.tree.map(float, muscle.domain) for muscle in plant.muscles)


def _raise_why(plant: JointPlant, initial: PlantState | AtRest | None, first_angle: float) -> None:
    """Raise the error of `JointPlant.equilibrium` for an initial state that does not exist."""
    angle, stiffness = map(np.asarray, initial if isinstance(initial, AtRest) else AtRest(first_angle))
    angle = first_angle if np.isnan(angle) else float(angle)
    plant.equilibrium(angle, stiffness=None if np.isnan(stiffness) else float(stiffness))
    raise SimulationError(f"the joint cannot start at {angle:g} rad", value=angle, unit="rad")
