"""Tuning objective: the cost of many sets of parameters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.control import RandomSteps, Samples, Step
from mckibben.errors import ParameterError
from mckibben.numerics.batching import cores
from mckibben.scenario import (
    ModelFollows,
    Scenario,
    batched,
    find_parameters,
    followed_names,
    initial_state,
    run_many,
    valid_rows,
)
from mckibben.simulation import Batch, disk_margins
from mckibben.simulation.problem import check_frequencies
from mckibben.study.parameters import SweptParameter, Table
from mckibben.study.tune.cost import Cost
from mckibben.study.tune.search import Vector
from mckibben.study.tune.space import SearchSpace, is_gain
from mckibben.study.tune.trials import Evaluated

_DELAY = "command_delay"

FAILED_COST = 1e6
"""Cost of parameters that are invalid or whose runs fail."""
UNSTABLE_COST = 1e5
"""Least cost of parameters without the disk margin: at most twice this, as the margin goes to 0."""


@dataclass(frozen=True)
class TuningProblem:
    """Parameters of scenarios to tune, and the cost of their values."""

    scenarios: tuple[Scenario, ...]
    space: SearchSpace
    cost: Cost
    model_follows: ModelFollows = ()  # plant parameters that the controllers' models follow
    conditions: Table = field(default_factory=dict)  # other parameters; each set of values runs under every row of them
    engine: str = "auto"
    _stepped: dict[int, Scenario] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        for scenario in self.scenarios:
            try:
                self._followed(scenario)
            except ParameterError as error:
                if len(self.scenarios) == 1:
                    raise
                raise ParameterError(f"{scenario.name}: {error}", value=error.value) from None
            if self.conditions:
                check_frequencies(batched(scenario, self.conditions).reference(), scenario.control_period)
            if "coupling" in self.cost.metrics:
                _check_steps(scenario)
            if "air" in self.cost.metrics:
                muscles = zip((scenario.joint.muscle1, scenario.joint.muscle2), scenario.joint.springs, strict=True)
                for muscle, is_spring in muscles:
                    if not is_spring:
                        muscle.specimen.braid("the air consumption")

    @classmethod
    def of(
        cls,
        scenarios: Sequence[Scenario],
        swept: Sequence[SweptParameter],
        cost: Cost,
        model_follows: ModelFollows = (),
        conditions: Table | None = None,
    ) -> TuningProblem:
        """Problem with the nominal values of the first scenario."""
        if not scenarios:
            raise ParameterError("nothing to tune", remedy="give a scenario")
        names = [tuned.name for tuned in swept]
        if both := [name for name in names if name in (conditions or {})]:
            raise ParameterError(f"{both[0]} is tuned and a condition", value=both[0], remedy="give it once")
        parameters = find_parameters(scenarios[0], names)
        pairs = zip(swept, parameters, strict=True)
        space = SearchSpace(tuple(replace(tuned, parameter=parameter) for tuned, parameter in pairs))
        return cls(tuple(scenarios), space, cost, model_follows, conditions or {})

    def _followed(self, scenario: Scenario) -> tuple[str, ...]:
        """Parameters that the controller's model follows; it does not know a delay that is longer by the margin."""
        names = followed_names(scenario, self.model_follows, [*self.space.names, *self.conditions])
        if not self.cost.delay_margin or _DELAY not in names:
            return names
        if self.model_follows != "all":
            message = f"the model follows {_DELAY}, but no controller knows the delay margin"
            raise ParameterError(
                message, value=_DELAY, remedy=f"leave {_DELAY} out of model_follows, or the delay margin at 0"
            )
        return tuple(name for name in names if name != _DELAY)

    @property
    def _draws(self) -> int:
        """Number of conditions."""
        return len(next(iter(self.conditions.values()))) if self.conditions else 1

    def costs(self, values: Vector) -> Vector:
        """Cost of each row of values [SI], shape (n, parameters)."""
        rows = self._with_margin(values)
        share = max(cores() // len(self.scenarios), 1)
        with ThreadPoolExecutor(cores()) as pool:
            measured = pool.map(lambda scenario: self._metrics(scenario, rows, share), self.scenarios)
            parts = [self.cost(metrics).reshape(self._draws, -1) for metrics in measured]
        costs = self._combine(np.concatenate(parts))
        wanted = self.cost.disk_margin
        if not wanted:
            return costs
        least = np.min([self._disk_margins(scenario, values) for scenario in self.scenarios], axis=0)
        # Feasible points first, then by their violation: K. Deb, Comput. Methods Appl. Mech. Eng. 186, 2000.
        return np.where((least < wanted) & (costs < FAILED_COST), UNSTABLE_COST * (2 - least / wanted), costs)

    def kept_margin(self, most: float) -> float:
        """Disk margin that tuned gains keep: that of the nominal ones, at most `most`, and 0 if there are no gains."""
        if not any(map(is_gain, self.space.names)):
            return 0.0
        margins = (float(self._disk_margins(scenario, self.space.nominal[None])[0]) for scenario in self.scenarios)
        return min(most, *(float(f"{0.99 * margin:.3g}") for margin in margins))  # the same on all machines

    def _disk_margins(self, scenario: Scenario, values: Vector) -> Vector:
        """Least disk margin of each row of values [SI] over the conditions; 0 if a condition is invalid."""
        rows = np.tile(values, (self._draws, 1))
        table = {name: rows[:, i] for i, name in enumerate(self.space.names)}
        table |= {name: np.repeat(column, len(values)) for name, column in self.conditions.items()}
        good = valid_rows(scenario, table)
        if not good.any():
            return np.zeros(len(values))
        many = batched(scenario, with_valid(table, good), model_follows=self._followed(scenario))
        margins = disk_margins(
            many.plant(),
            many.control(),
            many.reference(),
            initial_state(many),
            duration=scenario.duration,
            control_period=scenario.control_period,
            substeps=self._with_steps(scenario).substeps or 1,
        )
        return np.where(good, np.nan_to_num(margins), 0.0).reshape(self._draws, -1).min(axis=0)

    def evaluate(self, values: Vector) -> Evaluated:
        """Return the costs of rows of values [SI]."""
        return Evaluated(self.costs(values))

    def engines_used(self) -> set[str]:
        """Engines of the runs at the nominal values."""
        used = set()
        for scenario in self.scenarios:
            good, table = self._valid(scenario, self._with_margin(self.space.nominal[None]))
            if good.any():
                first = {name: column[np.argmax(good)][None] for name, column in table.items()}
                used.add(self._run(scenario, first).engine)
        return used

    def _with_steps(self, scenario: Scenario) -> Scenario:
        """The scenario with the integration steps that its nominal values need, which all trials have."""
        if scenario.substeps is not None:
            return scenario
        if id(scenario) not in self._stepped:
            good, table = self._valid(scenario, self._with_margin(self.space.nominal[None]))
            steps = None
            if good.any():
                batch = self._run(scenario, table, metrics=("angle_rmse",), engine=self.engine)
                steps = int(batch["substeps"][good].max())
            self._stepped[id(scenario)] = scenario.model_copy(update={"substeps": steps})
        return self._stepped[id(scenario)]

    def _gain_factors(self) -> Vector:
        """Factor on each value in the rows with the margin."""
        return np.where([is_gain(name) for name in self.space.names], self.cost.gain_margin, 1.0)

    def _with_margin(self, values: Vector) -> Vector:
        """Rows of values, then the rows with the margin, repeated for each condition."""
        if self.cost.has_margin:
            parameters = [tuned.parameter for tuned in self.space.swept]
            lower, upper = np.array([(parameter.lower, parameter.upper) for parameter in parameters]).T
            values = np.concatenate([values, np.clip(values * self._gain_factors(), lower, upper)])
        return np.tile(values, (self._draws, 1))

    def _combine(self, costs: Vector) -> Vector:
        """Combine costs, shape (runs, rows), into one per set of values, the larger one without and with margin."""
        count, rows = costs.shape
        costs = np.where(np.isfinite(costs), np.minimum(costs, FAILED_COST), FAILED_COST)
        if self.cost.percentile is None:
            total = np.sum(costs * (1.0 / count), axis=0)
            total[np.any(costs >= FAILED_COST, axis=0)] = FAILED_COST
        else:
            rank = math.ceil(self.cost.percentile / 100 * count) - 1
            total = np.sort(costs, axis=0)[rank]
        return total.reshape(-1, rows // 2 if self.cost.has_margin else rows).max(axis=0)

    def _table(self, scenario: Scenario, rows: Vector) -> Table:
        tuned = {name: rows[:, i] for i, name in enumerate(self.space.names)}
        table: dict[str, Any] = tuned | {
            name: np.repeat(column, len(rows) // self._draws) for name, column in self.conditions.items()
        }
        if self.cost.delay_margin:
            late = np.arange(len(rows)) // (len(rows) // (2 * self._draws)) % 2
            own = table.get(_DELAY, scenario.command_delay or 0.0)
            table[_DELAY] = own + self.cost.delay_margin * late
        return table

    def _valid(self, scenario: Scenario, rows: Vector) -> tuple[NDArray[np.bool_], Table]:
        """Mask of the valid rows, and the table of the rows with invalid ones replaced by a valid one."""
        good = valid_rows(scenario, self._table(scenario, rows))
        rows = rows if good.all() else np.where(good[:, None], rows, rows[np.argmax(good)])
        return good, self._table(scenario, rows)

    def _run(self, scenario: Scenario, table: Table, **options: Any) -> Batch:
        return run_many(
            scenario, table, **{"model_follows": self._followed(scenario), "metrics": self.cost.metrics} | options
        )

    def _metrics(self, scenario: Scenario, rows: Vector, workers: int) -> dict[str, Vector]:
        good, table = self._valid(scenario, rows)
        if not good.any():
            return {name: np.full(len(rows), np.nan) for name in self.cost.metrics}
        batch = self._run(self._with_steps(scenario), table, workers=workers, engine=self.engine)
        good &= batch.usable
        return {name: np.where(good, values, np.nan) for name, values in batch.metrics.items()}


def with_valid(table: Table, good: NDArray[np.bool_]) -> Table:
    """Return the table with invalid rows replaced by a valid one."""
    return {name: np.where(good, column, column[np.argmax(good)]) for name, column in table.items()}


def _check_steps(scenario: Scenario) -> None:
    stiffness = scenario.signals.stiffness
    if not isinstance(stiffness, Step | RandomSteps | Samples):
        raise ParameterError(
            f"coupling is not defined for {scenario.name!r}: its desired stiffness never steps",
            remedy="leave it out of the cost, or give the stiffness a step",
        )
