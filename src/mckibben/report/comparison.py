"""Controllers compared over seeds, and how the gains of BP move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullFormatter, NullLocator

from mckibben.report.panels import legend_above, letter
from mckibben.report.style import BLACK, CONTROLLERS, DOUBLE, GREEN, PURPLE, blank, styled
from mckibben.simulation import Result
from mckibben.study.paper.tracking import Run
from mckibben.units import deg

_METRICS = (
    ("angle_rmse", "angle RMSE [deg]", deg),
    ("stiffness_rmse", "stiffness RMSE [N·m/rad]", 1.0),
    ("stiffness_settling", "stiffness settling time [s]", 1.0),
)
_GAINS = {
    "kp": {"color": BLACK, "linestyle": "-"},
    "ki": {"color": GREEN, "linestyle": (0, (5, 1.5))},
    "kd": {"color": PURPLE, "linestyle": (0, (1, 1))},
}
_ABOVE: dict[str, Any] = {
    "xycoords": "axes fraction",
    "textcoords": "offset points",
    "va": "bottom",
    "fontsize": 7.5,
    "annotation_clip": False,
}
_WIDEST = 1e3  # an axis ends at so many times its smallest value; what lies beyond is an arrow


@styled
def controller_comparison(found: Mapping[str, Mapping[str, Mapping[str, Run]]]) -> Figure:
    """A dot at the median over seeds and a line to the worst, for each controller, on logarithmic axes.

    Parameters
    ----------
    found
        By geometry, wish and controller.
    """
    figure = blank(DOUBLE, 2.5 * len(found) + 0.5)
    grid = figure.subplots(len(found), len(_METRICS), squeeze=False, sharey="row")
    for i, (geometry, wishes) in enumerate(found.items()):
        names = list(dict.fromkeys(name for runs in wishes.values() for name in runs))
        names.sort(key=lambda name: list(CONTROLLERS).index(name) if name in CONTROLLERS else len(CONTROLLERS))
        for j, (metric, label, unit) in enumerate(_METRICS):
            axes = grid[i, j]
            _dots(axes, wishes, names, metric, unit)
            axes.set(xlabel=label)
            axes.set_yticks(range(len(names)), names)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="y", visible=False)
            letter(axes, "abcdefghi"[len(_METRICS) * i + j], geometry)
    wishes = next(iter(found.values()))
    handles = [
        Line2D(
            [],
            [],
            linestyle="",
            marker="o",
            color="#444444",
            markersize=5,
            markerfacecolor=face,
            label=f"{w} stiffness",
        )
        for w, face in zip(wishes, ("#444444", "white"), strict=False)
    ]
    handles.append(Line2D([], [], color="#444444", linewidth=1.6, alpha=0.6, label="from the median to the worst seed"))
    handles.append(Line2D([], [], linestyle="", marker=">", color="#444444", label="beyond the axis, never or lost"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


@styled
def gain_histories(results: Mapping[str, tuple[Result, float]]) -> Figure:
    """The gains of BP over time, relative to the base gains that it started from.

    Parameters
    ----------
    results
        By title: a run with telemetry of gains, and the largest factor by which they may move.
    """
    figure = blank(DOUBLE, 4.4)
    grid = figure.subplots(2, len(results), squeeze=False, sharex=True, sharey="col")
    for i, (title, (result, ratio)) in enumerate(results.items()):
        for row, loop in enumerate(("position", "stiffness")):
            axes = grid[row, i]
            for gain, look in _GAINS.items():
                values = result.table[f"{loop}_{gain}"].to_numpy()
                if values[0] != 0:  # a loop without this part
                    axes.plot(result.table["time"], values / values[0], label=f"${gain[0]}_{gain[1]}$", **look)
            for bound in (ratio, 1 / ratio):
                axes.axhline(bound, color="#888888", linewidth=0.8, linestyle=(0, (2, 2)), label="bound on the gains")
            axes.set_yscale("log", base=2)
            axes.set_ylim(ratio**-1.15, ratio**1.15)
            axes.yaxis.set_major_locator(FixedLocator([1 / ratio, ratio**-0.5, 1, ratio**0.5, ratio]))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
            axes.yaxis.set_minor_locator(NullLocator())
            letter(axes, "abcdefgh"[len(results) * row + i], f"{loop} loop")
            if row == 0:
                axes.annotate(title, (0, 1), (0, 18), **_ABOVE)
            axes.set(ylabel="gain / base gain [-]" if i == 0 else "", xlabel="time [s]" if row else "")
    legend_above(figure, *grid.ravel())
    return figure


def _dots(axes: Axes, wishes: Mapping[str, Mapping[str, Run]], names: list[str], metric: str, unit: float) -> None:
    runs = [(k, names.index(name), name, run) for k, w in enumerate(wishes.values()) for name, run in w.items()]
    medians = [run.median(metric) / unit for *_, run in runs]
    smallest = min((m for m in medians if np.isfinite(m) and m > 0), default=1.0)
    good = [run.worst(metric) / unit for *_, run in runs if run.lost == 0]
    largest = max((g for g in good if np.isfinite(g) and g < _WIDEST * smallest), default=10 * smallest)
    end = 2.0 * largest
    for (k, place, name, run), median in zip(runs, medians, strict=True):
        y = place + (-0.17 if k == 0 else 0.17)
        look = CONTROLLERS.get(name, {"color": "#444444", "marker": "o"})
        worst = run.worst(metric) / unit
        if not (median <= end) or run.lost > run_count(run) / 2:
            axes.plot(end, y, linestyle="", marker=">", color=look["color"], clip_on=False, markersize=5)
            text = (
                f"{run.lost} of {run_count(run)} lost" if run.lost else "never" if np.isnan(median) else f"{median:.2g}"
            )
            axes.annotate(text, (end, y), (-6, 0), textcoords="offset points", ha="right", va="center", fontsize=6.5)
            continue
        beyond = not (worst <= end)
        axes.plot([median, end if beyond else worst], [y, y], color=look["color"], linewidth=1.8, alpha=0.55)
        if beyond:
            axes.plot(end, y, linestyle="", marker=">", color=look["color"], clip_on=False, markersize=5)
        axes.plot(
            median,
            y,
            linestyle="",
            marker=look["marker"],
            markersize=5,
            markeredgewidth=1.1,
            color=look["color"],
            markerfacecolor=look["color"] if k == 0 else "white",
            zorder=3,
        )
    axes.set_xscale("log")
    axes.set_xlim(smallest / 1.6, end)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if end / smallest < 60 else (1.0,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def run_count(run: Run) -> int:
    """With how many seeds a controller was run; one where it has none."""
    return 1 if run.seeds is None else int(np.size(run.seeds.angle_rmse))
