"""Tuning objective: the cost of many sets of parameters."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError, SimulationError
from mckibben.numerics.batching import cores
from mckibben.scenario import (
    ModelFollows,
    StudiedScenario,
    batched,
    find_parameters,
    followed_names,
    list_parameters,
    valid_rows,
    with_values,
)
from mckibben.simulation import Batch
from mckibben.simulation.outcome import OUTCOMES, Outcome
from mckibben.simulation.problem import check_frequencies
from mckibben.storage.store import Store
from mckibben.study.parameters import Table, sweep_parameters
from mckibben.study.parameters.uncertainty import extremes, sensor_noise, uncertainty
from mckibben.study.tune.cost import Cost, mean_of_joints, parse_cost
from mckibben.study.tune.search import Vector
from mckibben.study.tune.space import SearchSpace, is_gain, parse_ranges
from mckibben.study.tune.trials import Evaluated, first_runs
from mckibben.units import bar, litre

FAILED_COST = 1e6
"""Cost of parameters that are invalid or whose runs fail."""
UNSTABLE_COST = 1e5
"""Least cost of parameters without the disk margin: twice this where it is 0, and more of unstable loops."""
USE = {"command_travel": 10.0, "air": 1.5}
"""Largest use of valves and air with noisy sensors, relative to that of the same loop with ideal ones."""
_LEAST_USE = {"command_travel": 0.2 * bar, "air": 0.01 * litre}  # per second, and in a run, of a joint at rest
_PENALTY = 10.0  # share of the cost by which it rises per share of use beyond the largest


@dataclass(frozen=True)
class TuningProblem:
    """Parameters of scenarios to tune, and the cost of their values.

    Each set of values is simulated in all scenarios, under all rows of the draws, and again with larger gains if the
    cost has a gain margin. Where sensors have noise, once more without it: beyond 10 times the travel of the commands
    and 1.5 times the air of that run, which are those of the reference, the cost rises.

    Attributes
    ----------
    scenarios
        Scenarios whose costs are combined.
    space
        Parameters and their ranges; nominal values are those of the first scenario.
    cost
        Cost of the runs. Gains keep its disk margin under all draws; it is not asked for if no gain is tuned.
    model_follows
        Plant parameters that the controllers' models follow, or "all".
    conditions
        Values [SI] of other parameters by name, shape (draws,). Without any, the draws are the extremes of the
        uncertainty of each plant, or the nominal one if no disk margin is asked for.
    engine
        As for `simulate_many`.
    """

    scenarios: tuple[StudiedScenario, ...]
    space: SearchSpace
    cost: Cost
    model_follows: ModelFollows = ()  # plant parameters that the controllers' models follow
    conditions: Table = field(default_factory=dict)  # other parameters; each set of values runs under every row of them
    engine: str = "auto"

    @classmethod
    def of(
        cls,
        scenarios: Sequence[StudiedScenario] | StudiedScenario,
        over: Any,
        cost: Cost | str,
        model_follows: ModelFollows = (),
        conditions: Table | None = None,
    ) -> TuningProblem:
        """Problem with the nominal values of the first scenario; arguments as for `tune`.

        Raises `ParameterError` if there is no scenario, a parameter is not in every scenario, has no range, is a
        condition as well, or cannot be followed; `SimulationError` if a frequency under the conditions is too high.
        """
        scenarios = [scenarios] if isinstance(scenarios, StudiedScenario) else list(scenarios)
        if not scenarios:
            raise ParameterError("nothing to tune", remedy="give a scenario")
        swept: Any = [over] if isinstance(over, str) else list(over)
        if isinstance(over, Mapping):
            swept = sweep_parameters(scenarios[0], over)
        elif all(isinstance(text, str) for text in swept):
            swept = parse_ranges(swept, scenarios[0])
        cost = cost if isinstance(cost, Cost) else parse_cost(cost, scenarios[0].joint_type)
        names = [tuned.name for tuned in swept]
        drawn = {name: np.asarray(column) for name, column in (conditions or {}).items()}
        if both := [name for name in names if name in drawn]:
            raise ParameterError(f"{both[0]} is tuned and a condition", value=both[0], remedy="give it once")
        pairs = zip(swept, find_parameters(scenarios[0], names), strict=True)
        space = SearchSpace(tuple(replace(tuned, parameter=parameter) for tuned, parameter in pairs))
        for scenario in scenarios:
            try:
                followed_names(scenario, model_follows, [*names, *drawn])
            except ParameterError as error:
                raise ParameterError(f"{scenario.name}: {error}", value=error.value) from None
            if drawn:
                check_frequencies(batched(scenario, drawn).references(), scenario.control_period)
            if all(name.startswith("controller.") for name in names):
                scenario.check_start()  # raises what no gains can mend
        return cls(tuple(scenarios), space, cost, model_follows, drawn)

    def begin(self, store: Store, engine: str) -> TuningProblem:
        """Return the problem with an engine; all its trials have the integration steps that its nominal values need.

        Raises `ParameterError` if a metric of the cost is not defined at the nominal values of a scenario.
        """
        nominal = self._with_margin(self.space.nominal[None])
        draws = zip(self.scenarios, self._draws, strict=True)
        batches = [self._batch(scenario, nominal, table) for scenario, table in draws]
        valid = [place for place, (good, _) in enumerate(batches) if good.any()]

        def simulate(engine: str) -> list[Batch]:
            return [batches[place][1].run_many(metrics=self.cost.metrics, engine=engine) for place in valid]

        engine, runs = first_runs(store, simulate, engine=engine)
        scenarios = list(self.scenarios)
        for place, batch in zip(valid, runs, strict=True):
            scenario = scenarios[place]
            for name, values in batch.metrics.items():
                if batch.usable.any() and np.isnan(values[..., batch.usable]).all():
                    message = f"{name} is not defined for {scenario.name!r}"
                    remedy = "leave it out of the cost: the coupling needs a stiffness step, the air known braids"
                    raise ParameterError(message, value=name, remedy=remedy)
            if scenario.substeps is None:
                scenarios[place] = scenario.model_copy(update={"substeps": batch.needed_substeps(scenario.accuracy)})
        return replace(self, scenarios=tuple(scenarios), engine=engine)

    def evaluate(self, values: Vector) -> Evaluated:
        """Return the costs of rows of values [SI], shape (n, parameters)."""
        return Evaluated(self.costs(values))

    def costs(self, values: Vector) -> Vector:
        """Cost of each row of values [SI] of shape (n, parameters), shape (n,).

        1e6 for values that are invalid or whose runs fail; 1e5 to 2e5 for those without the disk margin, and more for
        those whose loop is unstable, by its spectral radius.
        """
        costs, required = self.run_costs(values), self.disk_margin
        if not required:
            return costs
        least = np.min([self._disk_margins(place, values) for place in range(len(self.scenarios))], axis=(0, 1))
        # Feasible points first, then by their violation: K. Deb, Comput. Methods Appl. Mech. Eng. 186, 2000.
        return np.where(least < required, np.minimum(UNSTABLE_COST * (2 - least / required), FAILED_COST), costs)

    def run_costs(self, values: Vector) -> Vector:
        """Cost of the runs of each row of values [SI], whatever the margins of its loop; shapes as of `costs`."""
        rows = self._with_margin(values)
        workers = max(cores() // len(self.scenarios), 1)
        with ThreadPoolExecutor(cores()) as pool:
            by_scenario = pool.map(lambda place: self._costs_of_runs(place, rows, workers), range(len(self.scenarios)))
            costs_of_runs = np.concatenate(list(by_scenario))
        return self._combine(costs_of_runs).reshape(-1, len(values)).max(axis=0)

    @property
    def disk_margin(self) -> float:
        """Disk margin that tuned gains keep; 0 if no gain is tuned."""
        return self.cost.disk_margin if any(is_gain(swept.parameter) for swept in self.space.swept) else 0.0

    @functools.cached_property
    def _draws(self) -> tuple[Table, ...]:
        """Values [SI] of other parameters of each scenario under which gains are judged; the first ones are nominal."""
        if self.conditions or not self.disk_margin:
            return (self.conditions,) * len(self.scenarios)
        return tuple(extremes(uncertainty(scenario), without=self.space.names) for scenario in self.scenarios)

    @functools.cached_property
    def _quiet(self) -> tuple[Table, ...]:
        """Draws of each scenario, and the first again without noise of its sensors; the draws if it has none."""
        tables: list[Table] = []
        for scenario, draws in zip(self.scenarios, self._draws, strict=True):
            names = {name: size for name, size in sensor_noise(scenario).items() if name not in self.space.names}
            count = len(next(iter(draws.values()), "1"))
            given = {**{name: np.full(count, nominal) for name, nominal in names.items()}, **draws}
            last = {name: 0.0 if name in names else column[0] for name, column in given.items()}
            tables.append({name: np.append(column, last[name]) for name, column in given.items()} if names else draws)
        return tuple(tables)

    def margin_limit(self, values: Vector, points: int = 20) -> tuple[float, str]:
        """Return the least disk margin of values [SI] of shape (parameters,) at points of the runs, and what limits it.

        The text has the scenario, the draw of its plant, the operating point, and the loop with its frequency.
        """
        margins = [self._disk_margins(i, values[None], points)[:, 0] for i in range(len(self.scenarios))]
        place = int(np.argmin([column.min() for column in margins]))
        draw = int(np.argmin(margins[place]))
        scenario, table = self.scenarios[place], self._draws[place]
        drawn = {name: column[draw].item() for name, column in table.items()}
        values_of = dict(zip(self.space.names, values.tolist(), strict=True)) | drawn
        worst = with_values(scenario, values_of, model_follows=followed_names(scenario, self.model_follows, values_of))
        varied = [p for p in find_parameters(scenario, drawn) if drawn[p.name] != (p.nominal or 0.0)]
        plant = ", ".join(f"{p.name} {p.show(drawn[p.name])}" for p in varied) or "the nominal plant"
        try:
            limit = worst.margins(points).limit()
        except SimulationError:  # it has none: no point along the run to linearise at
            limit = "where the run diverges"
        return float(margins[place][draw]), f"{limit} of {scenario.name}, with {plant}"

    def change_needed(self, values: Vector) -> str:
        """Return the change of the worst plant that gives values [SI] the largest disk margin, as text.

        One of the drawn parameters is nominal, or the valves have half of their lag or delay.
        """
        margins = [self._disk_margins(i, values[None])[:, 0] for i in range(len(self.scenarios))]
        place = int(np.argmin([column.min() for column in margins]))
        scenario, draw = self.scenarios[place], int(np.argmin(margins[place]))
        drawn = {name: column[draw].item() for name, column in self._draws[place].items()}
        times = [p for p in list_parameters(scenario) if p.part == "valve" and p.unit == "s" and p.nominal]
        lags = {p.name: float(p.nominal or 0.0) for p in times if p.name not in {*drawn, *self.space.names}}
        parameters = find_parameters(scenario, [*drawn, *lags])
        changes = [lags[p.name] / 2 if p.name in lags else p.nominal or 0.0 for p in parameters]
        worst = {name: np.full(len(changes), value) for name, value in (drawn | lags).items()}
        for number, (parameter, change) in enumerate(zip(parameters, changes, strict=True)):
            worst[parameter.name][number] = change
        good, many = self._batch(scenario, values[None], worst)
        after = np.where(good, np.nan_to_num(many.disk_margins(4), nan=-np.inf), -np.inf)
        best, change = parameters[int(np.argmax(after))], changes[int(np.argmax(after))]
        return f"with {best.name} {best.show(change)} in this plant, it would be {max(float(after.max()), 0.0):.2g}"

    def _with_margin(self, values: Vector) -> Vector:
        """Rows of values, then the rows with gains larger by the gain margin, inside the ranges of their fields."""
        if self.cost.gain_margin == 1.0:
            return values
        factors = [self.cost.gain_margin if is_gain(swept.parameter) else 1.0 for swept in self.space.swept]
        limits = np.array([(tuned.parameter.lower, tuned.parameter.upper) for tuned in self.space.swept]).T
        return np.concatenate([values, np.clip(values * factors, *limits)])

    def _batch(
        self, scenario: StudiedScenario, values: Vector, conditions: Table
    ) -> tuple[NDArray[np.bool_], StudiedScenario]:
        """Valid rows of all values under each condition in turn, and their batch, with a valid row for invalid ones."""
        draws = len(next(iter(conditions.values()), "1"))
        table = {name: np.tile(values[:, i], draws) for i, name in enumerate(self.space.names)}
        table |= {name: np.repeat(column, len(values)) for name, column in conditions.items()}
        follows, good = followed_names(scenario, self.model_follows, table), valid_rows(scenario, table)
        if not good.any():
            return good, scenario
        return good, batched(scenario, with_valid(table, good), model_follows=follows, known_valid=True)

    def _costs_of_runs(self, place: int, rows: Vector, workers: int) -> Vector:
        """Cost of each run, shape (draws, rows)."""
        scenario, draws, table = self.scenarios[place], self._draws[place], self._quiet[place]
        good, many = self._batch(scenario, rows, table)
        costs = np.full(good.size, FAILED_COST)
        if not good.any():
            return costs.reshape(-1, len(rows))
        metrics = tuple(dict.fromkeys((*self.cost.metrics, *(USE if table is not draws else ()))))
        batch = many.run_many(metrics=metrics, workers=workers, engine=self.engine)
        values = self.cost(batch.metrics)
        usable = good & batch.usable & np.isfinite(values)
        costs[usable] = np.minimum(values[usable], FAILED_COST)
        costs = costs.reshape(-1, len(rows))
        if self.disk_margin and not self.conditions:  # no gains can mend a draw that cannot start
            started = (batch["outcome"] != OUTCOMES.index(Outcome.NO_START)).reshape(costs.shape)
            costs = np.where(started, costs, costs[0])
        if table is draws:
            return costs
        uses = {name: mean_of_joints(batch.metrics[name]).reshape(costs.shape) for name in USE}
        return with_use(costs[:-1], {n: use[:-1] for n, use in uses.items()}, {n: use[-1] for n, use in uses.items()})

    def _combine(self, costs: Vector) -> Vector:
        """Mean or percentile of costs over the runs, shape (runs, rows); a mean of failed ones is a failure."""
        count = len(costs)
        if self.cost.percentile is not None:
            return np.sort(costs, axis=0)[math.ceil(self.cost.percentile / 100 * count) - 1]
        return np.where((costs >= FAILED_COST).any(axis=0), FAILED_COST, np.sum(costs * (1.0 / count), axis=0))

    def _disk_margins(self, place: int, values: Vector, points: int = 4) -> NDArray[np.float64]:
        """Disk margin of each row of values [SI] under each draw, shape (draws, rows); -inf for invalid rows.

        Draws that cannot start count as the best of the others, since no gains can mend them.
        """
        good, many = self._batch(self.scenarios[place], values, self._draws[place])
        if not good.any():
            return np.full((1, len(values)), -np.inf)
        margins = np.where(good, many.disk_margins(points), -np.inf).reshape(-1, len(values))
        started = np.fmax.reduce(margins, axis=0)
        return np.where(np.isnan(margins), np.nan_to_num(started), margins)


def with_use(costs: Vector, noisy: Table, ideal: Table) -> Vector:
    """Return costs that rise where commands travel further or air is used more than `USE` allows.

    `noisy` has the metrics [SI] of these runs, `ideal` those of the same loops with ideal sensors.
    """
    for name, most in USE.items():
        excess = np.nan_to_num(noisy[name] / (most * np.maximum(ideal[name], _LEAST_USE[name])) - 1)
        costs = np.minimum(costs * (1 + _PENALTY * np.maximum(excess, 0)), FAILED_COST)
    return costs


def with_valid(table: Mapping[str, NDArray], good: NDArray[np.bool_]) -> Table:
    """Return the table with invalid rows replaced by the first valid one."""
    return {name: np.where(good, column, column[np.argmax(good)]) for name, column in table.items()}
