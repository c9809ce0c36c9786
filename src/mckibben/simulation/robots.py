"""Runs of a robot: one with its time traces, or many at once with metrics."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction
from mckibben.component.calls import checked_call
from mckibben.component.columns import Label, attributes, declare, labels_of
from mckibben.control.robot_control import RobotController, TimedReference, TrackingControl, check_pairs
from mckibben.errors import McKibbenWarning, SimulationError
from mckibben.notebook import Progress
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import jit
from mckibben.plant.robot_plant import RobotPlant, RobotSample, RobotStart
from mckibben.simulation.accuracy import (
    ACCURACY,
    Positions,
    Refinement,
    Resolution,
    Runs,
    StepCounts,
    check_accuracy,
    full_vectors,
    refine,
    refine_blocks,
    resolution_of,
    spacing,
)
from mckibben.simulation.batch import Batch, batch_table
from mckibben.simulation.engine import compute_groups, dynamic_steps, run_alone
from mckibben.simulation.loop import (
    LoopState,
    begun,
    control_period,
    initial_loop,
    of_any_length,
    positions_over_time,
)
from mckibben.simulation.metrics import Run, Totals, values_of
from mckibben.simulation.outcome import outcomes
from mckibben.simulation.problem import float_type, sampled_reference, sampling_times, single_run, split_runs
from mckibben.simulation.result import RunResult
from mckibben.simulation.robot_metrics import MetricSums, RobotMetrics, TrackingMetrics, TrackingSample, inflow, measure
from mckibben.simulation.trajectories import Record


class RobotProblem(NamedTuple):
    """All parts of a run of a robot; leaves are numbers, or arrays over runs."""

    plant: RobotPlant
    controller: RobotController
    start: RobotStart


_COMMAND = {"command": Label("Pa", "commanded pressure", along="muscle")}
declare(__name__, _COMMAND)


class RobotResult(RunResult):
    """A simulated run of a robot; ``result["z"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), those of joints (joints, periods) and of muscles (muscles, periods), in SI: the
    fields of `RobotSample`, ``command``, ``saturated``, and the telemetry of the controller. `joints` and `muscles` are
    their names, `control_period` is the time between two values [s], `engine` the one that computed it, "native" or
    "xla", and `resolution` the integration steps with the estimated error of the positions.
    """

    kind = RobotMetrics

    joints: tuple[str, ...] = ()
    muscles: tuple[str, ...] = ()
    _run: Any = None

    @classmethod
    def of(
        cls,
        plant: RobotPlant,
        record: Record,
        final: Any,
        control_period: float,
        engine: str,
        resolution: Resolution | None = None,
    ) -> RobotResult:
        """From the record of a run, and the state after it."""
        columns = record.state._asdict() | {"command": record.commands, "saturated": record.limited} | record.telemetry
        stacked = {name: np.stack(one) if isinstance(one, tuple) else one for name, one in columns.items()}
        joints, muscles = tuple(joint.name for joint in plant.robot.joints), plant.robot.muscle_names
        states = record.state, final, plant
        return cls(stacked, control_period, "", engine, resolution, joints=joints, muscles=muscles, _run=states)

    def _measure(self) -> Any:
        samples, final, plant = self._run
        return _measured(samples, final, np.asarray(self.control_period), plant)

    def verdict(self) -> str:
        """Return duration, size of the robot, and largest force of the ground."""
        return f"{self.size}, ground force up to {self['ground_up'].max():.4g} N"

    @property
    def size(self) -> str:
        """Duration, and numbers of joints and muscles, in words."""
        counts = ((len(self.joints), "joint"), (len(self.muscles), "muscle"))
        return ", ".join([f"{self.duration:g} s", *(f"{count} {noun}{'s' * (count != 1)}" for count, noun in counts)])

    def _rows_of(self, name: str) -> tuple[str, ...]:
        label = _LABELS.get(name)
        return (label.along if label else "joint",) if np.ndim(self.columns[name]) > 1 else ()

    def _coordinates(self) -> dict[str, list[str]]:
        return {"joint": list(self.joints), "muscle": list(self.muscles)}


_LABELS = labels_of(RobotSample) | _COMMAND


def robot_metrics(
    plant: RobotPlant, controller: RobotController, start: RobotStart, times: PyTree, period: ArrayLike, substeps: int
) -> RobotMetrics:
    """Run a robot and return its metrics alone; a pure function, whose memory does not grow with the duration."""

    def advance(carry: tuple[Any, MetricSums], time: Array) -> tuple[Any, None]:
        state, sums = carry
        state, _ = control_period(plant, controller, state, time, period, substeps)
        return (state, sums.after(plant.observe(state[0]), period, plant)), None

    loop = initial_loop(plant, controller, start)
    sums = MetricSums.of(plant.observe(loop[0]))
    count = jax.tree.leaves(times)[0].shape[0]
    return lax.scan(advance, (loop, sums), times)[0][1].finished(jnp.asarray(count), period)


def tracking_metrics(
    plant: RobotPlant, controller: TrackingControl, start: RobotStart, times: PyTree, period: ArrayLike, substeps: int
) -> TrackingMetrics:
    """Run a robot that follows references over time, and return its metrics alone, as `robot_metrics`."""

    def advance(carry: tuple[LoopState, PyTree, Totals], row: PyTree) -> tuple[tuple[LoopState, PyTree, Totals], None]:
        (loop, before, totals), (time, early) = carry, row
        following, record = control_period(plant, controller, loop, early, period, substeps)
        sample, setpoints = record.state, controller.setpoints_at(time)
        stiffness = plant.robot.stiffness(sample.angle, sample.pressure)
        kind = sample.z.dtype
        terms = TrackingSample(
            tuple(angle - to.angle for angle, to in zip(sample.angle, setpoints, strict=True)),
            tuple(own - to.stiffness for own, to in zip(stiffness, setpoints, strict=True)),
            record.telemetry.get("saturated", record.limited).astype(kind),
            sample.outside.astype(kind),
            inflow(sample.air_mass, before),
        ).totals
        return (following, sample.air_mass, totals.merge(terms)), None

    loop, early = begun(plant, controller, times, start, period)
    first = plant.observe(loop[0])
    zeros, zero = tuple(jnp.zeros_like(angle) for angle in first.angle), jnp.zeros_like(first.z)
    empty = TrackingSample(zeros, zeros, zero, zero, zero).totals.empty()
    (_, _, totals), _ = lax.scan(advance, (loop, first.air_mass, empty), (times, early))
    count = jax.tree.leaves(times)[0].shape[0]
    return values_of(TrackingMetrics, totals, Run(jnp.asarray(count), period))


def setpoints_over(controller: PyTree, times: NDArray[np.float64], varying: PyTree = None) -> PyTree:
    """Return the setpoints at times [s] of a controller whose reference is over time, which is computed before the run.

    The times themselves for other references, and for those that vary over runs: parts of the controller that do.
    """
    reference = getattr(controller, "reference", None)
    if not isinstance(reference, TimedReference) or jax.tree.leaves(getattr(varying, "reference", None)):
        return times
    return tuple(sampled_reference(own, times) for own in reference.references)


@checked_call
def simulate_robot(
    plant: RobotPlant,
    controller: RobotController,
    start: RobotStart,
    *,
    duration: float,
    control_period: float = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    engine: str = "auto",
) -> RobotResult:
    """Simulate a robot; the result has all states, forces and commands over ``time``, and the metrics of the run.


    Parameters
    ----------
    plant, controller, start
        Robot, controller, and start of the run.
    duration, control_period
        [s]; the first is a multiple of the second.
    accuracy
        Accuracy of the angles [rad], and of the position of the base [m].
    substeps
        Integration steps per control period. Default: as many as the accuracy needs.
    engine
        "native", "xla" or "auto", as for `mckibben.simulate`.

    Raises
    ------
    SimulationError
        If the times do not fit together, the step is too long for ground, stops, friction or air, the accuracy cannot
        be reached, or the run diverges.
    RangeError
        If the start is not possible; see `RobotPlant.init_state`.

    Warns
    -----
    McKibbenWarning
        If the run is not resolved, with the time from which.
    """
    check_accuracy(accuracy, substeps)
    times = sampling_times(duration, control_period)
    check_pairs(plant.robot, controller)
    run = single_run(RobotProblem(plant, controller, start), control_period, "simulate_robots")
    plant.check_start(start)
    rows = of_any_length(run.controller, setpoints_over(run.controller, times))
    solutions: dict[int, tuple[tuple[Any, Record], str]] = {}

    def solve(number: int, _: Any = None) -> Positions:
        parts = run.plant, run.controller, rows, run.start, np.asarray(control_period), np.asarray(number)
        solutions[number] = run_alone(engine, parts)
        at = solutions[number][0][1].state
        return np.stack([at.x, at.z, at.pitch, *at.angle])[..., None]

    if substeps is None:
        first = plant.needed_substeps(start.angles, None, control_period)
        resolution = resolution_of(refine(solve, 1, accuracy=accuracy, spacing=control_period, first=first), accuracy)
        if not resolution.resolved:
            warnings.warn(resolution.describe(), McKibbenWarning, stacklevel=2)
    else:
        plant.check_substeps(start.angles, None, control_period, substeps)
        resolution = Resolution(substeps)
        solve(substeps)
    (final, record), used = solutions[resolution.substeps]
    record, final = jax.tree.map(np.asarray, (record, final))
    result = RobotResult.of(run.plant, record, final, control_period, used, resolution)
    wrong = ~np.isfinite(result["z"])
    if wrong.any():
        raise SimulationError(
            f"the run diverges at {times[wrong.argmax()]:.4g} s",
            field="substeps",
            value=resolution.substeps,
            remedy="give more substeps, or softer stops and ground",
        )
    return result


@jit
def _measured(samples: RobotSample, final: Any, period: ArrayLike, plant: RobotPlant) -> RobotMetrics:
    return measure(samples, plant.observe(final), period, plant)


@checked_call
def simulate_robots(
    plant: RobotPlant,
    controller: RobotController,
    start: RobotStart,
    *,
    over: Mapping[str, ArrayLike] | None = None,
    metrics: type[RobotMetrics] | type[TrackingMetrics] = RobotMetrics,
    duration: float,
    control_period: float = 0.5e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    precision: int = 64,
    chunk: int | None = None,
    workers: int | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> Batch:
    """Simulate a robot many times, as `simulate_robot` does, and return the metrics of each run.

    Parameters
    ----------
    plant, controller, start
        With arrays of shape (runs,) in place of numbers that differ between runs.
    over
        Arrays by the dotted name of a leaf, such as ``{"robot.bodies.0.mass": [0.9, 1.1]}``: parts of the plant,
        ``controller`` or ``start``.
    metrics
        Class of the metrics: `TrackingMetrics` of a controller whose reference is over time, that of a file.
    duration, control_period
        As for `simulate_robot`; forces are sampled once per control period.
    accuracy, substeps
        As for `mckibben.simulate_many`; the table has the columns ``substeps``, ``error_estimate`` and ``chaotic``.
    precision
        Bits of the numbers, 64 or 32; with 32, integration steps are chosen with 64.
    chunk, workers, engine, progress
        As for `mckibben.simulate_many`.

    Raises
    ------
    ParameterError
        If a leaf does not exist, or no number varies.
    SimulationError
        If the times do not fit together, or the step is too long for ground, stops, friction or air.
    """
    kind = float_type(precision)
    check_accuracy(accuracy, substeps, np.finfo(kind).bits)
    times = sampling_times(duration, control_period)
    check_pairs(plant.robot, controller)
    lanes, shared, count = split_runs(
        RobotProblem(plant, controller, start), over or {}, control_period, "simulate_robot"
    )
    first = eqx.combine(jax.tree.map(lambda leaf: leaf[0], lanes), shared)

    every = spacing(times.size)
    rows = setpoints_over(shared.controller, times, lanes.controller)
    given = shared, of_any_length(shared.controller, rows, every), np.asarray(control_period)

    def refine_runs(runs: Runs) -> Refinement:
        some = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf)[runs], 0, -1), lanes)

        def solve(number: int, which: Runs) -> Positions:
            padded = jax.tree.map(lambda leaf: leaf[..., full_vectors(which)], some)
            found, _ = _positions(engine, (*given, np.asarray(number), every), padded)
            return np.stack(found)[..., : which.size]

        least = first.plant.needed_substeps(first.start.angles, None, control_period)
        return refine(solve, runs.size, accuracy=accuracy, spacing=every * control_period, first=least)

    if substeps is None:
        steps = refine_blocks(lanes, count, refine_runs, workers)
        steps.warn_of(accuracy)
    else:
        first.plant.check_substeps(first.start.angles, None, control_period, substeps)
        steps = StepCounts.given(substeps, count)
    tracks = metrics is TrackingMetrics
    joined, used = compute_groups(
        lambda lane, number: _run(engine, (*given, dynamic_steps(number), kind.name, tracks), lane, kind),
        lanes,
        steps.substeps,
        chunk=chunk,
        workers=workers,
        engine=engine,
        progress=progress,
    )
    found: PyTree = joined
    known = {name: getattr(found, name, 0.0) for name in ("time_outside_domain", "time_saturated")}
    errors = found.angle_max if tracks else [0.0 * found.peak_force, 0.0 * found.peak_trunk_force]  # NaN of a lost run
    codes = outcomes(known | {"angle_max": np.max(errors, axis=0)})
    columns: dict[str, Any] = {"joint": [joint.name for joint in plant.robot.joints]}
    for name, column in (found._asdict() | steps.columns()).items():
        dims = ("joint", "run") if isinstance(column, tuple) else ("run",)
        columns[name] = (dims, np.stack(column) if isinstance(column, tuple) else column, attributes(name))
    return Batch(batch_table(columns, codes, over or {}, engine=used), metrics)


@BatchFunction
def _run(given: Any, lane: Any) -> RobotMetrics | TrackingMetrics:
    """Metrics of one run."""
    shared, times, period, substeps, kind, tracks = given
    run: tuple[Any, ...] = eqx.combine(lane, shared), times, period
    own, times, period = run if kind == "float64" else cast(run, jnp.dtype(kind))
    compute = tracking_metrics if tracks else robot_metrics
    return compute(own.plant, own.controller, own.start, times, period, substeps)


@BatchFunction
def _positions(given: Any, lane: Any) -> tuple[Array, ...]:
    """Positions of one run over time."""
    shared, times, period, substeps, every = given
    own = eqx.combine(lane, shared)
    return positions_over_time(own.plant, own.controller, times, own.start, period, substeps, every)
