"""Figures of a joint: attainable stiffness and torque, over angle and along a reference."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from mckibben.joint.antagonistic import SMALL_MOTION
from mckibben.reachability import Envelope, JointReach, Selection, StaticEnvelope, static_envelope
from mckibben.reachability.static import AttainableRange, Values
from mckibben.report.palette import BLACK, BLUE, MUSCLES, ORANGE, VERMILLION
from mckibben.report.style import (
    DESIRED,
    DOUBLE,
    Look,
    beside,
    blank,
    draw_band,
    legend_above,
    letter,
    minus,
    plain_numbers,
    pressure_colours,
    robust_limits,
    styled,
)
from mckibben.study.stiffness import CLOSED, CONTROLLED, HELD, SHOWN, FeltStiffness, MotionTests, StiffnessTests
from mckibben.units import JointType, bar, deg, kPa, mm

if TYPE_CHECKING:
    from mckibben.calibration import ValveCalibration
    from mckibben.calibration.estimation import JointCalibration
    from mckibben.simulation import SimulationResult

_ANGLE, _STIFFNESS, _TORQUE = "joint angle [deg]", "stiffness [N·m/rad]", "muscle torque [N·m]"
_RANGE = "range of stiffness [N·m/rad]"
_BALANCE = "torque that balances gravity"
_SAMPLES_APART = 100
_SHOWN_RANGE = 1.3  # of the required angles
_FROM, _LENGTH, _ERRORS_APART = 5.0, 8.0, 20  # s and samples, of the figure of valves


@styled
def attainable_stiffness(
    joints: Mapping[str, StaticEnvelope], references: Mapping[str, Mapping[str, SimulationResult]] | None = None
) -> Figure:
    """Attainable stiffness in static equilibrium with the load over the joint angle, one panel per joint.

    Vertical lines are the ends of the static range of angles.

    Parameters
    ----------
    joints
        Static envelopes by name of the joint.
    references
        Runs by joint and by name of the reference, at most three, whose desired angle and stiffness are drawn over the
        range.
    """
    figure = blank(DOUBLE, 3.1)
    grid = figure.subplots(1, len(joints), squeeze=False)[0]
    for i, (axes, (name, static)) in enumerate(zip(grid, joints.items(), strict=True)):
        static = _shown(static)
        _band(axes, static, color="#BFD9EA", label="attainable in static equilibrium")
        curves = (references or {}).get(name, {})
        for (reference, result), color in zip(curves.items(), (BLACK, ORANGE, VERMILLION), strict=False):
            desired = result["desired_angle"] / deg, result["desired_stiffness"]
            axes.plot(*desired, color=color, linewidth=1.4, label=f"desired stiffness, {reference}", zorder=4)
        first, last = static.angle_min, static.angle_max
        for limit in (first, last):
            axes.axvline(limit, color="#888888", linewidth=0.7, linestyle="-.")
        axes.set(xlabel=_ANGLE, ylabel=_STIFFNESS if i == 0 else "")
        margin = 0.12 * (last - first)
        axes.set_xlim(first - margin, last + margin)
        letter(axes, i, name)
        beside(axes, f"equilibrium possible:\n{minus(first)}° to {minus(last)}°", x=0.5, ha="center", y=0.97)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.2 * (high - low))  # space for the text
    legend_above(figure, *grid)
    return figure


@styled
def torque_stiffness_map(joints: Mapping[str, StaticEnvelope]) -> Figure:
    """Contours of the attainable stiffness [N*m/rad] over angle and torque of the muscles, one row per joint.

    Columns: minimum, maximum, and their difference, the freedom that the co-contraction has. The dashed curve is the
    torque that balances the load at rest.

    Parameters
    ----------
    joints
        Static envelopes by name of the joint.
    """
    figure = blank(DOUBLE, 2.55 * len(joints) + 0.4)
    grid = figure.subplots(len(joints), 3, squeeze=False, sharey=True, sharex="row")
    titles = ("K_min", "K_max", "K_max − K_min")
    for i, (name, static) in enumerate(joints.items()):
        static = _shown(static)
        ends = static.map_stiffness
        span = _levels(*ends)
        for j, (axes, value) in enumerate(zip(grid[i], (*ends, ends.width), strict=True)):
            filled = _contours(
                axes, static, value, span if j < 2 else _levels(value), "viridis" if j < 2 else "cividis"
            )
            axes.plot(static.angles, static.torque, color="white", linewidth=2.6, zorder=4)
            look = {**DESIRED, "linewidth": 1.2, "zorder": 5}
            axes.plot(static.angles, static.torque, label="static torque of the load", **look)
            axes.set_facecolor("#F3F3F3")
            if j:
                label = _STIFFNESS if j == 1 else _RANGE
                figure.colorbar(filled, ax=list(grid[i, :2]) if j == 1 else axes, label=label, fraction=0.06, pad=0.02)
            letter(axes, 3 * i + j, f"{name}: {titles[j]}" if j < 2 else titles[j])
            axes.set_xlim(1.15 * static.map_angles.min(), 1.15 * static.map_angles.max())
            axes.set(xlabel=_ANGLE, ylabel=_TORQUE if j == 0 else "")
    legend_above(figure, *grid.ravel())
    return figure


def _contours(axes: Axes, static: StaticEnvelope, values: Values, levels: int | Values, cmap: str) -> ContourSet:
    """Filled contours of values over the attainable angles [deg] and torques [N*m]."""
    filled = axes.contourf(static.map_angles, static.map_torques, values, levels, cmap=cmap)
    filled.set_rasterized(True)
    axes.grid(False)
    return filled


def _shown(static: StaticEnvelope) -> StaticEnvelope:
    """Return a static envelope in the units that are drawn, of a hinge degrees."""
    angle, stiffness = (static.joint_type.size(unit) for unit in ("deg", "N*m/rad"))

    def band(values: AttainableRange) -> AttainableRange:
        return AttainableRange(values.lowest / stiffness, values.highest / stiffness)

    return dataclasses.replace(
        static,
        angles=static.angles / angle,
        stiffness=band(static.stiffness),
        angle_min=static.angle_min / angle,
        angle_max=static.angle_max / angle,
        map_angles=static.map_angles / angle,
        map_stiffness=band(static.map_stiffness),
        small_motion=static.small_motion and band(static.small_motion),
    )


def _shown_reach(reach: JointReach) -> JointReach:
    """Return the reachability of a joint, with its reference, in the units that are drawn."""
    static, reference = _shown(reach.static), reach.reference
    if reference is not None:
        angle, stiffness = (static.joint_type.size(unit) for unit in ("deg", "N*m/rad"))
        reference = dataclasses.replace(
            reference,
            desired_angle=reference.desired_angle / angle,
            desired_stiffness=reference.desired_stiffness / stiffness,
            lowest=reference.lowest / stiffness,
            highest=reference.highest / stiffness,
        )
    return reach._replace(static=static, reference=reference)


def _angle_label(static: StaticEnvelope) -> str:
    return static.joint_type.label("joint angle", "deg")


def _stiffness_label(static: StaticEnvelope) -> str:
    return static.joint_type.label("stiffness", "N*m/rad")


def _levels(*values: Values) -> Values:
    """About twelve round contour levels that cover all values."""
    return np.asarray(MaxNLocator(12).tick_values(float(np.nanmin(values)), float(np.nanmax(values))))


_STATIC = "#DCE9F2"


@styled
def envelope(envelope: Envelope) -> Figure:
    """Attainable set of the joints of a scenario, and their reference.

    Panels of a scenario of one joint: torque that balances gravity over the angle, with the width of the stiffness
    range [N*m/rad] as contours; stiffness over the angle; stiffness and angle over time, each with its static range. A
    robot has a row for each joint: torque and stiffness over its angle, the others held, and stiffness over time.

    Parameters
    ----------
    envelope
        Result of `mckibben.reachability.envelope`.
    """
    if "" not in envelope.joints:
        return _of_joints(envelope.joints)
    reach = _shown_reach(envelope.only)
    figure = blank(DOUBLE, 5.8)
    (torque, stiffness), (over_time, angle) = figure.subplots(2, 2)
    _torque(figure, torque, reach)
    _over_angle(stiffness, reach)
    _over_time(over_time, reach)
    _angle(angle, reach)
    titles = ("torque and stiffness range", "static stiffness", "stiffness along the reference", "angle")
    for i, (axes, title) in enumerate(zip(figure.axes, titles, strict=False)):
        letter(axes, i, reach.static.joint_type.words(title))
    legend_above(figure, torque, stiffness, over_time, angle, columns=3)
    return figure


def _of_joints(joints: Mapping[str, JointReach]) -> Figure:
    """Draw torque and stiffness over the angle, and the stiffness over time, one row per joint."""
    timed = any(reach.reference for reach in joints.values())
    figure = blank(DOUBLE, 1.5 * len(joints) + 0.9)
    rows = figure.subplots(len(joints), 2 + timed, squeeze=False, sharex="col" if len(joints) == 1 else False)
    for row, (name, reach) in zip(rows, joints.items(), strict=True):
        reach = _shown_reach(reach)
        static, inside = reach.static, reach.static.inside
        angles, limits = static.angles[inside], [edge[inside] for edge in static.torque_range]
        draw_band(row[0], angles, *limits, color=_STATIC, label="attainable, static")
        row[0].plot(
            angles, static.torque[inside], color=VERMILLION, linewidth=1.1, label="torque that balances gravity"
        )
        row[0].set_ylabel(name)
        _over_angle(row[1], reach)
        if reach.reference is not None:
            _over_time(row[2], reach)
        for axes in row:
            axes.set_xlabel("")
        row[1].set_ylabel("")
        row[-1].set_ylabel("")
    titles = ("torque [N·m]", _STIFFNESS, _STIFFNESS)
    for axes, title, label in zip(rows[0], titles, (_ANGLE, _ANGLE, "time [s]"), strict=False):
        axes.set_title(title)
        rows[-1, list(rows[0]).index(axes)].set_xlabel(label)
    legend_above(figure, *rows[0], columns=4)
    return figure


def _torque(figure: Figure, axes: Axes, reach: JointReach) -> None:
    """Draw the torque [N*m] that balances gravity over the width of the stiffness range."""
    static = reach.static
    angles, torque = static.angles[static.inside], static.torque[static.inside]
    if static.one_muscle:
        limits = (edge[static.inside] for edge in static.torque_range)
        draw_band(axes, angles, *limits, color=_STATIC, label="attainable, static")
    elif static.map_angles.size:
        drawn = _contours(axes, static, np.nan_to_num(static.map_stiffness.width), 10, "cividis")
        figure.colorbar(drawn, ax=axes, label=static.joint_type.label("range of stiffness", "N*m/rad"), pad=0.02)
    axes.plot(angles, torque, color="white", linewidth=2.4, zorder=4)
    axes.plot(angles, torque, color=VERMILLION, linewidth=1.1, zorder=5, label=static.joint_type.words(_BALANCE))
    axes.set(xlabel=_angle_label(static), ylabel=static.joint_type.label("muscle torque", "N*m"))


def _over_angle(axes: Axes, reach: JointReach) -> None:
    """Draw the static stiffness range over the angle; with friction on a logarithmic axis."""
    static, reference = reach.static, reach.reference
    inside = static.inside
    if inside.any():
        _band(axes, static, color=_STATIC, label="attainable, static")
    else:
        axes.text(0.5, 0.5, "no static equilibrium", transform=axes.transAxes, ha="center")
    desired = np.empty(0) if reference is None else reference.desired_stiffness
    if reference is not None:  # back and forth: no dashes
        axes.plot(reference.desired_angle, desired, color=BLACK, linewidth=0.9, zorder=3)
    axes.set(xlabel=_angle_label(static), ylabel=_stiffness_label(static))
    if static.small_motion is None:
        _limits(axes, *(edge[inside] for edge in static.stiffness), desired)
    else:  # often many times the isobaric stiffness
        axes.set_yscale("log")
        plain_numbers(axes.yaxis)


def _band(axes: Axes, static: StaticEnvelope, *, color: str, label: str) -> None:
    """Shade the static stiffness range [N*m/rad] over the angle [deg]; dotted: small motion, with friction."""
    inside = static.inside
    angles, low, high = static.angles[inside], static.stiffness.lowest[inside], static.stiffness.highest[inside]
    draw_band(axes, angles, low, high, color=color, label=label)
    for edge in (low, high):
        axes.plot(angles, edge, color=BLUE, linewidth=0.8)
    for edge, label in zip(static.small_motion or (), ("small motion, at both ends", "_nolegend_"), strict=False):
        axes.plot(angles, edge[inside], color=BLUE, linewidth=0.9, linestyle=(0, (1, 1.2)), label=label)


def _over_time(axes: Axes, reach: JointReach) -> None:
    """Draw stiffness range and reference [N*m/rad] over time [s]."""
    reference = reach.reference
    assert reference is not None
    times, desired = reference.times, reference.desired_stiffness
    draw_band(axes, times, reference.lowest, reference.highest, color=_STATIC, label="attainable, static")
    if reach.static.one_muscle:
        axes.plot(times, reference.lowest, color=BLUE, linewidth=0.8)
    axes.plot(times, desired, label="reference", **DESIRED)
    axes.set(xlabel="time [s]", ylabel=_stiffness_label(reach.static), xlim=(times[0], times[-1]))
    _limits(axes, reference.lowest, reference.highest, desired)


def _angle(axes: Axes, reach: JointReach) -> None:
    """Draw the reference of the angle [deg] over time, and the range in which the load can be held."""
    static, reference = reach.static, reach.reference
    assert reference is not None
    if static.angle_min <= static.angle_max:
        axes.axhspan(static.angle_min, static.angle_max, color=_STATIC, linewidth=0, zorder=0)
    axes.plot(reference.times, reference.desired_angle, label="reference", **DESIRED)
    axes.set(xlabel="time [s]", ylabel=_angle_label(static), xlim=(reference.times[0], reference.times[-1]))


def _limits(axes: Axes, *curves: np.ndarray) -> None:
    """Limit an axis to the curves, with at least 5 % of the largest value as its range."""
    largest = max(float(np.abs(curve[np.isfinite(curve)]).max(initial=0.0)) for curve in curves)
    axes.set_ylim(*robust_limits(curves, part=0.98, floor=0.05 * largest))


@styled
def felt_stiffness(result: FeltStiffness) -> Figure:
    """Stiffness [N*m/rad] that a push feels over its frequency, one panel per joint, on logarithmic axes.

    Dashed: isobaric stiffness, which is controlled; dotted: that of small motion at constant pressures, with friction.

    Parameters
    ----------
    result
        Result of `mckibben.study.stiffness.stiffness_tests`, or of a robot.
    """
    kind, columns = result.scenario.joint_type, min(len(result.felt), 3)
    rows, size = math.ceil(len(result.felt) / columns), kind.size("N*m/rad")
    figure = blank(DOUBLE if columns > 1 else 0.6 * DOUBLE, 2.3 * rows + 0.7)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid[len(result.felt) :]:
        axes.set_visible(False)
    for i, (axes, (name, felt)) in enumerate(zip(grid, result.felt.items(), strict=False)):
        torque = kind.show(felt.torque, "N*m").replace("*", "·")
        push = f"felt by a push{f' of {torque}' * (columns == 1)}"
        axes.plot(felt.frequency, felt.magnitude / size, "o-", color=VERMILLION, label=push)
        axes.axhline(felt.isobaric / size, color=BLUE, linestyle=(0, (4, 2)), label="isobaric: what is controlled")
        if felt.small_motion > 0:
            look: Look = {"color": BLACK, "linestyle": (0, (1, 1.5))}
            amplitude = kind.show(SMALL_MOTION * kind.scale, "deg")
            axes.axhline(felt.small_motion / size, label=f"motion by {amplitude} at constant pressures", **look)
        axes.set(xscale="log", yscale="log", xlabel="frequency [Hz]")
        axes.set_ylim(bottom=0.5 * min(felt.isobaric, felt.magnitude.min()) / size)
        plain_numbers(axes.xaxis)
        plain_numbers(axes.yaxis)
        if name:
            letter(axes, i, f"{name}, {torque}")
    for axes in grid[::columns]:
        axes.set_ylabel(kind.label("stiffness", "N*m/rad"))
    legend_above(figure, grid[0], columns=1 if columns == 1 else 3)
    return figure


@styled
def stiffness(tests: StiffnessTests) -> Figure:
    """Stiffness [N*m/rad] over the amplitude of a motion [deg], in a row for each joint.

    First panel: at constant pressures and with closed valves, by the closed forms (lines), simulated at the lowest and
    the highest rate (circles and crosses), and without friction (dashed). Further panels: tests that depend on the rate
    of the motion, one curve per rate; with the controller active, on a logarithmic axis, the magnitude of the dynamic
    stiffness.

    Parameters
    ----------
    tests
        Result of `mckibben.study.stiffness.stiffness_tests`.
    """
    names = list(next(iter(tests.motions.values())).tests)
    varied = [name for name in names if name not in (HELD, CLOSED)]
    count, kind = len(tests.motions), tests.scenario.joint_type
    figure = blank(DOUBLE, 2.3 * count + 0.6)
    grid = figure.subplots(count, 1 + len(varied), squeeze=False)
    for row, (joint, motion) in enumerate(tests.motions.items()):
        _over_amplitude(grid[row, 0], motion, kind)
        _over_rates(list(grid[row, 1:]), motion, varied, kind)
        titles = "constant pressures, closed valves", *(SHOWN[name] for name in varied)
        for i, (axes, title) in enumerate(zip(grid[row], titles, strict=True)):
            letter(axes, row * len(titles) + i, f"{joint}: {title}" if joint else title)
            axes.set_xscale("log")
            plain_numbers(axes.xaxis)
    for axes in grid[-1]:
        axes.set_xlabel(kind.label("amplitude", "deg"))
    legend_above(figure, grid[0, 0], grid[0, -1], columns=4)
    return figure


def _over_amplitude(axes: Axes, motion: MotionTests, kind: JointType) -> None:
    """Draw the tests that do not depend on the rate [N*m/rad] over the amplitude [deg]."""
    forms = (
        (HELD, motion.secant, motion.isobaric, BLUE),
        (CLOSED, motion.closed_secant, motion.closed_valve, VERMILLION),
    )
    amplitudes, size = motion.amplitude / kind.size("deg"), kind.size("N*m/rad")
    for name, secant, slope, color in forms:
        axes.plot(amplitudes, secant / size, color=color, label=f"{SHOWN[name]}, closed form")
        label = f"{SHOWN[name]}, without friction"
        axes.axhline(slope / size, color=color, linewidth=0.8, linestyle=(0, (4, 2)), label=label)
        test = motion.tests[name]
        for row, marker, diameter in ((0, "o", 4.5), (-1, "x", 3.0)):
            label = f"simulated, {test.frequency[row]:.2g} Hz" if color == BLUE else None
            look: Look = {"color": color, "linestyle": "", "marker": marker}
            look |= {"markersize": diameter, "fillstyle": "none"}
            axes.plot(amplitudes, test.stiffness[row] / size, label=label, **look)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(kind.label("stiffness", "N*m/rad"))


def _over_rates(panels: Sequence[Axes], motion: MotionTests, names: Sequence[str], kind: JointType) -> None:
    """Draw tests [N*m/rad] over the amplitude [deg], one curve per rate; the controller's on a logarithmic axis."""
    amplitudes, shades, size = motion.amplitude / kind.size("deg"), pressure_colours(), kind.size("N*m/rad")
    for axes, name in zip(panels, names, strict=True):
        for secant, color in ((motion.secant, BLUE), (motion.closed_secant, VERMILLION)):
            axes.plot(amplitudes, secant / size, color=color, linewidth=2.6, alpha=0.3)
        test = motion.tests[name]
        values = test.magnitude if name == CONTROLLED else test.stiffness
        for k, (rate, row) in enumerate(zip(test.frequency, values, strict=True)):
            color = shades(k / max(len(test.frequency) - 1, 1))
            axes.plot(amplitudes, row / size, color=color, linewidth=1.0, label=f"{rate:.2g} Hz")
        if name == CONTROLLED:
            axes.set_yscale("log")
            plain_numbers(axes.yaxis)
            axes.set_ylabel(kind.label("magnitude", "N*m/rad"))
        else:
            axes.set_ylim(bottom=0.0)


