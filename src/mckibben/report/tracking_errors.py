"""Error curves of position and stiffness (Fig. 8), and how the stiffness settles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mckibben.report.panels import legend_above, letter, note_off_scale, robust_limits
from mckibben.report.style import DOUBLE, blank, looks_of, styled
from mckibben.simulation import Result
from mckibben.simulation.metrics import SETTLING_PART, last_change, settling_band
from mckibben.units import deg

_BEFORE = 0.05  # s shown before a change of the wish
_ZOOM = (0.1, 1.0)  # s: the shortest and the longest time shown after it


@styled
def error_curves(columns: Mapping[str, Mapping[str, Result]]) -> Figure:
    """Errors of the angle and of the stiffness over time, and the stiffness error right after its wish changed.

    Parameters
    ----------
    columns
        By title, a column each: the runs to compare, by name of the controller.
    """
    figure = blank(DOUBLE, 6.3)
    count = len(columns)
    grid = figure.subplots(3, count, squeeze=False)
    looks = looks_of(dict.fromkeys(name for runs in columns.values() for name in runs))
    angle = {title: {n: _angle_error(r) for n, r in runs.items()} for title, runs in columns.items()}
    stiffness = {title: {n: _stiffness_error(r) for n, r in runs.items()} for title, runs in columns.items()}
    for i, (title, runs) in enumerate(columns.items()):
        times = next(iter(runs.values())).table["time"].to_numpy()
        for row, errors in ((0, angle[title]), (1, stiffness[title]), (2, stiffness[title])):
            axes = grid[row, i]
            for name, values in errors.items():
                axes.plot(times, values, label=name, **looks[name])
            axes.axhline(0, color="#444444", linewidth=0.7, zorder=1.5)
            axes.set(xlabel="time [s]" if row == 2 else "")
        letter(grid[0, i], "abcdef"[i], f"angle, {title}")
        letter(grid[1, i], "abcdef"[count + i], f"stiffness, {title}")
        _settling(grid[2, i], runs, times)
    _share_limits(grid[0], angle, next(iter(columns.values())), "deg", part=0.998, margin=0.12)
    _share_limits(grid[1], stiffness, next(iter(columns.values())), "N·m/rad", part=0.975, margin=0.7)
    grid[0, 0].set_ylabel("angle error [deg]")
    for row in (1, 2):
        grid[row, 0].set_ylabel("stiffness error [N·m/rad]")
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, *grid.ravel())
    return figure


def _share_limits(
    row: Sequence[Axes],
    errors: Mapping[str, Mapping[str, NDArray[np.float64]]],
    runs: Mapping[str, Result],
    unit: str,
    *,
    part: float,
    margin: float,
) -> None:
    low, high = robust_limits([v for column in errors.values() for v in column.values()], part=part, margin=margin)
    times = next(iter(runs.values())).table["time"].to_numpy()
    for axes, column in zip(row, errors.values(), strict=True):
        axes.set_ylim(low, high)
        note_off_scale(axes, times, dict(column), unit)


def _settling(axes: Axes, runs: Mapping[str, Result], times: NDArray[np.float64]) -> None:
    """The moments after the last change of the wish, with the settling band and each settling time marked."""
    first = next(iter(runs.values()))
    desired = first.table["desired_stiffness"].to_numpy()
    change = int(last_change(desired).at)
    start = float(times[change])
    band = float(settling_band(first.trajectory, SETTLING_PART))
    axes.axhspan(-band, band, color="#E8E8E8", zorder=0, label=f"{SETTLING_PART * 100:g} % of the change asked for")
    settled = {name: result.metrics()["stiffness_settling"] for name, result in runs.items()}
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


def _angle_error(result: Result) -> NDArray[np.float64]:
    return (result.table["angle"] - result.table["desired_angle"]).to_numpy() / deg


def _stiffness_error(result: Result) -> NDArray[np.float64]:
    return (result.table["stiffness"] - result.table["desired_stiffness"]).to_numpy()
