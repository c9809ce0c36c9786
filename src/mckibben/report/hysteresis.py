"""Figures of hysteresis loops and creep."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from mckibben.dataset import IsobaricDataset
from mckibben.errors import RangeError
from mckibben.identification.creep import CreepFit
from mckibben.identification.hysteresis import HysteresisFit
from mckibben.identification.loading_path import LoadingPaths
from mckibben.identification.relaxation import RelaxationCurves
from mckibben.muscle import MaxwellCreep
from mckibben.report.style import BLACK, DOUBLE, LOADING, UNLOADING, blank, letter, styled
from mckibben.units import bar, percent

_MOST_LOOPS = 6
_CONTRACTION = "contraction [%]"
_MODEL = {"color": BLACK, "linewidth": 0.8, "zorder": 4}


@styled
def loops(dataset: IsobaricDataset, found: HysteresisFit) -> Figure:
    """Hysteresis loops, measured and modelled: force (top), and friction force by pressure (bottom).

    Parameters
    ----------
    dataset
        Dataset of the identification.
    found
        Result of `identify_hysteresis`.

    Raises
    ------
    RangeError
        If the number of points differs.
    """
    means = dataset.plateau_means()
    if len(means) != len(found.residuals):
        raise RangeError(
            f"the hysteresis is of {len(found.residuals)} points, the dataset has {len(means)}",
            remedy="use the dataset of the identification",
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
    """Return at most `_MOST_LOOPS` levels from the lowest to the highest."""
    place = np.unique(np.linspace(0, len(levels) - 1, min(len(levels), _MOST_LOOPS)).round().astype(int))
    return levels[place]


def _forces(axes: Axes, means: IsobaricDataset, found: HysteresisFit) -> None:
    """Draw all points, and the modelled force of each pass."""
    force, model = means.force - found.offset, found.tension + found.friction_force
    loading = means.table["direction"].to_numpy() == "loading"
    for side, look in ((loading, LOADING), (~loading, UNLOADING)):
        axes.plot(means.contraction[side] / percent, force[side], linestyle="none", markersize=2, **look)
    for rows in _passes(means):
        axes.plot(means.contraction[rows] / percent, model[rows], **_MODEL)
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
    """Draw the friction force at a pressure, measured and modelled; return the RMSE [N]."""
    here = np.isclose(means.levels, level, rtol=0, atol=1.0) & (found.tension > 0)
    loading = means.table["direction"].to_numpy() == "loading"
    measured = found.residuals + found.friction_force
    for side, look in ((here & loading, LOADING), (here & ~loading, UNLOADING)):
        axes.plot(means.contraction[side] / percent, measured[side], linestyle="none", markersize=2.5, **look)
    for rows in _passes(means):
        if here[rows].any():
            rows = rows[here[rows]]
            axes.plot(means.contraction[rows] / percent, found.friction_force[rows], **_MODEL)
    axes.axhline(0.0, color="#999999", linewidth=0.5, zorder=0)
    return float(np.sqrt(np.mean(found.residuals[here] ** 2)))


def _passes(means: IsobaricDataset) -> list[NDArray[np.int64]]:
    """Rows of each pass at constant pressure, in order of time."""
    time = means.table["time"].to_numpy() if "time" in means.table else np.arange(len(means))
    order = np.argsort(time, kind="stable")
    return np.split(order, np.flatnonzero(np.abs(np.diff(means.levels[order])) > 1.0) + 1)


_CREEP_MODEL: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "zorder": 4}
_MOST = 20  # moves since the reversal


@styled
def relaxation(dataset: IsobaricDataset, found: CreepFit) -> Figure:
    """Relaxation of the force within plateaus: mean over time, and slope by moves since the last reversal.

    Bars are one standard error over plateaus; the common drift is subtracted.

    Parameters
    ----------
    dataset
        Dataset of the identification, with its samples.
    found
        Result of `identify_creep`.

    Raises
    ------
    RangeError
        If the number of points differs, or there are no samples.
    """
    if len(dataset) != len(found.initial_force) or "force_samples" not in dataset.table:
        raise RangeError(
            f"the creep is of the samples of {len(found.initial_force)} points, the dataset has {len(dataset)} points"
            + (" and no samples" if "force_samples" not in dataset.table else ""),
            remedy="use the dataset of the identification",
        )
    means = dataset.plateau_means()
    measured = RelaxationCurves.of(dataset.table["force_samples"].to_numpy(), found.interval)
    modelled = RelaxationCurves.of(found.relaxation(measured.times), found.interval)
    taut = ~means.slack
    side, moves = _since_turn(LoadingPaths.of(means))
    figure = blank(DOUBLE, 2.7)
    courses, slopes = figure.subplots(1, 2)
    _courses(courses, measured, modelled, found, taut, side)
    _slopes(slopes, measured, modelled, found, taut, side, moves)
    return figure


def _since_turn(strokes: LoadingPaths) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Sign of the last move, and number of consecutive moves of that sign; shape (rows,), 0 if none."""
    sides = np.sign(np.where(np.abs(strokes.displacement) > 1e-9, strokes.displacement, 0.0))
    counts = np.zeros(sides.shape)
    rows, run = np.zeros(sides.shape[1]), np.zeros(sides.shape[1])
    for k, now in enumerate(sides):
        run = np.where(now == 0, run, np.where(now == rows, run + 1, 1))
        rows = np.where(now == 0, rows, now)
        counts[k] = np.where(now == 0, 0, run)
    return strokes.scattered(sides), strokes.scattered(counts).astype(np.int64)


