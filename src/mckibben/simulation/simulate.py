"""Simulation of a plant, a controller and a reference."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import check_engine
from mckibben.component.calls import checked_call, user_level
from mckibben.component.checks import check_positive
from mckibben.config.model import DocumentModel
from mckibben.control.base import DiscreteTimeSystem, Reference, Setpoint
from mckibben.errors import DomainWarning, McKibbenWarning, ReachabilityWarning, SimulationError
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import Domain
from mckibben.numerics.compiled import numeric
from mckibben.plant import Plant, PlantState
from mckibben.plant.robot_plant import RobotStart
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
from mckibben.simulation.feasibility import Feasibility, feasibility, static_band, unattainable
from mckibben.simulation.loop import of_any_length
from mckibben.simulation.outcome import near_reference
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    in_order,
    resolved_at,
    sampled_reference,
    sampling_times,
    single_run,
    starts_of,
    without_last_change,
)
from mckibben.simulation.result import SimulationResult, columns_of_run
from mckibben.simulation.robot_metrics import measure_landing
from mckibben.simulation.trajectories import Record
from mckibben.units import Duration, ShortTime, deg

_BYTES = 456  # of a control period, as measured with all columns


@checked_call
def simulate(
    plant: Plant,
    controller: DiscreteTimeSystem | None = None,
    reference: Reference | Mapping[str, Reference] | None = None,
    *,
    duration: Duration = 10.0,
    control_period: ShortTime = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    initial: PlantState | AtRest | RobotStart | None = None,
    engine: str = "auto",
    scenario: str | DocumentModel = "",
    warn_infeasible: bool = True,
) -> SimulationResult:
    """Run a controller on a plant.

    Commands are constant over each control period, in which the plant is integrated by the two-point Hermite method
    if it is smooth (`Plant.with_last_step`), else by the classical one of Runge and Kutta. The run is computed
    with one integration step per period, with two, with four and so on, until the angles of the last two solutions
    agree within the accuracy; the result is the coarser one, with the steps that it needs, and their distance its
    error, within a factor of 2 where motions are smooth. The plant limits commands to the rated pressures of its
    specimens; the result reports for how long a law was outside its domain.

    Parameters
    ----------
    plant, controller, reference
        The joint with its load and valves, its controller, and the desired angle and stiffness; or a robot, with a
        reference of each joint by its name, or none for a controller that follows none.
    duration, control_period
        Time of the run, a multiple of that between two steps of the controller [s].
    accuracy
        Accuracy of the angle [rad].
    substeps
        Integration steps per control period. Default: as many as the accuracy needs; a given number is used as it is,
        and the error is not estimated.
    initial
        The initial state, `AtRest`, or the `RobotStart` of a robot. Default, of a joint: at rest at the first desired
        angle, at mid co-contraction.
    engine
        "native": emitted as C and compiled by the machine's compiler; "xla"; or "auto", native if possible.
        The result's `engine` names the one used. Their results differ by rounding.
    scenario
        Scenario to store with the result, or its text.
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
    times = sampling_times(duration, control_period)
    if (size := times.size * _BYTES) > 1e9:
        text = f"the run takes some {size / 1e9:.1f} GB of memory; `simulate_many` with `keep` and `every` takes less"
        warnings.warn(text, McKibbenWarning, stacklevel=user_level())
    check_accuracy(accuracy, substeps)
    check_engine(engine)
    problem = single_run(SimulationProblem.of(plant, controller, reference, initial), control_period, "simulate_many")
    setpoints = in_order(plant, sampled_reference(problem.reference, times))
    type(plant).check_start(plant, initial)  # unbound, as by `split_problem`
    for own in setpoints if isinstance(setpoints, tuple) and plant.mechanism.joint_names else ():
        check_positive("reference", "N*m/rad", stiffness=own.stiffness)
    start, exists = starts_of(None, problem, setpoints, engine=engine)
    reached = Reached(plant, problem.plant, times, setpoints, engine)
    reach = reached.by(problem.controller)
    if not exists:
        _raise_why(plant, initial, float(setpoints.angle[0]))
    if substeps is not None:
        plant.check_substeps(*resolved_at(plant, setpoints, start), control_period, substeps)
    run = _Run(problem.plant, problem.controller, setpoints, start, control_period, engine)
    record, final, used, resolution = run.solved(accuracy, substeps)
    result = _result(run, record, final, used, resolution, scenario, reach, reached.notes)
    if not resolution.resolved:
        warnings.warn(resolution.describe(result.joint_type), McKibbenWarning, stacklevel=user_level())
    if reach is not None:
        _warn_of(plant, result, user_level())
        if not reach.feasible and warn_infeasible:
            warnings.warn(reach.verdict(), ReachabilityWarning, stacklevel=user_level())
        tension = getattr(controller, "minimum_tension", None)
        limited = reached.by(problem.controller, tension) if tension and reach.feasible else None
        if tension and limited and not limited.feasible:
            text = f"with the controller's minimum tension of {float(tension):g} N {limited.verdict()}"
            warnings.warn(f"{text}; lower minimum_tension", ReachabilityWarning, stacklevel=user_level())
    return result


