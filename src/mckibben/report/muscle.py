"""Figures of the muscle: isobaric curves, force laws with measured points, fits with residuals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.muscle import ForceLaw, forces
from mckibben.report.palette import CONTRACTION, FORCE, PRESSURE
from mckibben.report.style import (
    DIRECTIONS,
    DOUBLE,
    EXPERIMENTAL,
    THEORETICAL,
    beside,
    blank,
    by_direction,
    draw_points,
    legend_above,
    letter,
    panels,
    pressure_colours,
    styled,
)
from mckibben.units import bar, percent

if TYPE_CHECKING:
    from mckibben.dataset import ExtractedPoints, IsobaricDataset, Recording
    from mckibben.identification import Fit, FitWithFriction, Validation

_CONTRACTION, _FORCE = "contraction [%]", "force [N]"


@styled
def isobaric_curves(dataset: IsobaricDataset) -> Figure:
    """Fig. 3 of the paper: characteristic curves of an isobaric test, as means over repeats.

    Force [N] over contraction [%], coloured by pressure; loading is solid, unloading dashed.

    Parameters
    ----------
    dataset
        Points of a test in both directions.

    Raises
    ------
    RangeError
        If the dataset does not have both directions.
    """
    if len(dataset.directions) < 2:
        raise RangeError(
            f"{dataset!r} does not have both directions, loading and unloading",
            remedy="draw the points: isobaric(dataset)",
        )
    figure = blank(DOUBLE, 4.6)
    axes = figure.subplots()
    scale = Normalize(dataset.pressures.min() / bar, dataset.pressures.max() / bar)
    for level in dataset.pressures:
        for direction, style, text in (("loading", "-", "being stretched"), ("unloading", "--", "shortening")):
            colour, label = pressure_colours()(scale(level / bar)), f"{direction} ({text})"
            axes.plot(*_mean_curve(dataset.at(level), direction), color=colour, linestyle=style, label=label)
    axes.set(xlabel=_CONTRACTION, ylabel=_FORCE, title=f"mean of {max(len(dataset.repeats), 1)} repeats")
    shades = ScalarMappable(scale, pressure_colours())
    figure.colorbar(shades, ax=axes, label="pressure [bar]", fraction=0.04, aspect=40)
    legend_above(figure, axes)
    return figure


@styled
def law_comparison(
    dataset: IsobaricDataset, laws: Mapping[str, ForceLaw], validation: Validation | None = None
) -> Figure:
    """Fig. 4 of the paper: measured points, the experimental law and the theoretical one, one panel per pressure.

    Parameters
    ----------
    dataset
        Measured points.
    laws
        Two laws by name, the experimental one first.
    validation
        Validation of these laws on the dataset, whose RMSE [N] at each pressure is written into the panels.
    """
    levels = dataset.pressures
    columns = 2 if len(levels) > 1 else 1
    rows = -(-len(levels) // columns)
    figure = blank(DOUBLE, 2.35 * rows + 0.5)
    grid = panels(figure, len(levels), columns, sharex=True, sharey=True)
    contraction = np.linspace(float(dataset.contraction.min()), float(dataset.contraction.max()), 300)
    top = float(dataset.force.max())
    for i, (axes, level) in enumerate(zip(grid, levels, strict=True)):
        points = dataset.at(level)
        draw_points(axes, points, points.force, "data", markersize=3.2)
        for (name, law), look in zip(laws.items(), (EXPERIMENTAL, THEORETICAL), strict=False):
            axes.plot(contraction / percent, forces(law, contraction, level), label=name, zorder=4, **look)
        letter(axes, i, f"{level / bar:g} bar")
        if validation:
            lines = [f"RMSE {name.split(' (')[0]}: {validation.of(name, pressure=level).rmse:.1f} N" for name in laws]
            beside(axes, "\n".join(lines))
        axes.set(xlabel=_CONTRACTION, ylabel=_FORCE, ylim=(-0.02 * top, 1.06 * top))
        axes.label_outer()
    legend_above(figure, *grid)
    return figure


def isobaric(dataset: IsobaricDataset, fit: Fit | None = None) -> Figure:
    """Points of an isobaric dataset: force [N] over contraction [%], coloured by pressure.

    Parameters
    ----------
    dataset
        Measured points; slack ones are grey.
    fit
        Fit to these or other points: adds its curves, which end where the muscle is slack, and residuals with their
        RMSE.

    Raises
    ------
    RangeError
        If the first argument is not a dataset.
    """
    if not hasattr(dataset, "levels"):
        remedy = "write isobaric(dataset, fit), or fit.plot()"
        raise RangeError(f"isobaric draws a dataset, not a {type(dataset).__name__}", remedy=remedy)
    return measured_muscles({dataset.table.attrs["specimen"] or "measured points": (dataset, fit)})


def fit(result: FitWithFriction) -> Figure:
    """Points, fitted curves and residuals of a law, without the friction that was identified with it."""
    return isobaric(result.points, result)


def points(extracted: ExtractedPoints) -> Figure:
    """Points that were extracted from a recording."""
    return isobaric(extracted.dataset)


@styled
def recording(recording: Recording) -> Figure:
    """Pressure [bar], force [N] and, where it was recorded, contraction [%] over time [s]; the set pressure in grey.

    Parameters
    ----------
    recording
        Samples over time, such as those of `mckibben.dataset.read_recording`.
    """
    rows = [("pressure [bar]", recording.pressure / bar, PRESSURE), (_FORCE, recording.force, FORCE)]
    if recording.contraction is not None:
        rows.append((_CONTRACTION, recording.contraction / percent, CONTRACTION))
    figure = blank(DOUBLE, 1.4 * len(rows) + 0.6)
    grid = figure.subplots(len(rows), sharex=True)
    if "set_pressure" in recording.table:
        grid[0].plot(recording.time, recording.table["set_pressure"] / bar, color="#999999", linewidth=0.7)
    for axes, (label, values, color) in zip(grid, rows, strict=True):
        axes.plot(recording.time, values, color=color, linewidth=0.8)
        axes.set_ylabel(label)
    grid[-1].set_xlabel("time [s]")
    return figure


@styled
def measured_muscles(muscles: Mapping[str, tuple[IsobaricDataset, Fit | None]]) -> Figure:
    """Datasets side by side, with their fits and residuals.

    Parameters
    ----------
    muscles
        Dataset and fit, or None, by title. Pressures have one colour scale in all panels.
    """
    residuals = any(fit for _, fit in muscles.values())
    figure = blank(DOUBLE if len(muscles) > 1 else 5.4, 5.0 if residuals else 3.4)
    heights = [2.4, 1] if residuals else [1]
    grid = figure.subplots(len(heights), len(muscles), squeeze=False, sharex="col", height_ratios=heights)
    low = min(float(data.levels.min()) for data, _ in muscles.values()) / bar
    high = max(float(data.levels.max()) for data, _ in muscles.values()) / bar
    scale = Normalize(low, max(high, low + 0.1))
    for i, (name, (data, fit)) in enumerate(muscles.items()):
        axes = grid[0, i]
        taut = data.taut
        _coloured(axes, taut, taut.force, scale)
        slack = data.select(data.slack)
        if len(slack):
            look = {"color": "#999999", "markersize": 3, "label": "slack (excluded)"}
            axes.plot(slack.contraction / percent, slack.force, "x", **look)
        if fit:
            _curves(axes, data, fit.law, scale)
            difference = taut.force - forces(fit.law, taut.contraction, taut.pressure)
            _coloured(grid[1, i], taut, difference, scale)
            grid[1, i].axhline(0, color="#444444", linewidth=0.7)
            grid[1, i].set(xlabel=_CONTRACTION, ylabel="measured − fitted [N]" if i == 0 else "")
            beside(grid[1, i], f"RMSE {np.sqrt(np.mean(difference**2)):.2f} N")
        else:
            axes.set_xlabel(_CONTRACTION)
        if len(muscles) > 1:
            letter(axes, i, name)
        else:
            axes.set_title(name)
        axes.set(ylabel=_FORCE if i == 0 else "")
        axes.set_ylim(bottom=-0.03 * float(data.force.max()))
        axes.legend(loc="upper right")
    shades = ScalarMappable(scale, pressure_colours())
    figure.colorbar(shades, ax=list(grid.ravel()), label="pressure [bar]", fraction=0.04, aspect=40)
    return figure


def _coloured(axes: Axes, data: IsobaricDataset, value: NDArray[np.float64], scale: Normalize) -> None:
    """Points coloured by pressure, with markers by direction."""
    for direction, mask in by_direction(data):
        axes.scatter(
            data.contraction[mask] / percent,
            value[mask],
            c=data.levels[mask] / bar,
            norm=scale,
            cmap=pressure_colours(),
            marker=DIRECTIONS.get(direction, {"marker": "o"})["marker"],
            label=direction or "taut",
            s=14 if len(data) < 300 else 6,
            edgecolors="white",
            linewidths=0.3,
            zorder=3,
        )


def _curves(axes: Axes, data: IsobaricDataset, law: ForceLaw, scale: Normalize) -> None:
    """Draw the force of a law at the pressures of a dataset, at ten pressures between if they are measured ones."""
    levels = data.taut.pressures
    if len(levels) > 20:  # measured pressures
        levels = np.linspace(levels[0], levels[-1], 10)
    first, last = float(data.contraction.min()), float(data.contraction.max())
    name = f"fitted {type(law).source.split(' of the paper')[0]}"
    for number, level in enumerate(levels):
        there = data.contraction[data.levels == level]
        contraction = np.linspace(float(there.min()) if there.size else first, last, 300)
        force = forces(law, contraction, level)
        # the curve ends where the muscle is slack
        taut = np.where(force > 0, force, np.nan)
        look = {"color": pressure_colours()(scale(level / bar)), "linewidth": 0.9, "zorder": 2}
        axes.plot(contraction / percent, taut, label="_nolegend_" if number else name, **look)


def _mean_curve(data: IsobaricDataset, direction: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Contraction [%], ascending, and mean force [N] over the repeats of one pass."""
    mask = data.table["direction"].to_numpy() == direction
    contraction = np.round(data.contraction[mask], 6)
    places = np.unique(contraction)
    force = np.array([data.force[mask][contraction == place].mean() for place in places])
    return places / percent, force
