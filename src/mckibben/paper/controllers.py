"""Figure of controllers over seeds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mckibben.paper.tracking import ControllerRun
from mckibben.report.style import (
    CONTROLLERS,
    DOUBLE,
    Look,
    blank,
    letter,
    plain_numbers,
    styled,
)
from mckibben.units import deg

_METRICS = (
    ("angle_rmse", "angle RMSE [deg]", deg),
    ("stiffness_rmse", "stiffness RMSE [N·m/rad]", 1.0),
    ("stiffness_settling", "stiffness settling time [s]", 1.0),
)


@styled
def controller_comparison(runs: Mapping[str, Mapping[str, Mapping[str, ControllerRun]]]) -> Figure:
    """Errors and settling time of controllers: median over seeds (dot) and worst seed (end of the line).

    One row of panels per geometry: RMSE of angle [deg] and of stiffness [N*m/rad], and settling time of the stiffness
    [s]. Controllers with unstable seeds, or that never settle, have their number in place of the dot.

    Parameters
    ----------
    runs
        Runs with the metrics of all seeds by geometry, stiffness reference (two at most: filled and white dots) and
        controller.
    """
    figure = blank(DOUBLE, 2.5 * len(runs) + 0.5)
    grid = figure.subplots(len(runs), len(_METRICS), squeeze=False, sharey="row")
    for i, (geometry, references) in enumerate(runs.items()):
        names = list(dict.fromkeys(name for controllers in references.values() for name in controllers))
        names.sort(key=lambda name: list(CONTROLLERS).index(name) if name in CONTROLLERS else len(CONTROLLERS))
        for j, (metric, label, unit) in enumerate(_METRICS):
            axes = grid[i, j]
            _dots(axes, references, names, metric, unit)
            axes.margins(x=0.08)  # of logarithmic axes, whose outer dots would be cut off
            axes.set(xlabel=label)
            axes.set_yticks(range(len(names)), names)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="y", visible=False)
            letter(axes, len(_METRICS) * i + j, geometry)
    references = next(iter(runs.values()))
    grey: Look = {"linestyle": "", "color": "#444444"}
    handles = [
        Line2D([], [], marker="o", markersize=5, markerfacecolor=face, label=f"{name} stiffness", **grey)
        for name, face in zip(references, ("#444444", "white"), strict=False)
    ]
    handles.append(Line2D([], [], color="#444444", linewidth=1.6, alpha=0.6, label="median to worst seed"))
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _dots(
    axes: Axes, references: Mapping[str, Mapping[str, ControllerRun]], names: list[str], metric: str, unit: float
) -> None:
    """Median and worst value of a metric by controller (row) and stiffness reference (filled or white dot)."""
    runs = [(name, k, run) for k, controllers in enumerate(references.values()) for name, run in controllers.items()]
    for name, k, run in runs:
        look: Look = CONTROLLERS.get(name, {"color": "#444444", "marker": "o"})
        row, color, median = names.index(name) + (-0.17 if k == 0 else 0.17), look["color"], run.median(metric) / unit
        if run.unstable or not np.isfinite(median):
            text = f"{run.unstable} unstable" if run.unstable else "never"
            axes.annotate(text, (1, row), xycoords=axes.get_yaxis_transform(), ha="right", va="center", fontsize=6.5)
        if 2 * run.unstable <= (0 if run.seeds is None else np.size(run.seeds.angle_rmse)):
            worst = median if run.unstable else run.worst(metric) / unit
            axes.plot([median, worst], [row] * 2, color=color, linewidth=1.8, alpha=0.55)
            dot = look | {"linestyle": "", "markersize": 5, "markeredgewidth": 1.1, "zorder": 3}
            axes.plot(median, row, markerfacecolor=color if k == 0 else "white", **dot)
    axes.set_xscale("log")
    plain_numbers(axes.xaxis)
