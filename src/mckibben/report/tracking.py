"""Figures of tracking runs: time traces and errors (Fig. 8)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.report.palette import BLACK, BLUE, GREEN, MEASURED, MUSCLES, PURPLE, VERMILLION
from mckibben.report.robot import robot_tracking
from mckibben.report.style import (
    DESIRED,
    DOUBLE,
    Look,
    blank,
    draw_band,
    legend_above,
    letter,
    looks_of,
    note_off_scale,
    plain_numbers,
    robust_limits,
    styled,
)
from mckibben.simulation import SimulationResult
from mckibben.simulation.metrics import SETTLING_PART, last_change, settling_band
from mckibben.units import bar

if TYPE_CHECKING:
    from mckibben.simulation import Margins

TIME = "time [s]"
_DEG, _STIFFNESS = "deg", "N*m/rad"  # of a hinge
_SMALL = "small_motion_stiffness"


@styled
def tracking(results: SimulationResult | Mapping[str, SimulationResult]) -> Figure:
    """Time traces of runs on one reference: angle, angle error, stiffness with the attainable range, pressures.

    Panels from top to bottom: angle [deg] with the reference (dashed); actual minus desired angle [deg]; stiffness
    [N*m/rad] with the range that is attainable at the desired angle; where muscles have friction, the stiffness of
    small motion, often many times larger; of a single run, the pressures [bar] of both muscles. Extreme values outside
    the axis limits are written into the panel, with their time.

    Parameters
    ----------
    results
        Runs by name, such as ``{"PID": result}``, or a run alone.

    Raises
    ------
    RangeError
        If there is no run, runs have no names, or their times or references differ.
    """
    if isinstance(results, SimulationResult):
        if results.joints:
            return robot_tracking(results)
        results = {"run": results}
    _same_reference(results)
    alone = len(results) == 1
    small = {name: _stiffness(result, _SMALL) for name, result in results.items() if _SMALL in result.columns}
    rows = 3 + alone + bool(small)
    figure = blank(DOUBLE, 1.8 + 1.3 * rows)
    grid = figure.subplots(rows, 1, sharex=True)
    looks = {name: {"color": MEASURED} for name in results} if alone else looks_of(results)
    first = next(iter(results.values()))
    times, kind = first.times, first.joint_type
    draw_angle(grid[0], results, looks)
    grid[0].set_ylim(*robust_limits([line.get_ydata() for line in grid[0].lines]))
    errors = {name: _angle_error(result) for name, result in results.items()}
    for name, values in errors.items():
        grid[1].plot(times, values, **looks[name])
    grid[1].axhline(0, color="#444444", linewidth=0.7)
    grid[1].set(ylabel="actual − desired\n" + kind.label("angle", _DEG))
    grid[1].set_ylim(*robust_limits(list(errors.values()), floor=1e-3))
    note_off_scale(grid[1], times, errors, kind.shown(_DEG))
    draw_stiffness(grid[2], results, looks)
    grid[2].set_ylim(*_stiffness_limits(results.values()))
    _note_stiffness(grid[2], results)
    for name, values in small.items():
        grid[3].plot(times, values, **looks[name])
    if small:
        grid[3].set(ylabel="small-motion\n" + kind.label("stiffness", _STIFFNESS))
        grid[3].set_ylim(*robust_limits(list(small.values())))
    if alone:
        draw_pressures(grid[-1], first)
    grid[-1].set(xlabel=TIME)
    figure.align_ylabels(list(grid))
    legend_above(figure, grid[0], grid[2])
    return figure


@styled
def control_results(panels: Mapping[str, tuple[str, SimulationResult]]) -> Figure:
    """Fig. 7 of the paper: angle and stiffness over time, with the attainable range of the stiffness.

    Each panel has two axes, the angle [deg] above the stiffness [N*m/rad]; both are to the same scale in all panels.

    Parameters
    ----------
    panels
        Name of the controller, which determines colour and line style, and its run, by title of the panel.
    """
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure = blank(DOUBLE, 3.15 * rows + 0.4)
    grid = figure.subplots(2 * rows, columns, squeeze=False, sharex=True)
    upper, lower = grid[::2].ravel(), grid[1::2].ravel()
    looks = looks_of(name for name, _ in panels.values())
    results = [result for _, result in panels.values()]
    angles = robust_limits([_angle(result, column) for result in results for column in ("angle", "desired_angle")])
    for i, (above, below, (title, (name, result))) in enumerate(zip(upper, lower, panels.items(), strict=False)):
        draw_angle(above, {name: result}, looks)
        draw_stiffness(below, {name: result}, looks)
        letter(above, i, title)
        above.set_ylim(*angles)
        below.set(xlabel=TIME, ylim=_stiffness_limits(results))
        note_off_scale(above, result.times, {name: _angle(result)}, result.joint_type.shown(_DEG), bottom=True)
        _note_stiffness(below, {name: result}, bottom=True)
    for axes in (*upper[len(panels) :], *lower[len(panels) :]):
        axes.remove()
    for axes in figure.axes:
        axes.label_outer()
    figure.align_ylabels(figure.axes)
    legend_above(figure, *figure.axes)
    return figure


def draw_angle(axes: Axes, runs: Mapping[str, SimulationResult], looks: Mapping[str, Look]) -> None:
    """Draw the angle [deg] of runs, and their common reference."""
    first = next(iter(runs.values()))
    axes.plot(first.times, _angle(first, "desired_angle"), label="desired", **DESIRED)
    for name, result in runs.items():
        axes.plot(first.times, _angle(result), label=name, **looks[name])
    axes.set(ylabel=first.joint_type.label("angle", _DEG))


def draw_stiffness(axes: Axes, runs: Mapping[str, SimulationResult], looks: Mapping[str, Look]) -> None:
    """Draw the stiffness [N*m/rad] of runs, their common reference, and the attainable range of the first one."""
    first = next(iter(runs.values()))
    low, high = (_stiffness(first, f"{end}_stiffness") for end in ("lowest", "highest"))
    draw_band(axes, first.times, low, high, label=first.joint_type.words("attainable at the desired angle"))
    for name, result in runs.items():
        axes.plot(first.times, _stiffness(result), label=name, **looks[name])
    axes.plot(first.times, _stiffness(first, "desired_stiffness"), label="desired", **DESIRED)
    axes.set(ylabel=first.joint_type.label("stiffness", _STIFFNESS))


def draw_pressures(axes: Axes, result: SimulationResult) -> None:
    """Draw the pressures [bar] of both muscles of a run, with a legend above the panel."""
    for number, (colour, style) in enumerate(zip(MUSCLES, ("-", "--"), strict=True), 1):
        pressure = result[f"pressure{number}"] / bar
        axes.plot(result.times, pressure, color=colour, linestyle=style, label=f"muscle {number}")
    axes.set(ylabel="pressure [bar]")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)


def _stiffness_limits(results: Iterable[SimulationResult]) -> tuple[float, float]:
    """Axis limits around reference and stiffness, with space for the attainable range."""
    curves = [_stiffness(result, column) for result in results for column in ("desired_stiffness", "stiffness")]
    desired = np.nan_to_num(max(float(np.abs(curve).max()) for curve in curves[::2]))  # NaN of one muscle
    return robust_limits(curves, part=0.99, margin=0.7, floor=0.05 * desired)


def _same_reference(results: Mapping[str, SimulationResult]) -> None:
    """Raise `RangeError` unless runs are given by name, and have the same times [s] and references."""
    if not isinstance(results, Mapping):
        remedy = "write tracking({'PID': result}), or result.plot()"
        raise RangeError(f"tracking draws results by name, not a {type(results).__name__}", remedy=remedy)
    if not results:
        raise RangeError("there is no result to draw", remedy="give at least one, by name")
    first = next(iter(results.values()))
    for name, result in results.items():
        for column in ("time", "desired_angle", "desired_stiffness"):
            if first[column].shape != result[column].shape or not np.allclose(
                first[column], result[column], rtol=1e-9, equal_nan=True
            ):
                raise RangeError(
                    f"{name} and {next(iter(results))} differ in {column.replace('_', ' ')}",
                    remedy="draw runs with different references in separate figures",
                )


@styled
def error_curves(columns: Mapping[str, Mapping[str, SimulationResult]]) -> Figure:
    """Fig. 8 of the paper: errors of angle and stiffness over time, and the settling of the stiffness.

    Rows: error of the angle [deg]; error of the stiffness [N*m/rad]; the same after the last step of its reference,
    with the band to which it settles and the settling times. The axis limits of a row are the same in all columns.

    Parameters
    ----------
    columns
        Runs by title of the column and name of the controller; all runs have the same times.
    """
    figure = blank(DOUBLE, 6.3)
    count = len(columns)
    grid = figure.subplots(3, count, squeeze=False)
    looks = looks_of(dict.fromkeys(name for runs in columns.values() for name in runs))
    angle = {title: {n: _angle_error(r) for n, r in runs.items()} for title, runs in columns.items()}
    stiffness = {title: {n: _stiffness_error(r) for n, r in runs.items()} for title, runs in columns.items()}
    times = next(run.times for runs in columns.values() for run in runs.values())
    for i, (title, runs) in enumerate(columns.items()):
        for row, errors in enumerate((angle[title], stiffness[title], stiffness[title])):
            axes = grid[row, i]
            for name, values in errors.items():
                axes.plot(times, values, label=name, **looks[name])
            axes.axhline(0, color="#444444", linewidth=0.7, zorder=1.5)
            axes.set(xlabel=TIME if row == 2 else "")
        letter(grid[0, i], i, f"angle, {title}")
        letter(grid[1, i], count + i, f"stiffness, {title}")
        letter(grid[2, i], 2 * count + i, _settling(grid[2, i], runs, times))
    _share_limits(grid[0], angle, times, "deg", part=0.998, margin=0.12)
    _share_limits(grid[1], stiffness, times, "N·m/rad", part=0.975, margin=0.7)
    grid[0, 0].set_ylabel("angle error [deg]")
    for axes in grid[1:, 0]:
        axes.set_ylabel("stiffness error [N·m/rad]")
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, *grid.ravel())
    return figure


def _share_limits(
    row: Sequence[Axes],
    errors: Mapping[str, Mapping[str, NDArray[np.float64]]],
    times: NDArray[np.float64],
    unit: str,
    *,
    part: float,
    margin: float,
) -> None:
    """Set the axis limits of a row of panels to those of all its curves, by `robust_limits`, and note what is outside.

    `errors` has the curves by panel and name, in a unit for the notes; `part` and `margin` are those of
    `robust_limits`.
    """
    low, high = robust_limits([v for column in errors.values() for v in column.values()], part=part, margin=margin)
    for axes, column in zip(row, errors.values(), strict=True):
        axes.set_ylim(low, high)
        note_off_scale(axes, times, dict(column), unit)


def _settling(axes: Axes, runs: Mapping[str, SimulationResult], times: NDArray[np.float64]) -> str:
    """Draw the stiffness error after the last step of its reference, with its band; the settling times in words."""
    first = next(iter(runs.values()))
    desired = first["desired_stiffness"]
    change = int(last_change(desired).at)
    start = float(times[change])
    band = float(settling_band(desired, first["stiffness"]))
    axes.axhspan(-band, band, color="#E8E8E8", zorder=0, label=f"{SETTLING_PART * 100:g} % of the step size")
    settled = {name: result.metrics["stiffness_settling"] for name, result in runs.items()}
    length = float(np.clip(2.5 * np.nanmax([*settled.values(), 0.04]), 0.1, 1.0))  # s
    axes.set_xlim(start - length / 8, start + length)
    window = (times >= start) & (times <= start + length)
    low, high = robust_limits([_stiffness_error(r)[window] for r in runs.values()], part=1.0, margin=0.08)
    axes.set_ylim(low, high)
    looks = looks_of(runs)
    for name, value in settled.items():
        if np.isfinite(value) and value <= length:
            axes.axvline(start + value, color=looks[name]["color"], linewidth=0.8, linestyle=":", zorder=1)
    text = ", ".join(f"{n} {v:.3f} s" if np.isfinite(v) else f"{n} never" for n, v in settled.items())
    return f"settling: {text}"


def _angle_error(result: SimulationResult) -> NDArray[np.float64]:
    """Actual minus desired angle [deg], shape (samples,)."""
    return _angle(result) - _angle(result, "desired_angle")


def _stiffness_error(result: SimulationResult) -> NDArray[np.float64]:
    """Actual minus desired stiffness [N*m/rad], shape (samples,)."""
    return _stiffness(result) - _stiffness(result, "desired_stiffness")


def _angle(result: SimulationResult, column: str = "angle") -> NDArray[np.float64]:
    """A column of angles [deg], of a slide of positions [mm]."""
    return result[column] / result.joint_type.size(_DEG)


def _stiffness(result: SimulationResult, column: str = "stiffness") -> NDArray[np.float64]:
    """A column of the stiffness [N*m/rad], of a slide [N/mm]."""
    return result[column] / result.joint_type.size(_STIFFNESS)


def _note_stiffness(axes: Axes, runs: Mapping[str, SimulationResult], *, bottom: bool = False) -> None:
    first = next(iter(runs.values()))
    curves = {name: _stiffness(result) for name, result in runs.items()}
    note_off_scale(axes, first.times, curves, first.joint_type.label("", _STIFFNESS)[2:-1], bottom=bottom)


_GAINS = {
    "kp": {"color": BLACK, "linestyle": "-"},
    "ki": {"color": GREEN, "linestyle": "--"},
    "kd": {"color": PURPLE, "linestyle": ":"},
}


@styled
def gain_histories(results: Mapping[str, tuple[SimulationResult, float]]) -> Figure:
    """Gains of BP over time, relative to its base gains.

    Upper panels: position loop; lower panels: stiffness loop. A gain that is zero has no curve. A curve is the mean
    over a two-hundredth of the run, in a band from the lowest to the highest value, as gains may switch at each sample.

    Parameters
    ----------
    results
        Run and largest gain ratio [-], whose bounds are dashed, by title.
    """
    figure = blank(DOUBLE, 4.4)
    grid = figure.subplots(2, len(results), squeeze=False, sharex=True, sharey="col")
    for i, (title, (result, ratio)) in enumerate(results.items()):
        for row, loop in enumerate(("position", "stiffness")):
            axes = grid[row, i]
            for gain, look in _GAINS.items():
                values = result[f"{loop}_{gain}"]
                if values[0] != 0:  # a loop without this part
                    spans = np.array_split(values / values[0], min(200, len(values)))
                    times = [float(span.mean()) for span in np.array_split(result.times, len(spans))]
                    low, mean, high = np.transpose([(span.min(), span.mean(), span.max()) for span in spans])
                    axes.fill_between(times, low, high, color=look["color"], alpha=0.25, linewidth=0)
                    axes.plot(times, mean, label=gain, **look)
            for bound in (ratio, 1 / ratio):
                axes.axhline(bound, color="#888888", linewidth=0.8, linestyle="--", label="bound on the gains")
            letter(axes, len(results) * row + i, f"{title}\n{loop} loop" if row == 0 else f"{loop} loop")
            axes.set(ylabel="gain / base gain [-]" if i == 0 else "", xlabel="time [s]" if row else "")
    legend_above(figure, *grid.ravel())
    return figure


@styled
def margins(margins: Margins) -> Figure:
    """Loci of the open loop at the operating point of least disk margin, and the sensitivity at all points."""
    figure = blank(DOUBLE, 3.0)
    nyquist, bode = figure.subplots(1, 2)
    worst = int(margins.disk.argmin())
    for locus in margins.loci[worst].T:
        nyquist.plot(locus.real, locus.imag, ".", color=BLUE, markersize=1.5)
    turn = np.linspace(0, 2 * np.pi, 200)
    nyquist.plot(np.cos(turn), np.sin(turn), color="0.7", linewidth=0.6)
    nyquist.plot(-1, 0, "+", color=VERMILLION)
    nyquist.set(xlim=(-3, 2), ylim=(-2.5, 2.5), aspect="equal", xlabel="real part", ylabel="imaginary part")
    letter(nyquist, 0, f"open loop at {margins.time[worst]:.3g} s")
    for row, values in enumerate(margins.sensitivity):
        look = {"color": BLUE, "zorder": 3} if row == worst else {"color": "0.75", "linewidth": 0.6}
        bode.loglog(margins.frequency, values, **look)
    bode.set(xlabel="frequency [Hz]", ylabel="largest singular value")
    letter(bode, 1, "sensitivity at the commands")
    plain_numbers(bode.xaxis)
    plain_numbers(bode.yaxis)
    return figure
