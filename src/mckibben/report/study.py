"""Figures of sweeps, tuning and experiment design."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from mckibben.report.style import (
    BAND,
    BLACK,
    BLUE,
    DIRECTIONS,
    DOUBLE,
    VERMILLION,
    beside,
    blank,
    by_direction,
    letter,
    log_ticks,
    minus,
    part_of,
    plain_numbers,
    robust_limits,
    styled,
)
from mckibben.simulation.metrics import METRICS
from mckibben.study.ranks import spearman
from mckibben.study.tune.objective import FAILED_COST
from mckibben.units import bar, factor, percent

if TYPE_CHECKING:
    from mckibben.experiment_design import ExperimentPlan, PlannedPoint
    from mckibben.study.sweep import SweepResult
    from mckibben.study.tune import TuneResult

_FEW = 12  # labelled parameters


@styled
def tuning(tuned: TuneResult) -> Figure:
    """Cost over the evaluated points, and the best values within their ranges."""
    figure = blank(DOUBLE, 2.9)
    costs_axes, places_axes = figure.subplots(1, 2, width_ratios=(1.35, 1))
    costs = np.array([trial.cost for trial in tuned.trials])
    finite = costs < FAILED_COST
    tried = np.arange(1, costs.size + 1)

    letter(costs_axes, 0, "cost of the evaluated points")
    costs_axes.plot(tried[finite], costs[finite], ".", color=BLUE, markersize=2.5, alpha=0.5, label="point")
    best = np.minimum.accumulate(np.where(finite, costs, np.inf))
    costs_axes.plot(tried, np.where(np.isfinite(best), best, np.nan), color=VERMILLION, label="lowest so far")
    if np.isfinite(tuned.cost_before):
        costs_axes.axhline(tuned.cost_before, color="#555555", linewidth=0.8, linestyle=(0, (4, 2)), label="before")
    lost = int(np.sum(~finite))
    besides = f"; {lost} not drawn: invalid or unstable" if lost else ""
    costs_axes.set(xlabel=f"evaluated points{besides}", ylabel="cost", yscale="log", xlim=(0, costs.size + 1))
    plain_numbers(costs_axes.yaxis)
    low, high = costs_axes.get_ylim()
    costs_axes.set_ylim(low, high * (high / low) ** 0.3)  # space for the legend
    costs_axes.legend(loc="upper right")

    letter(places_axes, 1, "values within their ranges")
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
    places_axes.set_xlabel("blue: within 10 % of the lowest cost", fontsize=7)
    places_axes.grid(False)
    return figure


_COLUMNS = 4
_SINGLE_POINTS = 4000  # more runs are binned in hexagons
_BINS = 16
_FEWEST = 8  # runs in a bin with a median
_FEW_TICKS = 4
_FEW_VALUES = 12  # an input with at most this many values is not binned
_SPREAD_OF_LOG = 30.0


class _Input(NamedTuple):
    """Values of a swept parameter, in its shown unit."""

    name: str
    unit: str
    values: NDArray[np.float64]
    log: bool

    @property
    def bins(self) -> list[tuple[float, NDArray[np.bool_]]]:
        """Centre and members of each bin."""
        distinct = np.unique(self.values)
        if distinct.size <= _FEW_VALUES:
            return [(float(value), self.values == value) for value in distinct]
        even = np.log(np.abs(self.values)) if self.log else self.values
        edges = np.linspace(even.min(), even.max(), _BINS + 1)
        place = np.clip(np.searchsorted(edges, even, side="right") - 1, 0, _BINS - 1)
        middles = (edges[1:] + edges[:-1]) / 2
        middles = np.sign(distinct[0]) * np.exp(middles) if self.log else middles
        return [(float(middle), place == i) for i, middle in enumerate(middles)]


@styled
def sweep(swept: SweepResult) -> Figure:
    """Main metrics (rows) over the four parameters with the strongest rank correlations (columns).

    Runs are points or hexagonal bins, with the running median and a band of 90 % of the runs; the last row shows the
    share of unstable runs.
    """
    metrics, lost = swept.main_metrics, swept.failed
    inputs = _strongest(swept, metrics)
    rows = [*metrics, *([None] if lost.any() or not metrics else [])]
    heights = [1.0 if metric else 0.5 for metric in rows]
    width = DOUBLE * max(len(inputs), 2) / 4 if len(inputs) < 3 else DOUBLE
    figure = blank(width, 1.75 * sum(heights) + 0.75)
    grid = figure.subplots(len(rows), len(inputs), sharex="col", sharey="row", squeeze=False, height_ratios=heights)
    for i, metric in enumerate(rows):
        for j, one in enumerate(inputs):
            axes: Axes = grid[i, j]
            if metric is None:
                _lost(axes, one, lost)
            else:
                _metric(axes, one, swept, metric)
            if 1 < np.unique(one.values).size <= _FEW_TICKS:
                axes.set_xticks(np.unique(one.values))
            elif one.log and one.values.min() > 0:
                axes.set_xscale("log")
                log_ticks(axes.xaxis, 1.0, 3.0)
        grid[i, 0].set_ylabel("unstable runs [%]" if metric is None else _label(metric))
        if metric is None:
            grid[i, 0].set_ylim(0, 1.1 * max(line.get_ydata().max() for axes in grid[i] for line in axes.lines))
    for j, one in enumerate(inputs):
        grid[-1, j].set_xlabel(f"{_broken(one.name)}\n[{one.unit.replace('*', '·')}]")
    figure.align_ylabels(list(grid[:, 0]))
    share = f", {int(lost.sum())} unstable" if lost.any() else ""
    left_out = len(swept.inputs) - len(inputs)
    others = f"; {left_out} input{'s' if left_out > 1 else ''} with weaker correlation not shown" if left_out else ""
    figure.suptitle(f"{swept.count} runs{share}{others}", x=0.01, ha="left", fontsize=8, fontweight="normal")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    if handles:
        place = "outside upper right" if len(inputs) > 2 else "outside lower center"
        figure.legend(handles, labels, loc=place, ncols=len(labels), markerscale=2.5)
    return figure


def _strongest(swept: SweepResult, metrics: tuple[str, ...]) -> list[_Input]:
    """Parameters with the largest rank correlations, in their original order."""
    lost = swept.failed
    strengths = {}
    for name in swept.inputs:
        column = swept.table[name].to_numpy()
        found = [abs(spearman(column, lost))]
        for metric in metrics:
            values = swept.table[metric].to_numpy()
            there = ~lost & np.isfinite(values)
            found.append(abs(spearman(column[there], values[there])))
        strengths[name] = max(np.nan_to_num(found))
    chosen = sorted(strengths, key=lambda name: -strengths[name])[:_COLUMNS]
    return [_input(swept, name) for name in swept.inputs if name in chosen]


def _input(swept: SweepResult, name: str) -> _Input:
    variable = swept.table[name]
    unit = variable.attrs.get("shown_units", "1")
    values = variable.to_numpy().astype(float) / factor(unit)
    log = bool(re.search(r"\slog\b", variable.attrs.get("over", ""))) and bool(np.all(values > 0) or np.all(values < 0))
    return _Input(name, unit, values, log)


def _metric(axes: Axes, one: _Input, swept: SweepResult, metric: str) -> None:
    values = swept.table[metric].to_numpy().astype(float) / _shown(metric)[1]
    there = ~swept.failed & np.isfinite(values)
    x, y = one.values[there], values[there]
    low, high = np.percentile(y, [5, 95])
    log = bool(low > 0 and high > _SPREAD_OF_LOG * low)
    if log:
        axes.set_yscale("log")
        limits = tuple(10**end for end in robust_limits([np.log10(y[y > 0])], margin=0.06))
    else:
        limits = robust_limits([y], margin=0.06, floor=1e-9 + 0.02 * abs(float(np.median(y))))
    axes.set_ylim(*limits)
    inside = (y >= limits[0]) & (y <= limits[1])
    if x.size <= _SINGLE_POINTS:
        size = float(np.clip(900 / max(x.size, 1), 1.5, 9.0))
        axes.scatter(x[inside], y[inside], s=size, color=BLUE, alpha=0.35, linewidths=0, rasterized=True, label="run")
    else:
        scales: dict[str, Any] = {
            "xscale": "log" if one.log and x.min() > 0 else "linear",
            "yscale": "log" if log else "linear",
        }
        look: dict[str, Any] = {"gridsize": (32, 18), "bins": "log", "cmap": part_of("Blues", 50, 200), "linewidths": 0}
        axes.hexbin(x[inside], y[inside], rasterized=True, **scales, **look)
    if log:
        log_ticks(axes.yaxis, 1.0, 3.0)
    _median(axes, _Input(one.name, one.unit, x, one.log), y)
    correlation = spearman(x, y)
    if np.isfinite(correlation):
        beside(axes, f"ρ = {minus(correlation, '+.2f')}")


def _median(axes: Axes, one: _Input, y: NDArray[np.float64]) -> None:
    middles, curves = [], []
    few = np.unique(one.values).size <= _FEW_VALUES
    for middle, members in one.bins:
        if members.sum() >= (1 if few else min(_FEWEST, y.size // _BINS + 1)):
            middles.append(middle)
            curves.append(np.percentile(y[members], [5, 50, 95]))
    low, median, high = np.array(curves).T
    label = "90 % of nearby runs"
    axes.fill_between(middles, low, high, facecolor="#1111111A", edgecolor="#111111", linewidth=0.5, label=label)
    halo = [Stroke(linewidth=2.8, foreground="white"), Normal()]
    marker = "o" if few else ""
    axes.plot(middles, median, color=BLACK, marker=marker, zorder=4, label="median", path_effects=halo)


def _lost(axes: Axes, one: _Input, lost: NDArray[np.bool_]) -> None:
    places = [(middle, 100 * float(lost[members].mean())) for middle, members in one.bins if members.any()]
    middles, shares = (np.array(each) for each in zip(*places, strict=True))
    axes.fill_between(middles, 0, shares, color=VERMILLION, alpha=0.25, linewidth=0)
    axes.plot(middles, shares, color=VERMILLION, marker="o", markersize=2.2, linewidth=1.0)


def _shown(metric: str) -> tuple[str, float]:
    return next((unit, size) for name, unit, size in METRICS.values() if name == metric)


def _label(metric: str) -> str:
    words = metric.replace("rmse", "RMSE").replace("_", " ")
    return f"{words} [{_shown(metric)[0].replace('*', '·')}]"


def _broken(name: str) -> str:
    """Break a long name into two lines."""
    if len(name) <= 26:
        return name
    head, _, tail = name.rpartition(".")
    return f"{head}.\n{tail}"


_UNKNOWN, _OUT = "#C9C9C9", "#FFFFFF"

_MOST_STATES = 60  # more states are drawn as a region
_LABEL_GAP = 2.5 * percent, 0.35 * bar  # closer points share a label
_WIDEST = 300.0  # ratio of the colour scale


@styled
def planned(found: ExperimentPlan) -> Figure:
    """Standard error of the force over contraction and pressure: before the plan (left) and after it (right).

    Grey: not determined; white: not measurable. Planned points are numbered in order of gain.
    """
    figure = blank(DOUBLE, 4.3)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    scale, colours = _scale(found), _colours()
    for axes, errors in ((left, found.map.now), (right, found.map.after)):
        _shade(axes, found, errors, scale, colours)
        axes.set_xlabel("contraction [%]")
    left.set_ylabel("pressure [bar]")
    letter(left, 0, "now, measured points")
    letter(right, 1, f"after {len(found.points)} planned points")
    handles: list[Line2D | Patch] = []
    handles += _measured_points(left, found) + _quantity_states(left, right, found) + _planned_points(right, found)
    if np.isinf(found.map.now).any():
        handles.append(Patch(color=_UNKNOWN, label="force not determined"))
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4))
    mappable = ScalarMappable(scale, colours)
    shades = figure.colorbar(
        mappable, ax=[left, right], label="standard error of the force [N]", fraction=0.04, pad=0.01
    )
    log_ticks(shades.ax.yaxis, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
    figure.suptitle(_wrapped(found.verdict()), fontsize=8, fontweight="normal")
    return figure


def _scale(found: ExperimentPlan) -> LogNorm:
    both = np.concatenate([found.map.now.ravel(), found.map.after.ravel()])
    both = both[np.isfinite(both)]
    low = float(both.min()) if both.size else 1.0
    high = min(float(both.max()), _WIDEST * low) if both.size else 10.0
    return LogNorm(low, max(high, 1.5 * low))


def _colours() -> Colormap:
    """Colour map with a light end that keeps markers legible."""
    shades = part_of("YlOrBr", 0, 215)
    return shades.with_extremes(over=shades(214))


def _shade(axes: Axes, found: ExperimentPlan, errors: NDArray[np.float64], scale: LogNorm, colours: Colormap) -> None:
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
    handles = []
    for direction, where in by_direction(points):
        look: dict[str, Any] = DIRECTIONS.get(direction, {"color": "#333333", "marker": "o"})
        style = look | {"linestyle": "", "markersize": 2.6, "markeredgewidth": 0.4, "markeredgecolor": "white"}
        axes.plot(points.contraction[where] / percent, points.levels[where] / bar, **style)
        name = f"measured, {direction}" if direction else "measured"
        handles.append(Line2D([], [], **(style | {"markersize": 4.5}), label=name))
    return handles


def _planned_points(axes: Axes, found: ExperimentPlan) -> list[Line2D]:
    """Draw the planned points; close ones share a label."""
    used: dict[str, Line2D] = {}
    clusters: list[list[int]] = []
    for number, point in enumerate(found.points):
        look: dict[str, Any] = DIRECTIONS.get(point.direction, {"color": "#333333", "marker": "o"})
        style = look | {"linestyle": "", "markersize": 6.5, "markeredgecolor": "white", "markeredgewidth": 0.7}
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
        place = x.max() if right else x.min(), float(np.mean([found.points[i].pressure / bar for i in cluster]))
        side = {"xytext": (6 if right else -6, 0), "textcoords": "offset points", "ha": "left" if right else "right"}
        look = {"va": "center", "fontsize": 7, "fontweight": "bold", "zorder": 5}
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
        axes.annotate(", ".join(str(number + 1) for number in cluster), place, bbox=box, **side, **look)
    return list(used.values())


def _close(one: PlannedPoint, other: PlannedPoint) -> bool:
    apart = ((one.contraction - other.contraction) / _LABEL_GAP[0], (one.pressure - other.pressure) / _LABEL_GAP[1])
    return bool(np.hypot(*apart) <= 1)


def _quantity_states(left: Axes, right: Axes, found: ExperimentPlan) -> list[Line2D]:
    """Draw the states of the quantity of interest."""
    states = found.target_states
    if not len(states):
        return []
    x, y = states[:, 0] / percent, states[:, 1] / bar
    look: dict[str, Any] = {"color": BLUE, "linewidth": 1.0}
    if len(states) <= _MOST_STATES:
        look = {"color": BLUE, "linestyle": "", "marker": "+", "markeredgewidth": 1.6}
    else:  # the outline of their range
        low, high, bottom, top = x.min(), x.max(), y.min(), y.max()
        x, y = np.array([low, high, high, low, low]), np.array([bottom, bottom, top, top, bottom])
    for axes in (left, right):
        axes.plot(x, y, zorder=3, markersize=8, **look)
    return [Line2D([], [], label="quantity of interest", **look)]


def _wrapped(text: str) -> str:
    """Break a sentence after its first clause."""
    first, semicolon, rest = text.partition("; ")
    return f"{first}{semicolon.strip()}\n{rest}"
