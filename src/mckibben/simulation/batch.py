"""Many runs at once: any number of plant, controller and reference may differ from run to run."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike
from numpy.typing import NDArray

from mckibben.control.base import Controller, Reference, Setpoint
from mckibben.errors import ParameterError, SimulationError
from mckibben.numerics.batching import cast, cores, many_runs, padded, worked_off
from mckibben.numerics.checks import whole_periods
from mckibben.numerics.compiled import compiled_batch
from mckibben.plant import JointPlant, PlantState
from mckibben.simulation.loop import AtRest, Run, check_names, check_substeps, described, sampling_times, wishes_at
from mckibben.simulation.metrics import Metrics, Trajectory, last_change
from mckibben.simulation.result import OUTCOMES, Outcome, attributes, outcomes
from mckibben.simulation.streaming import measured_episode

if TYPE_CHECKING:
    import xarray as xr

CHUNK = 256
"""Lanes that are computed together: what they hold fits a core's fast memory, and fills its vectors."""
ON_ACCELERATOR = 16384
"""The same on an accelerator."""
VECTOR = 16
"""Lanes: a piece smaller than a vector of 32-bit numbers would waste part of it."""


@dataclass(frozen=True, eq=False)
class Batch:
    """The answers of many runs, in their order.

    Attributes
    ----------
    table
        Along ``run``: the metrics (SI), ``outcome`` (a code; its attribute ``flag_meanings`` lists the words) and,
        where runs differ in named values, those values. Along ``run`` and ``time`` what was kept of the trajectories.
    """

    table: xr.Dataset

    @property
    def count(self) -> int:
        """The number of runs."""
        return self.table.sizes["run"]

    @property
    def metrics(self) -> dict[str, NDArray[np.floating]]:
        """The metrics that were computed, by name, shape (runs,), SI; NaN for a run that could not start."""
        return {name: self.table[name].to_numpy() for name in Metrics._fields if name in self.table}

    @property
    def outcomes(self) -> list[Outcome]:
        """How each run ended."""
        return [OUTCOMES[code] for code in self.table["outcome"].to_numpy()]

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Which runs came to no end that is of use."""
        return np.array([outcome.lost for outcome in OUTCOMES])[self.table["outcome"].to_numpy()]


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
    precision: Any = jnp.float64,
    chunk: int | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Batch:
    """Run a controller on a plant many times: the same numbers as `simulate` gives one by one.

    Runs differ in any numeric leaves: arrays of shape (runs,) in place of numbers in `plant`, `controller`,
    `reference` or `initial`, or a table of values in `over`. All share one compiled program, are computed in chunks on
    all cores, and are measured on the way, so that memory does not grow with their number or duration.

    Parameters
    ----------
    plant, controller, reference, duration, control_period, substeps
        As for `simulate`. Whether each reference is within reach is not checked; see `check_reference`.
    over
        Arrays by the dotted name of a leaf, such as ``{"plant.load.mass2": [0.4, 0.5]}``; the names begin with
        ``plant``, ``controller`` or ``reference``.
    initial
        The state at the start, or `AtRest`; at rest at the first desired angle unless given.
    metrics
        Which to compute. ``coupling`` costs a second run from the step of the stiffness on.
    keep
        Names of `Trajectory` to keep over time.
    every
        The time between two kept values [s]; the control period unless given.
    precision
        `jax.numpy.float64` or `jax.numpy.float32`: half the time, and some 6 digits.
    chunk
        Runs that are computed together: 256 unless given, fewer where that would leave cores idle. The bits of an
        answer depend on it (not on the number of runs, nor on the workers); its digits do not, to 1e-12.
    workers
        Threads; one a core unless given.
    progress
        Called with the part that is done, 0 to 1.

    Raises
    ------
    ParameterError
        If there is no such leaf, or their arrays are of different lengths, or there is none.
    SimulationError
        If the times make no sense together, or a metric or a part of the trajectory is not known.

    Examples
    --------
    >>> import numpy as np
    >>> from mckibben import catalog, PID, FirstOrderValve, JointPlant, PositionStiffnessControl, Reference, Sine
    >>> knee = catalog.joint("knee-table-2")
    >>> plant = JointPlant(knee, catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> control = PositionStiffnessControl(PID(2e5, 60e5, 0.4e5), PID(-1.5e5, -100e5, 0.0), model=knee)
    >>> batch = simulate_many(plant, control, Reference(angle=Sine(0.03, 1.0), stiffness=72.5), duration=0.5,
    ...                       over={"plant.load.mass2": np.linspace(0.3, 0.7, 3)}, metrics=["angle_rmse"])
    >>> [outcome.name for outcome in batch.outcomes]
    ['COMPLETED', 'COMPLETED', 'COMPLETED']
    """
    check_substeps(substeps)
    times = sampling_times(duration, control_period)
    apart = _apart(every, control_period, times.size)
    check_names("metric", metrics, Metrics._fields)
    check_names("part of a trajectory", keep, Trajectory._fields)
    if precision not in (jnp.float32, jnp.float64):
        raise SimulationError(f"precision {precision!r}", value=precision, remedy="give jax.numpy.float64 or float32")

    lanes, shared, count = described(plant, controller, reference, initial, over or {})
    if count is None:
        raise ParameterError(
            "nothing differs from run to run", remedy="give an array in place of a number, or use `simulate` for one"
        )
    size = _chunk_size(chunk, count, _workers(workers))
    period = jnp.asarray(control_period, float)
    asked = _Asked(substeps, tuple(metrics), tuple(keep), apart, jnp.dtype(precision).name)

    def answers(piece: slice) -> dict[str, NDArray]:
        answer = _chunk(padded(lanes, piece, size), shared, times, period, asked)
        return {name: np.asarray(values)[: piece.stop - piece.start] for name, values in answer.items()}

    parts = []
    for piece, answer in worked_off(answers, count, size, workers):
        parts.append(answer)
        if progress:
            progress(piece.stop / count)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Batch(_table(columns, over or {}, times[::apart], asked))


class _Asked(NamedTuple):
    """What shapes the program of a chunk."""

    substeps: int
    metrics: tuple[str, ...]
    keep: tuple[str, ...]
    apart: int
    precision: str


@compiled_batch
def _chunk(
    lanes: Run, shared: Run, times: NDArray[np.float64] | Array, period: Array, asked: _Asked
) -> dict[str, Array]:
    """The answers of some runs, by name: metrics, what decides their outcomes, and what is kept."""

    def whole(lane: Run) -> Run:
        return eqx.combine(lane, shared)

    # Wishes of all lanes side by side at each time: a row is what a control period needs.
    together = not jax.tree.leaves(lanes.reference)
    wishes = (
        wishes_at(shared.reference, times)
        if together
        else jax.vmap(lambda lane: wishes_at(whole(lane).reference, times), out_axes=1)(lanes)
    )
    along = None if together else 1
    split = None
    if "coupling" in asked.metrics:
        change = last_change(wishes.stiffness) if together else jax.vmap(last_change, in_axes=1)(wishes.stiffness)
        split = jnp.min(jnp.where(change.ends, change.at, jnp.size(times)))

    def one(lane: Run, wish: Setpoint) -> dict[str, Array]:
        run = whole(lane)
        start, exists = run.start(wish)
        change = last_change(wish.stiffness)
        plant, controller, wish, start, step = cast((run.plant, run.controller, wish, start, period), precision)
        with many_runs():
            measured = measured_episode(
                plant,
                controller,
                wish,
                start,
                step,
                asked.substeps,
                change=cast(change, precision),
                split=split,
                keep=asked.keep,
                every=asked.apart,
            )
        metrics = {name: jnp.where(exists, value, jnp.nan) for name, value in measured.metrics._asdict().items()}
        deciding = {f"_{name}": metrics[name] for name in _DECIDING}
        return {**{name: metrics[name] for name in asked.metrics}, **deciding, **measured.kept, "_started": exists}

    precision = jnp.dtype(asked.precision)
    return jax.vmap(one, in_axes=(0, along))(lanes, wishes)


_DECIDING = ("angle_max", "time_outside_domain", "time_overloaded", "time_saturated")


def _table(columns: dict[str, NDArray], over: Mapping[str, ArrayLike], times: NDArray, asked: _Asked) -> xr.Dataset:
    code = outcomes(
        angle_max=columns["_angle_max"],
        left_domain=(columns["_time_outside_domain"] > 0) | (columns["_time_overloaded"] > 0),
        saturated=columns["_time_saturated"] > 0,
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


def _apart(every: float | None, control_period: float, periods: int) -> int:
    """How many control periods lie between two values that are kept."""
    if every is None:
        return 1
    apart = whole_periods(every, control_period) if math.isfinite(every) and every > 0 else None
    if apart is None or periods % apart:
        raise SimulationError(
            f"values every {every:g} s do not fit {periods} control periods of {control_period:g} s",
            value=every,
            unit="s",
            remedy="give a multiple of the control period that divides the duration",
        )
    return apart


def _workers(workers: int | None) -> int:
    if workers is None:
        return cores()
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise SimulationError(f"{workers} workers", value=workers, remedy="give a whole number from 1 up")
    return workers


def _chunk_size(chunk: int | None, count: int, workers: int) -> int:
    """Lanes a piece: a few hundred, fewer where that leaves cores idle."""
    if chunk is None:
        chunk = CHUNK if jax.default_backend() == "cpu" else ON_ACCELERATOR
    if isinstance(chunk, bool) or not isinstance(chunk, int) or chunk < 1:
        raise SimulationError(f"{chunk} runs a chunk", value=chunk, remedy="give a whole number from 1 up")
    even = -(-count // workers)
    return min(chunk, max(VECTOR, -(-even // VECTOR) * VECTOR))
