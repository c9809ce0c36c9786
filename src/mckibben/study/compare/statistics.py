"""Statistics of a comparison: trials at equal air, spreads of errors, and ratios of medians."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.study.tune.trials import Trial

TRADED = ("angle_rmse", "stiffness_rmse", "air")
"""Metrics of each trial of the tuning, medians of the training runs."""
FAILED_RUNS = "failed"
"""Number of failed training runs, among the metrics of a trial."""


def median(trial: Trial, metric: str) -> float:
    """Metric [SI] of a trial, or its number of failed runs; infinite if unknown.

    >>> median(Trial((0.5,), 1.0, {"air": 2e-4}), "air"), median(Trial((0.5,), 1.0), "air")
    (0.0002, inf)
    """
    return (trial.metrics or {}).get(metric, 0.0 if trial.metrics and metric == FAILED_RUNS else np.inf)


def least_failing(trials: Iterable[Trial]) -> list[Trial]:
    """Trials with known metrics and the smallest number of failed training runs."""
    measured = [trial for trial in trials if trial.metrics]
    fewest = min((median(trial, FAILED_RUNS) for trial in measured), default=np.inf)
    return [trial for trial in measured if median(trial, FAILED_RUNS) == fewest]


def best_trial(trials: Iterable[Trial]) -> Trial:
    """Trial of the lowest cost of those of fewest failed runs; one without metrics if all failed in too many runs."""
    return min(least_failing(trials), key=lambda trial: trial.order, default=Trial((), np.inf))


def stiffness_limit(trials: Iterable[Trial], ratio: float = 1.1) -> float:
    """Largest stiffness error [N*m/rad] at equal air: a ratio times that of the best trial."""
    return ratio * median(best_trial(trials), "stiffness_rmse")


def comparable(trials: Sequence[Trial]) -> list[Trial]:
    """Trials with known metrics whose stiffness error is within the limit."""
    limit = stiffness_limit(trials)
    return [trial for trial in trials if trial.metrics and median(trial, "stiffness_rmse") <= limit]


def trial_at_air(trials: Sequence[Trial], air: float) -> Trial | None:
    """Comparable trial of fewest failed runs, then of lowest angle error, with at most some air [m^3], if any."""
    affordable = least_failing(trial for trial in comparable(trials) if median(trial, "air") <= air)
    return min(affordable, key=lambda trial: median(trial, "angle_rmse"), default=None)


def front(trials: Sequence[Trial]) -> list[Trial]:
    """Pareto front (air, angle error) of the comparable trials of fewest failed runs, by increasing air.

    A trial is on it if no other has both less air and a smaller error.
    """
    points: list[Trial] = []
    for trial in sorted(least_failing(comparable(trials)), key=lambda t: (median(t, "air"), median(t, "angle_rmse"))):
        if not points or median(trial, "angle_rmse") < median(points[-1], "angle_rmse"):
            points.append(trial)
    return points


class Ratio(NamedTuple):
    """Ratio of two medians, and the ends of its interval."""

    ratio: float
    low: float
    high: float


def ratio_of_medians(values: NDArray[np.float64], first: NDArray[np.float64], resamples: int) -> Ratio:
    """Ratio of the medians of two errors of the same runs, with its bootstrap interval at 95 %.

    Runs are resampled in pairs (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, Ch. 13); a failed run, of
    NaN, counts as an infinite error.

    >>> errors = np.array([1.0, 2.0, 4.0])
    >>> ratio_of_medians(errors, 2 * errors, 100)
    Ratio(ratio=0.5, low=0.5, high=0.5)
    """
    pair = np.where(np.isfinite([values, first]), [values, first], np.inf)
    generator = np.random.default_rng(0)
    draws = (pair[:, generator.integers(0, values.size, values.size)] for _ in range(resamples))
    medians = np.array([np.median(pair, axis=1), *(np.median(draw, axis=1) for draw in draws)])
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio, *ratios = medians[:, 0] / medians[:, 1]
    defined = np.array(ratios)[~np.isnan(ratios)]  # a ratio of two infinite medians is not known
    low, high = np.percentile(defined, [2.5, 97.5], method="nearest") if defined.size else (np.nan, np.nan)
    return Ratio(float(ratio), float(low), float(high))
