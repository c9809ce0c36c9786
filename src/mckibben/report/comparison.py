"""Figures of a comparison of controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from mckibben.report.style import DOUBLE, blank, legend_above, letter, looks_of, plain_numbers, styled
from mckibben.study.compare.statistics import front, median
from mckibben.units import litre

if TYPE_CHECKING:
    from mckibben.study.compare import CompareResult

_ERRORS = (("angle_rmse", "deg"), ("stiffness_rmse", "N*m/rad"))


@styled
def comparison_errors(result: CompareResult) -> Figure:
    """Cumulative distribution of the angle and stiffness errors over the unseen runs, by controller."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots(1, 2, sharey=True)
    looks, kind = looks_of(result.batches), result.joint_type
    for i, (panel, (metric, unit)) in enumerate(zip(axes, _ERRORS, strict=True)):
        label = kind.label(metric.replace("_", " "), unit)
        for name, look in looks.items():
            values = result.metric(name, metric) / kind.size(unit)  # failed runs are below no error
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


@styled
def comparison_front(result: CompareResult) -> Figure:
    """Pareto front of median angle error and air consumption among the tuning trials, by controller."""
    figure = blank(DOUBLE, 3.0)
    axes = figure.subplots()
    for name, look in looks_of(result.batches).items():
        if points := front(result.trials.get(name, ())):
            air, angle = (
                [median(trial, metric) / unit for trial in points]
                for metric, unit in (("air", litre), ("angle_rmse", result.joint_type.size("deg")))
            )
            marker = "o" if look["linestyle"] == "-" else "D"  # of a colour that is used twice
            axes.plot(air, angle, drawstyle="steps-post", marker=marker, markersize=2.5, label=name, **look)
    axes.set(xlabel="air consumption [L]", ylabel=result.joint_type.label("angle rmse", "deg"))
    if axes.lines:
        axes.set(xscale="log", yscale="log")
        plain_numbers(axes.xaxis)
        plain_numbers(axes.yaxis)
        legend_above(figure, axes, columns=4)
    return figure
