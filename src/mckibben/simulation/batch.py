"""Batches of runs that differ in any numbers of plant, controller, reference or start."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction
from mckibben.component.calls import checked_call
from mckibben.component.columns import attributes, labels_of
from mckibben.control.base import DiscreteTimeSystem, Reference, Setpoint
from mckibben.errors import McKibbenWarning, SimulationError
from mckibben.mechanism.base import Mechanism, over_joints
from mckibben.notebook import Progress
from mckibben.numerics.batching import cast
from mckibben.plant import Plant, PlantState
from mckibben.plant.robot_plant import RobotStart
from mckibben.result import Column, Result, TableColumns, table
from mckibben.simulation.accuracy import (
    ACCURACY,
    Positions,
    Refinement,
    Runs,
    StepCounts,
    check_accuracy,
    full_vectors,
    probed_runs,
    refine,
    refine_blocks,
    spacing,
)
from mckibben.simulation.engine import check_count, chunk_size, compute_groups, dynamic_steps
from mckibben.simulation.loop import of_any_length, positions_over_time, streaming_episode
from mckibben.simulation.metrics import Metrics, last_change, usual_metrics
from mckibben.simulation.outcome import OUTCOMES, Demand, Outcome, near_reference, outcomes
from mckibben.simulation.problem import (
    AtRest,
    SimulationProblem,
    check_names,
    float_type,
    in_order,
    resolved_at,
    sampled_runs,
    sampling_times,
    split_runs,
    starts_of,
    vary,
)
from mckibben.simulation.result import Measured, metric_columns, unknown_column
from mckibben.simulation.robot_metrics import RobotMetrics, landing_metrics
from mckibben.simulation.trajectories import LABELS, column_names
from mckibben.units import HINGE, JOINT_TYPES, Duration, JointType, ShortTime

if TYPE_CHECKING:
    import xarray as xr


class RunTable(Result):
    """Results of many runs, in their order; ``result["angle_rmse"]`` is a column as an array.

    `table` has along ``run`` the metrics (SI) and ``outcome``, a code; its attribute ``flag_meanings`` lists the names.
    """

    table: xr.Dataset

    @property
    def count(self) -> int:
        """Number of runs."""
        return self.table.sizes["run"]

    @property
    def outcomes(self) -> list[Outcome]:
        """Outcome of each run."""
        return [OUTCOMES[code] for code in self["outcome"]]

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Mask of the runs that diverged or could not start."""
        return np.array([outcome.failed for outcome in OUTCOMES])[self["outcome"]]

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Mask of the runs that neither failed nor oscillate."""
        return np.array([outcome.usable for outcome in OUTCOMES])[self["outcome"]]

    @property
    def oscillates(self) -> NDArray[np.bool_]:
        """Mask of the runs in a limit cycle of the angle, or whose commands wear the valves."""
        return np.array([outcome.oscillates for outcome in OUTCOMES])[self["outcome"]]

    @property
    def chaotic(self) -> NDArray[np.bool_]:
        """Mask of the runs that were found to be chaotic: they do not converge with the number of integration steps."""
        return self["chaotic"].astype(bool)

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.table:
            raise unknown_column(name, self.table)
        return self.table[name].to_numpy()

    def __contains__(self, name: object) -> bool:
        return name in self.table

    def __iter__(self) -> Iterator[Any]:
        return iter(self.table)

    def to_dataset(self) -> xr.Dataset:
        """Return the table."""
        return self.table


def rows_of(variable: xr.DataArray) -> dict[str, NDArray[np.floating]]:
    """Return the values of a metric over the runs, by the name of the joint or muscle, which is empty without one."""
    names = variable[variable.dims[0]].to_numpy() if variable.ndim > 1 else [""]
    return dict(zip(map(str, names), np.atleast_2d(variable.to_numpy()), strict=True))


_PARTS = {"least": 0, "median": 50, "largest": 100}
"""Percentiles of a batch that its table shows."""


class Batch(RunTable):
    """Results of a batch; ``batch["angle_rmse"]`` is a column as an array.

    `table` has as well ``substeps`` (integration steps per control period), ``error_estimate`` (of the angle by the
    integration [rad]), ``chaotic``, and the values of `over`; along ``run`` and ``time`` the kept parts of the
    trajectories. Metrics of several joints are along ``joint`` and ``run``. `kind` is the class of the metrics.
    """

    kind: type = Metrics

    @property
    def engine(self) -> str:
        """Engine that computed the runs, "native", "xla" or "cuda"; empty if unknown."""
        return self.table.attrs.get("engine", "")

    @property
    def joint_type(self) -> JointType:
        """How the joint of the runs moves, on which their units depend."""
        return JOINT_TYPES[self.table.attrs.get("joint_type", HINGE.name)]

    @property
    def metrics(self) -> dict[str, NDArray[np.floating]]:
        """The computed metrics by name, shape (runs,) or (joints, runs), SI; NaN for a run that could not start."""
        return Measured({name: self[name] for name in labels_of(self.kind) if name in self.table})

    def needed_substeps(self, accuracy: float) -> int:
        """Most integration steps per control period of the runs that have an accuracy [rad]; the fewest if none has."""
        steps, accurate = self["substeps"], self["error_estimate"] <= accuracy
        return int(steps[accurate].max() if accurate.any() else steps.min())

    def verdict(self) -> str:
        """Number of runs by their outcome."""
        counts = np.bincount(self["outcome"], minlength=len(OUTCOMES))
        counted = [f"{n} {outcome.name.lower()}" for n, outcome in zip(counts, OUTCOMES, strict=True) if n]
        chaotic = int(self.chaotic.sum())
        return f"{self.count} runs: {', '.join(counted + [f'{chaotic} chaotic'] * bool(chaotic))}"

    def declared(self) -> TableColumns:
        """The metrics of all runs, with their units."""
        columns = metric_columns(self.kind, self.metrics, "", "joint", "muscle")
        return {name: (replace(mark, dims=("run",)), values) for name, (mark, values) in columns.items()}

    @table("metrics")
    def spread(self) -> TableColumns:
        """Least, median and largest value of each metric; of several joints or muscles one row each."""
        rows = []
        for metric, (mark, _) in self.converted().items():
            for name, row in rows_of(self.table[metric]).items():
                finite = row[np.isfinite(row)]
                ends = np.percentile(finite, list(_PARTS.values())) if finite.size else np.full(len(_PARTS), np.nan)
                rows.append((f"{mark.title}, {name}" if name else mark.title, *map(mark.cell, ends), mark.shown_unit))
        titles = ("metric", *_PARTS, "unit")
        cells = zip(*rows, strict=True) if rows else [()] * len(titles)
        return {title: (Column(), values) for title, values in zip(titles, cells, strict=True)}


def batch_table(
    columns: Mapping[str, Any], codes: NDArray[np.int8], over: Mapping[str, ArrayLike], **attrs: str
) -> xr.Dataset:
    """Return the table of a batch: values of `over`, outcomes by code, and further variables."""
    import xarray as xr

    table: dict[str, Any] = {}
    for name, values in over.items():
        array = np.asarray(values)
        axes = [f"{name}.{axis}" for axis in range(array.ndim)]
        dims = ["run", *axes[1:]] if array.ndim and array.shape[0] == codes.size else axes
        table[name] = (dims, array, {"long_name": f"value of {name}"})
    return xr.Dataset({**table, **outcome_variable(codes), **columns}, attrs=attrs)


def outcome_variable(codes: NDArray[np.int8]) -> dict[str, Any]:
    """Return the variable ``outcome`` along ``run``, whose attributes name the codes."""
    flags = {
        "long_name": "outcome of the run",
        "flag_values": np.arange(len(OUTCOMES), dtype=np.int8),
        "flag_meanings": " ".join(outcome.name for outcome in OUTCOMES),
    }
    return {"outcome": ("run", codes, flags)}


@checked_call
def simulate_many(
    plant: Plant,
    controller: DiscreteTimeSystem,
    reference: Reference | Mapping[str, Reference] | None = None,
    *,
    over: Mapping[str, ArrayLike] | None = None,
    duration: Duration = 10.0,
    control_period: ShortTime = 1e-3,
    accuracy: float = ACCURACY,
    substeps: int | None = None,
    initial: PlantState | AtRest | RobotStart | None = None,
    metrics: Sequence[str] | None = None,
    keep: Sequence[str] = (),
    every: int = 1,
    precision: int = 64,
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
    plant, controller, reference, duration, control_period, substeps, initial
        As for `simulate`. The feasibility of each reference is not checked; see `check_reference`.
    accuracy
        Accuracy of the angles [rad]. The number of integration steps is chosen for each 1024 consecutive runs, by
        doubling it in the first run, in those with the lowest and highest value of each varied number, and in four
        random ones. With 32 bits rounding adds about 3e-7 rad.
    over
        Arrays by the dotted name of a leaf, such as ``{"load.mass2": [0.4, 0.5]}``: parts of the plant as in a
        scenario, ``controller``, ``reference`` or ``initial``.
    metrics
        Names of `Metrics` to compute, or of `RobotMetrics` for a controller that follows no reference. Default: all
        but ``coupling``, which needs a second run from the stiffness step on.
    precision
        Bits of the floats: 64 or 32.
    keep, every
        Columns of `Trajectory` to keep over time, and control periods between two of their values. Metrics are of all
        control periods, so that one run of hours, with an array of one value, takes little memory.
    chunk
        Runs computed together. Default: 1024, 256 by XLA, up to 65,536 by CUDA, fewer where that would leave cores
        idle. Results with different chunk sizes agree to 1e-12; they do not depend on the number of workers.
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
        If friction, or the flow of valves, needs more than the given substeps in a run with an extreme value.

    Raises
    ------
    ParameterError
        If a leaf does not exist, or the arrays differ in length or are missing; if the engine cannot be used.
    DeviceError
        If the GPU fails, or has too little memory for a chunk.
    SimulationError
        If an argument is of the wrong type, the times do not fit together, a name is not known, or the accuracy is
        beyond rounding.

    Examples
    --------
    >>> import numpy as np
    >>> from mckibben import catalog, PID, FirstOrderValve, JointPlant, PositionStiffnessControl, Reference, Sine
    >>> knee = catalog.joint("knee-table-2")
    >>> plant = JointPlant(knee, catalog.load("knee-table-2"), FirstOrderValve(0.02))
    >>> control = PositionStiffnessControl(PID(2e5, 60e5, 0.4e5), PID(-1.5e5, -100e5, 0.0), model=knee)
    >>> simulate_many(plant, control, Reference(angle=Sine(0.03, 0.2), stiffness=72.5), duration=2.0,
    ...               over={"load.mass2": np.linspace(0.3, 0.7, 3)}, metrics=["angle_rmse"])
    <Batch: 3 runs: 3 completed>
    """
    kind = float_type(precision)
    check_accuracy(accuracy, substeps, np.finfo(kind).bits)
    times = sampling_times(duration, control_period)
    problem = SimulationProblem.of(plant, controller, reference, initial)
    measured, joints = Metrics if controller.follows_reference else RobotMetrics, plant.mechanism.joint_names
    metrics = usual_metrics(measured) if metrics is None else metrics
    check_names("metric", metrics, measured._fields)
    check_names("column of a trajectory", keep, column_names(joints) if measured is Metrics else ())
    if times.size % check_count("control periods from one kept value to the next", every):
        remedy = f"give a divisor of {times.size}, the number of control periods"
        raise SimulationError(f"every is {every}", field="every", value=every, remedy=remedy)
    asked = _Asked(measured, tuple(metrics), tuple(keep), kind.name, every)
    lanes, shared, count = split_runs(problem, over or {}, control_period, alone="simulate")
    varied = times.size * len(Setpoint._fields) * bool(jax.tree.leaves(lanes.reference))
    numbers = len(asked.keep) * times.size // every + varied
    size = chunk_size(chunk, count, workers, engine, numbers)
    runs = _Runs(lanes, shared, times, control_period, asked, engine)
    if substeps is None:
        steps = refine_blocks(lanes, count, functools.partial(runs.refine, accuracy=accuracy), workers)
        steps.warn_of(accuracy)
    else:
        runs.check(substeps)
        steps = StepCounts.given(substeps, count)
    columns, used = compute_groups(
        runs.compute, lanes, steps.substeps, chunk=size, workers=workers, engine=engine, progress=progress
    )
    table = _table(columns, over or {}, times[::every], asked, steps, plant.mechanism)
    return Batch(table.assign_attrs(engine=used), measured)


