"""Figures of an envelope: torque and stiffness over angle, the band along time; and of a design, before and after."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from mckibben.report.panels import draw_band, legend_above, letter, robust_limits
from mckibben.report.style import BLACK, BLUE, DESIRED, DOUBLE, GREEN, ORANGE, PURPLE, VERMILLION, blank, styled
from mckibben.study.envelope import Design, Envelope, Holdable, Kept, Offer
from mckibben.units import deg

_ANGLE, _STIFFNESS, _TORQUE = "joint angle [deg]", "stiffness [N·m/rad]", "muscle torque [N·m]"
_STANDING, _MOVING, _NEAREST = "#DCE9F2", "#9CC3E0", "#BFE3D5"
_NAMES = {
    Kept.ANGLE: "nearest, angle kept",
    Kept.AMPLITUDE: "nearest, amplitude kept",
    Kept.STIFFNESS: "nearest, stiffness kept",
}
_LOOKS = {
    Kept.ANGLE: {"color": GREEN, "linestyle": "-", "linewidth": 1.3},
    Kept.AMPLITUDE: {"color": ORANGE, "linestyle": (0, (5, 1.2)), "linewidth": 1.3},
    Kept.STIFFNESS: {"color": PURPLE, "linestyle": (0, (3, 1, 1, 1)), "linewidth": 1.3},
}


@styled
def envelope(found: Envelope) -> Figure:
    """What the joint of a scenario can hold, the reference in it, and the nearest references that can be followed.

    Parameters
    ----------
    found
        Of `mckibben.study.envelope.envelope`.
    """
    figure = blank(DOUBLE, 5.8)
    (torque, stiffness), (over_time, angle) = figure.subplots(2, 2)
    _torque(figure, torque, found)
    _over_angle(stiffness, found)
    _over_time(over_time, found)
    _angle(angle, found)
    for mark, axes, title in (
        ("a", torque, "torque, and the room in stiffness"),
        ("b", stiffness, "stiffness held standing"),
        ("c", over_time, "stiffness along the reference"),
        ("d", angle, "angle"),
    ):
        letter(axes, mark, title)
    legend_above(figure, torque, stiffness, over_time, angle, columns=3)
    return figure


def _torque(figure: Figure, axes: Axes, found: Envelope) -> None:
    holds, motion = found.holds, found.following.motion
    if holds.map_angles.size:
        room = np.nan_to_num(holds.highest_at - holds.lowest_at)
        drawn = axes.contourf(holds.map_angles / deg, holds.map_torques, room, 10, cmap="cividis")
        drawn.set_rasterized(True)
        figure.colorbar(drawn, ax=axes, label="highest less lowest stiffness [N·m/rad]", pad=0.02)
        held = slice(*np.searchsorted(holds.angles, [holds.map_angles[0, 0] - 1e-9, holds.map_angles[0, -1] + 1e-9]))
        axes.plot(
            holds.angles[held] / deg,
            holds.torque[held],
            color="white",
            linewidth=1.2,
            linestyle=(0, (1, 1.2)),
            label=None,
        )
    torque = found.following.bands.torque
    axes.plot(motion.angle / deg, torque, color="white", linewidth=2.4, zorder=4)
    axes.plot(
        motion.angle / deg, torque, color=VERMILLION, linewidth=1.1, zorder=5, label="torque of the motion wished"
    )
    axes.grid(False)
    axes.set(xlabel=_ANGLE, ylabel=_TORQUE)
    seen = holds.map_torques if holds.map_torques.size else torque
    low, high = float(np.min(seen)), float(np.max(seen))
    most = 0.6 * (high - low)
    axes.set_ylim(max(min(low, torque.min()), low - most) - 0.3, min(max(high, torque.max()), high + most) + 0.3)


def _over_angle(axes: Axes, found: Envelope) -> None:
    holds, motion = found.holds, found.following.motion
    inside = (holds.angles >= holds.first) & (holds.angles <= holds.last)
    if inside.any():
        _band(axes, holds, color=_STANDING, label="attainable, standing")
    else:
        axes.text(0.5, 0.5, "no angle can be held", transform=axes.transAxes, ha="center")
    axes.plot(motion.angle / deg, motion.stiffness, color=BLACK, linewidth=0.9, zorder=3)  # back and forth: no dashes
    for offer in found.offers:
        moved = offer.following.motion
        axes.plot(moved.angle / deg, moved.stiffness, label=_NAMES[offer.kept], zorder=4, **_LOOKS[offer.kept])
    axes.set(xlabel=_ANGLE, ylabel=_STIFFNESS)
    _limits(axes, holds.stiffness.lowest[inside], holds.stiffness.highest[inside], motion.stiffness)


def _band(axes: Axes, holds: Holdable, *, color: str, label: str) -> None:
    inside = (holds.angles >= holds.first) & (holds.angles <= holds.last)
    angles, low, high = holds.angles[inside] / deg, holds.stiffness.lowest[inside], holds.stiffness.highest[inside]
    draw_band(axes, angles, low, high, color=color, label=label)
    for edge in (low, high):
        axes.plot(angles, edge, color=BLUE, linewidth=0.8)


def _over_time(axes: Axes, found: Envelope) -> None:
    motion, bands = found.following.motion, found.following.bands
    shown = _shown(found)
    times = motion.times[shown]
    draw_band(axes, times, *(edge[shown] for edge in bands.static), color=_STANDING, label="attainable, standing")
    look = {"color": _MOVING, "label": "attainable, moving as wished", "zorder": 1}
    draw_band(axes, times, *(edge[shown] for edge in bands.driven), **look)
    edges = [edge[shown] for edge in (*bands.static, *bands.driven)]
    if found.offers:
        following = found.offers[0].following
        near = following.motion.times <= times[-1]
        low, high = (edge[near] for edge in following.bands.driven)
        draw_band(axes, following.motion.times[near], low, high, color=_NEAREST, label="attainable, moving as nearest")
        edges += [low, high]
    _dashed(axes, times, motion.stiffness[shown], label="wished")
    for offer in found.offers:
        _along(axes, offer, offer.following.motion.stiffness, times[-1])
    axes.set(xlabel="time [s]", ylabel=_STIFFNESS)
    axes.set_xlim(times[0], times[-1])
    _limits(axes, *edges, motion.stiffness[shown])


def _angle(axes: Axes, found: Envelope) -> None:
    motion, holds = found.following.motion, found.holds
    shown = _shown(found)
    times = motion.times[shown]
    if holds.first <= holds.last:
        axes.axhspan(holds.first / deg, holds.last / deg, color=_STANDING, linewidth=0, zorder=0)
    _dashed(axes, times, motion.angle[shown] / deg, label="wished")
    for offer in found.offers:
        _along(axes, offer, offer.following.motion.angle / deg, times[-1])
    axes.set(xlabel="time [s]", ylabel=_ANGLE)
    axes.set_xlim(times[0], times[-1])


def _shown(found: Envelope) -> slice:
    """What of a run is drawn over time: of a sine two periods, so that one sees something; else all."""
    times, sine = found.following.motion.times, found.scenario.signals.angle.sine
    constant = found.scenario.signals.stiffness.constant is not None
    if sine is None or not constant or not sine.frequency:
        return slice(None)
    return slice(0, max(int(np.searchsorted(times, times[0] + 2 / sine.frequency)), 2))


def _along(axes: Axes, offer: Offer, values: np.ndarray, until: float) -> None:
    times = offer.following.motion.times
    kept = times <= until
    axes.plot(times[kept], values[kept], label=_NAMES[offer.kept], zorder=4, **_LOOKS[offer.kept])


def _dashed(axes: Axes, x: np.ndarray, y: np.ndarray, *, label: str) -> None:
    axes.plot(x, y, label=label, **DESIRED)


def _limits(axes: Axes, *curves: np.ndarray) -> None:
    low, high = robust_limits(curves, part=0.98, floor=1.0)
    axes.set_ylim(max(low, min(0.0, low)), high)


@styled
def design(found: Design, before: Holdable) -> Figure:
    """The band of stiffness of a joint before and after its lengths were chosen, and what was wanted of it.

    Parameters
    ----------
    found
        Of `mckibben.study.envelope.design`.
    before
        What the joint could hold as it was.
    """
    figure = blank(DOUBLE, 3.2)
    axes = figure.subplots()
    _band(axes, found.holds, color=_MOVING, label="attainable with the lengths found")
    inside = (before.angles >= before.first) & (before.angles <= before.last)
    for edge in before.stiffness:
        label = "attainable before" if edge is before.stiffness.lowest else None
        axes.plot(before.angles[inside] / deg, edge[inside], color="#777777", linestyle=(0, (3, 1.5)), label=label)
    (low, high), (first, last) = found.wanted.stiffness, (angle / deg for angle in found.wanted.angles)
    box = Rectangle((first, low), last - first, high - low, fill=False, edgecolor=BLACK, linewidth=1.4, label="wanted")
    axes.add_patch(box)
    held = found.holds
    reached = (held.angles >= held.first) & (held.angles <= held.last)
    if found.wanted.torque:
        draw_band(axes, found.angles / deg, *found.stiffness, color=BLUE, alpha=0.5, label="with the torque to spare")
    axes.set(xlabel=_ANGLE, ylabel=_STIFFNESS)
    _limits(axes, held.stiffness.lowest[reached], held.stiffness.highest[reached], np.array([low, high]))
    letter(
        axes, "a", ", ".join(f"{name.replace('_', ' ')} {value * 1e3:.4g} mm" for name, value in found.lengths.items())
    )
    legend_above(figure, axes)
    return figure
