"""Runs of a comparison, drawn once for all controllers, and their simulation with a controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import ArrayLike, NDArray

from mckibben.binding import call
from mckibben.control import Reference, Samples, Sine
from mckibben.control.base import Setpoint, with_fields
from mckibben.errors import ParameterError
from mckibben.notebook import silent
from mckibben.numerics.batching import lanes_of
from mckibben.numerics.compiled import jit, numeric
from mckibben.scenario import StudiedScenario, batched, with_values
from mckibben.scenario.scenario import BatchParts
from mckibben.simulation import Batch, Metrics, Outcome
from mckibben.simulation.outcome import OUTCOMES
from mckibben.simulation.problem import check_frequencies, sample_reference, sampled_reference, sampling_times
from mckibben.study.compare.settings import NOMINAL_JOINT
from mckibben.study.compare.suite import ControllerSuite, Suite
from mckibben.study.parameters import sample
from mckibben.study.parameters.uncertainty import sensor_noise
from mckibben.study.study import Table

Tree = TypeVar("Tree")


@dataclass(frozen=True, eq=False)
class Group:
    """Runs with one joint and its valves, or of a robot, which differ only in numbers and can be batched."""

    joint: str
    rows: NDArray[np.int64]  # indices of these runs, shape (count,)
    conditions: Table  # values [SI] of the varied plant parameters, one per run
    parts: BatchParts  # with arrays of shape (count, ...) where runs differ; references of a joint are sampled
    models: PyTree = None  # joint and load of the models, with arrays of shape (count,); None for those of the suite

    @property
    def count(self) -> int:
        """Number of runs."""
        return self.rows.size


@dataclass(frozen=True, eq=False)
class Runs:
    """Runs of a suite, the same for all controllers; `draw` makes them.

    Parameters that vary are arrays over the runs, and `groups` batches the runs of each joint.
    """

    suite: ControllerSuite
    joint: Sequence[str]  # names, of each run
    reference_name: Sequence[str]
    conditions: Table  # values [SI] of varied plant parameters by name, one per run
    reference_values: dict[str, Table]  # likewise, for each reference, one per run in order
    groups: tuple[Group, ...]  # plants and references

    @property
    def count(self) -> int:
        """Number of runs."""
        return len(self.joint)

    def scenario(self, controller: str, run: int, values: Mapping[str, float] | None = None) -> StudiedScenario:
        """Scenario of one run, numbered from 0, with a controller of tuned values [SI]."""
        reference, joint = self.reference_name[run], self.joint[run]
        group = next(group for group in self.groups if group.joint == joint)
        of_group = np.searchsorted(group.rows, run), group.conditions
        referred = self.reference_name[:run].count(reference), self.reference_values.get(reference, {})
        numbers = {name: column[row].item() for row, table in (of_group, referred) for name, column in table.items()}
        numbers |= values or {}
        scenario = self.suite.scenario(controller, reference, joint)
        return self.suite.at_rest(with_values(scenario, numbers) if numbers else scenario)

    def table(self) -> Table:
        """Joint, reference and varied parameters [SI] of all runs; NaN for those of other references."""
        table: dict[str, NDArray] = {"joint": np.array(self.joint), "reference": np.array(self.reference_name)}
        table |= self.conditions
        for reference, varied in self.reference_values.items():
            for name, values in varied.items():
                table.setdefault(name, np.full(self.count, np.nan))[table["reference"] == reference] = values
        return table

    def only(self, rows: NDArray[np.int64]) -> Runs:
        """Some of the runs, for their simulation."""
        groups = []
        for group in self.groups:
            kept = np.isin(group.rows, rows)
            if not kept.any():
                continue
            _, varying = lanes_of(group.parts)
            some = jax.tree.map(lambda leaf, varies, kept=kept: leaf[kept] if varies else leaf, group.parts, varying)
            conditions = {name: column[kept] for name, column in group.conditions.items()}
            groups.append(Group(group.joint, np.searchsorted(rows, group.rows[kept]), conditions, some))
        return replace(self, joint=[self.joint[row] for row in rows], groups=tuple(groups))

    def without_noise(self, rows: NDArray[np.int64]) -> Runs:
        """Some of the runs, with ideal sensors."""
        names, runs = [name.removeprefix("sensors.") for name in sensor_noise(self.suite.example())], self.only(rows)
        groups = []
        for group in runs.groups:
            sensors = replace(group.parts.plant.sensors, **dict.fromkeys(names, np.zeros(group.count)))
            groups.append(replace(group, parts=group.parts._replace(plant=replace(group.parts.plant, sensors=sensors))))
        return replace(runs, groups=tuple(groups))

    def calibrated(self, progress: Callable[[float], None]) -> tuple[Runs, NDArray[np.bool_]]:
        """Those of the first runs whose plants can be calibrated, with these models, and whether each of the first is.

        Raises `ParameterError` if none can.
        """
        settings, first = self.suite.calibration, next(iter(self.suite.controllers))  # type: ignore[attr-defined]
        count = min(settings.runs, self.count)
        models = []
        for run in range(count):
            progress(run / count)
            models.append(call("calibrated_models", self.scenario(first, run), settings))
        done = np.array([model is not None for model in models])
        if not done.any():
            remedy = "give another weight, or a smaller angle, in `calibration`"
            raise ParameterError("no plant can be calibrated with the first controller", remedy=remedy)
        kept, groups = self.only(np.flatnonzero(done)), []
        known = [model for model in models if model is not None]
        for group in kept.groups:
            stacked = jax.tree.map(lambda *numbers: np.stack(numbers), *[known[row] for row in group.rows])
            groups.append(replace(group, models=stacked))
        return replace(kept, groups=tuple(groups)), done


def draw(suite: ControllerSuite, count: int, seed: int) -> Runs:
    """Draw runs.

    Joints and references occur in their shares, in random order; parameters are scrambled Sobol points of their ranges.
    If the suite has sensors, each run has its own noise seed.

    Parameters
    ----------
    suite
        Plants, references and conditions.
    count
        Number of runs.
    seed
        Seed of the order and of the points; the same seed draws the same runs on any machine.

    Raises
    ------
    ParameterError
        If the conditions of a run do not give a valid scenario.
    SimulationError
        If a frequency of a reference is at or above half the control rate, or a plant needs more substeps.
    """
    conditions = dict(sample(suite.conditions_over(), samples=count, seed=seed)) if suite.conditions else {}
    if suite.has_noise and "sensors.seed" not in conditions:
        conditions["sensors.seed"] = np.arange(count, dtype=np.int64) + (1000 * seed) % 2**30
    if not isinstance(suite, Suite):
        parts = _with_columns(suite.example(), conditions).batch_parts()
        group = Group(NOMINAL_JOINT, np.arange(count), conditions, parts)
        return Runs(suite, (NOMINAL_JOINT,) * count, ("reference",) * count, conditions, {}, (group,))
    orders = np.random.default_rng(seed).spawn(2)
    joints = _dealt({name: plant.share for name, plant in suite.plants.items()}, count, orders[0])
    names = _dealt({name: case.share for name, case in suite.references.items()}, count, orders[1])
    times = sampling_times(suite.duration, suite.control_period)
    values: dict[str, Table] = {}
    setpoints = np.empty((2, count, times.size))
    for number, name in enumerate(suite.references):
        rows = np.flatnonzero(np.array(names) == name)
        values[name] = {}
        if rows.size:
            values[name] = table = _reference_values(suite, name, rows.size, seed + 7919 * (number + 1))
            reference = _with_columns(suite.example(name), table).reference()
            check_frequencies(reference, suite.control_period)
            setpoints[:, rows] = _sampled(reference, times)
    groups = []
    for joint in dict.fromkeys(joints):
        rows, scenario = np.flatnonzero(np.array(joints) == joint), suite.example(joint=joint)
        if suite.substeps is not None:
            scenario.plant().check_substeps(setpoints[0], setpoints[1], suite.control_period, suite.substeps)
        varied = {name: column[rows] for name, column in conditions.items() if suite.has(joint, name)}
        reference = Reference(*(Samples(times, column[rows]) for column in setpoints))
        groups.append(Group(joint, rows, varied, BatchParts(_with_columns(scenario, varied).plant(), reference)))
    return Runs(suite, joints, names, conditions, values, tuple(groups))


def _with_columns(scenario: PyTree, columns: Table, **options: PyTree) -> PyTree:
    """A batch of scenarios, or the scenario itself without any columns."""
    return batched(scenario, columns, **options) if columns else scenario


def _sampled(reference: Reference, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Setpoints of one reference or a batch of them, shape (2, 1 or runs, periods)."""
    count, varying = lanes_of(reference)
    lanes, shared = eqx.partition(numeric(reference), varying)
    if count is None:
        return np.stack(sampled_reference(reference, times))[:, None]
    return np.stack(_sampled_lanes(lanes, shared, times))