class _Asked(NamedTuple):
    """Static arguments of the program of a chunk."""

    kind: type  # of the metrics
    metrics: tuple[str, ...]
    keep: tuple[str, ...]
    precision: str
    every: int


class _Runs(NamedTuple):
    """Runs of a batch, as parts that vary and parts that do not."""

    lanes: SimulationProblem
    shared: SimulationProblem
    times: NDArray[np.float64]
    period: float
    asked: _Asked
    engine: str

    def begun(self, lanes: SimulationProblem, every: int = 1) -> tuple[PyTree, PyTree, PyTree]:
        """Shared and varying parts of runs, what is known before they begin included, and their setpoints."""
        setpoints = self.setpoints(lanes)
        starts, exist = starts_of(lanes, self.shared, setpoints, engine=self.engine)
        rows, varies = of_any_length(self.shared.controller, setpoints, every), vary(setpoints)
        follows = self.asked.kind is Metrics
        known = rows, over_joints(lambda own: last_change(own.stiffness, np), setpoints) if follows else None
        unused: Any = {"reference": None, "initial": None}
        shared = self.shared._replace(**unused), None if varies else known
        return shared, (lanes._replace(**unused), known if varies else None, starts, exist), setpoints

    def compute(self, lanes: SimulationProblem, substeps: int) -> tuple[dict[str, Array], str]:
        """Columns of a chunk of runs."""
        shared, varying, setpoints = self.begun(lanes, self.asked.every)
        constant = *shared, np.asarray(self.period, float), self.asked, dynamic_steps(substeps)
        columns, used = _run(self.engine, constant, varying, self.asked.precision)
        if self.asked.kind is Metrics:
            columns = columns | self.demand(setpoints, varying[-1].shape)
        return columns, used

    def demand(self, setpoints: PyTree, shape: tuple[int, ...]) -> dict[str, PyTree]:
        """Demand of the reference in each run, by columns."""
        duration, scale = self.times.size * self.period, self.shared.plant.mechanism.joint_type.scale

        def of_joint(own: Setpoint) -> Demand:
            demand = Demand.of(own.angle, own.stiffness, duration, scale)
            return Demand(*(np.broadcast_to(part, shape) for part in demand))

        joints = over_joints(of_joint, setpoints)
        return {
            name: over_joints(lambda own, field=field: getattr(own, field), joints) for name, field in _DEMAND.items()
        }

    def setpoints(self, lanes: SimulationProblem) -> PyTree:
        """Setpoints of runs, whose parts that vary have the runs along the last axis."""
        return in_order(self.shared.plant, sampled_runs(lanes.reference, self.shared.reference, self.times))

    def refine(self, runs: Runs, *, accuracy: float) -> Refinement:
        """Step doubling of some runs, with 64 bits."""
        every = spacing(self.times.size)
        shared, varying, setpoints = self.begun(self._some(runs), every)
        scale = self.shared.plant.mechanism.joint_type.scale
        near = near_reference(setpoints, functools.partial(self._desired, every), scale)

        def solve(substeps: int, which: Runs) -> Positions:
            padded = full_vectors(which)
            constant = *shared, np.asarray(self.period, float), np.asarray(substeps), every
            positions, _ = _positions(self.engine, constant, jax.tree.map(lambda leaf: leaf[..., padded], varying))
            return np.stack([x[..., : which.size] for x in positions])

        def meaningful(positions: Positions, which: Runs) -> NDArray[np.bool_]:
            return near(positions, which) & varying[-1][which]

        first, apart = self._first_substeps(runs, setpoints, varying[-2]), every * self.period
        return refine(solve, runs.size, accuracy=accuracy, spacing=apart, first=first, meaningful=meaningful)

    def _desired(self, every: int, values: ArrayLike, which: Runs) -> NDArray[np.float64]:
        """Setpoints of some runs, at every n-th control period."""
        desired = np.reshape(values, (self.times.size, -1))[::every]
        return desired if desired.shape[1] == 1 else desired[:, which]

    def check(self, substeps: int) -> None:
        """Warn of too few given steps where friction or flow, which are bounded, keeps runs from diverging.

        Raises `SimulationError` where they do not resolve the motion of a robot.
        """
        plant = eqx.combine(self.lanes, self.shared).plant
        joints = plant.mechanism.joint_names
        if not (plant.has_friction or plant.valve_of(0).holds_air or joints):
            return
        runs = probed_runs(self.lanes)
        some = self._some(runs)
        setpoints = self.setpoints(some)
        starts = starts_of(some, self.shared, setpoints, engine=self.engine)[0]
        if joints:
            first = self._plant(runs[0])
            angles = resolved_at(first, setpoints, jax.tree.map(lambda leaf: leaf[..., 0], starts))
            first.check_substeps(*angles, self.period, substeps)
            return
        needed = self._first_substeps(runs, setpoints, starts)
        if needed > substeps:
            text = f"substeps is {substeps}, too few for some runs, which friction or flow keeps from diverging"
            warnings.warn(f"{text}: their numbers may be wrong; give at least {needed}", McKibbenWarning, stacklevel=3)

    def _some(self, runs: Runs) -> SimulationProblem:
        """Parts of some runs that vary, with the runs along the last axis."""
        return jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf)[runs], 0, -1), self.lanes)

    def _plant(self, run: int) -> Plant:
        """Plant of a run."""
        own = jax.tree.map(lambda leaf: leaf[run], self.lanes.plant)
        return eqx.combine(own, self.shared.plant)

    def _first_substeps(self, runs: Runs, setpoints: PyTree, starts: PlantState) -> int:
        """Number of steps at which the integration of some runs is stable; of a robot, of the first one."""
        if not jax.tree.leaves(self.lanes.plant) or self.shared.plant.mechanism.joint_names:
            runs = runs[:1]
        needed = []
        for place, run in enumerate(runs):
            plant = self._plant(run)
            own = jax.tree.map(lambda values, at=place: values if values.ndim == 1 else values[:, at], setpoints)
            start = jax.tree.map(lambda leaf, at=place: leaf[..., at], starts)
            needed.append(plant.needed_substeps(*resolved_at(plant, own, start), self.period))
        return max(needed)


