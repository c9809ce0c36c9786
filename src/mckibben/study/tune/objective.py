"""Tuning objective: the cost of many sets of parameters, and its gradient."""

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
from mckibben.numerics.batching import cores, named_leaves
from mckibben.scenario import (
    Known,
    Scenario,
    batched,
    find_parameters,
    initial_state,
    known_names,
    run_many,
    valid_rows,
)
from mckibben.simulation import Batch, differentiate, disk_margins
from mckibben.simulation.problem import SimulationProblem, check_frequencies, split_problem
from mckibben.study.parameters import SweptParameter, Table
from mckibben.study.tune.cost import Cost
from mckibben.study.tune.search import SearchSpace, Vector, is_gain

SMOOTH = (
    "angle_rmse",
    "angle_max",
    "stiffness_rmse",
    "stiffness_max",
    "stiffness_ripple",
    "coupling",
    "estimate_rmse",
    "excursion_max",
    "force_max",
    "air",
)
"""Metrics that are differentiable almost everywhere; the others count control periods."""

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
    known: Known = ()  # plant parameters that the controllers' models follow
    conditions: Table = field(default_factory=dict)  # other parameters; each set of values runs under every row of them
    engine: str = "auto"  # of `costs`; gradients are computed by XLA
    _leaf_names: dict[tuple[int, str], list[str]] = field(default_factory=dict, repr=False, compare=False)
    _given: dict[int, Scenario] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        for scenario in self.scenarios:
            try:
                self._known(scenario)
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
        known: Known = (),
        conditions: Table | None = None,
    ) -> TuningProblem:
        """Problem with the nominal values of the first scenario."""
        if not scenarios:
            raise ParameterError("nothing to tune", remedy="give a scenario")
        if both := [each.name for each in swept if each.name in (conditions or {})]:
            raise ParameterError(f"{both[0]} is tuned and a condition", value=both[0], remedy="give it once")
        parameters = find_parameters(scenarios[0], [each.name for each in swept])
        space = SearchSpace(tuple(replace(each, parameter=p) for each, p in zip(swept, parameters, strict=True)))
        return cls(tuple(scenarios), space, cost, known, conditions or {})

    def _known(self, scenario: Scenario) -> tuple[str, ...]:
        """Parameters that the controller's model follows; it does not know a delay that is longer by the margin."""
        names = known_names(scenario, self.known, [*self.space.names, *self.conditions])
        if not self.cost.delay_margin or _DELAY not in names:
            return names
        if self.known != "all":
            message = f"{_DELAY} is known, but no controller knows the delay margin"
            raise ParameterError(message, value=_DELAY, remedy=f"leave {_DELAY} out of known, or the delay margin at 0")
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
            costs = self._combine(np.concatenate([self.cost(each).reshape(self._draws, -1) for each in measured]))[0]
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
        found = (float(self._disk_margins(scenario, self.space.nominal[None])[0]) for scenario in self.scenarios)
        return min(most, *(float(f"{0.99 * one:.3g}") for one in found))  # the same on all machines

    def _disk_margins(self, scenario: Scenario, values: Vector) -> Vector:
        """Least disk margin of each row of values [SI] over the conditions; 0 if a condition is invalid."""
        rows = np.tile(values, (self._draws, 1))
        table = {name: rows[:, i] for i, name in enumerate(self.space.names)}
        table |= {name: np.repeat(column, len(values)) for name, column in self.conditions.items()}
        good = valid_rows(scenario, table)
        if not good.any():
            return np.zeros(len(values))
        table = {name: np.where(good, column, column[np.argmax(good)]) for name, column in table.items()}
        many = batched(scenario, table, known=self._known(scenario))
        found = disk_margins(
            many.plant(),
            many.control(),
            many.reference(),
            initial_state(many),
            duration=scenario.duration,
            control_period=scenario.control_period,
            substeps=self._given_steps(scenario).substeps or 1,
        )
        return np.where(good, np.nan_to_num(found), 0.0).reshape(self._draws, -1).min(axis=0)

    def costs_and_gradients(self, values: Vector) -> tuple[Vector, Vector]:
        """Costs of rows of values [SI], shape (n, parameters), and their derivatives with respect to the values."""
        rows = self._with_margin(values)
        found = [self._derivatives(scenario, rows) for scenario in self.scenarios]
        total, shares = self._combine(np.concatenate([cost.reshape(self._draws, -1) for cost, _ in found]))
        size = len(self.space)
        slopes = shares[..., None] * np.concatenate([slope.reshape(self._draws, -1, size) for _, slope in found])
        slopes = np.sum(slopes, axis=0).reshape(-1, *values.shape)
        # The rows with the margin contain the values multiplied by it.
        gradient = slopes[0] + (slopes[1] * self._gain_factors() if len(slopes) > 1 else 0.0)
        return total, np.where(total[:, None] < FAILED_COST, gradient, 0.0)

    def engines_used(self) -> set[str]:
        """Engines of the runs at the nominal values."""
        used = set()
        for scenario in self.scenarios:
            good, table = self._valid(scenario, self._with_margin(self.space.nominal[None]))
            if good.any():
                first = {name: column[np.argmax(good)][None] for name, column in table.items()}
                used.add(self._run(scenario, first).engine)
        return used

    def _given_steps(self, scenario: Scenario) -> Scenario:
        """The scenario with the integration steps that its nominal values need, which all trials have."""
        if scenario.substeps is not None:
            return scenario
        if id(scenario) not in self._given:
            good, table = self._valid(scenario, self._with_margin(self.space.nominal[None]))
            steps = None
            if good.any():
                batch = self._run(scenario, table, metrics=("angle_rmse",), engine=self.engine)
                steps = int(batch["substeps"][good].max())
            self._given[id(scenario)] = scenario.model_copy(update={"substeps": steps})
        return self._given[id(scenario)]

    def check_smooth(self) -> None:
        """Raise an error if the cost is not differentiable with respect to the parameters."""
        if self.cost.disk_margin:
            raise ParameterError("the disk margin has no gradient", remedy="use cma or evolution for it")
        rough = [name for name in self.cost.metrics if name not in SMOOTH]
        if rough:
            message = f"{', '.join(rough)} counts control periods and has no gradient"
            raise ParameterError(message, remedy="use cma or evolution for it")
        for scenario in self.scenarios:
            for each in self.space.swept:
                self._leaves(scenario, each)

    def _gain_factors(self) -> Vector:
        """Factor on each value in the rows with the margin."""
        return np.where([is_gain(name) for name in self.space.names], self.cost.gain_margin, 1.0)

    def _with_margin(self, values: Vector) -> Vector:
        """Rows of values, then the rows with the margin, repeated for each condition."""
        if self.cost.has_margin:
            lower, upper = np.array([(each.parameter.lower, each.parameter.upper) for each in self.space.swept]).T
            values = np.concatenate([values, np.clip(values * self._gain_factors(), lower, upper)])
        return np.tile(values, (self._draws, 1))

    def _combine(self, costs: Vector) -> tuple[Vector, Vector]:
        """Combine costs, shape (runs, rows), into one per set of values; also return their weights."""
        count, rows = costs.shape
        sets = rows // 2 if self.cost.has_margin else rows
        costs = np.where(np.isfinite(costs), np.minimum(costs, FAILED_COST), FAILED_COST)
        shares = np.zeros_like(costs)
        percentile = 100.0 if self.cost.worst else self.cost.percentile
        if percentile is None:
            shares[:] = 1.0 / count
        else:
            rank = math.ceil(percentile / 100 * count) - 1
            shares[np.argsort(costs, axis=0)[rank], np.arange(rows)] = 1.0
        total = np.sum(shares * costs, axis=0)
        if percentile is None:
            total[np.any(costs >= FAILED_COST, axis=0)] = FAILED_COST
        total = total.reshape(-1, sets)
        worse = np.argmax(total, axis=0)
        chosen = np.arange(total.shape[0])[:, None] == worse
        return total[worse, np.arange(sets)], shares * chosen.reshape(-1)

    def _table(self, scenario: Scenario, rows: Vector) -> Table:
        tuned = {name: rows[:, i] for i, name in enumerate(self.space.names)}
        table: dict[str, Any] = tuned | {
            name: np.repeat(each, len(rows) // self._draws) for name, each in self.conditions.items()
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
        return run_many(scenario, table, **{"known": self._known(scenario), "metrics": self.cost.metrics} | options)

    def _metrics(self, scenario: Scenario, rows: Vector, workers: int) -> dict[str, Vector]:
        good, table = self._valid(scenario, rows)
        if not good.any():
            return {name: np.full(len(rows), np.nan) for name in self.cost.metrics}
        batch = self._run(self._given_steps(scenario), table, workers=workers, engine=self.engine)
        good &= batch.usable
        return {name: np.where(good, values, np.nan) for name, values in batch.metrics.items()}

    def _derivatives(self, scenario: Scenario, rows: Vector) -> tuple[Vector, Vector]:
        """Cost of each row, and its derivatives of shape (rows, parameters)."""
        good, table = self._valid(scenario, rows)
        if not good.any():
            return np.full(len(rows), np.nan), np.zeros_like(rows)
        stepped = self._given_steps(scenario)
        good &= self._run(stepped, table, engine=self.engine).usable
        many = batched(scenario, table, known=self._known(scenario))
        leaves = [self._leaves(scenario, each) for each in self.space.swept]
        found = differentiate(
            many.plant(),
            many.control(),
            many.reference(),
            [leaf for some in leaves for leaf in some],
            metrics=self.cost.metrics,
            **stepped.timing,
            initial=initial_state(many),
        )
        weights = {term.metric: term.weight / term.scale for term in self.cost.terms}
        slopes = [sum(weights[m] * found.gradients[m][leaf] for m in weights for leaf in some) for some in leaves]
        return np.where(good, self.cost(found.values), np.nan), np.stack(slopes, axis=1)

    def _leaves(self, scenario: Scenario, each: SweptParameter) -> list[str]:
        """Tree paths of the leaves of plant, controller, reference and start that contain a parameter."""
        key = (id(scenario), each.name)
        if key not in self._leaf_names:
            self._leaf_names[key] = self._find_leaves(scenario, each)
        return self._leaf_names[key]

    def _find_leaves(self, scenario: Scenario, each: SweptParameter) -> list[str]:
        for low, high in ((0.4, 0.6), (0.1, 0.2), (0.8, 0.9)):
            pair = each.distribution.ppf([low, high])
            if valid_rows(scenario, {each.name: pair}).all():
                break
        many = batched(scenario, {each.name: pair}, known=self.known)
        parts = many.plant(), many.control(), many.reference(), initial_state(many)
        varying, _, _ = split_problem(SimulationProblem.of(*parts), {}, scenario.control_period)
        leaves = named_leaves(varying._asdict()) if varying else {}
        if not leaves or not all(np.array_equal(leaf, pair) for leaf in leaves.values()):
            raise ParameterError(f"{each.name} has no gradient", remedy="use cma or evolution for it")
        return list(leaves)


def _check_steps(scenario: Scenario) -> None:
    stiffness = scenario.signals.stiffness
    if not isinstance(stiffness, Step | RandomSteps | Samples):
        raise ParameterError(
            f"coupling is not defined for {scenario.name!r}: its desired stiffness never steps",
            remedy="leave it out of the cost, or give the stiffness a step",
        )
