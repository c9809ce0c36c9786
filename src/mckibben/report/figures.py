"""Figures of a reproduction, with captions and alternative texts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from matplotlib.figure import Figure

from mckibben.control import BackpropPID
from mckibben.muscle import ChouLaw
from mckibben.paper import Reproduction
from mckibben.paper.identification import CHOU, EXPERIMENTAL, RIG
from mckibben.paper.settings import FREE, SETTINGS, Setting, StiffnessReference
from mckibben.paper.tracking import BP, PID, TUNED_BP, ControllerRun
from mckibben.report.joint import attainable_stiffness, torque_stiffness_map
from mckibben.report.muscle import isobaric_curves, law_comparison, measured_muscles
from mckibben.report.tables import SECTIONS, name_of
from mckibben.report.tracking import control_results, controller_comparison, error_curves, gain_histories
from mckibben.units import deg


@dataclass(frozen=True, eq=False)
class ReportFigure:
    """Figure of a page: file name, section (a key of `SECTIONS`, or empty), title, caption, alternative text."""

    name: str
    section: str
    title: str
    caption: str
    alternative: str
    figure: Figure

    def __post_init__(self) -> None:
        assert not self.section or self.section in SECTIONS


def figures(reproduction: Reproduction) -> Iterator[ReportFigure]:
    """Draw the figures in the order of the report."""
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
        f"The paper's test on the simulated rig: {levels} pressures, {rig.protocol.repeats} repeats, "
        f"{rig.samples:,} raw samples behind {len(rig.test)} plateau means. Solid: loading (being "
        f"stretched); dashed: unloading (shortening); the gap is friction of ±{rig.rig.hysteresis:g} N. Curves of high "
        f"pressure start late, since the rig stays below the rated force of {rig.muscle.specimen.rated_force:g} N.",
        f"{levels} curves of force over contraction, falling steeply, then more gently, higher for higher pressure; "
        "loading lies slightly above unloading.",
        isobaric_curves(rig.test),
    )
    laws = {EXPERIMENTAL: found.fits[RIG].law, CHOU: ChouLaw.of(rig.muscle.specimen)}
    yield ReportFigure(
        "fig4-law-comparison",
        "identification",
        "Fig. 4: measured force, experimental law and Chou's law",
        "Validation on a second test at the paper's four pressures: loading (blue) and unloading (orange) data, the "
        "law identified from the first test (purple) and Chou's law of the specimen (green). The former lies "
        "between the two directions; Chou's models neither the rubber nor the ends of the muscle. The simulated muscle "
        "follows Eq. 3, so this validates the method; the next figure has measured muscles.",
        "Panels of force over contraction, one a pressure, with points of both directions and the curves of both laws.",
        law_comparison(rig.retest, laws, found.retested),
    )
    measured = {name_of(name): (found.data[name], found.fits[name]) for name in found.measured}
    yield ReportFigure(
        "measured-muscles",
        "identification",
        "Eq. 2 on measured muscles",
        "Measured data of two other 10 mm muscles, Eq. 2 fitted to all taut points (curves), and residuals (below). "
        "Slack points are excluded.",
        "Force over contraction at many pressures for two muscles with fitted curves through the points; residuals "
        "below.",
        measured_muscles(measured),
    )


def _of_the_joint(reproduction: Reproduction) -> Iterator[ReportFigure]:
    maps = {setting.name: reproduction.joint[setting.key] for setting in SETTINGS}
    references = {
        setting.name: {
            reference.value: reproduction.tracking.runs[setting.key, reference, PID].result
            for reference in StiffnessReference
        }
        for setting in SETTINGS
    }
    yield ReportFigure(
        "attainable-stiffness",
        "joint",
        "Attainable stiffness of the knee",
        "Shaded: stiffness in static equilibrium with the load, for pressures and contractions within their limits. "
        "Outside the dash-dotted lines there is no equilibrium. Lines: references of the simulations; where one "
        "leaves the shaded area, no controller can follow it for long.",
        "A band of attainable stiffness over the joint angle for each geometry; "
        + "; ".join(f"{n}: {m.at(0.0)[0]:.1f} to {m.at(0.0)[1]:.1f} N·m/rad at 0 degrees" for n, m in maps.items()),
        attainable_stiffness(maps, references),
    )
    yield ReportFigure(
        "torque-stiffness-map",
        "joint",
        "Torque, stiffness and angle of the knee",
        "Minimum and maximum stiffness over angle and muscle torque, and their difference, the range of "
        "co-contraction. Grey: not attainable. Dashed: static torque of the load, along which the previous figure is "
        "drawn. Each row has its own colour scale.",
        "Colour maps over angle and torque, one row a geometry; the attainable region is a tilted patch.",
        torque_stiffness_map(maps),
    )


def _of_the_control(reproduction: Reproduction, setting: Setting) -> Iterator[ReportFigure]:
    runs, key = reproduction.tracking.runs, setting.key.replace("_", "-")
    panels = {
        f"{name}, {reference.value} stiffness": (name, runs[setting.key, reference, name].result)
        for name in (PID, BP)
        for reference in StiffnessReference
    }
    step = f"{setting.before} to {setting.after}".replace(" N*m/rad to", " to").replace("N*m/rad", "N·m/rad")
    constant = setting.constant.replace("N*m/rad", "N·m/rad")
    yield ReportFigure(
        f"fig7-control-results-{key}",
        "tracking",
        f"Fig. 7: control results, geometry {setting.name}",
        f"Desired (black, dashed) and actual angle and stiffness under PID and under BP (its first seed) on the same "
        f"moderate gains; a sine of {setting.amplitude}, stiffness {constant} or stepping from {step}. The grey band "
        "is the attainable stiffness at the desired angle: where the reference is outside, the error is not due to "
        "the controller.",
        "Four panels, each with the angle above and the stiffness below, desired and actual over ten seconds.",
        control_results(panels),
    )
    columns = {
        f"{reference.value} stiffness": {name: runs[setting.key, reference, name].result for name in (PID, BP)}
        for reference in StiffnessReference
    }
    rmse = {
        name: runs[setting.key, StiffnessReference.CONSTANT, name].result.metrics["angle_rmse"] / deg
        for name in (PID, BP)
    }
    yield ReportFigure(
        f"fig8-errors-{key}",
        "tracking",
        f"Fig. 8: errors, geometry {setting.name}",
        f"Actual minus desired. In (a) the angle error is {rmse[PID]:.2f}° RMS under PID and {rmse[BP]:.2f}° under BP "
        "(first seed; tables have the median over seeds). "
        "The last row shows the stiffness after the start or step of its reference, with the settling band (grey) and "
        "settling times (dotted). Peaks at the step itself are cut off and annotated.",
        "Error curves of PID and BP over time: angle above, stiffness in the middle, the settling of the stiffness "
        "below.",
        error_curves(columns),
    )


def _of_the_methods(reproduction: Reproduction) -> Iterator[ReportFigure]:
    runs, seeds = reproduction.tracking.runs, reproduction.tracking.seeds
    found: dict[str, dict[str, dict[str, ControllerRun]]] = {}
    for setting in SETTINGS:
        for reference in StiffnessReference:
            found.setdefault(setting.name, {})[reference.value] = {
                name: run for (key, w, name), run in runs.items() if key == setting.key and w is reference
            }
    yield ReportFigure(
        "controller-comparison",
        "tracking",
        "PID and BP with moderate and tuned gains",
        f"Median (dot) and worst (end of the line) over {seeds} seeds of the network, logarithmic axes; left is "
        "better. PID has no seeds.",
        "Dot plots of angle error, stiffness error and settling time for five controllers in two geometries.",
        controller_comparison(found),
    )
    histories = {}
    for setting in SETTINGS:
        for name in (BP, TUNED_BP):
            run = runs[setting.key, StiffnessReference.STEP, name]
            histories[f"{setting.name},\n{name}"] = (run.result, gain_ratio(run))
    yield ReportFigure(
        "bp-gains",
        "tracking",
        "Gains of BP over time",
        f"Gains relative to the base gains over a run with a stiffness step, first seed. Dashed: the bounds. Moderate "
        f"gains may change by a factor of {FREE:g}, tuned ones by less. A gain that stays at its bound is "
        "in effect another constant gain.",
        "Gains of both loops over time as multiples of their base, within dashed bounds.",
        gain_histories(histories),
    )


def gain_ratio(run: ControllerRun) -> float:
    """Largest gain ratio of the position loop of a BP run."""
    spec = run.scenario.controller.position
    assert spec is not None  # the paper has two loops
    loop = spec.build()
    return float(loop.gain_ratio) if isinstance(loop, BackpropPID) else 1.0
