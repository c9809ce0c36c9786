"""The figure of a muscle's hysteresis: its loops as measured and as the identified friction has them."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.identification.hysteresis_fit import HysteresisFit
from mckibben.report.panels import letter
from mckibben.report.style import BLACK, DOUBLE, LOADING, UNLOADING, blank, styled
from mckibben.units import bar, percent

_MOST_LOOPS = 6
_CONTRACTION = "contraction [%]"
_MODEL = {"color": BLACK, "linewidth": 0.8, "zorder": 4}


@styled
def loops(dataset: IsobaricDataset, found: HysteresisFit) -> Figure:
    """Loading and unloading, measured and modelled: above all of the force, below what the way adds to the static law.

    Parameters
    ----------
    dataset
        The one that the hysteresis was identified from.
    found
        Of `identify_hysteresis`.

    Raises
    ------
    RangeError
        If the dataset has another number of points.
    """
    means = dataset.plateau_means()
    if len(means) != len(found.residuals):
        raise RangeError(
            f"the hysteresis is of {len(found.residuals)} points, the dataset has {len(means)}",
            remedy="give the dataset that it was identified from",
        )
    shown = _spread(np.unique(means.levels[found.tension > 0]))
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    figure = blank(DOUBLE, 3.0 + 1.75 * rows)
    parts: Any = figure.subfigures(2, 1, height_ratios=[3.0, 1.75 * rows])
    upper, lower = parts
    curves = upper.subplots()
    _forces(curves, means, found)
    letter(curves, "a", "force")
    grid = lower.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for i, (axes, level) in enumerate(zip(grid, shown, strict=False)):
        error = _loop(axes, means, found, level)
        letter(axes, "bcdefg"[i], f"{level / bar:g} bar, RMSE {error:.2g} N")
        axes.set(xlabel=_CONTRACTION, ylabel="friction [N]")
        axes.label_outer()
    for axes in grid[len(shown) :]:
        axes.remove()
    return figure


def _spread(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """At most so many levels as there is room for, from the lowest to the highest."""
    place = np.unique(np.linspace(0, len(levels) - 1, min(len(levels), _MOST_LOOPS)).round().astype(int))
    return levels[place]


def _forces(axes: Axes, means: IsobaricDataset, found: HysteresisFit) -> None:
    """All points, and the modelled force as a line for each pass."""
    force, model = means.force - found.offset, found.tension + found.friction_force
    loading = means.table["direction"].to_numpy() == "loading"
    for side, look in ((loading, LOADING), (~loading, UNLOADING)):
        axes.plot(means.contraction[side] / percent, force[side], linestyle="none", markersize=2, **look)
    for way in _ways(means):
        axes.plot(means.contraction[way] / percent, model[way], **_MODEL)
    handles = [
        Line2D([], [], linestyle="none", markersize=4, label="loading (being stretched)", **LOADING),
        Line2D([], [], linestyle="none", markersize=4, label="unloading (shortening)", **UNLOADING),
        Line2D([], [], label="law and friction", **_MODEL),
    ]
    friction = found.friction
    title = f"half width {friction.half_width:.3g} N at {friction.reference_pressure / bar:.3g} bar"
    if friction.growth:
        title += f", {friction.growth * bar:+.2g} N/bar"
    axes.legend(handles=handles, loc="upper right", title=title, title_fontsize=7.5, alignment="left")
    axes.set(xlabel=_CONTRACTION, ylabel="force [N]")


def _loop(axes: Axes, means: IsobaricDataset, found: HysteresisFit, level: float) -> float:
    """What is measured beyond law and drift at a pressure, and the friction along the way; returns the RMSE [N]."""
    here = np.isclose(means.levels, level, rtol=0, atol=1.0) & (found.tension > 0)
    loading = means.table["direction"].to_numpy() == "loading"
    measured = found.residuals + found.friction_force
    for side, look in ((here & loading, LOADING), (here & ~loading, UNLOADING)):
        axes.plot(means.contraction[side] / percent, measured[side], linestyle="none", markersize=2.5, **look)
    for way in _ways(means):
        if here[way].any():
            way = way[here[way]]
            axes.plot(means.contraction[way] / percent, found.friction_force[way], **_MODEL)
    axes.axhline(0.0, color="#999999", linewidth=0.5, zorder=0)
    return float(np.sqrt(np.mean(found.residuals[here] ** 2)))


def _ways(means: IsobaricDataset) -> list[NDArray[np.int64]]:
    """The rows of each time a pressure was set, in the order of time."""
    time = means.table["time"].to_numpy() if "time" in means.table else np.arange(len(means))
    order = np.argsort(time, kind="stable")
    return np.split(order, np.flatnonzero(np.abs(np.diff(means.levels[order])) > 1.0) + 1)