@jit
def _sampled_lanes(lanes: Reference, shared: Reference, times: NDArray[np.float64]) -> Setpoint:
    return jax.vmap(lambda lane: sample_reference(eqx.combine(lane, shared), times))(lanes)


def _dealt(shares: dict[str, int], count: int, order: np.random.Generator) -> list[str]:
    """Names in their shares, in random order."""
    names = [name for name, share in shares.items() for _ in range(share)]
    return [names[i % len(names)] for i in order.permutation(count)]


def _reference_values(suite: Suite, name: str, count: int, seed: int) -> Table:
    """Values of a reference's varied parameters, with sine amplitudes of the angle within the suite's limits."""
    varied = suite.reference_over(name)
    table = dict(sample(varied, samples=count, seed=seed)) if varied else {}
    sine = suite.references[name].reference.angle
    if isinstance(sine, Sine):
        amplitude, frequency = (
            table.get(f"reference.angle.{term}", np.full(count, getattr(sine, term)))
            for term in ("amplitude", "frequency")
        )
        rate = np.maximum(2 * np.pi * frequency, 1e-6)
        limits = (suite.max_angular_velocity, rate), (suite.max_angular_acceleration, rate**2)
        for largest in (most / factor for most, factor in limits if most is not None):
            table["reference.angle.amplitude"] = amplitude = np.clip(amplitude, -largest, largest)
    return table


