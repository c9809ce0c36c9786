"""All figures of a reproduction, each with a caption that says what to see and a text for those who cannot."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from matplotlib.figure import Figure

from mckibben.control import BackpropPID
from mckibben.muscle import ChouLaw
from mckibben.paper import Reproduction
from mckibben.paper.identification import CHOU, EXPERIMENTAL, RIG
from mckibben.paper.settings import FREE, SETTINGS, Setting, Wish
from mckibben.paper.tracking import BP, PID, TUNED_BP, Run
from mckibben.report.joint import attainable_stiffness, torque_stiffness_map
from mckibben.report.muscle import isobaric_curves, law_comparison, measured_muscles
from mckibben.report.tables import SECTIONS, name_of
from mckibben.report.tracking import control_results, controller_comparison, error_curves, gain_histories
from mckibben.study.scenario.building import build_loop
from mckibben.units import deg


@dataclass(frozen=True, eq=False)
class ReportFigure:
    """A figure as the report shows it.

    Attributes
    ----------
    name
        Of its files.
    section
        Where it belongs: one of the keys of `mckibben.report.tables.SECTIONS`; empty on a page without these.
    title, caption
        What it is, and what to see in it.
    alternative
        The same for a reader who cannot see it.
    figure
        The drawing.
    """

    name: str
    section: str
    title: str
    caption: str
    alternative: str
    figure: Figure

    def __post_init__(self) -> None:
        assert not self.section or self.section in SECTIONS


def figures(reproduction: Reproduction) -> Iterator[ReportFigure]:
    """Draw them one after the other, in the order of the report."""
    yield from _of_the_muscle(reproduction)
    yield from _of_the_joint(reproduction)
    for setting in SETTINGS:
        yield from _of_the_control(reproduction, setting)
    yield from _of_the_methods(reproduction)


def _of_the_muscle(reproduction: Reproduction) -> Iterator[ReportFigure]:
    found = reproduction.identification
    rig = found.rig
    levels = len(rig.test.pressures)
    yield ReportFigure(
        "fig3-isobaric-curves",
        "identification",
        "Fig. 3: isobaric characteristic curves",
        f"The paper's test on the virtual rig: {levels} pressures, {rig.protocol.repeats} repeats, "
        f"{rig.samples:,} raw samples behind {len(rig.test)} plateau means. Each pressure has two curves: the upper "
        f"(solid) while the muscle is stretched, the lower (dashed) while it shortens; the gap is the rig's friction "
        f"of ±{rig.rig.hysteresis:g} N. The curves of high pressure start late because the rig stays below the rated "
        f"force of {rig.muscle.specimen.rated_force:g} N.",
        f"{levels} curves of force over contraction, falling steeply, then more gently, higher for higher pressure; "
        "loading lies slightly above unloading.",
        isobaric_curves(rig.test),
    )
    laws = {EXPERIMENTAL: found.fits[RIG].law, CHOU: ChouLaw.of(rig.muscle.specimen)}
    yield ReportFigure(
        "fig4-law-comparison",
        "identification",
        "Fig. 4: measured force, experimental law and Chou's law",
        "A second test, which no law has seen, at the paper's four pressures, in the paper's colours: loading data "
        "blue, unloading data orange, the law identified from the first test purple, Chou's law of the specimen green. "
        "The experimental law runs between the two directions; Chou's knows neither the rubber nor the ends of the "
        "muscle. The errors of both are in the panels. The muscle of the virtual rig follows Eq. 3, so this shows the "
        "method at work; the next figure has muscles that were measured.",
        "Panels of force over contraction, one a pressure, with points of both directions and the curves of both laws.",
        law_comparison(rig.retest, laws, found.retested),
    )
    measured = {name_of(name): (found.data[name], found.fits[name]) for name in found.measured}
    yield ReportFigure(
        "measured-muscles",
        "identification",
        "Eq. 2 on measured muscles",
        "Independent data of two other 10 mm muscles: points are those of the tables, curves are Eq. 2 fitted to all "
        "taut points together; what is left over is below, on its own scale. Slack points say only that the force is "
        "zero, and are left out.",
        "Force over contraction at many pressures for two muscles with fitted curves through the points; residuals "
        "below.",
        measured_muscles(measured),
    )


def _of_the_joint(reproduction: Reproduction) -> Iterator[ReportFigure]:
    maps = {setting.name: reproduction.joint[setting.key] for setting in SETTINGS}
    wishes = {
        setting.name: {wish.value: reproduction.tracking.runs[setting.key, wish, PID].result for wish in Wish}
        for setting in SETTINGS
    }
    yield ReportFigure(
        "attainable-stiffness",
        "joint",
        "Stiffness that the knee can hold",
        "The shaded band is all the stiffness that pressures within limits can give at an angle while the muscles "
        "carry the load and stay within their range of contraction; outside the dash-dotted lines it cannot be "
        "held. The wishes of the simulations are drawn over it: where one leaves the band, no controller can follow "
        "it for long.",
        "A band of attainable stiffness over the joint angle for each geometry; "
        + "; ".join(f"{n}: {m.at(0.0)[0]:.1f} to {m.at(0.0)[1]:.1f} N·m/rad at 0 degrees" for n, m in maps.items()),
        attainable_stiffness(maps, wishes),
    )
    yield ReportFigure(
        "torque-stiffness-map",
        "joint",
        "Torque, stiffness and angle of the knee",
        "Lowest and highest stiffness at each angle and muscle torque, and the room that co-contraction has between "
        "them. Grey: out of reach. The dashed line is the torque that holds the load against gravity; the band of the "
        "previous figure is the map along this line. Each row has its own colours.",
        "Colour maps over angle and torque, one row a geometry; the attainable region is a tilted patch.",
        torque_stiffness_map(maps),
    )


def _of_the_control(reproduction: Reproduction, setting: Setting) -> Iterator[ReportFigure]:
    runs, key = reproduction.tracking.runs, setting.key.replace("_", "-")
    panels = {
        f"{name}, {wish.value} stiffness": (name, runs[setting.key, wish, name].result)
        for name in (PID, BP)
        for wish in Wish
    }
    step = f"{setting.before} to {setting.after}".replace(" N*m/rad to", " to").replace("N*m/rad", "N·m/rad")
    constant = setting.constant.replace("N*m/rad", "N·m/rad")
    yield ReportFigure(
        f"fig7-control-results-{key}",
        "tracking",
        f"Fig. 7: control results, geometry {setting.name}",
        f"Desired (black, dashed) and actual angle and stiffness under PID and under BP (its first seed) on the same "
        f"moderate gains; a sine of {setting.amplitude}, stiffness {constant} or stepping from {step}. The grey band "
        "is the stiffness that is attainable at the desired angle: where the wish lies outside it, the error is not "
        "the controller's.",
        "Four panels, each with the angle above and the stiffness below, desired and actual over ten seconds.",
        control_results(panels),
    )
    columns = {
        f"{wish.value} stiffness": {name: runs[setting.key, wish, name].result for name in (PID, BP)} for wish in Wish
    }
    rmse = {name: runs[setting.key, Wish.CONSTANT, name].result.metrics["angle_rmse"] / deg for name in (PID, BP)}
    yield ReportFigure(
        f"fig8-errors-{key}",
        "tracking",
        f"Fig. 8: errors, geometry {setting.name}",
        f"Actual minus desired. In (a) the angle error is {rmse[PID]:.2f}° RMS under PID and {rmse[BP]:.2f}° under BP. "
        "The last row zooms in on the stiffness after its wish was set or changed; grey is the settling band, and "
        "dotted lines mark when each controller has entered it for good. A peak that is only the jump of the wish is "
        "cut off, and said so.",
        "Error curves of PID and BP over time: angle above, stiffness in the middle, the settling of the stiffness "
        "below.",
        error_curves(columns),
    )


def _of_the_methods(reproduction: Reproduction) -> Iterator[ReportFigure]:
    runs, seeds = reproduction.tracking.runs, reproduction.tracking.seeds
    found: dict[str, dict[str, dict[str, Run]]] = {}
    for setting in SETTINGS:
        for wish in Wish:
            found.setdefault(setting.name, {})[wish.value] = {
                name: run for (key, w, name), run in runs.items() if key == setting.key and w is wish
            }
    yield ReportFigure(
        "controller-comparison",
        "tracking",
        "PID and BP, on moderate and on tuned gains",
        f"Median over {seeds} seeds of BP's network (dot) and the worst of them (end of the line), on logarithmic "
        "axes; left is better. PID has no seeds. What BP changes on moderate gains is to be seen beside what tuning "
        "changes.",
        "Dot plots of angle error, stiffness error and settling time for five controllers in two geometries.",
        controller_comparison(found),
    )
    histories = {}
    for setting in SETTINGS:
        for name in (BP, TUNED_BP):
            run = runs[setting.key, Wish.STEP, name]
            histories[f"{setting.name},\n{name}"] = (run.result, gain_ratio(run))
    yield ReportFigure(
        "bp-gains",
        "tracking",
        "How BP moves its gains",
        f"Gains relative to the base gains over a run with a stiffness step, first seed. Dashed: the bounds. About "
        f"moderate gains BP may move by a factor of {FREE:g}, about tuned ones by less. Where a gain climbs to "
        "its bound and stays, learning has become a choice of other constant gains.",
        "Gains of both loops over time as multiples of their base, within dashed bounds.",
        gain_histories(histories),
    )


def gain_ratio(run: Run) -> float:
    """By what factor the position loop of a run under BP may move its gains."""
    spec = run.scenario.controller.position
    assert spec is not None  # the paper has two loops
    loop = build_loop(spec)
    return float(loop.gain_ratio) if isinstance(loop, BackpropPID) else 1.0