def _box(axes: Axes, angles: Sequence[float], stiffness: Sequence[float], label: str) -> None:
    """Draw a range of angles [rad] and of stiffness [N*m/rad]."""
    (first, last), (low, high) = (angle / deg for angle in angles), stiffness
    look: Look = {"fill": False, "edgecolor": BLACK, "linewidth": 1.4}
    axes.add_patch(Rectangle((first, low), last - first, high - low, label=label, **look))


@styled
def selection(selection: Selection) -> Figure:
    """Attainable stiffness and torque over the angle of the best joint, and the requirement (black).

    Parameters
    ----------
    selection
        Result of `mckibben.reachability.size`.
    """
    need, joint = selection.requirement, selection.best
    static = _shown(static_envelope(joint.plant, about=need.middle))
    figure = blank(DOUBLE, 3.2)
    left, right = figure.subplots(1, 2)
    _band(left, static, color=_STATIC, label="attainable, static")
    if need.stiffness:
        _box(left, need.angles, need.stiffness, "required")
    inside = static.inside
    angles, torque = static.angles[inside], static.torque[inside]
    limits = (edge[inside] for edge in static.torque_range)
    draw_band(right, angles, *limits, color=_STATIC, label="attainable, static")
    right.plot(angles, torque, label="static torque of the load", **DESIRED)
    moved = (angles >= need.angles[0] / deg) & (angles <= need.angles[1] / deg)
    for sign, label in ((-1, None), (1, "required, with motion and reserve")):
        right.plot(angles[moved], torque[moved] + sign * need.reserve, color=BLACK, linewidth=1.4, label=label)
    middle, half = need.middle / deg, _SHOWN_RANGE * need.amplitude / deg
    left.set(xlabel=_ANGLE, ylabel=_STIFFNESS, xlim=(middle - half, middle + half))
    right.set(xlabel=_ANGLE, ylabel=_TORQUE, xlim=(middle - half, middle + half))
    letter(left, 0, joint.name)
    letter(right, 1, ", ".join(f"{name} {length / mm:.4g} mm" for name, length in list(joint.lengths.items())[:2]))
    legend_above(figure, left, right)
    return figure


