"""Figures of a comparison of controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mckibben.report.style import DOUBLE, Look, blank, legend_above, letter, looks_of, plain_numbers, styled
from mckibben.study.compare.statistics import front, median
from mckibben.units import deg, litre

if TYPE_CHECKING:
    from mckibben.study.compare import CompareResult

_ERRORS = (("angle_rmse", "angle rmse [deg]", deg), ("stiffness_rmse", "stiffness rmse [N·m/rad]", 1.0))


@styled
def comparison_errors(result: CompareResult) -> Figure:
    """Cumulative distribution of the angle and stiffness errors over the unseen runs, by controller."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots(1, 2, sharey=True)
    looks = looks_of(result.batches)
    for i, (panel, (metric, label, unit)) in enumerate(zip(axes, _ERRORS, strict=True)):
        for name, look in looks.items():
            values = result.metric(name, metric) / unit  # failed runs are below no error
            panel.ecdf(np.where(np.isfinite(values), values, np.inf), label=name, **look)
        panel.set_xscale("log")
        plain_numbers(panel.xaxis)
        panel.set(xlabel=label, ylim=(0, 1.02))
        for share in (0.5, 0.95):
            panel.axhline(share, color="0.6", linewidth=0.6, zorder=0)
        letter(panel, i, label.split(" [")[0])
    axes[0].set_ylabel("share of runs below")
    axes[0].set_yticks([0, 0.25, 0.5, 0.75, 0.95], ["0", "0.25", "0.5", "0.75", "0.95"])
    legend_above(figure, axes[0], columns=min(len(looks), 4))
    return figure


def _marker(look: Look) -> str:
    """Marker of a controller, which differs if its colour is reused."""
    return "o" if look["linestyle"] == "-" else "D"


@styled
def comparison_air(result: CompareResult) -> Figure:
    """Angle error over air consumption: median and 90 % range of the runs."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots()
    for name, look in looks_of(result.batches).items():
        air, angle = result.metric(name, "air") * 1e3, result.metric(name, "angle_rmse") / deg
        if not (np.isfinite(angle) & np.isfinite(air)).any():
            continue  # all runs diverged, or the volume of a muscle unknown
        (x0, x, x1), (y0, y, y1) = (np.nanpercentile(values, [5, 50, 95]) for values in (air, angle))
        axes.plot([x0, x1], [y, y], color=look["color"], linewidth=0.8)
        axes.plot([x, x], [y0, y1], color=look["color"], linewidth=0.8)
        axes.plot(x, y, marker=_marker(look), markersize=4.5, linestyle="", color=look["color"], label=name)
    _air_axes(figure, axes)
    return figure


def _air_axes(figure: Figure, axes: Axes) -> None:
    """Logarithmic axes of air and error with a legend, unless nothing is drawn."""
    axes.set(xlabel="air consumption [L]", ylabel="angle rmse [deg]")
    if axes.lines:
        axes.set(xscale="log", yscale="log")
        plain_numbers(axes.xaxis)
        plain_numbers(axes.yaxis)
        legend_above(figure, axes, columns=4)


@styled
def comparison_front(result: CompareResult) -> Figure:
    """Pareto front of median angle error and air consumption among the tuning trials, by controller."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots()
    for name, look in looks_of(result.batches).items():
        if points := front(result.trials.get(name, ())):
            air, angle = (
                [median(trial, metric) / unit for trial in points]
                for metric, unit in (("air", litre), ("angle_rmse", deg))
            )
            axes.plot(air, angle, drawstyle="steps-post", marker=_marker(look), markersize=2.5, label=name, **look)
    _air_axes(figure, axes)
    return figure