def _courses(
    axes: Axes,
    measured: RelaxationCurves,
    modelled: RelaxationCurves,
    found: CreepFit,
    taut: NDArray[np.bool_],
    side: NDArray[np.float64],
) -> None:
    edges = np.append(measured.edges, len(measured.times)) * found.interval
    times = (edges[:-1] + edges[1:] - found.interval) / 2
    common = found.common_rate * measured.blocks(measured.times)
    for sign, look in ((1, LOADING), (-1, UNLOADING)):
        here = taut & (side == sign)
        values = measured.values[here] - common
        error = values.std(axis=0, ddof=1) / np.sqrt(len(values))
        axes.errorbar(times, values.mean(axis=0) * 1e3, error * 1e3, linestyle="none", markersize=3, **look)
        axes.plot(times, modelled.values[here].mean(axis=0) * 1e3, **_CREEP_MODEL)
    axes.set(xlabel="time since the first sample [s]", ylabel="force minus its mean [mN]")
    letter(axes, "a", "mean over plateaus")


def _slopes(
    axes: Axes,
    measured: RelaxationCurves,
    modelled: RelaxationCurves,
    found: CreepFit,
    taut: NDArray[np.bool_],
    side: NDArray[np.float64],
    moves: NDArray[np.int64],
) -> None:
    slope, model = measured.slopes - found.common_rate, modelled.slopes
    for sign, look, label in ((-1, UNLOADING, "after shortening"), (1, LOADING, "after stretching")):
        here = taut & (side == sign)
        counts = [n for n in range(1, _MOST + 1) if np.count_nonzero(here & (moves == n)) > 1]
        groups = [slope[here & (moves == n)] * 1e3 for n in counts]
        errors = [group.std(ddof=1) / np.sqrt(len(group)) for group in groups]
        heights = [group.mean() for group in groups]
        axes.errorbar(counts, heights, errors, linestyle="none", markersize=3, label=label, **look)
        modelled_heights = [model[here & (moves == n)].mean() * 1e3 for n in counts]
        axes.plot(counts, modelled_heights, label="Maxwell element" if sign > 0 else None, **_CREEP_MODEL)
    axes.axhline(0.0, color="#999999", linewidth=0.5, zorder=0)
    axes.set(xlabel="moves since the reversal", ylabel="slope within a plateau [mN/s]")
    creep = found.creep
    title = (
        f"{creep.stiffness / 1e3:.3g} N/mm, {creep.time_constant:.3g} s"
        if isinstance(creep, MaxwellCreep)
        else "no creep detected"
    )
    axes.legend(title=title, title_fontsize=7.5, alignment="left", loc="center right")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    letter(axes, "b", "relaxation rate")
