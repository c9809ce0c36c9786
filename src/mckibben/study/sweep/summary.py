"""A sweep in numbers: how runs ended, how well they went, what that depends on, and what was out of reach."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.numbers import METRICS
from mckibben.study.sweep.answer import Sweep

MAIN = ("angle_rmse", "stiffness_rmse", "coupling")
"""The metrics of which correlations are computed and figures are drawn, as far as they are there."""

_FEWEST = 3  # runs: with fewer every order is a perfect one
_SHOWN = {metric: name for name, (metric, _, _) in METRICS.items()}


def summary(sweep: Sweep) -> dict[str, Any]:
    """The statistics of a sweep, as JSON has them.

    Parameters
    ----------
    sweep
        What has been computed.

    Returns
    -------
    numbers
        ``scenario``, ``runs``, ``lost``; ``outcomes``: counts. ``metrics``, under the names and in the units in which
        they are shown, over the runs that are not lost: ``median``, ``percentile_5``, ``percentile_95``, ``worst`` with
        its ``worst_run`` (from 0), and how many ``runs`` have a number at all; None where none has.
        ``correlations``: Spearman's rank correlation of each input with each main metric, and with being lost, the
        strongest first. ``reach``: how many runs wish for what the joint cannot hold.
    """
    lost = sweep.lost
    codes = sweep.table["outcome"].to_numpy()
    counts = {outcome.name.lower(): int(np.sum(codes == code)) for code, outcome in enumerate(OUTCOMES)}
    return {
        "scenario": sweep.table.attrs.get("title", ""),
        "runs": sweep.count,
        "lost": int(lost.sum()),
        "outcomes": {name: count for name, count in counts.items() if count},
        "metrics": {_SHOWN[name]: _spread(sweep, name, ~lost) for name in sweep.metrics},
        "correlations": _correlations(sweep, lost),
        "reach": _reach(sweep),
    }


def main_metrics(sweep: Sweep) -> tuple[str, ...]:
    """Up to three metrics that have numbers: the main ones, and others where there is none of these."""
    alive = [name for name in sweep.metrics if np.isfinite(sweep.table[name].to_numpy()[~sweep.lost]).any()]
    main = [name for name in MAIN if name in alive]
    return tuple(main or alive[:3])


def spearman(x: ArrayLike, y: ArrayLike) -> float:
    """Spearman's rank correlation of two columns; ties share their mean rank. NaN where one of them is constant.

    >>> round(spearman([1, 2, 3, 4], [1, 10, 100, 50]), 6)
    0.8
    """
    from scipy.stats import rankdata

    ranks = [rankdata(np.asarray(values, float)) for values in (x, y)]
    centred = [rank - rank.mean() for rank in ranks] if len(ranks[0]) else ranks
    size = np.sqrt(np.sum(centred[0] ** 2) * np.sum(centred[1] ** 2))
    return float(np.sum(centred[0] * centred[1]) / size) if size > 0 else float("nan")


def _spread(sweep: Sweep, name: str, of_use: NDArray[np.bool_]) -> dict[str, Any]:
    values = sweep.table[name].to_numpy().astype(float) / METRICS[_SHOWN[name]][2]
    there = of_use & np.isfinite(values)
    if not there.any():
        nothing = dict.fromkeys(("median", "percentile_5", "percentile_95", "worst", "worst_run"))
        return {**nothing, "runs": 0}
    low, median, high = np.percentile(values[there], [5, 50, 95])
    worst = int(np.argmax(np.where(there, values, -np.inf)))
    return {
        "median": float(median),
        "percentile_5": float(low),
        "percentile_95": float(high),
        "worst": float(values[worst]),
        "worst_run": worst,
        "runs": int(there.sum()),
    }


def _correlations(sweep: Sweep, lost: NDArray[np.bool_]) -> list[dict[str, Any]]:
    answers = {_SHOWN[name]: sweep.table[name].to_numpy() for name in main_metrics(sweep)}
    found = []
    for name in sweep.inputs:
        column = sweep.table[name].to_numpy()
        for metric, values in answers.items():
            there = ~lost & np.isfinite(values)
            if there.sum() >= _FEWEST:
                found.append({"input": name, "with": metric, "spearman": spearman(column[there], values[there])})
        if len(column) >= _FEWEST:
            found.append({"input": name, "with": "lost", "spearman": spearman(column, lost)})
    found = [each for each in found if np.isfinite(each["spearman"])]
    return sorted(found, key=lambda each: -abs(each["spearman"]))


def _reach(sweep: Sweep) -> dict[str, Any]:
    short, unheld = sweep.table["shortfall_max"].to_numpy(), sweep.table["unheld"].to_numpy()
    out_of_reach = np.nan_to_num(short) > 0
    worst = int(np.argmax(np.nan_to_num(short)))
    return {
        "runs_stiffness_out_of_reach": int(out_of_reach.sum()),
        "shortfall_max": float(short[worst]) if out_of_reach.any() else 0.0,
        "shortfall_max_run": worst if out_of_reach.any() else None,
        "runs_angle_unheld": int(np.sum(unheld > 0)),
        "runs_out_of_reach": int(np.sum(out_of_reach | (unheld > 0))),
    }