@BatchFunction
def _positions(shared: PyTree, lane: PyTree) -> tuple[Array, ...]:
    """Positions of one run over time."""
    problem, known, period, substeps, every = shared
    own, varying, start, _ = lane
    run, (setpoints, _) = eqx.combine(own, problem), known or varying
    return positions_over_time(run.plant, run.controller, setpoints, start, period, substeps, every)


@BatchFunction
def _run(shared: PyTree, lane: PyTree) -> dict[str, Array]:
    """Columns of one run."""
    problem, known, period, asked, substeps = shared
    own, varying, start, exists = lane
    run, precision = eqx.combine(own, problem), jnp.dtype(asked.precision)
    setpoints, change = cast(known or varying, precision)
    parts = *cast((run.plant, run.controller), precision), setpoints, *cast((start, period), precision), substeps
    if asked.kind is RobotMetrics:
        landing = landing_metrics(*parts)._asdict()
        return {name: landing[name] for name in asked.metrics} | {f"_{name}": landing[name] for name in _LANDED}
    coupling = "coupling" in asked.metrics
    streamed = streaming_episode(*parts, change=change, coupling=coupling, keep=asked.keep, every=asked.every)
    metrics = jax.tree.map(lambda value: jnp.where(exists, value, jnp.nan), streamed.metrics._asdict())
    deciding = {f"_{name}": metrics[name] for name in _DECIDING}
    deciding |= {"_started": exists, "_angle_at_end": streamed.angle_at_end}
    return {**{name: metrics[name] for name in asked.metrics}, **deciding, **streamed.kept}


