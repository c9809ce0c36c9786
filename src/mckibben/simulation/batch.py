"""Batches of runs that differ in any numbers of plant, controller, reference or start."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.component.checks import whole_periods
from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import McKibbenWarning, SimulationError
from mckibben.notebook import Progress, html_table
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import compiled_batch
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.engine import BatchFunction, compute_chunks
from mckibben.simulation.loop import streaming_episode
from mckibben.simulation.metrics import Change, Metrics, Trajectory, last_change
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    check_names,
    float_type,
    sample_reference,
    sampled_reference,
    sampling_times,
    split_runs,
)
from mckibben.simulation.result import OUTCOMES, Outcome, attributes, outcomes

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True, eq=False, repr=False)
class Batch:
    """Results of many runs, in their order; ``batch["angle_rmse"]`` is a column as an array.

    `table` has along ``run`` the metrics (SI), ``outcome`` (a code; its attribute ``flag_meanings`` lists the names)
    and the values of `over`; along ``run`` and ``time`` the kept parts of the trajectories.
    """

    table: xr.Dataset

    @property
    def count(self) -> int:
        """The number of runs."""
        return self.table.sizes["run"]

    @property
    def metrics(self) -> dict[str, NDArray[np.floating]]:
        """The computed metrics by name, shape (runs,), SI; NaN for a run that could not start."""
        return {name: self[name] for name in Metrics._fields if name in self.table}

    @property
    def outcomes(self) -> list[Outcome]:
        """Outcome of each run."""
        return [OUTCOMES[code] for code in self["outcome"]]

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Mask of the failed runs."""
        return np.array([outcome.failed for outcome in OUTCOMES])[self["outcome"]]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of the runs that did not fail, and did not end in a limit cycle."""
        return np.array([outcome.usable for outcome in OUTCOMES])[self["outcome"]]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.table[name].to_numpy()

    def _counted(self) -> str:
        counts = np.bincount(self["outcome"], minlength=len(OUTCOMES))
        return ", ".join(f"{n} {outcome.name.lower()}" for n, outcome in zip(counts, OUTCOMES, strict=True) if n)

    def __repr__(self) -> str:
        return f"<Batch: {self.count} runs ({self._counted()}), metrics {', '.join(self.metrics)}>"

    def _repr_html_(self) -> str:
        parts = (0, 50, 100)
        rows = []
        for name, values in self.metrics.items():
            finite = values[np.isfinite(values)]
            numbers = np.percentile(finite, parts) if finite.size else np.full(len(parts), np.nan)
            about = attributes(name)
            rows.append((about["long_name"], *(f"{number:.4g}" for number in numbers), about.get("units", "")))
        head = ("metric", "least", "median", "largest", "unit")
        return html_table(f"{self.count} runs: {self._counted()}", head, rows)


def simulate_many(
    plant: JointPlant,
    controller: Controller,
    reference: Reference,
    *,
    over: Mapping[str, ArrayLike] | None = None,
    duration: float = 10.0,
    control_period: float = 1e-3,
    substeps: int = 4,
    initial: PlantState | AtRest | None = None,
    metrics: Sequence[str] = Metrics._fields,
    keep: Sequence[str] = (),
    every: float | None = None,
    precision: Any = 64,
    chunk: int | None = None,
    workers: int | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> Batch:
    """Run a controller on a plant many times; the results equal those of `simulate` for each run.

    Runs differ in any numeric leaves: arrays of shape (runs,) in place of numbers in `plant`, `controller`,
    `reference` or `initial`, or a table of values in `over`. All share one compiled program, are computed in chunks on
    all cores, and are reduced to metrics during the run, so that memory does not grow with their number or duration.

    Parameters
    ----------
    plant, controller, reference, duration, control_period, substeps, initial, precision
        As for `simulate`. The feasibility of each reference is not checked; see `check_reference`.
    over
        Arrays by the dotted name of a leaf, such as ``{"load.mass2": [0.4, 0.5]}``: parts of the plant as in a
        scenario, ``controller``, ``reference`` or ``initial``.
    metrics
        Metrics to compute. ``coupling`` needs a second run from the stiffness step on.
    keep, every
        Names of `Trajectory` to keep over time, and the time between two values [s], by default the control period.
    chunk
        Runs computed together. Default: 1024, 256 by XLA, up to 65,536 by CUDA, fewer where that would leave cores
        idle. Results with different chunk sizes agree to 1e-12; they do not depend on the number of runs or workers.
    workers
        Threads. Default: one per core.
    engine
        "native": emitted as C and compiled by the machine's compiler; "xla"; "cuda": kernels on an NVIDIA GPU, which
        needs the extra ``gpu``; or "auto", native if possible, else XLA. The attribute ``engine`` of the table names
        the one used. Their results differ by rounding.
    progress
        Called with the present step and the finished fraction, 0 to 1; a progress bar in notebooks.

    Warns
    -----
    McKibbenWarning
        If friction, or the flow of valves, needs more substeps in the first run or in one with an extreme value.

    Raises
    ------
    ParameterError
        If a leaf does not exist, or the arrays differ in length or are missing; if the engine cannot be used.
    DeviceError
        If the GPU fails, or has too little memory for a chunk.
    SimulationError
        If an argument is of the wrong type, the times do not fit together, or a name is not known.

    Examples
    --------
    >>> import numpy as np
    >>> from mckibben import catalog, PID, FirstOrderValve, JointPlant, PositionStiffnessControl, Reference, Sine
    >>> knee = catalog.joint("knee-table-2")
    >>> plant = JointPlant(knee, catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> control = PositionStiffnessControl(PID(2e5, 60e5, 0.4e5), PID(-1.5e5, -100e5, 0.0), model=knee)
    >>> simulate_many(plant, control, Reference(angle=Sine(0.03, 1.0), stiffness=72.5), duration=0.5,
    ...               over={"load.mass2": np.linspace(0.3, 0.7, 3)}, metrics=["angle_rmse"])
    <Batch: 3 runs (3 completed), metrics angle_rmse>
    """
    times = sampling_times(duration, control_period, substeps)
    stride = _stride(every, control_period, times.size)
    check_names("metric", metrics, Metrics._fields)
    check_names("column of a trajectory", keep, Trajectory._fields)
    asked = _Asked(substeps, tuple(metrics), tuple(keep), stride, float_type(precision).name)

    problem = SimulationProblem.of(plant, controller, reference, initial)
    lanes, shared, count = split_runs(problem, over or {}, control_period, alone="simulate")
    _warn_of_substeps(lanes, shared, times, control_period, substeps)
    period = jnp.asarray(control_period, float)

    def compute(lane: SimulationProblem) -> tuple[dict[str, Array], str]:
        begun, span = _begun(lane, shared, times, asked)
        each = bool(jax.tree.leaves(lane.reference))
        spec = _Beginnings(setpoints=each, changes=each, starts=True, exist=True, split=False)  # type: ignore
        of_each, of_all = eqx.partition(begun, spec)
        unused: Any = {"reference": None, "initial": None}
        given = (shared._replace(**unused), of_all, period, asked), (lane._replace(**unused), of_each)
        columns, used = _run(engine, *given, asked.precision)
        return columns | {"_span": np.broadcast_to(span, begun.exist.shape)}, used

    columns, used = compute_chunks(
        compute,
        lanes,
        count,
        chunk=chunk,
        workers=workers,
        engine=engine,
        precision=asked.precision,
        numbers=len(asked.keep) * times.size // stride
        + times.size * len(Setpoint._fields) * bool(jax.tree.leaves(lanes.reference)),
        progress=progress,
    )
    table = _table(columns, over or {}, times[::stride], asked)
    return Batch(table.assign_attrs(engine=used))


def _warn_of_substeps(
    lanes: SimulationProblem, shared: SimulationProblem, times: NDArray[np.float64], period: float, substeps: int
) -> None:
    """Warn of too few substeps where friction or flow, which are bounded, keeps runs from diverging.

    Checks the first run, and those with the lowest and the highest value of each varied number of the plant.
    The text names no run, as in a part of a sweep it has another number, and is the same for most parts.
    """
    plant = eqx.combine(lanes, shared).plant
    if not (plant.joint.has_friction or plant.friction is not None or plant.valve.holds_air):
        return
    varied = [np.reshape(leaf, (len(leaf), -1)).sum(axis=1) for leaf in jax.tree.leaves(lanes.plant)]
    needed = 0
    for run in sorted({0, *(int(find(values)) for values in varied for find in (np.argmin, np.argmax))}):
        problem = eqx.combine(jax.tree.map(lambda leaf, run=run: leaf[run], lanes), shared)
        setpoints = sampled_reference(problem.reference, times)
        try:
            problem.plant.check_substeps(*setpoints, period, substeps)
        except SimulationError as error:
            needed = max(needed, int(error.lower or 0))
    if needed:
        text = f"substeps is {substeps}, too few for some runs, which friction or flow keeps from diverging"
        warnings.warn(f"{text}: their numbers may be wrong; give at least {needed}", McKibbenWarning, stacklevel=3)


class _Asked(NamedTuple):
    """Static arguments of the program of a chunk."""

    substeps: int
    metrics: tuple[str, ...]
    keep: tuple[str, ...]
    stride: int
    precision: str


class _Beginnings(NamedTuple):
    """Quantities of runs that are known before they begin; setpoints and changes are shared where the reference is."""

    setpoints: Setpoint  # with runs along the last axis: a row is what one control period needs
    changes: Change
    starts: PlantState
    exist: Array
    split: Array | None  # first control period that needs the run without the last change


def _begin(
    lanes: SimulationProblem, shared: SimulationProblem, times: NDArray[np.float64] | Array, asked: _Asked
) -> tuple[_Beginnings, Array]:
    """The beginnings of a chunk of runs, and the distance that their desired angles move."""

    def of(lane: SimulationProblem) -> Setpoint:
        return sample_reference(eqx.combine(lane, shared).reference, times)

    if jax.tree.leaves(lanes.reference):
        axis, setpoints = -1, jax.vmap(of, in_axes=-1, out_axes=-1)(lanes)
        changes = jax.vmap(last_change, in_axes=-1)(setpoints.stiffness)
    else:
        axis, setpoints = None, sample_reference(shared.reference, times)
        changes = last_change(setpoints.stiffness)

    def start(lane: SimulationProblem, setpoints: Setpoint) -> tuple[PlantState, Array]:
        return eqx.combine(lane, shared).start(setpoints)

    starts, exist = jax.vmap(start, (-1, axis), -1)(lanes, setpoints)
    first = jnp.min(jnp.where(changes.ends, changes.at, jnp.size(times)))
    split = first if "coupling" in asked.metrics else None
    span = setpoints.angle.max(axis=0) - setpoints.angle.min(axis=0)
    return _Beginnings(setpoints, changes, starts, exist, split), span


_begun = compiled_batch(_begin)


@BatchFunction
def _run(shared: Any, lane: Any) -> dict[str, Array]:
    """Columns of one run."""
    problem, begun, period, asked = shared
    own, begun = eqx.combine(lane[0], problem), eqx.combine(lane[1], begun)
    precision = jnp.dtype(asked.precision)
    parts = cast((own.plant, own.controller, begun.setpoints, begun.starts, period), precision)
    streamed = streaming_episode(
        *parts,
        asked.substeps,
        change=cast(begun.changes, precision),
        split=begun.split,
        keep=asked.keep,
        every=asked.stride,
    )
    metrics = {name: jnp.where(begun.exist, value, jnp.nan) for name, value in streamed.metrics._asdict().items()}
    deciding = {f"_{name}": metrics[name] for name in _DECIDING}
    deciding |= {"_started": begun.exist, "_angle_at_end": streamed.angle_at_end}
    return {**{name: metrics[name] for name in asked.metrics}, **deciding, **streamed.kept}


_DECIDING = ("angle_max", "time_outside_domain", "time_overloaded", "time_saturated", "oscillation_amplitude")


def _table(columns: Mapping[str, Any], over: Mapping[str, ArrayLike], times: NDArray, asked: _Asked) -> xr.Dataset:
    code = outcomes(
        angle_max=columns["_angle_max"],
        angle_at_end=columns["_angle_at_end"],
        span=columns["_span"],
        left_domain=(columns["_time_outside_domain"] > 0) | (columns["_time_overloaded"] > 0),
        saturated=columns["_time_saturated"] > 0,
        oscillates=columns["_oscillation_amplitude"] > 0,
        started=columns["_started"],
    )
    flags = {
        "flag_values": np.arange(len(OUTCOMES), dtype=np.int8),
        "flag_meanings": " ".join(o.name for o in OUTCOMES),
    }
    table: dict[str, Any] = {}
    for name, values in over.items():
        given = np.asarray(values)
        axes = [f"{name}.{axis}" for axis in range(given.ndim)]
        dims = ["run", *axes[1:]] if given.ndim and given.shape[0] == code.size else axes
        table[name] = (dims, given, {"long_name": f"value of {name}"})
    table |= {name: ("run", columns[name], attributes(name)) for name in asked.metrics}
    table |= {"outcome": ("run", code, {"long_name": "how the run ended", **flags})}
    table |= {name: (("run", "time"), columns[name], attributes(name)) for name in asked.keep}
    time = {"time": ("time", times, {"units": "s", "long_name": "time"})} if asked.keep else {}
    import xarray as xr

    return xr.Dataset(table, coords=time)


def _stride(every: float | None, control_period: float, periods: int) -> int:
    """Control periods between two kept values."""
    if every is None:
        return 1
    stride = whole_periods(every, control_period) if math.isfinite(every) and every > 0 else None
    if stride is None or periods % stride:
        raise SimulationError(
            f"values every {every:g} s do not fit {periods} control periods of {control_period:g} s",
            value=every,
            unit="s",
            remedy="give a multiple of the control period that divides the duration",
        )
    return stride
