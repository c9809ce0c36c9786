"""Stability margins of a scenario's loop: by simulation, and least ones of the linearised loop with its metrics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.control import Reference, Step
from mckibben.errors import McKibbenError, ParameterError
from mckibben.plant import NoDisturbance
from mckibben.scenario import ModelFollows, Scenario, find_parameters, run_many, run_scenario
from mckibben.simulation.metrics import METRICS, in_shown_units
from mckibben.study.parameters import Table
from mckibben.units import deg

SMALL_STEP = 0.2 * deg
DISK_MARGIN = 0.4
"""Disk margin below which a loss is reported: gains off by 1.5, phases by 23 deg."""
_STEP_AT = 0.1  # of the duration
_FACTORS = 64
_OF_STEP = ("start", "reference", "disturbance")  # sections that `on_small_step` replaces


def on_small_step(scenario: Scenario) -> Scenario:
    """The scenario with a step of 0.2 deg from its start at constant stiffness, without disturbance torques."""
    start = scenario.start
    stiffness = float(scenario.reference().stiffness(0.0)) if start.stiffness is None else start.stiffness
    step = Step(start.angle, start.angle + SMALL_STEP, at=_STEP_AT * scenario.duration)
    return scenario.model_copy(update={"signals": Reference(step, stiffness), "disturbance": NoDisturbance()})


def stability_margin(
    scenario: Scenario,
    names: Sequence[str],
    *,
    largest: float = 10.0,
    growth: float = 3.0,
    conditions: Table | None = None,
    model_follows: ModelFollows = (),
) -> float:
    """Return the factor by which parameters may be increased together before the loop oscillates.

    The scenario runs once for each of 64 factors from 1 to `largest`; the loop is assumed unstable from the first run
    that fails or whose RMS angle error is `growth` times that of factor 1. Pressure limits turn an unstable loop into a
    limit cycle, which can be distinguished from slow tracking only with a small reference motion, as in
    `on_small_step`.

    Raises `ParameterError` if a parameter is unknown, zero or has no value, or a factor takes it outside its range; if
    the nominal run fails; or if a number is not above 1.

    Parameters
    ----------
    names
        Parameters: all gains of a loop for its gain margin, ``valve.time_constant`` for the margin to an unmodelled
        lag.
    largest, growth
        Largest factor, and ratio of errors, both above 1.
    conditions
        Values [SI] of other parameters by name; the margin is then the smallest over all rows.
    model_follows
        Plant parameters that the controller's model follows, "all" for all of them. Default: none.

    Returns
    -------
    float
        Largest factor below the first unstable one, to a step of the factors (3.7 % for 10); infinite if all are
        stable.
    """
    for what, number in (("largest", largest), ("growth", growth)):
        if not (np.isfinite(number) and number > 1):
            raise ParameterError(f"{what} is {number:g}", value=number, remedy="give a number above 1")
    factors, conditions = np.geomspace(1.0, largest, _FACTORS), conditions or {}
    rows = len(next(iter(conditions.values()))) if conditions else 1
    table = {name: np.repeat(column, _FACTORS) for name, column in conditions.items()}
    for parameter in find_parameters(scenario, names):
        if not parameter.nominal:
            raise ParameterError(f"{parameter.name} has no value to multiply", remedy="set it in the scenario")
        table[parameter.name] = np.tile(parameter.nominal * factors, rows)
    batch = run_many(scenario, table, model_follows=model_follows, metrics=("angle_rmse",))
    error = np.where(batch.failed, np.inf, batch["angle_rmse"]).reshape(rows, _FACTORS)
    if not np.isfinite(error[:, 0]).all():
        raise ParameterError("the nominal run fails", remedy="simulate it to see why")
    unstable = (error > growth * error[:, :1]).any(axis=0)
    return float(factors[np.argmax(unstable) - 1]) if unstable.any() else np.inf


def lost_margin(before: float, after: float) -> str:
    """Note on a least disk margin that tuning reduced below `DISK_MARGIN`; empty without such a loss."""
    lost = after < min(before, DISK_MARGIN)
    return f"tuning reduced the least disk margin from {before:.2g} to {after:.2g}" if lost else ""


UNSTABLE = (
    "least margins of 0: the linearised loop is unstable at some points of the run; `mckibben margins` shows where, "
    "and whether sticking friction bounds the oscillation"
)
"""Note on tuned gains without a disk margin."""


class Robustness(NamedTuple):
    """A scenario under conditions, and its stability on a small step."""

    angle_rmse: NDArray[np.float64]  # [rad], infinite if diverged
    unstable: int  # conditions in which the error exceeds the step
    gain_margin: float | None  # 0 if there are such; None if there are no gains


def in_conditions(
    scenario: Scenario, gains: Sequence[str], conditions: Table, *, largest: float, model_follows: ModelFollows = ()
) -> Robustness:
    """Return errors under conditions and the margin of nonzero gains, at most `largest` or their range."""

    def errors(of: Scenario, rows: Table) -> NDArray[np.float64]:
        batch = run_many(of, rows, model_follows=model_follows, metrics=("angle_rmse",))
        return np.where(batch.failed, np.inf, batch["angle_rmse"])

    moved = errors(scenario, conditions)
    if not gains:
        return Robustness(moved, 0, None)
    tuned = find_parameters(scenario, gains)
    same = {tuned[0].name: np.full(moved.size, tuned[0].nominal)}  # conditions may concern only the reference
    small = on_small_step(scenario)
    rows = same | {n: x for n, x in conditions.items() if n.split(".")[0] not in _OF_STEP}
    if unstable := int((errors(small, rows) > SMALL_STEP).sum()):
        return Robustness(moved, unstable, 0.0)
    most = min(largest, *(float(gain.upper) / float(gain.nominal or 1.0) for gain in tuned))
    del rows[tuned[0].name]
    return Robustness(
        moved, 0, min(stability_margin(small, gains, largest=most, conditions=rows, model_follows=model_follows), most)
    )


def metrics_and_margins(scenario: Scenario) -> tuple[dict[str, float], dict[str, float]]:
    """Metrics of a run and its least stability margins, by name and in shown units; NaN if it cannot be run."""
    margins: dict[str, float] = dict.fromkeys(("gain", "phase_deg", "delay_ms", "disk"), np.nan)
    try:
        metrics = in_shown_units(run_scenario(scenario).metrics)
        margins = scenario.margins().least()
    except McKibbenError:
        return dict.fromkeys(METRICS, np.nan), margins
    return metrics, margins
