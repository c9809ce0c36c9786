"""Figures of tracking runs: time traces, errors (Fig. 8) and controllers over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, NullLocator, StrMethodFormatter
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.report.palette import BLACK, BLUE, GREEN, MUSCLES, PURPLE, VERMILLION
from mckibben.report.style import (
    CONTROLLERS,
    DESIRED,
    DOUBLE,
    blank,
    draw_band,
    legend_above,
    letter,
    log_ticks,
    looks_of,
    note_off_scale,
    plain_numbers,
    robust_limits,
    styled,
)
from mckibben.simulation import SimulationResult
from mckibben.simulation.metrics import SETTLING_PART, last_change, settling_band
from mckibben.units import bar, deg

if TYPE_CHECKING:
    from mckibben.paper.tracking import ControllerRun
    from mckibben.simulation import Feasibility, Margins

TIME, ANGLE, STIFFNESS = "time [s]", "angle [deg]", "stiffness [N·m/rad]"
_BAND = "attainable at the desired angle"
_SMALL = "small_motion_stiffness"


@styled
def tracking(results: SimulationResult | Mapping[str, SimulationResult]) -> Figure:
    """Time traces of runs on one reference: angle, angle error, stiffness with the attainable range, pressures.

    Where muscles have friction, the stiffness of small motion, often many times larger, has a panel of its own.

    Runs are given by name, such as ``{"PID": result}``, or one alone. Raises `RangeError` if their references differ.
    """
    if isinstance(results, SimulationResult):
        results = {"run": results}
    _same_reference(results)
    alone = len(results) == 1
    small = {name: result[_SMALL] for name, result in results.items() if _SMALL in result.columns}
    rows = 3 + alone + bool(small)
    figure = blank(DOUBLE, 1.8 + 1.3 * rows)
    grid = figure.subplots(rows, 1, sharex=True)
    looks = looks_of(results)
    first = next(iter(results.values()))
    times = first.times
    grid[0].plot(times, first["desired_angle"] / deg, label="desired", **DESIRED)
    errors: dict[str, NDArray[np.float64]] = {}
    for name, result in results.items():
        errors[name] = _angle_error(result)
        grid[0].plot(times, result["angle"] / deg, label=name, **looks[name])
        grid[1].plot(times, errors[name], **looks[name])
    grid[0].set(ylabel=ANGLE)
    grid[0].set_ylim(*robust_limits([line.get_ydata() for line in grid[0].lines]))
    grid[1].axhline(0, color="#444444", linewidth=0.7)
    grid[1].set(ylabel="actual − desired\nangle [deg]")
    grid[1].set_ylim(*robust_limits(list(errors.values()), floor=1e-3))
    note_off_scale(grid[1], times, errors, "deg")
    _stiffness(grid[2], results, looks)
    grid[2].set_ylim(*_stiffness_limits(list(results.values())))
    note_off_scale(grid[2], times, {name: result["stiffness"] for name, result in results.items()}, "N·m/rad")
    for name, values in small.items():
        grid[3].plot(times, values, **looks[name])
    if small:
        grid[3].set(ylabel="small-motion\n" + STIFFNESS)
        grid[3].set_ylim(*robust_limits(list(small.values()), floor=_LEAST_RANGE * max(map(np.nanmax, small.values()))))
    if alone:
        for number, (colour, style) in enumerate(zip(MUSCLES, ("-", (0, (5, 1.5))), strict=True), 1):
            pressure = first[f"pressure{number}"] / bar
            grid[-1].plot(times, pressure, color=colour, linestyle=style, label=f"muscle {number}")
        grid[-1].set(ylabel="pressure [bar]")
        grid[-1].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)
    grid[-1].set(xlabel=TIME)
    figure.align_ylabels(list(grid))
    legend_above(figure, grid[0], grid[2])
    return figure


@styled
def control_results(panels: Mapping[str, tuple[str, SimulationResult]]) -> Figure:
    """Fig. 7: angle and stiffness with its attainable range: controller and result by panel title."""
    columns = 2 if len(panels) > 1 else 1
    rows = -(-len(panels) // columns)
    figure = blank(DOUBLE, 3.15 * rows + 0.4)
    outer = figure.add_gridspec(rows, columns)
    looks = looks_of(name for name, _ in panels.values())
    upper: list[Axes] = []
    lower: list[Axes] = []
    for i, (title, (name, result)) in enumerate(panels.items()):
        left = i % columns == 0
        inner = outer[i // columns, i % columns].subgridspec(2, 1, hspace=0.02)
        above = figure.add_subplot(inner[0], sharex=upper[0] if upper else None, sharey=upper[0] if upper else None)
        below = figure.add_subplot(inner[1], sharex=above, sharey=lower[0] if lower else None)
        above.plot(result.times, result["desired_angle"] / deg, label="desired", **DESIRED)
        above.plot(result.times, result["angle"] / deg, label=name, **looks[name])
        _stiffness(below, {name: result}, looks)
        letter(above, i, title)
        above.set(ylabel=ANGLE if left else "")
        above.tick_params(labelbottom=False, labelleft=left)
        below.set(xlabel=TIME, ylabel=STIFFNESS if left else "")
        below.tick_params(labelleft=left)
        upper.append(above)
        lower.append(below)
    angles = [result[column] / deg for _, result in panels.values() for column in ("angle", "desired_angle")]
    upper[0].set_ylim(*robust_limits(angles, part=1.0 if _bounded(angles) else 0.98, margin=0.08))
    lower[0].set_ylim(*_stiffness_limits([result for _, result in panels.values()]))
    for above, below, (name, result) in zip(upper, lower, panels.values(), strict=True):
        note_off_scale(above, result.times, {name: result["angle"] / deg}, "deg", bottom=True)
        note_off_scale(below, result.times, {name: result["stiffness"]}, "N·m/rad", bottom=True)
    figure.align_ylabels(upper + lower)
    legend_above(figure, *upper, *lower)
    return figure


def _stiffness(axes: Axes, runs: Mapping[str, SimulationResult], looks: Mapping[str, dict[str, Any]]) -> None:
    first = next(iter(runs.values()))
    draw_band(axes, first.times, first["lowest_stiffness"], first["highest_stiffness"], label=_BAND)
    for name, result in runs.items():
        axes.plot(first.times, result["stiffness"], label=name, **looks[name])
    axes.plot(first.times, first["desired_stiffness"], label="desired", **DESIRED)
    axes.set(ylabel=STIFFNESS)


def _stiffness_limits(results: list[SimulationResult]) -> tuple[float, float]:
    """Axis limits that contain the reference and most of the stiffness, with a margin."""
    desired = [r["desired_stiffness"] for r in results]
    floor = _LEAST_RANGE * max(float(np.abs(d).max()) for d in desired)
    low, high = robust_limits(desired + [r["stiffness"] for r in results], part=0.99, margin=0.0, floor=floor)
    low, high = min(low, *(float(d.min()) for d in desired)), max(high, *(float(d.max()) for d in desired))
    band_low = np.nanmin([np.nanmin(r["lowest_stiffness"], initial=low) for r in results])
    band_high = np.nanmax([np.nanmax(r["highest_stiffness"], initial=high) for r in results])
    margin = 0.7 * (high - low)
    return max(low - margin, min(float(band_low) - 0.1 * margin, low - 0.2 * margin)), min(
        high + margin, max(float(band_high) + 0.1 * margin, high + 0.2 * margin)
    )


_LEAST_RANGE = 0.05  # of the desired stiffness


def _bounded(curves: list[NDArray[np.float64]]) -> bool:
    """Whether the full range of the curves is at most three times the range of their central 96 %."""
    finite = np.concatenate([c[np.isfinite(c)] for c in curves])
    return bool(np.ptp(finite) < 3 * np.ptp(np.quantile(finite, [0.02, 0.98])))


def _same_reference(results: Mapping[str, SimulationResult]) -> None:
    if not isinstance(results, Mapping):
        remedy = "write tracking({'PID': result}), or result.plot()"
        raise RangeError(f"tracking draws results by name, not a {type(results).__name__}", remedy=remedy)
    if not results:
        raise RangeError("there is no result to draw", remedy="give at least one, by name")
    first = next(iter(results.values()))
    for name, result in results.items():
        for column in ("time", "desired_angle", "desired_stiffness"):
            if not np.array_equal(first[column], result[column]):
                raise RangeError(
                    f"{name} and {next(iter(results))} differ in {column.replace('_', ' ')}",
                    remedy="draw runs with different references in separate figures",
                )


_BEFORE = 0.05  # s shown before the stiffness step
_ZOOM = (0.1, 1.0)  # s, limits of the time shown after it


@styled
def error_curves(columns: Mapping[str, Mapping[str, SimulationResult]]) -> Figure:
    """Fig. 8: errors of angle and stiffness, and the settling of the stiffness: results by column and controller."""
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
        _settling(grid[2, i], runs, times)
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
    low, high = robust_limits([v for column in errors.values() for v in column.values()], part=part, margin=margin)
    for axes, column in zip(row, errors.values(), strict=True):
        axes.set_ylim(low, high)
        note_off_scale(axes, times, dict(column), unit)


def _settling(axes: Axes, runs: Mapping[str, SimulationResult], times: NDArray[np.float64]) -> None:
    """Stiffness error after the last step of its reference, with settling band and settling times."""
    first = next(iter(runs.values()))
    desired = first["desired_stiffness"]
    change = int(last_change(desired).at)
    start = float(times[change])
    band = float(settling_band(desired, first["stiffness"]))
    axes.axhspan(-band, band, color="#E8E8E8", zorder=0, label=f"{SETTLING_PART * 100:g} % of the step size")
    settled = {name: result.metrics["stiffness_settling"] for name, result in runs.items()}
    finite = [value for value in settled.values() if np.isfinite(value)]
    length = float(np.clip(2.5 * max(finite, default=_ZOOM[1]), *_ZOOM))
    axes.set_xlim(start - (_BEFORE * length / 0.4 if change else 0), start + length)
    shown = (times >= start) & (times <= start + length)
    low, high = robust_limits([_stiffness_error(r)[shown] for r in runs.values()], part=1.0, margin=0.08)
    axes.set_ylim(low, high)
    looks = looks_of(runs)
    for name, value in settled.items():
        if np.isfinite(value) and value <= length:
            axes.axvline(start + value, color=looks[name]["color"], linewidth=0.8, linestyle=":", zorder=1)
    text = ", ".join(f"{n} {v:.3f} s" if np.isfinite(v) else f"{n} never" for n, v in settled.items())
    axes.set_title(f"settling: {text}", fontsize=7.5)


def _angle_error(result: SimulationResult) -> NDArray[np.float64]:
    return (result["angle"] - result["desired_angle"]) / deg


def _stiffness_error(result: SimulationResult) -> NDArray[np.float64]:
    return result["stiffness"] - result["desired_stiffness"]


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
_WIDEST = 1e3  # ratio of axis limits; larger values are drawn as arrows


@styled
def controller_comparison(runs: Mapping[str, Mapping[str, Mapping[str, ControllerRun]]]) -> Figure:
    """Median over seeds (dot) and worst seed of runs by geometry, stiffness reference and controller."""
    figure = blank(DOUBLE, 2.5 * len(runs) + 0.5)
    grid = figure.subplots(len(runs), len(_METRICS), squeeze=False, sharey="row")
    for i, (geometry, references) in enumerate(runs.items()):
        names = list(dict.fromkeys(name for controllers in references.values() for name in controllers))
        names.sort(key=lambda name: list(CONTROLLERS).index(name) if name in CONTROLLERS else len(CONTROLLERS))
        for j, (metric, label, unit) in enumerate(_METRICS):
            axes = grid[i, j]
            _dots(axes, references, names, metric, unit)
            axes.set(xlabel=label)
            axes.set_yticks(range(len(names)), names)
            axes.set_ylim(len(names) - 0.4, -0.6)
            axes.tick_params(axis="y", length=0)
            axes.grid(axis="y", visible=False)
            letter(axes, len(_METRICS) * i + j, geometry)
    references = next(iter(runs.values()))
    grey: dict[str, Any] = {"linestyle": "", "color": "#444444"}
    handles = [
        Line2D([], [], marker="o", markersize=5, markerfacecolor=face, label=f"{name} stiffness", **grey)
        for name, face in zip(references, ("#444444", "white"), strict=False)
    ]
    handles.append(Line2D([], [], color="#444444", linewidth=1.6, alpha=0.6, label="median to worst seed"))
    handles.append(Line2D([], [], marker=">", label="off scale, never or unstable", **grey))
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


@styled
def gain_histories(results: Mapping[str, tuple[SimulationResult, float]]) -> Figure:
    """Gains of BP over time relative to its base gains, from a run and its largest gain ratio by title."""
    figure = blank(DOUBLE, 4.4)
    grid = figure.subplots(2, len(results), squeeze=False, sharex=True, sharey="col")
    for i, (title, (result, ratio)) in enumerate(results.items()):
        for row, loop in enumerate(("position", "stiffness")):
            axes = grid[row, i]
            for gain, look in _GAINS.items():
                values = result[f"{loop}_{gain}"]
                if values[0] != 0:  # a loop without this part
                    axes.plot(result.times, values / values[0], label=gain, **look)
            for bound in (ratio, 1 / ratio):
                axes.axhline(bound, color="#888888", linewidth=0.8, linestyle=(0, (2, 2)), label="bound on the gains")
            axes.set_yscale("log", base=2)
            axes.set_ylim(ratio**-1.15, ratio**1.15)
            axes.yaxis.set_major_locator(FixedLocator([1 / ratio, ratio**-0.5, 1, ratio**0.5, ratio]))
            axes.yaxis.set_major_formatter(StrMethodFormatter("{x:.3g}"))
            axes.yaxis.set_minor_locator(NullLocator())
            letter(axes, len(results) * row + i, f"{loop} loop")
            if row == 0:
                axes.annotate(title, (0, 1), (0, 18), **_ABOVE)
            axes.set(ylabel="gain / base gain [-]" if i == 0 else "", xlabel="time [s]" if row else "")
    legend_above(figure, *grid.ravel())
    return figure


def _dots(
    axes: Axes, references: Mapping[str, Mapping[str, ControllerRun]], names: list[str], metric: str, unit: float
) -> None:
    """Median and worst value of a metric by controller (row) and stiffness reference (filled or white dot)."""
    runs = [(name, k, run) for k, w in enumerate(references.values()) for name, run in w.items()]
    medians = [run.median(metric) / unit for *_, run in runs]
    smallest = min((value for value in medians if 0 < value < np.inf), default=1.0)
    stable = [run.worst(metric) / unit for *_, run in runs if run.unstable == 0]
    end = 2.0 * max((value for value in stable if value < _WIDEST * smallest), default=10 * smallest)
    for (name, k, run), median in zip(runs, medians, strict=True):
        look: dict[str, Any] = CONTROLLERS.get(name, {"color": "#444444", "marker": "o"})
        place, color = names.index(name) + (-0.17 if k == 0 else 0.17), look["color"]
        worst = run.worst(metric) / unit
        lost = not (median <= end) or run.unstable > _seeds(run) / 2
        if lost or not (worst <= end):
            axes.plot(end, place, linestyle="", marker=">", color=color, clip_on=False, markersize=5)
        if lost:
            look = {"ha": "right", "va": "center", "fontsize": 6.5}
            axes.annotate(_why_lost(run, median), (end, place), (-6, 0), textcoords="offset points", **look)
            continue
        axes.plot([median, worst if worst <= end else end], [place] * 2, color=color, linewidth=1.8, alpha=0.55)
        dot = look | {"linestyle": "", "markersize": 5, "markeredgewidth": 1.1, "zorder": 3}
        axes.plot(median, place, markerfacecolor=color if k == 0 else "white", **dot)
    axes.set_xscale("log")
    axes.set_xlim(smallest / 1.6, end)
    log_ticks(axes.xaxis, *(1.0, 2.0, 5.0) if end / smallest < 60 else (1.0,))


def _seeds(run: ControllerRun) -> int:
    return 1 if run.seeds is None else int(np.size(run.seeds.angle_rmse))


def _why_lost(run: ControllerRun, median: float) -> str:
    """Text of a run that is not on the scale."""
    if run.unstable:
        return f"{run.unstable} of {_seeds(run)} unstable"
    return "never" if np.isnan(median) else f"{median:.2g}"


@styled
def feasibility(feasibility: Feasibility) -> Figure:
    """A reference over time: its angle, and its stiffness with the attainable range at that angle."""
    figure = blank(DOUBLE, 3.4)
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(feasibility.times, feasibility.desired_angle / deg, **DESIRED)
    above.set(ylabel=ANGLE)
    draw_band(below, feasibility.times, feasibility.lowest, feasibility.highest, label=_BAND)
    below.plot(feasibility.times, feasibility.desired_stiffness, label="desired", **DESIRED)
    missed = np.where(feasibility.shortfall == 0, np.nan, feasibility.desired_stiffness)
    if not feasibility.feasible:
        below.plot(
            feasibility.times, missed, color=VERMILLION, marker=".", markersize=3, label="not attainable", zorder=4
        )
    below.set(xlabel=TIME, ylabel=STIFFNESS)
    figure.align_ylabels([above, below])
    legend_above(figure, below)
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
