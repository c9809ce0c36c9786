"""Figure of a plan: standard error of the force before and after it, measured and planned points."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from mckibben.experiment_design import ExperimentPlan, PlannedPoint
from mckibben.report.style import BLUE, DOUBLE, LOADING, UNLOADING, blank, letter, styled
from mckibben.units import bar, percent

_UNKNOWN, _OUT = "#C9C9C9", "#FFFFFF"
_DIRECTIONS = {"loading": LOADING, "unloading": UNLOADING}
_MOST_STATES = 60  # more states are drawn as a region
_LABEL_GAP = 2.5 * percent, 0.35 * bar  # closer points share a label
_WIDEST = 300.0  # ratio of the colour scale


@styled
def planned(found: ExperimentPlan) -> Figure:
    """Standard error of the force over contraction and pressure: before the plan (left) and after it (right).

    Grey: not determined; white: not measurable. Planned points are numbered by their gain.
    """
    figure = blank(DOUBLE, 4.3)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    scale, colours = _scale(found), _colours()
    for axes, errors in ((left, found.map.now), (right, found.map.after)):
        _shade(axes, found, errors, scale, colours)
        axes.set_xlabel("contraction [%]")
    left.set_ylabel("pressure [bar]")
    letter(left, "a", "now, measured points")
    letter(right, "b", f"after {len(found.points)} planned points")
    handles: list[Line2D | Patch] = []
    handles += _measured_points(left, found) + _quantity_states(left, right, found) + _planned_points(right, found)
    if np.isinf(found.map.now).any():
        handles.append(Patch(color=_UNKNOWN, label="force not determined"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    mappable = ScalarMappable(scale, colours)
    shades = figure.colorbar(
        mappable, ax=[left, right], label="standard error of the force [N]", fraction=0.04, pad=0.01
    )
    shades.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0)))
    shades.ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    shades.ax.yaxis.set_minor_formatter(NullFormatter())
    figure.suptitle(_wrapped(found.summary()), fontsize=8, fontweight="normal")
    return figure


def _scale(found: ExperimentPlan) -> LogNorm:
    both = np.concatenate([found.map.now.ravel(), found.map.after.ravel()])
    both = both[np.isfinite(both)]
    low = float(both.min()) if both.size else 1.0
    high = min(float(both.max()), _WIDEST * low) if both.size else 10.0
    return LogNorm(low, max(high, 1.5 * low))


def _colours() -> ListedColormap:
    """Colour map whose light end leaves markers legible."""
    import matplotlib as mpl

    shades = ListedColormap(mpl.colormaps["YlOrBr"].resampled(256)(range(256))[:215])
    shades.set_over(shades(214))
    return shades


def _shade(
    axes: Axes, found: ExperimentPlan, errors: NDArray[np.float64], scale: LogNorm, colours: ListedColormap
) -> None:
    x, y = found.map.states.contractions / percent, found.map.states.pressures / bar
    axes.pcolormesh(
        _edges(x), _edges(y), np.ma.masked_where(~np.isinf(errors), np.ones_like(errors)),
        cmap=ListedColormap([_UNKNOWN]), rasterized=True,
    )  # fmt: skip
    shown = np.ma.masked_where(~np.isfinite(errors), errors)
    axes.pcolormesh(_edges(x), _edges(y), shown, norm=scale, cmap=colours, rasterized=True)
    axes.set_facecolor(_OUT)
    axes.grid(False)


def _edges(centres: NDArray[np.float64]) -> NDArray[np.float64]:
    """Edges of evenly spaced cells."""
    step = float(np.diff(centres[:2])[0]) if len(centres) > 1 else 1.0
    return np.append(centres - step / 2, centres[-1] + step / 2)


def _measured_points(axes: Axes, found: ExperimentPlan) -> list[Line2D]:
    points = found.measured.taut
    known = points.table["direction"].to_numpy() if "direction" in points.table else np.full(len(points), "")
    handles = []
    for direction in np.unique(known):
        look = _DIRECTIONS.get(str(direction), {"color": "#333333", "marker": "o"})
        where = known == direction
        style = {**look, "linestyle": "", "markersize": 2.6, "markeredgewidth": 0.4, "markeredgecolor": "white"}
        axes.plot(points.contraction[where] / percent, points.levels[where] / bar, **style)
        name = f"measured, {direction}" if direction else "measured"
        handles.append(Line2D([], [], **{**style, "markersize": 4.5}, label=name))
    return handles


def _planned_points(axes: Axes, found: ExperimentPlan) -> list[Line2D]:
    """Draw the planned points; close ones share a label."""
    used: dict[str, Line2D] = {}
    clusters: list[list[int]] = []
    for number, point in enumerate(found.points):
        look = _DIRECTIONS.get(point.direction, {"color": "#333333", "marker": "o"})
        style = {**look, "linestyle": "", "markersize": 6.5, "markeredgecolor": "white", "markeredgewidth": 0.7}
        axes.plot([point.contraction / percent], [point.pressure / bar], zorder=4, clip_on=False, **style)
        name = f"planned, {point.direction}" if point.direction else "planned"
        used[name] = Line2D([], [], label=name, **style)
        near = next((cluster for cluster in clusters if any(_close(found.points[i], point) for i in cluster)), None)
        if near is None:
            clusters.append([number])
        else:
            near.append(number)
    low, high = axes.get_xlim()
    for cluster in clusters:
        x = np.array([found.points[i].contraction / percent for i in cluster])
        right = x.max() < (low + high) / 2
        axes.annotate(
            ", ".join(str(number + 1) for number in cluster),
            (x.max() if right else x.min(), float(np.mean([found.points[i].pressure / bar for i in cluster]))),
            xytext=(6 if right else -6, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            fontsize=7,
            fontweight="bold",
            zorder=5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6},
        )
    return list(used.values())


def _close(one: PlannedPoint, other: PlannedPoint) -> bool:
    apart = (
        (one.contraction - other.contraction) / _LABEL_GAP[0],
        (one.pressure - other.pressure) / _LABEL_GAP[1],
    )
    return bool(np.hypot(*apart) <= 1)


def _quantity_states(left: Axes, right: Axes, found: ExperimentPlan) -> list[Line2D]:
    """Draw the states of the quantity of interest."""
    states = found.target_states
    if not len(states):
        return []
    x, y = states[:, 0] / percent, states[:, 1] / bar
    for axes in (left, right):
        if len(states) <= _MOST_STATES:
            axes.plot(x, y, "+", color=BLUE, markersize=8, markeredgewidth=1.6, zorder=3)
        else:
            low, high, bottom, top = x.min(), x.max(), y.min(), y.max()
            axes.plot(
                [low, high, high, low, low], [bottom, bottom, top, top, bottom], color=BLUE, linewidth=1.0, zorder=3
            )
    if len(states) <= _MOST_STATES:
        return [Line2D([], [], linestyle="", marker="+", color=BLUE, markeredgewidth=1.6, label="quantity of interest")]
    return [Line2D([], [], color=BLUE, linewidth=1.0, label="quantity of interest")]


def _wrapped(text: str) -> str:
    """Break a sentence after its first clause."""
    first, semicolon, rest = text.partition("; ")
    return f"{first}{semicolon.strip()}\n{rest}"
