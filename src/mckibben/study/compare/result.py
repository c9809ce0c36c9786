"""Result of a comparison."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.result import Column, Listing, Remark, Result
from mckibben.scenario import Scenario, run_scenario, with_values
from mckibben.simulation import Batch, Metrics, Outcome, SimulationResult
from mckibben.simulation.outcome import OUTCOMES
from mckibben.storage.files import make_folder
from mckibben.study.compare.checks import filename
from mckibben.study.compare.runs import Runs
from mckibben.study.compare.statistics import (
    MAIN,
    SHOWN,
    TRADED,
    UNIT,
    by_group,
    correlation,
    front,
    least_air,
    percentiles,
    ratio_of_medians,
)
from mckibben.study.compare.suite import Suite
from mckibben.study.compare.table import write_table
from mckibben.study.tune.objective import FAILED_COST
from mckibben.study.tune.search import Vector
from mckibben.study.tune.trials import Trial

FAILED = "diverged + limit cycles"
"""Title of `failed_runs`."""


class CompareResult(Result):
    """Result of a comparison, by controller.

    `at_air` is the evaluation at equal air: for each controller, the trial of lowest angle error on its Pareto front
    with no more air than the tuned first controller, by medians of the training runs; None if the first is not tuned.
    """

    figures = ("comparison_errors",)
    files = ("runs.nc", "suite.yaml", "controllers")

    suite: Suite
    runs: Runs  # of the evaluation
    tuned: dict[str, dict[str, float]]  # values [SI] by name; empty for an untuned controller
    training_cost: dict[str, tuple[float, float]]  # on the training runs, after and before tuning
    at_bound: dict[str, tuple[str, ...]]  # parameters at an end of their range
    batches: dict[str, Batch]  # results in the evaluation runs
    trials: dict[str, tuple[Trial, ...]] = field(default_factory=dict)  # with medians of the training runs
    at_air: CompareResult | None = None
    finalists: dict[str, tuple[Trial, ...]] = field(default_factory=dict)  # with the medians of their further runs

    def median_run(self, controllers: Sequence[str]) -> tuple[int, dict[str, SimulationResult]]:
        """Return the run with the first controller's median angle error, and the results of some controllers in it."""
        errors = self.metric(next(iter(self.batches)), "angle_rmse")
        order = np.argsort(errors)  # NaN last
        run = int(np.flatnonzero(self.started)[order[np.isfinite(errors).sum() // 2]])
        scenarios = {name: self.runs.scenario(name, run, self.tuned.get(name)) for name in controllers}
        return run, {name: run_scenario(scenario) for name, scenario in scenarios.items()}

    @property
    def started(self) -> NDArray[np.bool_]:
        """Mask of the runs that could start, independent of the controller. Shape (runs,)."""
        return started(next(iter(self.batches.values())))

    def metric(self, controller: str, name: str) -> Vector:
        """A metric [SI] of each run that started; NaN where the run diverged."""
        return self.of(self.batches[controller], name)

    def of(self, batch: Batch, name: str) -> Vector:
        """A metric [SI] in the results of a controller."""
        return np.where(batch.usable, batch.metrics[name], np.nan)[self.started]

    def diverged(self, controller: str) -> NDArray[np.bool_]:
        """Mask of the runs that started and diverged."""
        return self.batches[controller].failed[self.started]

    def oscillates(self, controller: str) -> NDArray[np.bool_]:
        """Mask of the runs that ended in a limit cycle."""
        return ended(self.batches[controller], Outcome.LIMIT_CYCLE)[self.started]

    def cost(self, controller: str) -> Vector:
        """Cost of each run that started; 1e6 where the run diverged."""
        names = self.suite.cost.metrics
        cost = self.suite.cost({name: self.metric(controller, name) for name in names})
        return np.where(np.isfinite(cost), cost, FAILED_COST)

    def training_air(self, controller: str) -> float:
        """Median air [m^3] of a tuned controller in the training runs; NaN if unknown."""
        finalists = self.finalists.get(controller) or self.trials.get(controller, ())
        best = min(finalists, key=lambda trial: (trial.cost, trial.point), default=None)
        known = (trial.metrics for trial in self.trials.get(controller, ()) if best and trial.point == best.point)
        return (next(known, None) or {}).get("air", np.nan)

    def scenario(self, controller: str, run: int) -> Scenario:
        """Scenario of one run with the tuned controller."""
        return self.runs.scenario(controller, run, self.tuned[controller])

    @functools.cached_property
    def numbers(self) -> dict[str, Any]:
        """Statistics in the units of results: spreads of errors, ratios to the first controller, fronts, for JSON."""
        median_cost = {name: float(np.median(self.cost(name))) for name in self.batches}
        return {
            "suite": self.suite.name,
            "cost": self.suite.tuning.cost,
            "runs": self.runs.count,
            "no_start": int((~self.started).sum()),
            "order": sorted(self.batches, key=lambda name: median_cost[name]),
            "controllers": {name: _controller_statistics(self, name, median_cost[name]) for name in self.batches},
            "at_air_of_first": _at_air(self),
        }

    def verdict(self) -> str:
        """Return the controller of the least median cost, and its angle error against that of the first."""
        numbers, first = self.numbers, next(iter(self.batches))
        best = numbers["order"][0]
        ratio = numbers["controllers"][best]["ratio_to_first"][SHOWN["angle_rmse"]]["ratio"]
        runs = f"{len(self.batches)} controllers on {self.runs.count} runs"
        return f"{runs}: {best} is best, with {ratio:.3g} x the angle RMSE of {first}"

    def remarks(self) -> Iterator[Remark]:
        """Yield remarks on runs that cannot start, ranges that are too narrow, and gains that take too much air."""
        if count := self.numbers["no_start"]:
            yield Remark.warning("runs", f"{count} runs were infeasible: no static equilibrium at their start")
        if text := left_out_at_air(self.numbers):
            yield Remark.warning("at_air", text)
        for name, parameters in self.at_bound.items():
            if parameters:
                text = f"{name}: at a bound of the range: {', '.join(parameters)}"
                yield Remark.warning("at_bound", text, remedy="consider a wider range")

    def listings(self) -> Iterator[Listing]:
        """Yield errors on the evaluation runs, as tuned and with no more air than the first controller."""
        numbers, first = self.numbers, next(iter(self.batches))
        controllers = {name: numbers["controllers"][name] for name in numbers["order"]}
        runs = numbers["runs"] - numbers["no_start"]
        yield error_table(f"{numbers['suite']}: {runs} unseen runs", controllers, first)
        if at_air := numbers["at_air_of_first"]:
            title = f"With no more air than the tuned {first} ({at_air['air_L']:.4g} L in the training runs)"
            yield error_table(title, at_air["controllers"], first)

    def write(self, folder: Path) -> None:
        """Write runs.nc, suite.yaml, and each tuned controller as a scenario with the plant of its model."""
        write_table(self.suite, self.runs, self.batches, self.tuned, folder / "runs.nc")
        self.suite.to_yaml(folder / "suite.yaml")
        controllers, reference = make_folder(folder / "controllers"), next(iter(self.suite.references))
        at_air = self.at_air.tuned if self.at_air else {}
        for suffix, tuned in (("", self.tuned), (", at equal air", at_air)):
            for name, values in tuned.items():
                scenario = self.suite.scenario(name, reference)
                scenario = with_values(scenario, values) if values else scenario
                scenario.to_yaml(controllers / f"{filename(name + suffix)}.yaml")


def error_table(title: str, controllers: Mapping[str, Mapping[str, Any]], first: str) -> Listing:
    """Return a table of errors, ratios of medians to the first controller, air and failed runs."""

    def spread(metric: str, statistic: str) -> list[float | None]:
        return [(errors["metrics"][SHOWN[metric]] or {}).get(statistic) for errors in controllers.values()]

    def ratio(metric: str, statistic: str) -> list[float]:
        return [errors["ratio_to_first"][SHOWN[metric]][statistic] for errors in controllers.values()]

    ends = zip(ratio("angle_rmse", "low"), ratio("angle_rmse", "high"), strict=True)
    intervals = [f"{low:.3g}..{high:.3g}" for low, high in ends]
    number = Column(digits=3)
    columns: dict[str, tuple[Column, Any]] = {
        "controller": (Column(), list(controllers)),
        "angle rmse, deg": (number, spread("angle_rmse", "median")),
        "angle, 95 %": (number, spread("angle_rmse", "percentile_95")),
        f"x {first}": (number, ratio("angle_rmse", "ratio")),
        "95 % interval": (Column(), intervals),
        "stiffness rmse": (number, spread("stiffness_rmse", "median")),
        "stiffness, 95 %": (number, spread("stiffness_rmse", "percentile_95")),
        "air, L": (number, spread("air", "median")),
        FAILED: (Column(), [failed_runs(errors) for errors in controllers.values()]),
    }
    return Listing(title, columns)


def ended(batch: Batch, outcome: Outcome) -> NDArray[np.bool_]:
    """Return the mask of the runs with an outcome. Shape (runs,)."""
    return batch["outcome"] == OUTCOMES.index(outcome)


def started(batch: Batch) -> NDArray[np.bool_]:
    """Return the mask of the runs that could start. Shape (runs,)."""
    return ~ended(batch, Outcome.NO_START)


def failed_runs(errors: Mapping[str, Any]) -> str:
    """Return the numbers of diverged runs and of limit cycles of a controller, for tables."""
    return f"{errors['diverged']} + {errors['limit_cycles']}"


def left_out_at_air(numbers: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> str:
    """Text on the tuned controllers of which no gains take as little air as the first; empty if there are none."""
    if (at_air := numbers["at_air_of_first"]) is None:
        return ""
    controllers = numbers["controllers"]
    shown = {name: name for name in controllers} | dict(titles or {})
    left_out = [
        shown[name] + ("" if errors["least_air_L"] is None else f" (at least {errors['least_air_L']:.4g} L)")
        for name, errors in controllers.items()
        if errors["tuned"] and name not in at_air["controllers"]
    ]
    first = shown[next(iter(controllers))]
    limit = f"{at_air['air_L']:.4g} L of air, the median of {first} in the training runs"
    return f"no gains were found that take at most {limit}: {', '.join(left_out)}" if left_out else ""


class PooledResult(Result):
    """Errors over the runs of all setups together, as tuned and with no more air than the first controller."""

    suite: str
    results: dict[str, CompareResult]

    @functools.cached_property
    def numbers(self) -> dict[str, Any]:
        """Errors by controller, for JSON."""
        numbers = {"as_tuned": _pooled([(result, result) for result in self.results.values()])}
        if all(result.at_air for result in self.results.values()):
            pairs = [(result.at_air, result) for result in self.results.values() if result.at_air]
            numbers["at_air_of_first"] = _pooled(pairs)
        return numbers

    def verdict(self) -> str:
        """Return the controller of the least angle error over all setups."""
        errors = self.numbers["as_tuned"]
        best = min(errors, key=lambda name: errors[name]["ratio_to_first"][SHOWN["angle_rmse"]]["ratio"])
        ratio = errors[best]["ratio_to_first"][SHOWN["angle_rmse"]]["ratio"]
        setups = f"{self.suite}, {len(self.results)} setups"
        return f"{setups}: {best} has {ratio:.3g} x the angle RMSE of {next(iter(errors))}"

    def listings(self) -> Iterator[Listing]:
        """Yield the errors over all setups, then those of each setup as details."""
        first = next(iter(self.numbers["as_tuned"]))
        titles = {"as_tuned": "All setups, as tuned", "at_air_of_first": "All setups, with no more air than the first"}
        for key, errors in self.numbers.items():
            yield error_table(titles[key], errors, first)
        for result in self.results.values():
            yield from (replace(listing, detail=True) for listing in result.listings())


def _pooled(results: Sequence[tuple[CompareResult, CompareResult]]) -> dict[str, Any]:
    """Errors of each controller of all results over their runs, and their ratio to the first as tuned in others."""
    first = next(iter(results[0][1].batches))

    def all_runs(name: str, metric: str) -> NDArray[np.float64]:
        return np.concatenate([result.metric(name, metric) for result, _ in results])

    tuned = {metric: np.concatenate([result.metric(first, metric) for _, result in results]) for metric in MAIN}
    return {
        name: {
            "diverged": sum(int(result.diverged(name).sum()) for result, _ in results),
            "limit_cycles": sum(int(result.oscillates(name).sum()) for result, _ in results),
            "metrics": {SHOWN[metric]: percentiles(all_runs(name, metric), UNIT[metric]) for metric in TRADED},
            "ratio_to_first": {
                SHOWN[metric]: ratio_of_medians(all_runs(name, metric), tuned[metric]) for metric in MAIN
            },
        }
        for name in results[0][0].batches
        if all(name in result.batches for result, _ in results)
    }


def _at_air(result: CompareResult) -> dict[str, Any] | None:
    if (at_air := result.at_air) is None:
        return None
    first = next(iter(result.batches))
    errors = {name: _errors(at_air, name, result.batches[first]) for name in at_air.batches}
    return {"air_L": result.training_air(first) / UNIT["air"], "controllers": errors}


def _errors(result: CompareResult, name: str, first: Batch) -> dict[str, Any]:
    """Metrics and failed runs of a controller, also by reference and joint, and its ratios to the first."""
    errors = {metric: result.metric(name, metric) for metric in MAIN}
    return {
        "diverged": int(result.diverged(name).sum()),
        "limit_cycles": int(result.oscillates(name).sum()),
        "metrics": {
            SHOWN[metric]: percentiles(result.metric(name, metric), UNIT[metric]) for metric in Metrics._fields
        },
        "ratio_to_first": {
            SHOWN[metric]: ratio_of_medians(errors[metric], result.of(first, metric)) for metric in MAIN
        },
        "by_reference": by_group(np.array(result.runs.reference_name)[result.started], errors),
        "by_joint": by_group(np.array(result.runs.joint)[result.started], errors),
        "tuned": result.tuned[name],
    }


def _controller_statistics(result: CompareResult, name: str, median_cost: float) -> dict[str, Any]:
    cost = result.training_cost.get(name)
    stepped = np.isfinite(result.metric(name, "coupling"))
    settled = stepped & np.isfinite(result.metric(name, "stiffness_settling"))
    least = least_air(result.trials.get(name, ()))
    return {
        **_errors(result, name, next(iter(result.batches.values()))),
        "median_cost": median_cost,
        "settled": {"runs": int(settled.sum()), "of": int(stepped.sum())},
        "correlations": {
            condition: {
                SHOWN[metric]: correlation(values[result.started], result.metric(name, metric)) for metric in MAIN
            }
            for condition, values in result.runs.conditions.items()
            if condition != "sensors.seed"
        },
        "training_cost": None if cost is None else {"tuned": cost[0], "before": cost[1]},
        "at_bound": list(result.at_bound[name]),
        "least_air_L": least / UNIT["air"] if np.isfinite(least) else None,
        "front": [
            {SHOWN[metric]: at[metric] / UNIT[metric] for metric in TRADED}
            for _, at in front(result.trials.get(name, ()))
        ],
    }
