"""Runs of a leg: one with its time traces, or many at once with metrics."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike

from mckibben.component.columns import Label, attributes, declare, labels_of
from mckibben.errors import SimulationError
from mckibben.leg.control import LegController
from mckibben.leg.metrics import LegMetrics, MetricSums, measure
from mckibben.leg.plant import LegPlant, LegSample, LegStart
from mckibben.notebook import Progress
from mckibben.numerics.compiled import compiled
from mckibben.simulation.engine import BatchFunction, compute_chunks, run_alone
from mckibben.simulation.loop import Record, control_period, initial_loop
from mckibben.simulation.outcome import outcomes
from mckibben.simulation.problem import sampling_times, single_run, split_runs
from mckibben.simulation.table import Batch, RunResult, batch_table


class LegProblem(NamedTuple):
    """All parts of a run of a leg; leaves are numbers, or arrays over runs."""

    plant: LegPlant
    controller: LegController
    start: LegStart

    kinds = MappingProxyType(  # type: ignore[misc]
        {"plant": (LegPlant,), "controller": (LegController,), "start": (LegStart,)}
    )


declare(__name__, {"command": Label("Pa", "commanded pressure", along="muscle")})


class LegResult(RunResult):
    """A simulated run of a leg; ``result["z"]`` is a column as an array, ``result["time"]`` its times.

    Columns have shape (periods,), those of joints (joints, periods) and of muscles (muscles, periods), in SI: the
    fields of `LegSample`, ``command``, ``saturated``, and the telemetry of the controller. `joints` and `muscles` are
    their names, `control_period` is the time between two values [s], and `engine` what computed it, "native" or "xla".
    """

    kind = LegMetrics

    def __init__(self, plant: LegPlant, record: Record, final: Any, control_period: float, engine: str) -> None:
        columns = record.state._asdict() | {"command": record.commands, "saturated": record.limited} | record.telemetry
        stacked = {name: np.stack(one) if isinstance(one, tuple) else one for name, one in columns.items()}
        super().__init__(stacked, control_period, engine=engine)
        self.joints = tuple(joint.name for joint in plant.leg.joints)
        self.muscles = plant.leg.muscle_names
        self._run = record.state, final, plant

    def _measure(self) -> LegMetrics:
        samples, final, plant = self._run
        return _measured(samples, final, np.asarray(self.control_period), plant)

    def __repr__(self) -> str:
        return f"<LegResult: {self.describe()}>"

    def describe(self) -> str:
        """Return duration, size of the leg, and largest force of the ground."""
        size = f"{len(self.joints)} joints, {len(self.muscles)} muscles"
        return f"{self.duration:g} s, {size}, ground force up to {self['ground_up'].max():.4g} N"

    def _rows_of(self, name: str) -> tuple[str, ...]:
        label = _LABELS.get(name)
        return (label.along if label else "muscle",) if np.ndim(self.columns[name]) > 1 else ()

    def _coordinates(self) -> dict[str, list[str]]:
        return {"joint": list(self.joints), "muscle": list(self.muscles)}


_LABELS = labels_of(LegSample)


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
    return lax.scan(advance, (loop, sums), times)[0][1].finished(len(times), period)


def simulate_leg(
    plant: LegPlant,
    controller: LegController,
    start: LegStart,
    *,
    duration: float,
    control_period: float = 1e-3,
    substeps: int = 4,
    engine: str = "auto",
) -> LegResult:
    """Simulate a leg; the result has all states, forces and commands over ``time``, and the metrics of the run.

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
    (final, record), used = run_alone(
        engine, run.plant, run.controller, times, run.start, np.asarray(control_period), substeps
    )
    record, final = jax.tree.map(np.asarray, (record, final))
    result = LegResult(run.plant, record, final, control_period, used)
    wrong = ~np.isfinite(result["z"])
    if wrong.any():
        raise SimulationError(
            f"the run diverges at {times[wrong.argmax()]:.4g} s",
            field="substeps",
            value=substeps,
            remedy="give more substeps, or softer stops and ground",
        )
    return result


@compiled
def _measured(samples: LegSample, final: Any, period: ArrayLike, plant: LegPlant) -> LegMetrics:
    return measure(samples, plant.observe(final), period, plant)


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
) -> Batch:
    """Simulate a leg many times, as `simulate_leg` does, and return the `LegMetrics` of each run.

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
    finite = np.isfinite(joined.peak_force + joined.peak_trunk_force + joined.deflection)
    codes = outcomes(
        angle_max=np.where(finite, 0.0, np.inf), left_domain=joined.time_outside_domain > 0, saturated=False
    )
    columns: dict[str, Any] = {"joint": [joint.name for joint in plant.leg.joints]}
    for name, column in joined._asdict().items():
        dims = ("joint", "run") if isinstance(column, tuple) else ("run",)
        columns[name] = (dims, np.stack(column) if isinstance(column, tuple) else column, attributes(name))
    return Batch(batch_table(columns, codes, over or {}, engine=used), LegMetrics)


@BatchFunction
def _run(given: Any, lane: Any) -> LegMetrics:
    """Metrics of one run."""
    shared, *rest = given
    return leg_metrics(*eqx.combine(lane, shared), *rest)
