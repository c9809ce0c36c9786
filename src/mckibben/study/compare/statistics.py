"""Statistics of a benchmark: errors of all controllers, their ratios, and errors at equal air."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mckibben.simulation import Batch, Metrics
from mckibben.simulation.metrics import METRICS
from mckibben.study.sweep.ranks import spearman
from mckibben.study.tune.tune import Trial

if TYPE_CHECKING:
    from mckibben.study.compare.compare import BenchmarkResult

MAIN = ("angle_rmse", "stiffness_rmse")
"""Errors compared with those of the first controller."""
TRADED = (*MAIN, "air")
"""Metrics of each trial of the tuning."""
FAILED_RUNS = "failed"
"""Number of failed training runs, among the metrics of a trial."""
_SAME_STIFFNESS = 1.1  # largest stiffness error on a Pareto front, relative to the tuned controller
_RESAMPLES = 2000
_MAX_RESAMPLED = 2_000_000  # values at once
SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}
_UNIT = {metric: unit for metric, _, unit in METRICS.values()}


FAILED = "diverged + limit cycles"
"""Title of `failed_runs`."""


def failed_runs(found: Mapping[str, Any]) -> str:
    """Return the numbers of diverged runs and of limit cycles of a controller, for tables."""
    return f"{found['diverged']} + {found['limit_cycles']}"


def statistics(result: BenchmarkResult) -> dict[str, Any]:
    """Statistics of a benchmark, for JSON, in the units of results."""
    names = list(result.batches)
    median_cost = {name: float(np.median(result.cost(name))) for name in names}
    return {
        "suite": result.suite.name,
        "cost": result.suite.tuning.cost,
        "runs": result.runs.count,
        "no_start": int((~result.started).sum()),
        "order": sorted(names, key=lambda name: median_cost[name]),
        "controllers": {name: _controller_statistics(result, name, median_cost[name]) for name in names},
        "at_air_of_first": _at_air(result),
    }


def left_out_at_air(numbers: Mapping[str, Any], titles: Mapping[str, str] | None = None) -> str:
    """Text on the tuned controllers of which no gains take as little air as the first; empty if there are none."""
    if (at_air := numbers["at_air_of_first"]) is None:
        return ""
    found = numbers["controllers"]
    shown = {name: name for name in found} | dict(titles or {})
    left_out = [
        shown[name] + ("" if each["least_air_L"] is None else f" (at least {each['least_air_L']:.4g} L)")
        for name, each in found.items()
        if each["tuned"] and name not in at_air["controllers"]
    ]
    first = shown[next(iter(found))]
    limit = f"{at_air['air_L']:.4g} L of air, the median of {first} in the training runs"
    return f"no gains were found that take at most {limit}: {', '.join(left_out)}" if left_out else ""


def pooled(results: Mapping[str, BenchmarkResult]) -> dict[str, Any]:
    """Errors over the runs of all setups together, for JSON: as tuned, and at the air of the first controller."""
    every = [(result, result) for result in results.values()]
    found = {"as_tuned": _pooled(every)}
    if all(result.at_air for result in results.values()):
        found["at_air_of_first"] = _pooled([(result.at_air, result) for result in results.values() if result.at_air])
    return found


def _pooled(results: Sequence[tuple[BenchmarkResult, BenchmarkResult]]) -> dict[str, Any]:
    """Errors of each controller of all results over their runs, and their ratio to the first as tuned in others."""
    first = next(iter(results[0][1].batches))

    def all_runs(name: str, metric: str) -> NDArray[np.float64]:
        return np.concatenate([result.metric(name, metric) for result, _ in results])

    tuned = {metric: np.concatenate([result.metric(first, metric) for _, result in results]) for metric in MAIN}
    return {
        name: {
            "diverged": sum(int(result.diverged(name).sum()) for result, _ in results),
            "limit_cycles": sum(int(result.oscillates(name).sum()) for result, _ in results),
            "metrics": {SHOWN[metric]: _percentiles(all_runs(name, metric), _UNIT[metric]) for metric in TRADED},
            "ratio_to_first": {SHOWN[metric]: _ratio(all_runs(name, metric), tuned[metric]) for metric in MAIN},
        }
        for name in results[0][0].batches
        if all(name in result.batches for result, _ in results)
    }


def _at_air(result: BenchmarkResult) -> dict[str, Any] | None:
    if (at_air := result.at_air) is None:
        return None
    first = next(iter(result.batches))
    errors = {name: _errors(at_air, name, result.batches[first]) for name in at_air.batches}
    return {"air_L": result.training_air(first) / _UNIT["air"], "controllers": errors}


def _errors(result: BenchmarkResult, name: str, first: Batch) -> dict[str, Any]:
    """Metrics and failed runs of a controller, also by reference and joint, and its ratios to the first."""
    errors = {metric: result.metric(name, metric) for metric in MAIN}
    return {
        "diverged": int(result.diverged(name).sum()),
        "limit_cycles": int(result.oscillates(name).sum()),
        "metrics": {
            SHOWN[metric]: _percentiles(result.metric(name, metric), _UNIT[metric]) for metric in Metrics._fields
        },
        "ratio_to_first": {SHOWN[metric]: _ratio(errors[metric], result.of(first, metric)) for metric in MAIN},
        "by_reference": _by_group(np.array(result.runs.reference_name)[result.started], errors),
        "by_joint": _by_group(np.array(result.runs.joint)[result.started], errors),
        "tuned": result.tuned[name],
    }


def _controller_statistics(result: BenchmarkResult, name: str, median_cost: float) -> dict[str, Any]:
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
                SHOWN[metric]: _correlation(values[result.started], result.metric(name, metric)) for metric in MAIN
            }
            for condition, values in result.runs.conditions.items()
            if condition != "sensors.seed"
        },
        "training_cost": None if cost is None else {"tuned": cost[0], "before": cost[1]},
        "at_bound": list(result.at_bound[name]),
        "least_air_L": least / _UNIT["air"] if np.isfinite(least) else None,
        "front": [
            {SHOWN[metric]: at[metric] / _UNIT[metric] for metric in TRADED}
            for _, at in front(result.trials.get(name, ()))
        ],
    }


def front(trials: Sequence[Trial]) -> list[tuple[Trial, dict[str, float]]]:
    """Pareto front (air, angle error) of trials with fewest failed runs and at most 1.1 times the stiffness error."""
    known = [(trial, trial.metrics) for trial in _least_failing(_of_same_stiffness(trials)) if trial.metrics]
    found: list[tuple[Trial, dict[str, float]]] = []
    for trial, at in sorted(known, key=lambda one: (one[1]["air"], one[1]["angle_rmse"])):
        if not found or at["angle_rmse"] < found[-1][1]["angle_rmse"]:
            found.append((trial, at))
    return found


def stiffness_limit(trials: Sequence[Trial]) -> float:
    """Largest stiffness error [N*m/rad] on the Pareto front: 1.1 times that of the best trial."""
    return _SAME_STIFFNESS * _best(trials).get("stiffness_rmse", np.inf)


def air_of(trials: Sequence[Trial]) -> float:
    """Air [m^3] of the trial of lowest cost, median of the training runs that did not fail; NaN if unknown."""
    return _best(trials).get("air", np.nan)


def trial_at_air(trials: Sequence[Trial], air: float) -> Trial | None:
    """Trial of fewest failed runs, then of lowest angle error, with at most the given air [m^3], if any."""
    known = [one for one in _of_same_stiffness(trials) if (one.metrics or {})["air"] <= air]
    return min(_least_failing(known), key=lambda one: (one.metrics or {})["angle_rmse"], default=None)


def least_air(trials: Sequence[Trial]) -> float:
    """Least air [m^3] of the trials that may be the one at equal air; infinite without any."""
    return min(((one.metrics or {})["air"] for one in _of_same_stiffness(trials)), default=np.inf)


def _of_same_stiffness(trials: Sequence[Trial]) -> list[Trial]:
    """Trials with known metrics and at most 1.1 times the stiffness error of the best."""
    limit = stiffness_limit(trials)
    return [one for one in trials if one.metrics and one.metrics["stiffness_rmse"] <= limit]


def _best(trials: Sequence[Trial]) -> dict[str, float]:
    """Metrics [SI] of the trial of lowest cost; empty if half of the runs or more failed in all trials."""
    known = _least_failing(trials)
    return min(known, key=lambda trial: (trial.cost, trial.point)).metrics or {} if known else {}


def fewest_failed(trials: Sequence[Trial]) -> float:
    """Return the smallest number of training runs that failed in a trial; infinite if unknown."""
    return min((trial.metrics.get(FAILED_RUNS, 0.0) for trial in trials if trial.metrics), default=np.inf)


def _least_failing(trials: Sequence[Trial]) -> list[Trial]:
    """Trials with the smallest number of failed training runs."""
    fewest = fewest_failed(trials)
    return [one for one in trials if one.metrics and one.metrics.get(FAILED_RUNS, 0.0) == fewest]


def _percentiles(values: NDArray[np.float64], unit: float) -> dict[str, Any] | None:
    values = values[np.isfinite(values)] / unit
    if not values.size:
        return None
    median, high = np.percentile(values, [50, 95])
    return {"median": float(median), "percentile_95": float(high), "runs": int(values.size)}


def _ratio(values: NDArray[np.float64], first: NDArray[np.float64]) -> dict[str, float]:
    """Ratio of the medians, with infinite errors in failed runs, and its bootstrap interval."""
    values, first = (np.where(np.isfinite(each), each, np.inf) for each in (values, first))
    generator, ratios = np.random.default_rng(0), np.empty(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.median(values) / np.median(first)
        while ratios.size < _RESAMPLES:
            some = min(_RESAMPLES - ratios.size, max(_MAX_RESAMPLED // values.size, 1))
            rows = generator.integers(0, values.size, (some, values.size))
            found = np.median(values[rows], axis=1) / np.median(first[rows], axis=1)
            ratios = np.append(ratios, found)
    ratios = ratios[~np.isnan(ratios)]  # ratio of two infinite medians
    low, high = np.percentile(ratios, [2.5, 97.5], method="nearest") if ratios.size else (np.nan, np.nan)
    return {"ratio": float(ratio), "low": float(low), "high": float(high)}


def _by_group(groups: NDArray[Any], errors: dict[str, NDArray[np.float64]]) -> dict[str, dict[str, Any]]:
    """Median and 95th percentile of errors in each group of runs."""
    return {
        group: {
            SHOWN[metric]: _percentiles(values[groups == group], _UNIT[metric]) for metric, values in errors.items()
        }
        for group in sorted(set(groups.tolist()))
    }


def _correlation(condition: NDArray[Any], error: NDArray[np.float64]) -> float | None:
    """Rank correlation, with infinite errors in failed runs."""
    found = spearman(condition, np.where(np.isfinite(error), error, np.inf))
    return float(found) if np.isfinite(found) else None