_DECIDING = (
    *("angle_max", "angle_rmse", "stiffness_rmse", "oscillation_amplitude", "command_travel"),
    *("time_outside_domain", "time_overloaded", "time_saturated"),
)
_DEMAND = {f"_demand_{field}": field for field in Demand._fields}


_LANDED = ("peak_force", "peak_trunk_force", "time_outside_domain")


def _table(
    columns: Mapping[str, Any],
    over: Mapping[str, ArrayLike],
    times: NDArray,
    asked: _Asked,
    steps: StepCounts,
    mechanism: Mechanism,
) -> xr.Dataset:
    columns = {name: np.stack(values) if isinstance(values, tuple) else values for name, values in columns.items()}
    if asked.kind is RobotMetrics:
        worst = np.max([0.0 * columns[f"_{name}"] for name in _LANDED[:2]], axis=0)  # NaN of a lost run
        code = outcomes({"angle_max": worst, "time_outside_domain": columns["_time_outside_domain"]})
    else:
        code = outcomes(
            {name: columns[f"_{name}"] for name in _DECIDING},
            Demand(**{field: columns[name] for name, field in _DEMAND.items()}),
            angle_at_end=columns["_angle_at_end"],
            started=columns["_started"],
            by_joint=bool(mechanism.joint_names),
            scale=mechanism.joint_type.scale,
        )
    labels = labels_of(asked.kind)

    def column(name: str, *axes: str, along: str) -> tuple[Any, ...]:
        rows = [along] if along == "muscle" or (along and mechanism.joint_names) else []
        return (*rows, *axes), columns[name], attributes(name, mechanism.joint_type)

    table: dict[str, Any] = {name: column(name, "run", along=labels[name].along) for name in asked.metrics}
    table |= {name: ("run", values, attributes(name, mechanism.joint_type)) for name, values in steps.columns().items()}
    table |= {
        name: column(name, "run", "time", along=LABELS[name].along if name in LABELS else "") for name in asked.keep
    }
    used = {axis for axes, *_ in table.values() for axis in (axes if isinstance(axes, tuple) else ())}
    used |= {"joint"} if mechanism.joint_names else set()
    table |= {axis: list(mechanism.names_along(axis)) for axis in ("joint", "muscle") if axis in used}
    if asked.keep:
        table |= {"time": ("time", times, {"units": "s", "long_name": "time"})}
    return batch_table(table, code, over, joint_type=mechanism.joint_type.name)
