"""Figures and pages of the leg: landings over stiffness, and time traces of jumps."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mckibben import catalog
from mckibben.errors import UnreachableError
from mckibben.leg.attainable import attainable_foot_stiffness
from mckibben.leg.dynamics import at_rest, frames, posture_of
from mckibben.leg.foot import stiffness_of
from mckibben.leg.landing import EDGES, LandingStudy
from mckibben.report.figures import ReportFigure
from mckibben.report.page import embedded, style_sheet, template_of, write_page
from mckibben.report.style import (
    BAND,
    BLACK,
    BLUE,
    DOUBLE,
    ORANGE,
    VERMILLION,
    blank,
    draw_band,
    legend_above,
    letter,
    looks_of,
    styled,
)
from mckibben.report.tables import Table
from mckibben.units import bar, mm, ms

if TYPE_CHECKING:
    from mckibben.leg.foot import FootStiffness
    from mckibben.leg.foot_pressures import FootPressures
    from mckibben.leg.jumping import JumpStudy
    from mckibben.leg.mechanism import Leg


@styled
def landing_forces(study: LandingStudy) -> Figure:
    """Force on the trunk, deflection and share of landings that bottom out over the commanded stiffness.

    One column per drop; bands contain 90 % of the draws, triangles mark the best stiffness.
    """
    table = study.table
    stiffness, drops = table["stiffness"].to_numpy(), table["drop"].to_numpy()
    rows = (
        ("force on the trunk\n[its weight]", study.trunk_weights()),
        ("deflection [mm]", table["deflection"].to_numpy() / mm),
        ("force of the ground\n[weight of the leg]", study.body_weights()),
    )
    valves = [str(name) for name in table["valve"].to_numpy()]
    best = study.best()
    figure = blank(DOUBLE, 6.0)
    grid = figure.subplots(len(rows), drops.size, sharex=True, sharey="row", squeeze=False)
    for i, (label, values) in enumerate(rows):
        for j, drop in enumerate(drops):
            axes: Axes = grid[i, j]
            for v, (name, look) in enumerate(looks_of(valves).items()):
                low, high = np.percentile(values[v, j, :, 1:], EDGES, axis=-1)
                draw_band(axes, stiffness, low, high, color=look["color"], alpha=0.15)
                axes.plot(stiffness, values[v, j, :, 0], label=name, **look)
                at = best[v, j, 0]
                axes.plot(
                    stiffness[at], values[v, j, at, 0], "v", color=look["color"], markersize=6, markeredgecolor="white"
                )
            if i == 0:
                letter(axes, j, f"drop of {drop / mm:g} mm")
        grid[i, 0].set_ylabel(label)
    for axes in grid[-1]:
        axes.set_xlabel("stiffness of the " + study.joint + " [N·m/rad]")
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, grid[0, 0])
    return figure


@styled
def foot_ellipses(
    leg: Leg, angles: Sequence[float], *, force: float = 1.0, found: FootPressures | None = None
) -> Figure:
    """Posture of a leg, and displacements of its foot under a force [N] in all directions of a plane.

    The plane is that of walking, and for a leg in space also that across it. Grey: all attainable stiffness, at zero
    torque or at the torques that are held; coloured: the softest and the stiffest on average over the directions, or,
    of the pressures `found` for a stiffness of the foot, that and the desired one.
    """
    torques, held = ([0.0] * len(angles), None)
    if found is not None:
        torques, held = [float(one) for one in leg.torques(angles, found.pressures)], found.force
    attainable = attainable_foot_stiffness(leg, angles, torques, levels=9 if leg.is_planar else 4, force=held)
    if found is None:
        ordered = sorted(attainable, key=lambda one: np.trace(one.compliance))
        shown = {"softest": ordered[-1], "stiffest": ordered[0]}
    else:
        shown = {"attained": found.stiffness, "desired": stiffness_of(np.linalg.inv(found.wanted))}
    planes = _planes(leg)
    figure = blank(DOUBLE * (0.8 if leg.is_planar else 1.0), 3.0)
    posture_axes, *others = figure.subplots(1, 1 + len(planes), width_ratios=(1, *(1.6 for _ in planes)))
    posture = posture_of(leg, angles)
    links = frames(leg, posture, at_rest(posture))[1:]
    points = [*(link.position for link in links), links[-1].point(-leg.links[-1].length)[0]]
    x, z = (np.array([float(point[i]) for point in points]) / mm for i in (0, 2))
    posture_axes.plot(x, z, "o-", color=BLACK, linewidth=3)
    names: dict[tuple[float, float], list[str]] = {}  # of joints at the same place
    for joint, place in zip(
        leg.joints, zip(np.round(x, 3).tolist(), np.round(z, 3).tolist(), strict=True), strict=False
    ):
        names.setdefault(place, []).append(joint.name)
    for place, joints in names.items():
        posture_axes.annotate(", ".join(joints), place, xytext=(8, 0), textcoords="offset points", va="center")
    posture_axes.set(aspect="equal", xlabel="forwards [mm]", ylabel="up from the hip [mm]")
    posture_axes.margins(x=0.6, y=0.1)
    letter(posture_axes, 0, "posture")
    for number, (axes, (along, plane)) in enumerate(zip(others, planes.items(), strict=True), 1):
        _ellipses(axes, plane, attainable, shown, force)
        axes.set(xlabel=f"{along} [mm]", ylabel="up [mm]" if number == 1 else "")
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.35 * (high - low))  # space for the legend
        letter(axes, number, f"foot under {force:g} N" + (" in all directions" if leg.is_planar else ""))
    others[-1].legend(loc="upper right")
    return figure


def _planes(leg: Leg) -> dict[str, tuple[int, int]]:
    """Planes in which the stiffness of the foot is drawn, each with up, by the name of the other direction."""
    walking = {"forwards": (0, -1)}
    return walking if leg.is_planar else walking | {"to the left": (1, -1)}


def _ellipses(
    axes: Axes,
    plane: tuple[int, int],
    attainable: Sequence[FootStiffness],
    shown: Mapping[str, FootStiffness],
    force: float = 1.0,
) -> None:
    """Displacements of the foot in a plane: grey what is attainable, and two in colours, the second dashed."""
    for k, one in enumerate(attainable):
        outline = one.ellipse(force, plane=plane)[list(plane)] / mm
        axes.plot(*outline, color=BAND, linewidth=0.8, zorder=1, label=None if k else "attainable")
    for (name, one), colour, line in zip(shown.items(), (VERMILLION, BLUE), ("-", (0, (4, 2))), strict=True):
        axes.plot(*(one.ellipse(force, plane=plane)[list(plane)] / mm), color=colour, linestyle=line, label=name)


@styled
def jump_traces(study: JumpStudy) -> Figure:
    """Pressures, force of the ground and height of the centre of mass of each jump, and of the plan."""
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
    if study.plan is not None:
        times, planned = study.plan.times / ms, {"color": BLACK, "linewidth": 0.9, "linestyle": (0, (1, 1))}
        grid[1, -1].plot(times, study.plan.ground_force, **planned)
        grid[2, -1].plot(times, (study.plan.mass_height - study.standing) / mm, **planned)
    grid[0, 0].set_ylabel("pressure [bar]")
    grid[1, 0].set_ylabel("force of the\nground [N]")
    grid[2, 0].set_ylabel("centre of mass above\nthat of standing [mm]")
    figure.align_ylabels(list(grid[:, 0]))
    legend_above(figure, grid[0, 0])
    return figure


@styled
def plan_stiffness(study: JumpStudy) -> Figure:
    """Planned pressures, certified error of the stiffness of the foot, and displacements of the foot under 1 N.

    Displacements are in the plane of walking, and for a leg in space also across it; grey: attainable with the torques
    of the plan.
    """
    plan, leg = study.plan, study.scenario.leg
    assert plan is not None and plan.foot
    planes = _planes(leg)
    figure = blank(DOUBLE, 2.4 * (1 + len(planes)))
    grid = figure.add_gridspec(1 + len(planes), 4)
    left, right = figure.add_subplot(grid[0, :2]), figure.add_subplot(grid[0, 2:])
    for i, (name, look) in enumerate(looks_of(list(leg.muscle_names)).items()):
        left.plot(plan.times / ms, plan.pressures[i] / bar, label=name, **look)
    left.set(xlabel="time of the plan [ms]", ylabel="planned pressure [bar]")
    letter(left, 0, "pressures")
    errors, least = (np.array([getattr(one, name) for one in plan.foot]) for name in ("error", "least"))
    right.plot(plan.times / ms, errors * 100, color=BLUE, label="error")
    right.plot(plan.times / ms, least * 100, color=ORANGE, linestyle=(0, (4, 2)), label="lower bound")
    right.set(xlabel="time of the plan [ms]", ylabel="error of the stiffness [%]", ylim=(0, None))
    right.legend()
    letter(right, 1, "stiffness of the foot")
    for axes in (left, right):
        axes.axvspan(plan.take_off / ms, plan.touchdown / ms, color=BAND, alpha=0.4, linewidth=0)
    legend_above(figure, left)
    pushed = int(np.argmax(np.where(plan.times < plan.take_off, plan.ground_force, 0.0)))
    left_at = int(np.searchsorted(plan.times, plan.take_off))
    moments = {"squat": 0, "largest force": pushed, "take-off": left_at, "after landing": plan.times.size - 1}
    shared: list[Axes | None] = [None] * len(planes)
    for number, (title, k) in enumerate(moments.items()):
        angles, torques = plan.angles[:, k].tolist(), plan.torques[:, k].tolist()
        attainable = attainable_foot_stiffness(leg, angles, torques, levels=7 if leg.is_planar else 4)
        shown = {"attained": plan.foot[k].stiffness, "desired": stiffness_of(np.linalg.inv(plan.foot[k].wanted))}
        for row, (along, plane) in enumerate(planes.items()):
            axes = figure.add_subplot(grid[1 + row, number], sharex=shared[row], sharey=shared[row])
            shared[row] = shared[row] or axes
            _ellipses(axes, plane, attainable, shown)
            axes.set_xlabel(f"{along} [mm]")
            if row == 0:
                letter(axes, 2 + number, title)
            if number == 0:
                axes.set_ylabel("up, under 1 N [mm]")
            if number == row == 0:
                axes.legend(loc="upper right", fontsize="x-small")
    return figure


def write_landing(study: LandingStudy, folder: str | os.PathLike[str]) -> Path:
    """Write `landing.html`, self-contained, and its figures in `figures/`; return its path."""
    low, high = study.attainable
    text = (
        f"{study.table['peak_force'].size} landings: {study.joint} at its stiffness, commands constant. At touchdown "
        f"{low:.3g} to {high:.3g} N*m/rad are attainable. Best is the softest stiffness whose force on the trunk is "
        "within 2 % of the lowest; intervals are 5 to 95 % of the draws of muscles and masses."
    )
    caption = (
        "Largest force on the trunk, deflection of the hip and largest force of the ground over the commanded "
        "stiffness, by valve. Bands: 90 % of the draws. Triangles: best stiffness. Soft joints bottom out, and the "
        "closed valve compresses its air, so that the best stiffness moves with the valve and the drop."
    )
    figures = [ReportFigure("landing", "", "Landings", caption, "Forces over stiffness", landing_forces(study))]
    try:
        ellipses = foot_ellipses(study.scenario.leg, study.angles)
    except UnreachableError as error:
        text += f" The stiffness of the foot at touchdown is not drawn: {error.message}."
    else:
        what = (
            "Displacement of the foot at touchdown, with the trunk held, under 1 N in each direction; the scales "
            "of both axes differ. Grey: over the attainable stiffness of all joints."
        )
        name = "Ellipses of the foot's displacement"
        figures.append(ReportFigure("foot", "", "Stiffness of the foot", what, name, ellipses))
    tables = [Table("Landings at the best stiffness", *study.rows())]
    return _page(Path(folder), "landing.html", study.scenario, text, tables, figures)


def write_jump(study: JumpStudy, folder: str | os.PathLike[str]) -> Path:
    """Write `jump.html`, self-contained, and its figure in `figures/`; return its path."""
    gain, low, high = (one / mm for one in study.gain())
    text = (
        f"From the squat the centre of mass rises {study.constant.heights[0] / mm:.0f} mm above that of the "
        f"standing leg with the best constant pressures, {study.timed.heights[0] / mm:.0f} mm with the best timed "
        f"ones: {gain:.0f} mm more ({low:.0f} to {high:.0f} mm in 5 to 95 % of the draws of muscles and masses)."
    )
    if study.planned is not None and study.plan is not None:
        weight = float(study.scenario.leg.total_mass) * float(study.scenario.plant().gravity)
        text += (
            f" The planned jump lands with {study.planned.landing_force[0]:.1f} weights of the leg (planned: "
            f"{study.plan.landing_force / weight:.1f}), the timed one with {study.timed.landing_force[0]:.1f}."
        )
    caption = (
        "Pressures (thin: commands), force of the ground and height of the centre of mass above its greatest height "
        "with the foot on the ground. Dashed: apex; dotted: planned."
    )
    figures = [ReportFigure("jump", "", "Jumps", caption, "Time traces of the jumps", jump_traces(study))]
    if study.plan is not None and study.plan.foot:
        what = (
            "Planned pressures, error of the stiffness of the foot with its certified bound (grey: flight), and "
            "displacement of the foot under 1 N in each direction (grey: attainable with the planned torques)."
        )
        figures.append(ReportFigure("plan", "", "Plan", what, "Pressures and errors over time", plan_stiffness(study)))
    tables = [Table("Jumps; intervals are 5 to 95 % of the draws", *study.rows()), _energies(study), _published(study)]
    return _page(Path(folder), "jump.html", study.scenario, text, tables, figures)


def _energies(study: JumpStudy) -> Table:
    """Energies of the nominal jumps, landing included."""
    names = ("muscles", "stops", "resisting", "ground", "kinetic", "potential", "residual")
    head = (
        "pressures",
        "work of muscles",
        "of stops",
        "of damping and friction",
        "of the ground",
        "change of kinetic energy",
        "of potential energy",
        "residual",
    )
    rows = [(name, *(f"{getattr(jump.balance, one):.3f} J" for one in names)) for name, jump in study.jumps.items()]
    return Table("Energies from the start to the end of the nominal runs, landing included", head, rows)


def _published(study: JumpStudy) -> Table:
    """Published jumps next to ours, with the differences."""
    head = ("robot", "jump", "of its height", "actuators", "what differs")
    rows = []
    for name in catalog.names("robots"):
        found = catalog.find("robots", name)[0]
        rows.append((found["title"], found["jump"], found["of_height"], found["actuators"], found["differs"]))
    height, length = study.timed.heights[0] / mm, study.leg_length / mm
    leg = study.scenario.leg
    place = "in the plane" if leg.is_planar else "in space"
    ours = (
        f"{height:.0f} mm, centre of mass",
        f"{height / length * 100:.0f} % of the leg",
        f"{len(leg.muscles)} muscles",
    )
    rows.append(("this leg, timed pressures", *ours, f"simulated, {place}, trunk: {leg.trunk.freedom}"))
    return Table("Comparison with published jumps", head, rows)


def _page(
    folder: Path,
    name: str,
    scenario: Any,
    text: str,
    tables: Sequence[Table],
    figures: Sequence[ReportFigure],
) -> Path:
    page = template_of("leg.html.jinja").render(
        style=style_sheet(),
        title=scenario.name,
        text=text,
        tables=tables,
        figures=[embedded(figure, folder) for figure in figures],
        scenario=scenario.dumps(folder=folder),
    )
    return write_page(folder / name, page)
