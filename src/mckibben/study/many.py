"""A scenario run many times, with other numbers in some of its fields each time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp

from mckibben.simulation import Batch, Metrics, simulate_many
from mckibben.study.parameters import Known, Table, lanes
from mckibben.study.scenario import Scenario
from mckibben.study.starting import rest


def run_many(
    scenario: Scenario,
    table: Table,
    *,
    known: Known = (),
    metrics: Sequence[str] = Metrics._fields,
    precision: Any = jnp.float64,
    chunk: int | None = None,
    workers: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Batch:
    """Simulate a scenario once for each row of a table of values.

    Parameters
    ----------
    scenario
        What all runs share.
    table
        Arrays of one length by the names of the scenario's fields, SI; see `mckibben.study.parameters.design`.
    known
        Numbers of the plant that the controller's model follows; see `mckibben.study.parameters.lanes`.
    metrics, precision, chunk, workers, progress
        As for `simulate_many`.

    Raises
    ------
    ParameterError
        If a row of the table makes no valid scenario; it names the first.

    Examples
    --------
    >>> scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.2})
    >>> run_many(scenario, {"load.mass2": [0.4, 0.5]}, metrics=["angle_rmse"]).count
    2
    """
    many = lanes(scenario, table, known=known)
    return simulate_many(
        many.plant(),
        many.control(),
        many.reference(),
        duration=scenario.duration,
        control_period=scenario.control_period,
        substeps=scenario.substeps,
        initial=rest(many),
        metrics=metrics,
        precision=precision,
        chunk=chunk,
        workers=workers,
        progress=progress,
    )
