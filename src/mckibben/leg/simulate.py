"""Runs of a leg: one with its time traces, or many at once with metrics."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.errors import SimulationError
from mckibben.leg.control import LegController
from mckibben.leg.metrics import LEG_UNITS, LegMetrics, MetricSums
from mckibben.leg.plant import LegPlant, LegStart
from mckibben.notebook import Progress
from mckibben.simulation.engine import BatchFunction, compute_chunks, run_alone
from mckibben.simulation.loop import Record, control_period, initial_loop
from mckibben.simulation.problem import sampling_times, single_run, split_runs
from mckibben.simulation.result import variables

if TYPE_CHECKING:
    import xarray as xr


class LegProblem(NamedTuple):
    """All parts of a run of a leg; leaves are numbers, or arrays over runs."""

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
    substeps: int = 4,
    engine: str = "auto",
) -> xr.Dataset:
    """Simulate a leg; the dataset has all states, forces and commands over ``time``.

    Columns of joints have the dimension ``joint``, those of muscles ``muscle``. Attributes: ``units`` of each, and the
    ``engine`` that computed it.

    Parameters
    ----------
    plant, controller, start
        Leg, controller, and start of the run.
    duration, control_period
        [s]; the first is a multiple of the second.
    substeps
        Integration steps per control period.
    engine
        "native", "xla" or "auto", as for `mckibben.simulate`.

    Raises
    ------
    SimulationError
        If the times do not fit together, the step is too long for ground, stops, friction or air, or the run diverges.
    RangeError
        If the start is not possible; see `LegPlant.init_state`.
    """
    times = sampling_times(duration, control_period, substeps)
    run = single_run(LegProblem(plant, controller, start), control_period, "simulate_legs")
    plant.check_start(start)
    plant.check_substeps(start.angles, None, control_period, substeps)
    record, used = run_alone(engine, run.plant, run.controller, times, run.start, np.asarray(control_period), substeps)
    table = _table(plant, jax.tree.map(np.asarray, record), times).assign_attrs(engine=used)
    wrong = ~np.isfinite(table["z"].to_numpy())
    if wrong.any():
        raise SimulationError(
            f"the run diverges at {times[wrong.argmax()]:.4g} s",
            field="substeps",
            value=substeps,
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
    substeps: int = 1,
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
    duration, control_period, substeps
        As for `simulate_leg`; forces are sampled once per control period.
    chunk, workers, engine, progress
        As for `mckibben.simulate_many`.

    Raises
    ------
    ParameterError
        If a leaf does not exist, or no number varies.
    SimulationError
        If the times do not fit together, or the step is too long for ground, stops, friction or air.
    """
    times = sampling_times(duration, control_period, substeps)
    lanes, shared, count = split_runs(LegProblem(plant, controller, start), over or {}, control_period, "simulate_leg")
    first = eqx.combine(jax.tree.map(lambda leaf: leaf[0], lanes), shared)
    first.plant.check_substeps(first.start.angles, None, control_period, substeps)
    given = shared, times, np.asarray(control_period), substeps
    joined, used = compute_chunks(
        lambda lane: _run(engine, given, lane),
        lanes,
        count,
        chunk=chunk,
        workers=workers,
        engine=engine,
        progress=progress,
    )
    import xarray as xr

    finite = np.isfinite(joined.peak_force + joined.peak_trunk_force + joined.deflection)
    table = variables(joined._asdict() | {"diverged": ~finite}, "run", lambda _: "joint", LEG_UNITS)
    coords = {"joint": [joint.name for joint in plant.leg.joints]}
    return xr.Dataset(table, coords=coords, attrs={"engine": used})


@BatchFunction
def _run(given: Any, lane: Any) -> LegMetrics:
    """Metrics of one run."""
    shared, *rest = given
    return leg_metrics(*eqx.combine(lane, shared), *rest)


def _table(plant: LegPlant, record: Record, times: Any) -> xr.Dataset:
    import xarray as xr

    given = record.state._asdict() | {"command": record.commands, "saturated": record.limited} | record.telemetry
    of_joints = ("angle", "velocity", "stop_torque")
    columns = variables(given, "time", lambda name: "joint" if name in of_joints else "muscle", LEG_UNITS)
    joints = [joint.name for joint in plant.leg.joints]
    coords = {"time": ("time", times, {"units": "s"}), "joint": joints, "muscle": list(plant.leg.muscle_names)}
    return xr.Dataset(columns, coords=coords)
