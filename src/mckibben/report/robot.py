"""Figures of the robot: landings over stiffness, time traces of jumps, and stiffness of the foot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from mckibben.mechanism.outline import outline, stiffness_ellipsoid
from mckibben.mechanism.point_stiffness import stiffness_of
from mckibben.report.palette import BAND, BLACK, BLUE, GREY, MEASURED, ORANGE, VERMILLION
from mckibben.report.style import (
    DESIRED,
    DOUBLE,
    Look,
    blank,
    draw_band,
    legend_above,
    letter,
    looks_of,
    pressure_colours,
    styled,
)
from mckibben.statics.attainable import attainable_point_stiffness
from mckibben.study.landing import EDGES, LandingStudy
from mckibben.units import bar, deg, mm, ms

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

    from mckibben.mechanism.bodies import BodyPoint, Foot
    from mckibben.mechanism.point_stiffness import PointStiffness
    from mckibben.mechanism.robot import Robot
    from mckibben.simulation import SimulationResult
    from mckibben.statics.pressures import StaticPressures
    from mckibben.study.jumping import JumpStudy


BONE: Look = {"color": "#AAB4BD", "linewidth": 5, "solid_capstyle": "round"}
_LOOKS = ((VERMILLION, "-"), (BLUE, (0, (4, 2))))


@styled
def landing_forces(study: LandingStudy) -> Figure:
    """Forces on the trunk and of the ground, and deflection of the joint, over the commanded stiffness.

    One column per height of the drop, one colour per valve; bands contain 90 % of the draws. Triangles mark the
    nominal best stiffness, circles the robust one.

    Parameters
    ----------
    study
        Result of `mckibben.study.landing.study_landing`.
    """
    table = study.table
    stiffness, drops = table["stiffness"].to_numpy(), table["drop"].to_numpy()
    rows = (
        ("force on the trunk\n[its weight]", study.trunk_weights()),
        ("deflection [mm]", table["deflection"].to_numpy() / mm),
        ("force of the ground\n[weight of the robot]", study.body_weights()),
    )
    valves = [str(name) for name in table["valve"].to_numpy()]
    best, robust = study.best(), study.robust()
    figure = blank(DOUBLE, 6.0)
    grid = figure.subplots(len(rows), drops.size, sharex=True, sharey="row", squeeze=False)
    for i, (label, values) in enumerate(rows):
        for j, drop in enumerate(drops):
            axes: Axes = grid[i, j]
            for v, (name, look) in enumerate(looks_of(valves).items()):
                low, high = np.percentile(values[v, j, :, 1:], EDGES, axis=-1)
                draw_band(axes, stiffness, low, high, color=look["color"], alpha=0.15)
                axes.plot(stiffness, values[v, j, :, 0], label=name, **look)
                mark = {"markersize": 6, "markeredgecolor": "white", "color": look["color"]}
                for at, shape in ((best[v, j, 0], "v"), (robust[v, j], "o")):
                    axes.plot(stiffness[at], values[v, j, at, 0], shape, **mark)
            if i == 0:
                letter(axes, j, f"drop of {drop / mm:g} mm")
        grid[i, 0].set_ylabel(label)
    for axes in grid[-1]:
        axes.set_xlabel("stiffness of the " + study.joint + " [N·m/rad]")
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, grid[0, 0])
    return figure


@styled
def point_ellipses(
    robot: Robot,
    angles: Sequence[float],
    *,
    force: float = 1.0,
    found: StaticPressures | None = None,
    point: BodyPoint | Foot | None = None,
) -> Figure:
    """Posture of a robot, and displacements of a point [mm] under a force in all directions of a plane.

    The plane is that of walking, and for a robot in space also that across it. Grey: all attainable stiffness, at zero
    torque or at the torques that are held; coloured: the softest and the stiffest on average over the directions, or
    the attained and the desired one.

    Parameters
    ----------
    robot, angles
        Robot, and the angles of its joints [rad].
    force
        Magnitude of the force [N].
    found
        Pressures for a stiffness of the point, which is drawn in place of the extremes.
    point
        Point of a body. Default: the foot.
    """
    torques, held = ([0.0] * len(angles), None)
    if found is not None:
        torques, held = [float(torque) for torque in robot.torques(angles, found.pressures)], found.force
    levels, point = 9 if robot.is_planar else 4, point or robot.foot
    attainable = attainable_point_stiffness(robot, angles, torques, levels=levels, force=held, point=point)
    if found is None or found.stiffness is None or found.wanted is None:
        ordered = sorted(attainable, key=lambda stiffness: np.trace(stiffness.compliance))
        ellipses = {"softest": ordered[-1], "stiffest": ordered[0]}
    else:
        ellipses = {"attained": found.stiffness, "desired": stiffness_of(np.linalg.inv(found.wanted))}
    planes = _planes(robot)
    figure = blank(DOUBLE * (0.8 if robot.is_planar else 1.0), 3.0)
    posture_axes, *others = figure.subplots(1, 1 + len(planes), width_ratios=(1, *(1.6 for _ in planes)))
    for bone in outline(robot, angles).bodies:
        posture_axes.plot(bone[:, 0] / mm, bone[:, 2] / mm, "o-", color=BLACK, linewidth=3)
    posture_axes.set(aspect="equal", xlabel="forwards [mm]", ylabel="up from the base [mm]")
    posture_axes.margins(x=0.6, y=0.1)
    letter(posture_axes, 0, "posture")
    for number, (axes, (along, plane)) in enumerate(zip(others, planes.items(), strict=True), 1):
        _ellipses(axes, plane, attainable, ellipses, force)
        axes.set(xlabel=f"{along} [mm]", ylabel="up [mm]" if number == 1 else "")
        letter(axes, number, f"point under {force:g} N" + (" in all directions" if robot.is_planar else ""))
    legend_above(figure, *others)
    return figure


def _planes(robot: Robot) -> dict[str, tuple[int, int]]:
    """Planes in which the stiffness of the foot is drawn, each with up, by the name of the other direction."""
    walking = {"forwards": (0, -1)}
    return walking if robot.is_planar else walking | {"to the left": (1, -1)}


def _ellipses(
    axes: Axes,
    plane: tuple[int, int],
    attainable: Sequence[PointStiffness],
    ellipses: Mapping[str, PointStiffness],
    force: float,
) -> None:
    """Displacements of the foot in a plane: grey what is attainable, and two in colours, the second dashed."""
    curves = [("attainable", stiffness, BAND, "-") for stiffness in attainable]
    curves += [(name, stiffness, *look) for (name, stiffness), look in zip(ellipses.items(), _LOOKS, strict=True)]
    for name, stiffness, colour, line in curves:
        outline = stiffness.ellipse(force, plane=plane)[list(plane)] / mm
        axes.plot(*outline, color=colour, linestyle=line, linewidth=0.8 if colour == BAND else 1.2, label=name)


@styled
def posture(
    robot: Robot,
    angles: Sequence[float],
    pressures: Sequence[float] | None = None,
    *,
    stiffness: np.ndarray | None = None,
    point: BodyPoint | Foot | None = None,
) -> Figure:
    """Bodies and muscles of a robot in space [mm]; muscles have the colour of their pressure [bar].

    Parameters
    ----------
    robot, angles
        Robot, and the angles of its joints [rad].
    pressures
        Gauge pressures [Pa] of all muscles. Default: unknown, muscles are grey.
    stiffness, point
        Stiffness matrix [N*m/rad] of the joints, for the ellipsoid of a point (default: the foot). Default: none.
    """
    figure = blank(0.75 * DOUBLE, 0.6 * DOUBLE)
    axes = figure.add_subplot(projection="3d", proj_type="ortho", computed_zorder=False)
    lines, colours = outline(robot, angles), pressure_colours()
    for bone in lines.bodies:
        axes.plot(*(bone.T / mm), **BONE)
    for place in np.unique(lines.hinges, axis=0):
        names = [joint.name for joint, at in zip(robot.joints, lines.hinges, strict=True) if (at == place).all()]
        x, y, z = (place / mm).tolist()
        axes.text(x, y, z, f"   {', '.join(names)}")
    highest = robot.highest_pressure
    levels = {} if pressures is None else dict(zip(robot.muscle_names, pressures, strict=True))
    for name, path in lines.muscles.items():
        axes.plot(*(path.T / mm), color=colours(float(levels[name]) / highest) if levels else GREY, linewidth=2)
    if levels:
        scale = ScalarMappable(Normalize(0, highest / bar), colours)
        figure.colorbar(scale, ax=axes, label="pressure [bar]", shrink=0.6, pad=0.12)
    half = set_space(axes, [*lines.bodies, *lines.muscles.values()])
    if stiffness is not None and (point := point or robot.foot) is not None:
        shape = stiffness_ellipsoid(robot, angles, stiffness, point, 0.3 * half * mm)
        turn, rise = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
        ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)])
        surface = np.einsum("ij,j,jkl->ikl", shape.axes, shape.lengths, ball) + shape.centre[:, None, None]
        axes.plot_wireframe(*(surface / mm), color=MEASURED, linewidth=0.5)
        axes.text2D(0.0, 0.98, f"ellipsoid: displacement under {shape.force:g} N", transform=axes.transAxes)
    return figure


def set_space(axes: Axes3D, lines: Sequence[np.ndarray]) -> float:
    """Set labels, view and limits [mm] of axes for lines [m] in space; return half the extent [mm]."""
    points = np.concatenate(lines) / mm
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle, half = (low + high) / 2, float((high - low).max() / 2)
    axes.set(xlabel="forwards [mm]", ylabel="to the left [mm]", zlabel="up [mm]")
    axes.set_box_aspect((1, 1, 1), zoom=1.05)
    for limit, at in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        limit(at - half, at + half)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.view_init(elev=12, azim=-55)
    return half


@styled
def robot_tracking(run: SimulationResult) -> Figure:
    """Angle [deg], its error [deg] and stiffness [N*m/rad] of each joint over time [s], and pressures of all muscles.

    Dashed: references.

    Parameters
    ----------
    run
        Result of a robot whose joints follow references.
    """
    count, time = len(run.joints), run["time"]
    figure = blank(DOUBLE, 1.4 * (count + 1) + 0.6)
    grid = figure.add_gridspec(count + 1, 3)
    angles, desired = run["angle"] / deg, run["desired_angle"] / deg
    titles = ("angle [deg]", "angle error [deg]", "stiffness [N·m/rad]")
    columns = ((angles, desired), (angles - desired, None), (run["stiffness"], run["desired_stiffness"]))
    for j, (title, (values, reference)) in enumerate(zip(titles, columns, strict=True)):
        for i, name in enumerate(run.joints):
            axes = figure.add_subplot(grid[i, j])
            axes.plot(time, values[i], color=MEASURED, label="run")
            if reference is not None:
                axes.plot(time, reference[i], **DESIRED, label="desired")
            axes.margins(x=0)
            axes.tick_params(labelbottom=i == count - 1)
            letter(axes, len(titles) * i + j, "" if i else title)
            if j == 0:
                axes.set_ylabel(name)
    legend_above(figure, figure.axes[0])
    axes = figure.add_subplot(grid[count, :])
    letter(axes, len(titles) * count, "pressures")
    for muscle, (name, look) in enumerate(looks_of(list(run.muscles)).items()):
        axes.plot(time, run["pressure"][muscle] / bar, label=name, **look)
    axes.margins(x=0)
    axes.set(xlabel="time [s]", ylabel="pressure [bar]")
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), ncols=1 + len(run.muscles) // 9)
    return figure


@styled
def jump_traces(study: JumpStudy) -> Figure:
    """Pressures [bar], force of the ground [N] and height of the centre of mass [mm] of jumps over time [ms].

    Thin: commands; dashed: height of the jump at take-off speed.

    Parameters
    ----------
    study
        Result of `mckibben.study.jumping.study_jump`.
    """
    jumps = study.jumps
    figure = blank(DOUBLE, 5.6)
    grid = figure.subplots(3, len(jumps), sharex=True, sharey="row")
    for j, (title, jump) in enumerate(jumps.items()):
        run = jump.run
        time = run["time"] / ms
        names = list(run.muscles)
        for i, (name, look) in enumerate(looks_of(names).items()):
            grid[0, j].plot(time, run["pressure"][i] / bar, label=name, **look)
            grid[0, j].plot(time, run["command"][i] / bar, color=look["color"], linewidth=0.6, alpha=0.6)
        grid[1, j].plot(time, run["ground_up"], color=VERMILLION)
        height = (run["mass_height"] - study.standing) / mm
        grid[2, j].plot(time, height, color=BLUE)
        grid[2, j].axhline(jump.heights[0] / mm, color=ORANGE, linewidth=0.8, linestyle=(0, (4, 2)))
        letter(grid[0, j], j, title)
        grid[2, j].set_xlabel("time [ms]")
    grid[0, 0].set_ylabel("pressure [bar]")
    grid[1, 0].set_ylabel("force of the\nground [N]")
    grid[2, 0].set_ylabel("centre of mass above\nthat of standing [mm]")
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, grid[0, 0])
    return figure
