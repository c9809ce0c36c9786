"""Figures of the joint before any control: the stiffness it can hold over angle, and over angle and torque."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from mckibben.report.panels import beside, draw_band, legend_above, letter, minus
from mckibben.report.style import BLACK, BLUE, DOUBLE, blank, styled
from mckibben.simulation import Result
from mckibben.study.paper.joint import JointMap
from mckibben.units import deg

_ANGLE, _STIFFNESS, _TORQUE = "joint angle [deg]", "stiffness [N·m/rad]", "muscle torque [N·m]"
_WISHES = (
    {"color": BLACK, "linestyle": (0, (4, 2)), "linewidth": 1.1},
    {"color": BLACK, "linestyle": (0, (1, 1.2)), "linewidth": 1.5},
    {"color": BLACK, "linestyle": "-", "linewidth": 0.8},
)


@styled
def attainable_stiffness(
    maps: Mapping[str, JointMap], wishes: Mapping[str, Mapping[str, Result]] | None = None
) -> Figure:
    """The band of stiffness that a joint can hold at each angle while it carries its load.

    Parameters
    ----------
    maps
        By name of the geometry.
    wishes
        By name of the geometry and of the wish: runs whose desired angle and stiffness are drawn over the band.
    """
    figure = blank(DOUBLE, 3.1)
    grid = figure.subplots(1, len(maps), squeeze=False)[0]
    for i, (axes, (name, found)) in enumerate(zip(grid, maps.items(), strict=True)):
        angles = found.angles / deg
        draw_band(axes, angles, found.lowest, found.highest, label="attainable while holding the load", color="#BFD9EA")
        for edge in (found.lowest, found.highest):
            axes.plot(angles, edge, color=BLUE, linewidth=0.9)
        for (wish, result), look in zip(((wishes or {}).get(name) or {}).items(), _WISHES, strict=False):
            for label, x, y in _path(result, wish):
                axes.plot(x, y, label=label, zorder=4, **look)
        first, last = (limit / deg for limit in found.holdable)
        for limit in (first, last):
            axes.axvline(limit, color="#888888", linewidth=0.7, linestyle="-.")
        axes.set(xlabel=_ANGLE, ylabel=_STIFFNESS if i == 0 else "")
        room = 0.12 * (last - first)
        axes.set_xlim(first - room, last + room)
        letter(axes, "abcdef"[i], name)
        beside(axes, f"can be held:\n{minus(first)}° to {minus(last)}°", x=0.5, ha="center", y=0.97)
        _head_room(axes, 0.2)
    legend_above(figure, *grid)
    return figure


@styled
def torque_stiffness_map(maps: Mapping[str, JointMap]) -> Figure:
    """Lowest and highest attainable stiffness over angle and torque, and the room between them.

    Parameters
    ----------
    maps
        By name of the geometry, a row each.
    """
    figure = blank(DOUBLE, 2.55 * len(maps) + 0.4)
    grid = figure.subplots(len(maps), 3, squeeze=False, sharey=True, sharex="row")
    titles = ("lowest", "highest", "room between them")
    for i, (name, found) in enumerate(maps.items()):
        values = (found.lowest_at, found.highest_at, found.highest_at - found.lowest_at)
        span = _levels(found.lowest_at, found.highest_at)
        for j, (axes, value) in enumerate(zip(grid[i], values, strict=True)):
            levels = span if j < 2 else _levels(np.zeros(1), value)
            cmap = "viridis" if j < 2 else "cividis"
            _filled(axes, found, value, levels, cmap)
            filled = ScalarMappable(BoundaryNorm(levels, 256), cmap)
            axes.plot(
                found.angles / deg,
                found.gravity_torque,
                color="white",
                linewidth=2.6,
                zorder=4,
            )
            axes.plot(
                found.angles / deg,
                found.gravity_torque,
                color=BLACK,
                linestyle=(0, (4, 2)),
                linewidth=1.2,
                label="torque that holds the load against gravity",
                zorder=5,
            )
            axes.set_facecolor("#F3F3F3")
            axes.grid(False)
            if j:
                label = _STIFFNESS if j == 1 else "room [N·m/rad]"
                figure.colorbar(filled, ax=list(grid[i, :2]) if j == 1 else axes, label=label, fraction=0.06, pad=0.02)
            letter(axes, "abcdefghi"[3 * i + j], f"{name}: {titles[j]}" if j < 2 else titles[j])
            reach = found.angles[~np.isnan(found.lowest_at).all(axis=0)] / deg
            edge = found.angles[[0, -1]] / deg
            axes.set_xlim(max(edge[0], 1.15 * reach.min()), min(edge[1], 1.15 * reach.max()))
            axes.set(xlabel=_ANGLE, ylabel=_TORQUE if j == 0 else "")
    legend_above(figure, *grid.ravel())
    return figure


def _filled(axes: Axes, found: JointMap, value: NDArray[np.float64], levels: NDArray[np.float64], cmap: str) -> None:
    """Filled contours within the attainable region, whose edge is drawn as a curve and not in the steps of the grid."""
    held = ~np.isnan(value)
    columns = np.flatnonzero(held.any(axis=0))
    whole = np.stack([_extended(value[:, j], held[:, j]) for j in columns], axis=1)
    angles = found.angles[columns] / deg
    filled = axes.contourf(angles, found.torques, whole, levels, cmap=cmap)
    lines = axes.contour(filled, levels=levels[::2], colors="white", linewidths=0.4, alpha=0.7)
    low = [found.torques[held[:, j]].min() for j in columns]
    high = [found.torques[held[:, j]].max() for j in columns]
    outline = np.column_stack([np.append(angles, angles[::-1]), np.append(low, high[::-1])])
    edge = Polygon(outline, closed=True, transform=axes.transData)
    for drawn in (filled, lines):
        drawn.set_clip_path(edge)
    filled.set_rasterized(True)


def _extended(column: NDArray[np.float64], held: NDArray[np.bool_]) -> NDArray[np.float64]:
    places = np.arange(column.size)
    return np.interp(places, places[held], column[held])


def _levels(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.float64]:
    """About twelve round steps that hold all values."""
    first, last = float(np.nanmin(low)), float(np.nanmax(high))
    rough = max(last - first, 1e-6) / 11
    power = 10 ** np.floor(np.log10(rough))
    step = float(next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= rough * 0.999))
    return np.arange(np.floor(first / step), np.ceil(last / step) + 1) * step


def _path(result: Result, wish: str) -> Sequence[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """The desired stiffness over the range of desired angles: a horizontal piece for each level that is asked for."""
    angle = result.table["desired_angle"].to_numpy() / deg
    stiffness = result.table["desired_stiffness"].to_numpy()
    levels = np.unique(stiffness)
    if len(levels) > 4:
        return [(f"desired stiffness, {wish}", angle, stiffness)]
    label, pieces = f"desired stiffness, {wish}", []
    for level in levels:
        there = angle[stiffness == level]
        pieces.append((label, np.array([there.min(), there.max()]), np.array([level, level])))
    return pieces


def _head_room(axes: Axes, part: float) -> None:
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + part * (high - low))