@styled
def calibration(calibration: JointCalibration) -> Figure:
    """Stiffness of a model before and after calibration along the recordings, with 95 % intervals, and its change.

    Left: over recording time, one recording after the other; right: calibrated minus before, over the angle. A row for
    each joint.

    Parameters
    ----------
    calibration
        Result of `mckibben.calibration.calibrate_joint`.
    """
    names, kind = calibration.model.joint_names, calibration.model.joint_type
    size = kind.size("N*m/rad")
    figure = blank(DOUBLE, 1.0 + 1.9 * len(names))
    rows, start = figure.subplots(len(names), 2, width_ratios=(2, 1), squeeze=False), 0.0
    for recording in calibration.recordings:
        angle, pressures = recording.angle[::_SAMPLES_APART], tuple(recording.pressures[::_SAMPLES_APART].T)
        before, after = (
            [np.reshape(each, (len(angle), -1)).T / size for each in stiffness(angle.T, pressures)]
            for stiffness in (calibration.prior_stiffness, calibration.stiffness)
        )
        time = start + recording.time[::_SAMPLES_APART] - recording.time[0]
        start = float(time[-1])
        for i, (over_time, over_angle) in enumerate(rows):
            over_time.axvline(start, color=BLACK, linewidth=0.6)
            for name, (values, deviations), color in (("model before", before, ORANGE), ("calibrated", after, BLUE)):
                over_time.plot(time, values[i], color=color, linewidth=1.0, label=name)
                edges = values[i] - 1.96 * deviations[i], values[i] + 1.96 * deviations[i]
                draw_band(over_time, time, *edges, color=color, alpha=0.2, label=f"{name}, 95 % interval")
            angles = angle.reshape(len(angle), -1)[:, i] / kind.size("deg")
            over_angle.plot(angles, after[0][i] - before[0][i], ".", color=BLUE, markersize=2)
    for i, ((over_time, over_angle), name) in enumerate(zip(rows, names, strict=True)):
        letter(over_time, 2 * i, f"{name.removesuffix('.')} stiffness along the recordings".strip())
        letter(over_angle, 2 * i + 1, "calibrated minus before")
        over_time.set(xlabel="time [s]", ylabel=kind.label("stiffness", "N*m/rad"))
        over_angle.set(xlabel=kind.label("joint angle", "deg"), ylabel=kind.label("difference", "N*m/rad"))
        over_angle.axhline(0.0, color=BLACK, linewidth=0.6)
    legend_above(figure, rows[0, 0], columns=2)
    return figure


