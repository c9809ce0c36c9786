"""Statistics of a comparison: trials at equal air, spreads of errors, and ratios of medians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mckibben.simulation.metrics import METRICS
from mckibben.study.ranks import spearman
from mckibben.study.tune.trials import Trial

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
UNIT = {metric: unit for metric, _, unit in METRICS.values()}


def front(trials: Sequence[Trial]) -> list[tuple[Trial, dict[str, float]]]:
    """Pareto front (air, angle error) of trials with fewest failed runs and at most 1.1 times the stiffness error."""
    known = [(trial, trial.metrics) for trial in _least_failing(_of_same_stiffness(trials)) if trial.metrics]
    points: list[tuple[Trial, dict[str, float]]] = []
    for trial, at in sorted(known, key=lambda pair: (pair[1]["air"], pair[1]["angle_rmse"])):
        if not points or at["angle_rmse"] < points[-1][1]["angle_rmse"]:
            points.append((trial, at))
    return points


def stiffness_limit(trials: Sequence[Trial]) -> float:
    """Largest stiffness error [N*m/rad] on the Pareto front: 1.1 times that of the best trial."""
    return _SAME_STIFFNESS * _best(trials).get("stiffness_rmse", np.inf)


def air_of(trials: Sequence[Trial]) -> float:
    """Air [m^3] of the trial of lowest cost, median of the training runs that did not fail; NaN if unknown."""
    return _best(trials).get("air", np.nan)


def trial_at_air(trials: Sequence[Trial], air: float) -> Trial | None:
    """Trial of fewest failed runs, then of lowest angle error, with at most the given air [m^3], if any."""
    known = [trial for trial in _of_same_stiffness(trials) if (trial.metrics or {})["air"] <= air]
    return min(_least_failing(known), key=lambda trial: (trial.metrics or {})["angle_rmse"], default=None)


def least_air(trials: Sequence[Trial]) -> float:
    """Least air [m^3] of the trials that may be the one at equal air; infinite without any."""
    return min(((trial.metrics or {})["air"] for trial in _of_same_stiffness(trials)), default=np.inf)


def _of_same_stiffness(trials: Sequence[Trial]) -> list[Trial]:
    """Trials with known metrics and at most 1.1 times the stiffness error of the best."""
    limit = stiffness_limit(trials)
    return [trial for trial in trials if trial.metrics and trial.metrics["stiffness_rmse"] <= limit]


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
    return [trial for trial in trials if trial.metrics and trial.metrics.get(FAILED_RUNS, 0.0) == fewest]


def percentiles(values: NDArray[np.float64], unit: float) -> dict[str, float] | None:
    """Return median, 95th percentile and number of finite values in a unit; None without any."""
    values = values[np.isfinite(values)] / unit
    if not values.size:
        return None
    median, high = np.percentile(values, [50, 95])
    return {"median": float(median), "percentile_95": float(high), "runs": int(values.size)}


def ratio_of_medians(values: NDArray[np.float64], first: NDArray[np.float64]) -> dict[str, float]:
    """Ratio of the medians, with infinite errors in failed runs, and its bootstrap interval."""
    values, first = (np.where(np.isfinite(errors), errors, np.inf) for errors in (values, first))
    generator, ratios = np.random.default_rng(0), np.empty(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.median(values) / np.median(first)
        while ratios.size < _RESAMPLES:
            some = min(_RESAMPLES - ratios.size, max(_MAX_RESAMPLED // values.size, 1))
            rows = generator.integers(0, values.size, (some, values.size))
            ratios = np.append(ratios, np.median(values[rows], axis=1) / np.median(first[rows], axis=1))
    ratios = ratios[~np.isnan(ratios)]  # ratio of two infinite medians
    low, high = np.percentile(ratios, [2.5, 97.5], method="nearest") if ratios.size else (np.nan, np.nan)
    return {"ratio": float(ratio), "low": float(low), "high": float(high)}


def by_group(groups: NDArray, errors: dict[str, NDArray[np.float64]]) -> dict[str, dict[str, dict[str, float] | None]]:
    """Median and 95th percentile of errors in each group of runs."""
    return {
        group: {SHOWN[metric]: percentiles(values[groups == group], UNIT[metric]) for metric, values in errors.items()}
        for group in sorted(set(groups.tolist()))
    }


def correlation(condition: NDArray, error: NDArray[np.float64]) -> float | None:
    """Rank correlation, with infinite errors in failed runs."""
    coefficient = spearman(condition, np.where(np.isfinite(error), error, np.inf))
    return coefficient if np.isfinite(coefficient) else None