def evaluate(
    runs: Runs,
    controller: str,
    values: Mapping[str, ArrayLike],
    *,
    metrics: Sequence[str] = Metrics._fields,
    engine: str = "auto",
) -> Batch:
    """Simulate the runs with a controller of given values [SI], or all runs for each of several sets of values.

    Parameters
    ----------
    runs
        Runs of a suite, of which each joint is one batch.
    controller
        Name of a controller of the suite.
    values
        Tuned values [SI] by name, numbers or arrays of shape (sets,).
    metrics, engine
        As for `simulate_many`.

    Returns
    -------
    Batch
        All runs of the first set, then those of the next: shape (sets * runs,).

    Raises
    ------
    ParameterError
        If no run can start.
    """
    import xarray as xr

    table = {name: np.atleast_1d(np.asarray(value)) for name, value in values.items()}
    sets = max(map(len, table.values()), default=1)
    batches, lanes = [], []
    for group in runs.groups:
        control = controller_of(runs, group, controller, table, sets)
        batches.append(simulate_group(runs.suite, group, control, sets, tuple(metrics), engine).table)
        lanes.append((np.arange(sets)[:, None] * runs.count + group.rows).ravel())
    whole = xr.concat(batches, "run", combine_attrs="override").isel(run=np.argsort(np.concatenate(lanes)))
    engines = [table.attrs.get("engine", "") for table in batches]
    batch = Batch(whole.assign_attrs(engine="xla" if "xla" in engines else engines[0]))
    if not started(batch).any():
        raise ParameterError(
            "none of the runs can start: no pressures hold their plants at the start of their references",
            remedy="give references that start at other angles, or change the joint or its load",
        )
    return batch


def controller_of(runs: Runs, group: Group, controller: str, table: Table, sets: int) -> PyTree:
    """A controller with sets of values, each used in all runs of a group: arrays of shape (sets * runs,)."""
    columns = {name: np.repeat(np.asarray(column), group.count) for name, column in table.items()}
    suite = runs.suite
    if controller not in suite.true_model:
        control = _with_columns(suite.scenario(controller), columns).control()
        return control if group.models is None else with_fields(control, _tiled(group.models, sets))
    columns |= {name: np.tile(column, sets) for name, column in group.conditions.items()}
    return _with_columns(suite.scenario(controller, joint=group.joint), columns, model_follows="all").control()


def simulate_group(
    suite: ControllerSuite, group: Group, controller: PyTree, sets: int, metrics: tuple[str, ...], engine: str
) -> Batch:
    """Simulate the runs of a group with a controller of sets of values."""
    options: dict[str, PyTree] = {"metrics": metrics, "engine": engine, "progress": silent}
    return suite.example().run_parts(_tiled(group.parts, sets), controller, **options)


def _tiled(tree: Tree, sets: int) -> Tree:
    """A batch of runs repeated for sets of values; leaves that do not vary are unchanged."""
    _, varying = lanes_of(tree)

    def repeated(leaf: PyTree, varies: bool) -> PyTree:
        return np.tile(leaf, (sets, *[1] * (np.ndim(leaf) - 1))) if varies else leaf

    return jax.tree.map(repeated, tree, varying)


def started(batch: Batch) -> NDArray[np.bool_]:
    """Return the mask of the runs that could start. Shape (runs,)."""
    return batch["outcome"] != OUTCOMES.index(Outcome.NO_START)