class Reached(NamedTuple):
    """Static feasibility of setpoints for a plant."""

    plant: Plant
    numbers: PyTree  # plant, `numeric`
    times: NDArray[np.float64]
    setpoints: PyTree
    engine: str = "auto"

    def by(self, controller: PyTree, tension: float = 0.0) -> Feasibility | None:
        """Return the feasibility of the reference of an unnamed joint under a controller with a least tension [N]."""
        if not isinstance(self.setpoints, Setpoint):
            return None
        amplitude = controller.stiffness_amplitude
        band = static_band(self.numbers, self.setpoints.angle, amplitude, tension, engine=self.engine)
        return feasibility(self.plant, self.times, self.setpoints, band)

    def notes(self) -> list[Remark]:
        """Return remarks on the plant; of a robot, those on what it does not attain of its references."""
        if isinstance(self.setpoints, Setpoint):
            return _remarks(self.plant.mechanism.joint)  # type: ignore[attr-defined]
        return unattainable(self.plant, self.times, self.setpoints) if isinstance(self.setpoints, tuple) else []


def _warn_of(plant: PyTree, result: SimulationResult, level: int) -> None:
    """Warn of an angle outside the table of the geometry of a joint."""
    low, high = plant.joint.geometry.angle_range
    if math.isfinite(high - low) and (np.any(result["angle"] < low) or np.any(result["angle"] > high)):
        text = f"the angle leaves the table of the geometry, {low / deg:.4g}..{high / deg:.4g} deg"
        warnings.warn(f"{text}, outside of which the moment arm is assumed constant", DomainWarning, stacklevel=level)


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
    plant: Plant,
    controller: DiscreteTimeSystem,
    setpoints: PyTree,
    start: PlantState,
    control_period: float,
    substeps: int | None = None,
    *,
    accuracy: float = ACCURACY,
) -> SimulationResult:
    """The result of an episode from a start that exists, without the attainable stiffness."""
    run = _Run.of(plant, controller, setpoints, start, control_period)
    return _result(run, *run.solved(accuracy, substeps))


def needed_substeps(
    plant: Plant,
    controller: DiscreteTimeSystem,
    reference: PyTree,
    initial: PlantState | AtRest | RobotStart,
    *,
    duration: float,
    control_period: float,
    accuracy: float = ACCURACY,
) -> int:
    """Return the integration steps per control period that a run needs for an accuracy of its angle [rad].

    Raises `SimulationError` if the accuracy cannot be reached. It is 4 or more if the run is chaotic.
    """
    check_accuracy(accuracy)
    times = sampling_times(duration, control_period)
    problem = single_run(SimulationProblem.of(plant, controller, reference, initial), control_period, "simulate_many")
    setpoints = in_order(plant, sampled_reference(problem.reference, times))
    start = existing_start(plant, problem, setpoints, initial)
    return episode_substeps(problem.plant, problem.controller, setpoints, start, control_period, accuracy=accuracy)


def existing_start(plant: Plant, problem: SimulationProblem, setpoints: PyTree, initial: PyTree) -> PlantState:
    """Return the state at the start of a run; raises as `simulate` if it does not exist."""
    start, exists = starts_of(None, problem, setpoints)
    if not exists:
        _raise_why(plant, initial, float(setpoints.angle[0]))
    return start


def episode_substeps(*parts: Any, accuracy: float) -> int:
    """`needed_substeps` of an episode of `numeric` plant, controller, setpoints, start and control period [s]."""
    refined = _Run(*parts).refined(accuracy, {})
    return resolution_of(refined, accuracy).batch_substeps(refined.first)


