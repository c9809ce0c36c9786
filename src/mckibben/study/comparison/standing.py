"""A contest in numbers: how each controller did, against the first, and what its errors depend on."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mckibben.simulation import Metrics
from mckibben.study.comparison.comparing import Contest
from mckibben.study.numbers import METRICS
from mckibben.study.sweep.summary import spearman

if TYPE_CHECKING:
    import xarray as xr

MAIN = ("angle_rmse", "stiffness_rmse")
"""The errors that are set against those of the first controller."""
_RESAMPLED = 2000
_AT_ONCE = 2_000_000  # numbers
_SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}
_UNIT = {metric: unit for metric, _, unit in METRICS.values()}


def standing(contest: Contest) -> dict[str, Any]:
    """The statistics of a contest, as JSON has them.

    Parameters
    ----------
    contest
        What `compare` gave.

    Returns
    -------
    numbers
        ``suite``; ``runs``, of which ``not_begun`` no controller could begin; ``order``: controllers by their median
        cost. ``controllers``, by name: ``lost`` runs; ``metrics`` under the names and in the units in which they are
        shown: ``median`` and ``percentile_95`` over the runs that were not lost, and how many ``runs`` have a number;
        ``against_first``: for both errors the ratio of the medians, and the interval in which 95 % of 2000 resamplings
        of the runs lie; ``settled``: in how many ``runs`` the stiffness settled after its step, ``of`` how many that
        have one and were not lost; ``by_wish`` and ``by_joint``: medians of both errors; ``depends_on``: Spearman's
        rank correlation of both errors with each condition; ``tuned``: numbers [SI]; ``training_cost`` before and
        after; ``at_bound``.
    """
    names = list(contest.batches)
    median_cost = {name: float(np.median(contest.cost(name))) for name in names}
    return {
        "suite": contest.suite.name,
        "cost": contest.suite.tuning.cost,
        "runs": contest.runs.count,
        "not_begun": int((~contest.started).sum()),
        "order": sorted(names, key=lambda name: median_cost[name]),
        "controllers": {name: _of(contest, name, median_cost[name]) for name in names},
    }


def table_of(contest: Contest) -> xr.Dataset:
    """All runs of all controllers, along ``controller`` and ``run``: metrics and outcomes; along ``run`` the draws."""
    import xarray as xr

    batches = contest.batches
    names = list(batches)
    table: dict[str, Any] = {
        name: (("controller", "run"), np.stack([batches[each].metrics[name] for each in names]))
        for name in Metrics._fields
    }
    codes = np.stack([batches[each].table["outcome"].to_numpy() for each in names])
    flags = {key: batches[names[0]].table["outcome"].attrs[key] for key in ("flag_values", "flag_meanings")}
    table["outcome"] = (("controller", "run"), codes, flags)
    table["joint"] = ("run", np.array(contest.runs.joint, dtype=str))
    table["wish"] = ("run", np.array(contest.runs.wish, dtype=str))
    for name, values in contest.runs.conditions.items():
        table[name] = ("run", values)
    for wish, columns in contest.runs.wished.items():
        rows = np.array([each == wish for each in contest.runs.wish])
        for name, values in columns.items():
            column = table.get(name, ("run", np.full(contest.runs.count, np.nan)))[1]
            column[rows] = values
            table[name] = ("run", column)
    found = xr.Dataset(table, coords={"controller": names}, attrs={"title": contest.suite.name})
    found.attrs["tuned"] = json.dumps(contest.tuned)
    return found


def keep_table(contest: Contest, path: Path) -> None:
    """Write `table_of` to a NetCDF file, which appears whole or not at all."""
    from mckibben.dataset.netcdf import write_netcdf

    write_netcdf(table_of(contest), path)


def _of(contest: Contest, name: str, median_cost: float) -> dict[str, Any]:
    first = next(iter(contest.batches))
    wishes, joints = (np.array(each)[contest.started] for each in (contest.runs.wish, contest.runs.joint))
    errors = {metric: contest.metric(name, metric) for metric in MAIN}
    cost = contest.training_cost.get(name)
    stepped = np.isfinite(contest.metric(name, "coupling"))
    settled = stepped & np.isfinite(contest.metric(name, "stiffness_settling"))
    return {
        "lost": int(contest.lost(name).sum()),
        "median_cost": median_cost,
        "metrics": {_SHOWN[metric]: _spread(contest.metric(name, metric), _UNIT[metric]) for metric in Metrics._fields},
        "settled": {"runs": int(settled.sum()), "of": int(stepped.sum())},
        "against_first": {_SHOWN[metric]: _ratio(errors[metric], contest.metric(first, metric)) for metric in MAIN},
        "by_wish": _by(wishes, errors),
        "by_joint": _by(joints, errors),
        "depends_on": {
            condition: {_SHOWN[metric]: _correlation(values[contest.started], errors[metric]) for metric in MAIN}
            for condition, values in contest.runs.conditions.items()
            if condition != "sensors.seed"
        },
        "tuned": contest.tuned[name],
        "training_cost": None if cost is None else {"tuned": cost[0], "before": cost[1]},
        "at_bound": list(contest.at_bound[name]),
    }


def _spread(values: NDArray[np.float64], unit: float) -> dict[str, Any] | None:
    values = values[np.isfinite(values)] / unit
    if not values.size:
        return None
    median, high = np.percentile(values, [50, 95])
    return {"median": float(median), "percentile_95": float(high), "runs": int(values.size)}


def _ratio(values: NDArray[np.float64], first: NDArray[np.float64]) -> dict[str, float]:
    """Of the medians, lost runs counting as endless errors; and what resampling the runs makes of it."""
    values, first = (np.where(np.isfinite(each), each, np.inf) for each in (values, first))
    generator, ratios = np.random.default_rng(0), np.empty(0)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.median(values) / np.median(first)
        while ratios.size < _RESAMPLED:  # some at once, as memory allows
            some = min(_RESAMPLED - ratios.size, max(_AT_ONCE // values.size, 1))
            rows = generator.integers(0, values.size, (some, values.size))
            found = np.median(values[rows], axis=1) / np.median(first[rows], axis=1)
            ratios = np.append(ratios, found)
    ratios = ratios[~np.isnan(ratios)]  # of two that are endless
    low, high = np.percentile(ratios, [2.5, 97.5], method="nearest") if ratios.size else (np.nan, np.nan)
    return {"ratio": float(ratio), "low": float(low), "high": float(high)}


def _by(groups: NDArray[Any], errors: dict[str, NDArray[np.float64]]) -> dict[str, dict[str, float | None]]:
    def median(values: NDArray[np.float64]) -> float | None:
        values = values[np.isfinite(values)]
        return float(np.median(values)) if values.size else None

    found = {}
    for group in dict.fromkeys(groups.tolist()):
        chosen = {metric: median(values[groups == group]) for metric, values in errors.items()}
        found[group] = {_SHOWN[m]: None if v is None else v / _UNIT[m] for m, v in chosen.items()}
    return dict(sorted(found.items()))


def _correlation(condition: NDArray[Any], error: NDArray[np.float64]) -> float | None:
    """Lost runs stand behind all others."""
    found = spearman(condition, np.where(np.isfinite(error), error, np.inf))
    return float(found) if np.isfinite(found) else None
