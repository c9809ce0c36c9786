"""Simulation of the runs of a comparison with a controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.control import Controller
from mckibben.notebook import silent
from mckibben.numerics.batching import lanes_of
from mckibben.scenario import batched
from mckibben.simulation import Batch, Metrics, simulate_many
from mckibben.study.compare.runs import Group, Runs, merged
from mckibben.study.compare.suite import Suite
from mckibben.study.study import Table


def evaluate(
    runs: Runs, controller: str, values: Mapping[str, ArrayLike], *, metrics: Sequence[str] = Metrics._fields
) -> Batch:
    """Simulate the runs with a controller of given values [SI], or all runs for each of several sets of values."""
    table = {name: np.atleast_1d(np.asarray(value)) for name, value in values.items()}
    return simulate_runs(runs, controller, table, max(map(len, table.values()), default=1), tuple(metrics))


def engines_used(runs: Runs, controller: str, table: Table, metrics: tuple[str, ...]) -> set[str]:
    """Return the engines of the runs with one set of values [SI]."""
    used = set()
    for group in runs.groups:
        control = _controller_of(runs, group, controller, table, 1)
        used.add(_simulate_group(runs.suite, group, control, 1, metrics, "auto").engine)
    return used


def _controller_of(runs: Runs, group: Group, controller: str, table: Table, sets: int) -> Controller:
    """A controller with sets of values, each used in all runs of a group: arrays of shape (sets * runs,)."""
    suite, reference = runs.suite, next(iter(runs.suite.references))
    columns = {name: np.repeat(np.asarray(column), group.count) for name, column in table.items()}
    if controller not in suite.true_model:
        scenario = suite.scenario(controller, reference)
        return (batched(scenario, columns) if columns else scenario).control()
    parts = []
    for joint in dict.fromkeys(group.joint):
        own = np.flatnonzero([name == joint for name in group.joint])
        lanes = _lanes(own, group.count, sets)
        conditions = runs.conditions_of(joint, group.rows[own])
        values = {name: np.tile(column, sets) for name, column in conditions.items()}
        values |= {name: column[lanes] for name, column in columns.items()}
        scenario = suite.scenario(controller, reference, joint)
        parts.append((lanes, (batched(scenario, values, model_follows="all") if values else scenario).control()))
    return merged(parts, group.count * sets)


def _lanes(rows: NDArray[np.int64], count: int, sets: int) -> NDArray[np.int64]:
    """Indices of selected runs, repeated for sets of values."""
    return (np.arange(sets)[:, None] * count + rows).ravel()


def _tiled(tree: Any, sets: int) -> Any:
    """A batch of runs repeated for sets of values; leaves that do not vary are unchanged."""
    _, varying = lanes_of(tree)
    return jax.tree.map(
        lambda leaf, varies: np.tile(leaf, (sets, *[1] * (np.ndim(leaf) - 1))) if varies else leaf, tree, varying
    )


def simulate_runs(
    runs: Runs, controller: str, table: Table, sets: int, metrics: tuple[str, ...], engine: str = "auto"
) -> Batch:
    """Simulate all runs with sets of values [SI], one group of runs after the other."""
    batches, lanes = [], []
    for group in runs.groups:
        control = _controller_of(runs, group, controller, table, sets)
        batches.append(_simulate_group(runs.suite, group, control, sets, metrics, engine))
        lanes.append(_lanes(group.rows, runs.count, sets))
    if len(batches) == 1:
        return batches[0]
    import xarray as xr

    whole: Any = xr.concat([batch.table for batch in batches], "run")
    return Batch(whole.isel(run=np.argsort(np.concatenate(lanes))))


def _simulate_group(
    suite: Suite, group: Group, controller: Controller, sets: int, metrics: tuple[str, ...], engine: str
) -> Batch:
    """Simulate the runs of a group with a controller of sets of values."""
    plant, reference = (_tiled(part, sets) for part in (group.plant, group.reference))
    return simulate_many(plant, controller, reference, **suite.timing, metrics=metrics, engine=engine, progress=silent)