class _Run(NamedTuple):
    """`numeric` parts of a run."""

    plant: Plant
    controller: DiscreteTimeSystem
    setpoints: PyTree
    start: PlantState
    control_period: float
    engine: str = "auto"

    @classmethod
    def of(cls, plant: Any, controller: Any, setpoints: PyTree, start: PlantState, period: float) -> _Run:
        """From parts that are neither `numeric` nor completed."""
        plant, controller = plant.with_period(period), controller.with_period(period)
        plant, controller, setpoints, start = numeric((plant, controller, setpoints, plant.complete_state(start)))
        return cls(plant, controller, setpoints, start, period)

    def record(self, substeps: int) -> tuple[Record, PlantState, str]:
        """The record with a number of integration steps per period, the state after it, and the engine."""
        setpoints = of_any_length(self.controller, self.setpoints)
        parts = self.plant, self.controller, setpoints, self.start, np.asarray(self.control_period)
        (final, record), used = run_alone(self.engine, (*parts, np.asarray(substeps)))
        return record, final, used

    def refined(self, accuracy: float, solutions: dict[int, tuple[Record, PlantState, str]]) -> Refinement:
        """Step doubling; `solutions` keeps the last three, by their numbers of steps."""

        def solve(substeps: int, _: Runs) -> Positions:
            solutions[substeps] = self.record(substeps)
            solutions.pop(substeps // 8, None)
            return np.stack(self.plant.mechanism.coordinates_of(solutions[substeps][0].state.position))[..., None]

        return refine(
            solve,
            1,
            accuracy=accuracy,
            spacing=self.control_period,
            first=self.plant.needed_substeps(*resolved_at(self.plant, self.setpoints, self.start), self.control_period),
            meaningful=near_reference(
                self.setpoints, lambda values, _: np.asarray(values)[:, None], self.plant.mechanism.joint_type.scale
            ),
        )

    def solved(self, accuracy: float, substeps: int | None) -> tuple[Record, PlantState, str, Resolution]:
        """As `record`, with the given steps or as many as the accuracy needs."""
        if substeps is not None:
            return *self.record(substeps), Resolution(substeps)
        solutions: dict[int, tuple[Record, PlantState, str]] = {}
        resolution = resolution_of(self.refined(accuracy, solutions), accuracy)
        return *solutions[resolution.substeps], resolution


def _result(
    run: _Run,
    record: Record,
    final: PlantState,
    used: str,
    resolution: Resolution,
    scenario: str | DocumentModel = "",
    reach: Feasibility | None = None,
    notes: Callable[[], list[Remark]] = list,
) -> SimulationResult:
    """Result of a run; much is computed when it is first asked for."""
    plant, setpoints = run.plant, run.setpoints

    def without_step() -> PyTree:
        constant = without_last_change(setpoints)
        if constant is None:
            return record.state.angle
        return run._replace(setpoints=constant).record(resolution.substeps)[0].state.angle

    free = not run.controller.follows_reference
    amplitude = getattr(run.controller, "stiffness_amplitude", None)
    return SimulationResult(
        columns_of_run(plant, setpoints, record, without_step, amplitude, reach, run.engine),
        run.control_period,
        scenario,
        used,
        resolution,
        angle_resolution=float(plant.sensors.angle_resolution),
        domains=functools.partial(_domains, plant),
        feasibility=reach,
        notes=notes,
        joints=plant.mechanism.joint_names,
        muscles=plant.mechanism.muscle_names,
        joint_type=plant.mechanism.joint_type,
        landing=functools.partial(measure_landing, plant, record.state, final, run.control_period) if free else None,
    )


def _domains(plant: Plant) -> tuple[Domain, ...]:
    """Domains of the muscles, whose computation takes a sixth of a run."""
    return tuple(jax.tree.map(float, muscle.domain) for muscle in plant.muscles)


def _raise_why(plant: PyTree, initial: PyTree, first_angle: float) -> None:
    """Raise the error of `JointPlant.equilibrium` for an initial state that does not exist."""
    angle, stiffness = map(np.asarray, initial if isinstance(initial, AtRest) else AtRest(first_angle))
    angle = first_angle if np.isnan(angle) else float(angle)
    plant.equilibrium(angle, stiffness=None if np.isnan(stiffness) else float(stiffness))
    unit = plant.mechanism.joint_type.unit("rad")
    raise SimulationError(f"the joint cannot start at {angle:g} {unit}", value=angle, unit=unit)