@styled
def valve_calibration(calibration: ValveCalibration) -> Figure:
    """Commands, measured and simulated pressures [bar] of both muscles over 8 s of each recording, and errors [kPa].

    Parameters
    ----------
    calibration
        Result of `mckibben.calibration.calibrate_valves`; one row of panels per recording.
    """
    recordings = calibration.recordings
    figure = blank(DOUBLE, 1.9 * len(recordings) + 0.8)
    rows = figure.subplots(len(recordings), 2, squeeze=False, width_ratios=(2, 1))
    for number, ((over_time, over_error), recording) in enumerate(zip(rows, recordings, strict=True)):
        assert recording.commands is not None
        simulated, time = calibration.simulate(recording), recording.time - recording.time[0]
        window = (time >= _FROM) & (time <= _FROM + _LENGTH)
        for place, muscle in enumerate(calibration.muscles):
            color, measured = MUSCLES[muscle], recording.pressures[:, muscle]
            over_time.plot(time[window], recording.commands[window, muscle] / bar, color=BLACK, linewidth=0.7)
            over_time.plot(time[window], measured[window] / bar, color=color, linewidth=2.4, alpha=0.35)
            label = f"muscle {muscle + 1}"
            over_time.plot(time[window], simulated[window, place] / bar, color=color, linewidth=0.9, label=label)
            error = (measured - simulated[:, place]) / kPa
            over_error.plot(time[::_ERRORS_APART], error[::_ERRORS_APART], color=color, linewidth=0.5)
        letter(over_time, 2 * number, "commands (black), measured (pale) and simulated")
        letter(over_error, 2 * number + 1, "measured minus simulated")
        over_time.set(xlabel="time [s]", ylabel="pressure [bar]")
        over_error.set(xlabel="time [s]", ylabel="error [kPa]")
    legend_above(figure, rows[0][0], columns=2)
    return figure
