"""Costs of many sets of numbers at once, and the gradient of the cost of one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import ParameterError
from mckibben.numerics.batching import cores, named_leaves
from mckibben.simulation import differentiate
from mckibben.simulation.problem import split_problem
from mckibben.study.parameters import Known, LogUniform, Over, Table, Uniform, allowed, find_all, known_names, lanes
from mckibben.study.scenario import Scenario
from mckibben.study.scenario.running import rest, run_many
from mckibben.study.tune.cost import SMOOTH, Cost, Numbers, is_gain, nominal_of, point_of, values_at

LOST = 1e6
"""The cost of numbers that are not allowed, or whose runs did not stay finite."""


@dataclass(frozen=True)
class TuningProblem:
    """What is tuned: numbers of scenarios within ranges, and what they cost.

    A point is a place in the unit cube, one axis a number: 0 and 1 are the ends of its range.

    Parameters
    ----------
    scenarios
        The runs that count.
    over
        The numbers, and their ranges; all scenarios have them.
    cost
        Of the runs.
    known
        Numbers of the plant that the controllers' models follow; see `mckibben.study.parameters.values`.
    """

    scenarios: tuple[Scenario, ...]
    over: tuple[Over, ...]
    cost: Cost
    known: Known = ()
    _found: dict[tuple[int, str], list[str]] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        if not self.scenarios or not self.over:
            raise ParameterError("nothing to tune", remedy="give a scenario and at least one parameter")
        for each in self.over:
            if not isinstance(each.spread, Uniform | LogUniform):
                raise ParameterError(f"{each.name} has no range to search", remedy="give one, like `1..10 bar/rad log`")
        for scenario in self.scenarios:
            try:
                known_names(scenario, self.known, self.names)
            except ParameterError as error:
                if len(self.scenarios) == 1:
                    raise
                raise ParameterError(f"{scenario.name}: {error}", value=error.value) from None
            if "coupling" in self.cost.metrics:
                _check_steps(scenario)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the numbers."""
        return tuple(each.name for each in self.over)

    @property
    def nominal(self) -> Numbers:
        """The numbers of the first scenario, SI; the middle of the range where it has none."""
        return nominal_of(self.over, [address.nominal for address in find_all(self.scenarios[0], self.names)])

    def values(self, points: Numbers) -> Numbers:
        """The numbers [SI] at points of shape (n, numbers)."""
        return values_at(self.over, points)

    def point(self, values: Numbers) -> Numbers:
        """The point of numbers [SI] of shape (numbers,), moved into the ranges."""
        return point_of(self.over, values)

    def costs(self, values: Numbers) -> Numbers:
        """The cost of each row of numbers [SI], shape (n, numbers)."""
        rows = self._with_margin(values)
        share = max(cores() // len(self.scenarios), 1)
        with ThreadPoolExecutor(cores()) as pool:
            measured = pool.map(lambda scenario: self._metrics(scenario, rows, share), self.scenarios)
            return self._together(np.stack([self.cost(each) for each in measured]))[0]

    def costs_and_gradients(self, values: Numbers) -> tuple[Numbers, Numbers]:
        """The costs of rows of numbers [SI], shape (n, numbers), and their derivatives, of that shape."""
        rows = self._with_margin(values)
        found = [self._derivatives(scenario, rows) for scenario in self.scenarios]
        total, shares = self._together(np.stack([cost for cost, _ in found]))
        slopes = shares[..., None] * np.stack([slope for _, slope in found])
        slopes = np.sum(slopes, axis=0).reshape(-1, *values.shape)
        # A number enters the rows with the margin multiplied by it.
        gradient = slopes[0] + (slopes[1] * self._margins() if len(slopes) > 1 else 0.0)
        return total, np.where(total[:, None] < LOST, gradient, 0.0)

    def to_unit(self, values: Numbers, gradient: Numbers) -> Numbers:
        """Derivatives with respect to numbers [SI], shape (n, numbers), as ones with respect to points."""
        lengths = np.empty_like(values)
        for i, each in enumerate(self.over):
            low, high = each.spread.ends
            even = not isinstance(each.spread, LogUniform)
            lengths[:, i] = high - low if even else values[:, i] * np.log(high / low)
        return gradient * lengths

    def check_smooth(self) -> None:
        """Raise if there is no gradient to follow."""
        rough = [name for name in self.cost.metrics if name not in SMOOTH]
        if rough:
            raise ParameterError(
                f"{', '.join(rough)} counts control periods and has no gradient", remedy="use cma or evolution for it"
            )
        for scenario in self.scenarios:
            for each in self.over:
                self._leaves(scenario, each)

    def _margins(self) -> Numbers:
        """The factor on each number in the row with the margin."""
        return np.where([is_gain(name) for name in self.names], self.cost.gain_margin, 1.0)

    def _with_margin(self, values: Numbers) -> Numbers:
        if self.cost.gain_margin == 1.0:
            return values
        lower, upper = np.array([(each.address.lower, each.address.upper) for each in self.over]).T
        return np.concatenate([values, np.clip(values * self._margins(), lower, upper)])

    def _together(self, costs: Numbers) -> tuple[Numbers, Numbers]:
        """From the cost of each scenario and row to that of each set of numbers, and the share that each has in it."""
        count, rows = costs.shape
        sets = rows if self.cost.gain_margin == 1.0 else rows // 2
        costs = np.where(np.isfinite(costs), np.minimum(costs, LOST), LOST)
        shares = np.zeros_like(costs)
        if self.cost.worst:
            shares[np.argmax(costs, axis=0), np.arange(rows)] = 1.0
        else:
            shares[:] = 1.0 / count
        total = np.where(np.any(costs >= LOST, axis=0), LOST, np.sum(shares * costs, axis=0)).reshape(-1, sets)
        worse = np.argmax(total, axis=0)
        chosen = np.arange(total.shape[0])[:, None] == worse
        return total[worse, np.arange(sets)], shares * chosen.reshape(-1)

    def _table(self, rows: Numbers) -> Table:
        return {name: rows[:, i] for i, name in enumerate(self.names)}

    def _permitted(self, scenario: Scenario, rows: Numbers) -> tuple[NDArray[np.bool_], Numbers]:
        """Which rows the scenario allows, and all rows with the others replaced by one that it does."""
        good = allowed(scenario, self._table(rows))
        return good, rows if good.all() else np.where(good[:, None], rows, rows[np.argmax(good)])

    def _metrics(self, scenario: Scenario, rows: Numbers, workers: int) -> dict[str, Numbers]:
        good, rows = self._permitted(scenario, rows)
        if not good.any():
            return {name: np.full(len(rows), np.nan) for name in self.cost.metrics}
        table = self._table(rows)
        found = run_many(scenario, table, known=self.known, metrics=self.cost.metrics, workers=workers).metrics
        return {name: np.where(good, values, np.nan) for name, values in found.items()}

    def _derivatives(self, scenario: Scenario, rows: Numbers) -> tuple[Numbers, Numbers]:
        """The cost of each row, and its derivatives of shape (rows, numbers)."""
        good, rows = self._permitted(scenario, rows)
        if not good.any():
            return np.full(len(rows), np.nan), np.zeros_like(rows)
        many = lanes(scenario, self._table(rows), known=self.known)
        leaves = [self._leaves(scenario, each) for each in self.over]
        found = differentiate(
            many.plant(),
            many.control(),
            many.reference(),
            [leaf for some in leaves for leaf in some],
            metrics=self.cost.metrics,
            duration=scenario.duration,
            control_period=scenario.control_period,
            substeps=scenario.substeps,
            initial=rest(many),
        )
        slopes = [
            sum(
                term.weight / term.scale * found.gradients[term.metric][leaf]
                for term in self.cost.terms
                for leaf in some
            )
            for some in leaves
        ]
        return np.where(good, self.cost(found.values), np.nan), np.stack(slopes, axis=1)

    def _leaves(self, scenario: Scenario, each: Over) -> list[str]:
        """The leaves of plant, controller, reference and start that a number of a scenario stands in."""
        key = (id(scenario), each.name)
        if key not in self._found:
            self._found[key] = self._looked_for(scenario, each)
        return self._found[key]

    def _looked_for(self, scenario: Scenario, each: Over) -> list[str]:
        for low, high in ((0.4, 0.6), (0.1, 0.2), (0.8, 0.9)):
            pair = each.spread.at([low, high])
            if allowed(scenario, {each.name: pair}).all():
                break
        many = lanes(scenario, {each.name: pair}, known=self.known)
        varying, _, _ = split_problem(many.plant(), many.control(), many.reference(), rest(many), {})
        leaves = named_leaves(varying._asdict()) if varying else {}
        if not leaves or not all(np.array_equal(leaf, pair) for leaf in leaves.values()):
            raise ParameterError(f"{each.name} has no gradient", remedy="use cma or evolution for it")
        return list(leaves)


def _check_steps(scenario: Scenario) -> None:
    stiffness = scenario.signals.stiffness
    if stiffness.step is None and stiffness.samples is None:
        raise ParameterError(
            f"coupling is not defined for {scenario.name!r}: its desired stiffness never steps",
            remedy="leave it out of the cost, or give the stiffness a step",
        )


def problem(scenarios: Sequence[Scenario], over: Sequence[Over], cost: Cost, known: Known = ()) -> TuningProblem:
    """A problem with the ranges' addresses taken from the first scenario."""
    names = find_all(scenarios[0], [each.name for each in over]) if scenarios else []
    return TuningProblem(
        tuple(scenarios),
        tuple(dataclasses.replace(each, address=address) for each, address in zip(over, names, strict=True)),
        cost,
        known,
    )
