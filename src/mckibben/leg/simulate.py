"""Runs of a leg: one with its time traces, or many at once with metrics."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.errors import McKibbenWarning, SimulationError
from mckibben.leg.control import LegController
from mckibben.leg.metrics import LEG_UNITS, LegMetrics, MetricSums
from mckibben.leg.plant import LegPlant, LegStart
from mckibben.notebook import Progress
from mckibben.simulation.accuracy import (
    ACCURACY,
    STEP_UNITS,
    Positions,
    Refinement,
    Resolution,
    Runs,
    Steps,
    check_accuracy,
    full_vectors,
    refine,
    refine_blocks,
    resolution_of,
    spacing,
)
from mckibben.simulation.engine import BatchFunction, compute_groups, dynamic_steps, run_alone
from mckibben.simulation.loop import Record, control_period, initial_loop, positions_over_time
from mckibben.simulation.problem import sampling_times, single_run, split_runs
from mckibben.simulation.result import variables

if TYPE_CHECKING:
    import xarray as xr


class LegProblem(NamedTuple):
    """Everything that a run of a leg is made of; leaves are numbers, or arrays over runs."""

    plant: LegPlant
    controller: LegController
    start: LegStart

    kinds = MappingProxyType(  # type: ignore[misc]
        {"plant": (LegPlant,), "controller": (LegController,), "start": (LegStart,)}
    )


def leg_metrics(
    plant: LegPlant, controller: LegController, start: LegStart, times: Array, period: ArrayLike, substeps: int
) -> LegMetrics:
    """Run a leg and return its metrics alone; a pure function, whose memory does not grow with the duration."""

    def advance(carry: tuple[Any, MetricSums], time: Array) -> tuple[Any, None]:
        state, sums = carry
        state, _ = control_period(plant, controller, state, time, period, substeps)
        return (state, sums.after(plant.observe(state[0]), period, plant)), None

    loop = initial_loop(plant, controller, start)
    sums = MetricSums.of(plant.observe(loop[0]))
    return lax.scan(advance, (loop, sums), times)[0][1].finished()


def simulate_leg(
    plant: LegPlant,
    controller: LegController,
    start: LegStart,
    *,
    duration: float,
    control_period: float = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    engine: str = "auto",
) -> xr.Dataset:
    """Simulate a leg; the dataset has all states, forces and commands over ``time``.

    Columns of joints have the dimension ``joint``, those of muscles ``muscle``. Attributes: ``units`` of each, the
    ``engine`` that computed it, and the fields of `mckibben.simulation.Resolution`.

    Parameters
    ----------
    plant, controller, start
        Leg, controller, and start of the run.
    duration, control_period
        [s]; the first is a multiple of the second.
    accuracy
        Accuracy of the angles [rad], and of the position of the trunk [m].
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
        If the start is not possible; see `LegPlant.init_state`.

    Warns
    -----
    McKibbenWarning
        If the run is not resolved, with the time from which.
    """
    check_accuracy(accuracy, substeps)
    times = sampling_times(duration, control_period)
    run = single_run(LegProblem(plant, controller, start), control_period, "simulate_legs")
    plant.check_start(start)
    solutions: list[tuple[Record, str]] = []

    def solve(number: int, _: Any = None) -> Positions:
        found = run_alone(engine, run.plant, run.controller, times, run.start, np.asarray(control_period), number)
        solutions[:] = [found]
        at = found[0].state
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
    record, used = solutions[0]
    table = _table(plant, jax.tree.map(np.asarray, record), times).assign_attrs(engine=used, **resolution.attributes)
    wrong = ~np.isfinite(table["z"].to_numpy())
    if wrong.any():
        raise SimulationError(
            f"the run diverges at {times[wrong.argmax()]:.4g} s",
            field="substeps",
            value=resolution.substeps,
            remedy="give more substeps, or softer stops and ground",
        )
    return table


def simulate_legs(
    plant: LegPlant,
    controller: LegController,
    start: LegStart,
    *,
    over: Mapping[str, ArrayLike] | None = None,
    duration: float,
    control_period: float = 0.5e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> xr.Dataset:
    """Simulate a leg many times, as `simulate_leg` does, and return the `LegMetrics` along ``run``.

    Parameters
    ----------
    plant, controller, start
        With arrays of shape (runs,) in place of numbers that differ between runs.
    over
        Arrays by the dotted name of a leaf, such as ``{"leg.trunk.mass": [0.9, 1.1]}``: parts of the plant,
        ``controller`` or ``start``.
    duration, control_period, engine
        As for `simulate_leg`; forces are sampled once a control period.
    accuracy, substeps
        As for `mckibben.simulate_many`; the table has the columns ``substeps``, ``error_estimate`` and ``chaotic``.
    chunk, workers, progress
        As for `mckibben.simulate_many`.

    Raises
    ------
    ParameterError
        If there is no such leaf, or no number varies.
    SimulationError
        If the times do not fit together, or the step is too long for ground, stops, friction or air.
    """
    check_accuracy(accuracy, substeps)
    times = sampling_times(duration, control_period)
    lanes, shared, count = split_runs(LegProblem(plant, controller, start), over or {}, control_period, "simulate_leg")
    first = eqx.combine(jax.tree.map(lambda leaf: leaf[0], lanes), shared)
    given = shared, times, np.asarray(control_period)

    def refine_runs(runs: Runs) -> Refinement:
        some, every = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf)[runs], 0, -1), lanes), spacing(times.size)

        def solve(number: int, which: Runs) -> Positions:
            padded = jax.tree.map(lambda leaf: leaf[..., full_vectors(which)], some)
            found, _ = _positions(engine, (*given, np.asarray(number), every), padded)
            return np.stack(found)[..., : which.size]

        least = first.plant.needed_substeps(first.start.angles, None, control_period)
        return refine(solve, runs.size, accuracy=accuracy, spacing=every * control_period, first=least)

    if substeps is None:
        steps = refine_blocks(lanes, count, refine_runs, workers)
    else:
        first.plant.check_substeps(first.start.angles, None, control_period, substeps)
        steps = Steps.given(substeps, count)
    joined, used = compute_groups(
        lambda lane, number: _run(engine, (*given, dynamic_steps(number)), lane),
        lanes,
        steps.substeps,
        chunk=chunk,
        workers=workers,
        engine=engine,
        progress=progress,
    )
    import xarray as xr

    finite = np.isfinite(joined.peak_force + joined.peak_trunk_force + joined.deflection)
    columns = joined._asdict() | {"diverged": ~finite} | steps.columns()
    table = variables(columns, "run", lambda _: "joint", LEG_UNITS | STEP_UNITS)
    coords = {"joint": [joint.name for joint in plant.leg.joints]}
    return xr.Dataset(table, coords=coords, attrs={"engine": used})


@BatchFunction
def _run(given: Any, lane: Any) -> LegMetrics:
    """Metrics of one run."""
    shared, *rest = given
    return leg_metrics(*eqx.combine(lane, shared), *rest)


@BatchFunction
def _positions(given: Any, lane: Any) -> tuple[Array, ...]:
    """Positions of one run over time."""
    shared, times, period, substeps, every = given
    own = eqx.combine(lane, shared)
    return positions_over_time(own.plant, own.controller, times, own.start, period, substeps, every)


def _table(plant: LegPlant, record: Record, times: Any) -> xr.Dataset:
    import xarray as xr

    given = record.state._asdict() | {"command": record.commands, "saturated": record.limited} | record.telemetry
    of_joints = ("angle", "velocity", "stop_torque")
    columns = variables(given, "time", lambda name: "joint" if name in of_joints else "muscle", LEG_UNITS)
    joints = [joint.name for joint in plant.leg.joints]
    coords = {"time": ("time", times, {"units": "s"}), "joint": joints, "muscle": list(plant.leg.muscle_names)}
    return xr.Dataset(columns, coords=coords)
