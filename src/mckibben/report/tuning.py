"""How a search went: the cost of all that was tried, and where in its range each number ended."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from mckibben.report.panels import letter
from mckibben.report.style import BAND, BLUE, DOUBLE, VERMILLION, blank, styled
from mckibben.study.tuning import Tuned
from mckibben.study.tuning.problem import LOST

_FEW = 12  # numbers that still have room for their names


@styled
def tuning(tuned: Tuned) -> Figure:
    """Draw a search.

    Parameters
    ----------
    tuned
        Its outcome.
    """
    figure = blank(DOUBLE, 2.9)
    costs_axes, places_axes = figure.subplots(1, 2, width_ratios=(1.35, 1))
    costs = np.array([trial.cost for trial in tuned.trials])
    finite = costs < LOST
    tried = np.arange(1, costs.size + 1)

    letter(costs_axes, "a", "cost of what was tried")
    costs_axes.plot(tried[finite], costs[finite], ".", color=BLUE, markersize=2.5, alpha=0.5, label="a point")
    best = np.minimum.accumulate(np.where(finite, costs, np.inf))
    costs_axes.plot(tried, np.where(np.isfinite(best), best, np.nan), color=VERMILLION, label="the best so far")
    if np.isfinite(tuned.cost_before):
        costs_axes.axhline(tuned.cost_before, color="#555555", linewidth=0.8, linestyle=(0, (4, 2)), label="before")
    lost = int(np.sum(~finite))
    besides = f"; {lost} not drawn: not allowed, or lost" if lost else ""
    costs_axes.set(xlabel=f"points tried{besides}", ylabel="cost", yscale="log", xlim=(0, costs.size + 1))
    low, high = costs_axes.get_ylim()
    costs_axes.set_ylim(low, high * (high / low) ** 0.3)  # room for the legend
    costs_axes.legend(loc="upper right")

    letter(places_axes, "b", "where in its range each ended")
    names = list(tuned.values)
    points = np.array([trial.point for trial in tuned.trials])
    good = finite & (costs <= 1.1 * costs.min())
    rows = np.arange(len(names))[::-1]
    places_axes.hlines(rows, 0, 1, color=BAND, linewidth=5, zorder=0)
    for row, column in zip(rows, points[good].T, strict=True):
        places_axes.plot(column, np.full(column.size, row), "|", color=BLUE, markersize=7, alpha=0.25)
    places_axes.plot(points[np.argmin(costs)], rows, "D", color=VERMILLION, markersize=4)
    shown = [name.removeprefix("controller.") for name in names] if len(names) <= _FEW else [""] * len(names)
    places_axes.set(xlim=(-0.03, 1.03), ylim=(-0.7, len(names) - 0.3), yticks=rows, yticklabels=shown)
    places_axes.set_xticks([0, 0.5, 1], ["lower end", "middle", "upper end"])
    places_axes.set_xlabel("blue: within 10 % of the least cost", fontsize=7)
    places_axes.grid(False)
    return figure
