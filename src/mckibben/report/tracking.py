"""Figures of tracking runs: angle and stiffness over time, desired and actual, the attainable band behind (Fig. 7)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.report.panels import draw_band, legend_above, letter, note_off_scale, robust_limits
from mckibben.report.style import BLUE, DESIRED, DOUBLE, SKY, blank, looks_of, styled
from mckibben.simulation import Result
from mckibben.units import bar, deg

TIME, ANGLE, STIFFNESS = "time [s]", "angle [deg]", "stiffness [N·m/rad]"
_BAND = "attainable stiffness"


@styled
def tracking(results: Mapping[str, Result]) -> Figure:
    """Runs on one reference over each other: angle, its error, stiffness before the attainable band, and pressures.

    Parameters
    ----------
    results
        By name, such as ``{"PID": result}``; "PID", "BP" and the other names of the paper's study keep their colours.

    Raises
    ------
    RangeError
        If there is none, or their references differ.
    """
    _same_reference(results)
    alone = len(results) == 1
    figure = blank(DOUBLE, 7.0 if alone else 5.8)
    grid = figure.subplots(4 if alone else 3, 1, sharex=True)
    looks = looks_of(results)
    first = next(iter(results.values()))
    times = _column(first, "time")
    grid[0].plot(times, _column(first, "desired_angle") / deg, label="desired", **DESIRED)
    errors: dict[str, NDArray[np.float64]] = {}
    for name, result in results.items():
        angle = _column(result, "angle") / deg
        errors[name] = angle - _column(result, "desired_angle") / deg
        grid[0].plot(times, angle, label=name, **looks[name])
        grid[1].plot(times, errors[name], **looks[name])
    grid[0].set(ylabel=ANGLE)
    grid[0].set_ylim(*robust_limits([line.get_ydata() for line in grid[0].lines]))
    grid[1].axhline(0, color="#444444", linewidth=0.7)
    grid[1].set(ylabel="actual − desired angle [deg]")
    grid[1].set_ylim(*robust_limits(list(errors.values()), floor=1e-3))
    note_off_scale(grid[1], times, errors, "deg")
    _stiffness(grid[2], {name: (result, looks[name]) for name, result in results.items()})
    if alone:
        for muscle, colour, style in (("1", BLUE, "-"), ("2", SKY, (0, (5, 1.5)))):
            pressure = _column(first, f"pressure{muscle}") / bar
            grid[3].plot(times, pressure, color=colour, linestyle=style, label=f"muscle {muscle}")
        grid[3].set(ylabel="pressure [bar]")
        grid[3].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)
    grid[-1].set(xlabel=TIME)
    figure.align_ylabels(list(grid))
    legend_above(figure, grid[0], grid[2])
    return figure


@styled
def control_results(panels: Mapping[str, tuple[str, Result]]) -> Figure:
    """Each run in a panel of its own (Fig. 7): angle above, stiffness and its attainable band below.

    Parameters
    ----------
    panels
        By title, in reading order: the name of the controller and its run. All share their axes.
    """
    columns = 2 if len(panels) > 1 else 1
    rows = -(-len(panels) // columns)
    figure = blank(DOUBLE, 3.15 * rows + 0.4)
    outer = figure.add_gridspec(rows, columns)
    looks = looks_of(name for name, _ in panels.values())
    upper: list[Axes] = []
    lower: list[Axes] = []
    for i, (title, (name, result)) in enumerate(panels.items()):
        inner = outer[i // columns, i % columns].subgridspec(2, 1, hspace=0.02)
        above = figure.add_subplot(inner[0], sharex=upper[0] if upper else None, sharey=upper[0] if upper else None)
        below = figure.add_subplot(inner[1], sharex=above, sharey=lower[0] if lower else None)
        times = _column(result, "time")
        above.plot(times, _column(result, "desired_angle") / deg, label="desired", **DESIRED)
        above.plot(times, _column(result, "angle") / deg, label=name, **looks[name])
        above.tick_params(labelbottom=False)
        _stiffness(below, {name: (result, looks[name])}, limit=False, label=False)
        letter(above, "abcdefgh"[i], title)
        if i % columns == 0:
            above.set(ylabel=ANGLE)
            below.set(ylabel=STIFFNESS)
        else:
            below.set(ylabel="")
            above.tick_params(labelleft=False)
            below.tick_params(labelleft=False)
        below.set(xlabel=TIME)
        upper.append(above)
        lower.append(below)
    runs = list(panels.values())
    angles = [_column(r, c) / deg for _, r in runs for c in ("angle", "desired_angle")]
    upper[0].set_ylim(*robust_limits(angles, part=1.0 if _bounded(angles) else 0.98, margin=0.08))
    lower[0].set_ylim(*_stiffness_limits([r for _, r in runs]))
    for axes, (name, result) in zip(lower, runs, strict=True):
        note_off_scale(axes, _column(result, "time"), {name: _column(result, "stiffness")}, "N·m/rad", bottom=True)
    for axes, (name, result) in zip(upper, runs, strict=True):
        note_off_scale(axes, _column(result, "time"), {name: _column(result, "angle") / deg}, "deg", bottom=True)
    figure.align_ylabels(upper + lower)
    legend_above(figure, *upper, *lower)
    return figure


def _stiffness(axes: Axes, runs: Mapping[str, tuple[Result, dict]], *, limit: bool = True, label: bool = True) -> None:
    first = next(iter(runs.values()))[0]
    times = _column(first, "time")
    draw_band(axes, times, _column(first, "lowest_stiffness"), _column(first, "highest_stiffness"), label=_BAND)
    for name, (result, look) in runs.items():
        axes.plot(times, _column(result, "stiffness"), label=name, **look)
    axes.plot(times, _column(first, "desired_stiffness"), label="desired", **DESIRED)
    axes.set(ylabel=STIFFNESS)
    if limit:
        axes.set_ylim(*_stiffness_limits([result for result, _ in runs.values()]))
        note_off_scale(
            axes, times, {name: _column(result, "stiffness") for name, (result, _) in runs.items()}, "N·m/rad"
        )


def _stiffness_limits(results: list[Result]) -> tuple[float, float]:
    """The desired stiffness and most of the actual one, with a margin as wide; the band is cut where it is wider."""
    desired = [_column(r, "desired_stiffness") for r in results]
    low, high = robust_limits(desired + [_column(r, "stiffness") for r in results], part=0.99, margin=0.0, floor=1e-3)
    low, high = min(low, *(float(d.min()) for d in desired)), max(high, *(float(d.max()) for d in desired))
    band_low = np.nanmin([np.nanmin(_column(r, "lowest_stiffness"), initial=low) for r in results])
    band_high = np.nanmax([np.nanmax(_column(r, "highest_stiffness"), initial=high) for r in results])
    room = 0.45 * (high - low)
    return max(low - room, min(float(band_low) - 0.1 * room, low - 0.2 * room)), min(
        high + room, max(float(band_high) + 0.1 * room, high + 0.2 * room)
    )


def _bounded(curves: list[NDArray[np.float64]]) -> bool:
    """Whether the whole of the curves fits on an axis without flattening most of it."""
    finite = np.concatenate([c[np.isfinite(c)] for c in curves])
    return bool(np.ptp(finite) < 3 * np.ptp(np.quantile(finite, [0.02, 0.98])))


def _same_reference(results: Mapping[str, Result]) -> None:
    if not results:
        raise RangeError("there is no result to draw", remedy="give at least one, by name")
    first = next(iter(results.values()))
    for name, result in results.items():
        for wish in ("time", "desired_angle", "desired_stiffness"):
            if not np.array_equal(_column(first, wish), _column(result, wish)):
                raise RangeError(
                    f"{name} follows another {wish.replace('_', ' ')} than {next(iter(results))}",
                    remedy="draw runs of different references in figures of their own",
                )


def _column(result: Result, name: str) -> NDArray[np.float64]:
    return result.table[name].to_numpy()
