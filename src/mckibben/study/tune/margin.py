"""Stability margin of a scenario's loop, by simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mckibben.errors import ParameterError
from mckibben.study.parameters import Table, find_parameters
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.building import run_many

_FACTORS = 64


def stability_margin(
    scenario: Scenario,
    names: Sequence[str],
    *,
    largest: float = 10.0,
    growth: float = 3.0,
    conditions: Table | None = None,
) -> float:
    """Return the factor by which parameters may rise together before the loop oscillates.

    The scenario runs once for each of 64 factors from 1 to `largest`; a loop is taken for unstable from the first run
    on that fails, or whose RMS angle error is `growth` times that of factor 1. Pressure limits turn an unstable loop
    into a limit cycle, which only a reference that moves little, such as a small step, tells from slow tracking.
    Controllers keep their nominal model.

    Parameters
    ----------
    names
        Parameters: all gains of a loop for its gain margin, ``valve.time_constant`` for that of an unmodelled lag.
    largest, growth
        Largest factor, and ratio of errors, both above 1.
    conditions
        Values [SI] of other parameters by name; the margin is then the least of all rows.

    Returns
    -------
    float
        Largest factor below the first unstable one, to a step of the factors (3.7 % for 10); infinite where all are
        stable.

    Raises
    ------
    ParameterError
        If a parameter is unknown, is zero or has no value, or a factor takes it outside its range; if the run fails as
        it is; or a number is not above 1.
    """
    for what, number in (("largest", largest), ("growth", growth)):
        if not (np.isfinite(number) and number > 1):
            raise ParameterError(f"{what} is {number:g}", value=number, remedy="give a number above 1")
    factors, conditions = np.geomspace(1.0, largest, _FACTORS), conditions or {}
    rows = len(next(iter(conditions.values()))) if conditions else 1
    table = {name: np.repeat(column, _FACTORS) for name, column in conditions.items()}
    for each in find_parameters(scenario, names):
        if not each.nominal:
            raise ParameterError(f"{each.name} has no value to multiply", remedy="give it one in the scenario")
        table[each.name] = np.tile(each.nominal * factors, rows)
    batch = run_many(scenario, table, metrics=("angle_rmse",))
    error = np.where(batch.failed, np.inf, batch["angle_rmse"]).reshape(rows, _FACTORS)
    if not np.isfinite(error[:, 0]).all():
        raise ParameterError("the run fails as it is", remedy="simulate it, and see why")
    unstable = (error > growth * error[:, :1]).any(axis=0)
    return float(factors[np.argmax(unstable) - 1]) if unstable.any() else np.inf
