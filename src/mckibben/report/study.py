"""Figures of sweeps, tuning and experiment design."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import Normal, Stroke
from numpy.typing import NDArray

from mckibben.numerics.calculus import evenly_spaced
from mckibben.report.palette import BAND, BLACK, BLUE, VERMILLION
from mckibben.report.style import (
    DIRECTIONS,
    DOUBLE,
    Look,
    beside,
    blank,
    draw_points,
    letter,
    minus,
    part_of,
    plain_numbers,
    robust_limits,
    styled,
)
from mckibben.study.tune.objective import FAILED_COST
from mckibben.units import bar, factor, percent

if TYPE_CHECKING:
    from mckibben.experiment_design import ExperimentPlan
    from mckibben.study.sweep import SweepResult
    from mckibben.study.tune import TuneResult


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
    labels = [name.removeprefix("controller.") if len(names) <= 12 else "" for name in names]
    places_axes.set(xlim=(-0.03, 1.03), ylim=(-0.7, len(names) - 0.3), yticks=rows, yticklabels=labels)
    places_axes.set_xticks([0, 0.5, 1], ["lower end", "middle", "upper end"])
    places_axes.set_xlabel("blue: within 10 % of the lowest cost", fontsize=7)
    places_axes.grid(False)
    return figure


class _Input(NamedTuple):
    """Values of a swept parameter, in its shown unit, and the bin of each for medians."""

    name: str
    unit: str
    values: NDArray[np.float64]
    log: bool

    @property
    def label(self) -> str:
        """Label of its axis; a long address is broken into two lines."""
        head, _, tail = self.name.rpartition(".")
        return f"{head}.\n{tail} [{self.unit.replace('*', '·')}]" if head else f"{tail} [{self.unit.replace('*', '·')}]"

    def bins(self) -> Iterator[tuple[float, NDArray[np.bool_]]]:
        """Median and members of each bin: of each value, or of as many parts with equally many runs."""
        edges, most = np.unique(self.values), int(np.clip(self.values.size // 8, 4, 12))
        if edges.size > most:
            edges = np.quantile(self.values, np.linspace(0, 1, most, endpoint=False))
        place = np.searchsorted(edges, self.values, side="right")
        for number in np.unique(place):
            yield float(np.median(self.values[place == number])), place == number


@styled
def sweep(swept: SweepResult) -> Figure:
    """Main metrics (rows) over the four parameters with the strongest rank correlations (columns).

    Points are runs, with the running median and a band of 90 % of the runs; the last row shows the share of unstable
    runs.
    """
    metrics, lost = swept.main_metrics, swept.failed
    inputs = _strongest(swept)
    heights = [1.0] * len(metrics) + [0.5] * bool(lost.any() or not metrics)
    figure = blank(DOUBLE if len(inputs) > 2 else DOUBLE / 2, 1.75 * sum(heights) + 0.75)
    grid = figure.subplots(len(heights), len(inputs), sharex="col", sharey="row", squeeze=False, height_ratios=heights)
    for column, swept_input in zip(grid.T, inputs, strict=True):
        for axes, metric in zip(column, metrics, strict=False):
            _metric(axes, swept_input, swept, metric)
        if len(heights) > len(metrics):
            _lost(column[-1], swept_input, lost)
        if swept_input.log and swept_input.values[0] > 0:
            column[0].set_xscale("log")
            plain_numbers(column[0].xaxis)
        column[-1].set_xlabel(swept_input.label)
    for axes, metric in zip(grid[:, 0], metrics, strict=False):
        axes.set_ylabel(_label(swept, metric))
    if len(heights) > len(metrics):
        grid[-1, 0].set_ylabel("unstable runs [%]")
        grid[-1, 0].set_ylim(0, 1.1 * max(line.get_ydata().max() for axes in grid[-1] for line in axes.lines))
    figure.align_ylabels(list(grid[:, 0]))
    figure.suptitle(_title(swept, len(inputs)), x=0.01, ha="left", fontsize=8, fontweight="normal")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    if handles:
        place = "outside upper right" if len(inputs) > 2 else "outside lower center"
        figure.legend(handles, labels, loc=place, ncols=len(labels), markerscale=2.5)
    return figure


def _title(swept: SweepResult, drawn: int) -> str:
    """Numbers of runs, of unstable runs, and of inputs that are not shown."""
    lost, left_out = int(swept.failed.sum()), len(swept.inputs) - drawn
    unstable = f", {lost} unstable" if lost else ""
    others = f"; {left_out} input{'s' if left_out > 1 else ''} with weaker correlation not shown" if left_out else ""
    return f"{swept.count} runs{unstable}{others}"


def _strongest(swept: SweepResult) -> list[_Input]:
    """Parameters with the largest rank correlations, in their original order."""
    strengths = swept.correlations().abs().max(axis=1).fillna(0.0)
    chosen = strengths.sort_values(ascending=False, kind="stable").index[:4]
    return [_input(swept, name) for name in swept.inputs if name in chosen]


def _input(swept: SweepResult, name: str) -> _Input:
    variable = swept.table[name]
    unit = variable.attrs.get("shown_units", "1")
    values = variable.to_numpy().astype(float) / factor(unit)
    log = bool(re.search(r"\slog\b", variable.attrs.get("over", ""))) and bool(np.all(values > 0) or np.all(values < 0))
    return _Input(name, unit, values, log)


def _metric(axes: Axes, swept_input: _Input, swept: SweepResult, metric: str) -> None:
    values = swept.table[metric].to_numpy().astype(float) / swept.label(metric).size
    valid = ~swept.failed & np.isfinite(values)
    x, y = swept_input.values[valid], values[valid]
    low, high = np.percentile(y, [5, 95])
    limits = robust_limits([y], margin=0.06, floor=1e-9 + 0.02 * abs(float(np.median(y))))
    if low > 0 and high > 30 * low:
        axes.set_yscale("log")
        limits = tuple(10**end for end in robust_limits([np.log10(y[y > 0])], margin=0.06))
        plain_numbers(axes.yaxis)
    axes.set_ylim(*limits)
    drawn = evenly_spaced(y.size, 4000)
    size = float(np.clip(900 / max(y.size, 1), 1.5, 9.0))
    axes.scatter(x[drawn], y[drawn], s=size, color=BLUE, alpha=0.35, linewidths=0, rasterized=True, label="run")
    _median(axes, swept_input._replace(values=x), y)
    correlation = float(swept.correlations()[metric][swept_input.name])
    if np.isfinite(correlation):
        beside(axes, f"ρ = {minus(correlation, '+.2f')}")


def _median(axes: Axes, swept_input: _Input, y: NDArray[np.float64]) -> None:
    middles, members = zip(*swept_input.bins(), strict=True)
    low, median, high = np.array([np.percentile(y[bin_members], [5, 50, 95]) for bin_members in members]).T
    label = "90 % of nearby runs"
    axes.fill_between(middles, low, high, facecolor="#1111111A", edgecolor="#111111", linewidth=0.5, label=label)
    halo = [Stroke(linewidth=2.8, foreground="white"), Normal()]
    axes.plot(middles, median, color=BLACK, marker=".", zorder=4, label="median", path_effects=halo)


def _lost(axes: Axes, swept_input: _Input, lost: NDArray[np.bool_]) -> None:
    middles, shares = np.array(
        [(middle, 100 * float(lost[members].mean())) for middle, members in swept_input.bins()]
    ).T
    axes.fill_between(middles, 0, shares, color=VERMILLION, alpha=0.25, linewidth=0)
    axes.plot(middles, shares, color=VERMILLION, marker="o", markersize=2.2, linewidth=1.0)


def _label(swept: SweepResult, metric: str) -> str:
    return f"{swept.words(metric).replace('rmse', 'RMSE')} [{swept.label(metric).shown_unit.replace('*', '·')}]"


_UNKNOWN, _OUT = "#C9C9C9", "#FFFFFF"


@styled
def planned(plan: ExperimentPlan) -> Figure:
    """Standard error of the force over contraction and pressure: before the plan (left) and after it (right).

    Grey: not determined; white: not measurable. Planned points are numbered in order of gain.
    """
    figure = blank(DOUBLE, 4.3)
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    scale, shades = _scale(plan), part_of("YlOrBr", 0, 215)
    colours = shades.with_extremes(over=shades(214))  # light at the lower end, for the markers
    for axes, errors in ((left, plan.map.now), (right, plan.map.after)):
        _shade(axes, plan, errors, scale, colours)
        axes.set_xlabel("contraction [%]")
    left.set_ylabel("pressure [bar]")
    letter(left, 0, "now, measured points")
    letter(right, 1, f"after {len(plan.points)} planned points")
    taut = plan.measured.taut
    draw_points(left, taut, taut.levels / bar, "measured", markersize=3.0, markeredgecolor="white", markeredgewidth=0.3)
    _planned_points(right, plan)
    _quantity_states((left, right), plan)
    handles = {
        label: mark for axes in (left, right) for mark, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    if np.isinf(plan.map.now).any():
        handles["force not determined"] = Patch(color=_UNKNOWN)
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=min(len(handles), 4))
    bar_of_colours = figure.colorbar(
        ScalarMappable(scale, colours),
        ax=[left, right],
        label="standard error of the force [N]",
        fraction=0.04,
        pad=0.01,
    )
    plain_numbers(bar_of_colours.ax.yaxis)
    figure.suptitle(plan.verdict().replace("; ", ";\n", 1), fontsize=8, fontweight="normal")
    return figure


def _scale(plan: ExperimentPlan) -> LogNorm:
    both = np.concatenate([plan.map.now.ravel(), plan.map.after.ravel()])
    both = both[np.isfinite(both)]
    low, high = (float(both.min()), float(both.max())) if both.size else (1.0, 10.0)
    return LogNorm(low, min(max(high, 1.5 * low), 300 * low))


def _shade(axes: Axes, plan: ExperimentPlan, errors: NDArray[np.float64], scale: LogNorm, colours: Colormap) -> None:
    x, y = plan.map.states.contractions / percent, plan.map.states.pressures / bar
    unknown = np.ma.masked_where(~np.isinf(errors), np.ones_like(errors))
    finite = np.ma.masked_where(~np.isfinite(errors), errors)
    axes.pcolormesh(x, y, unknown, cmap=ListedColormap([_UNKNOWN]), rasterized=True, shading="nearest")
    axes.pcolormesh(x, y, finite, norm=scale, cmap=colours, rasterized=True, shading="nearest")
    axes.set_facecolor(_OUT)
    axes.grid(False)


def _marks(direction: str, size: float) -> Look:
    look: Look = DIRECTIONS.get(direction, {"color": "#333333", "marker": "o"})
    return look | {"linestyle": "", "markersize": size, "markeredgewidth": size / 9, "markeredgecolor": "white"}


def _planned_points(axes: Axes, plan: ExperimentPlan) -> None:
    """Draw the planned points with their numbers."""
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}
    label: Look = {"textcoords": "offset points", "va": "center", "fontsize": 7, "fontweight": "bold", "bbox": box}
    for number, point in enumerate(plan.points, 1):
        name = f"planned, {point.direction}" if point.direction else "planned"
        look = _marks(point.direction, 6.5)
        axes.plot(point.contraction / percent, point.pressure / bar, zorder=4, clip_on=False, label=name, **look)
        axes.annotate(str(number), (point.contraction / percent, point.pressure / bar), (6, 0), zorder=5, **label)


def _quantity_states(panels: tuple[Axes, Axes], plan: ExperimentPlan) -> None:
    """Draw the states of the quantity of interest."""
    states = plan.target_states
    look: Look = {"color": BLUE, "linestyle": "", "marker": "+", "markersize": 8, "markeredgewidth": 1.6}
    for axes in panels if len(states) else ():
        axes.plot(states[:, 0] / percent, states[:, 1] / bar, zorder=3, label="quantity of interest", **look)
