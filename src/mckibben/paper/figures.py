"""Figures of a reproduction of the paper, with captions and alternative texts.

The texts are in figures.toml; numbers in them are filled in from the results.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from mckibben.control import BackpropPID
from mckibben.muscle import ChouLaw
from mckibben.paper.controllers import controller_comparison
from mckibben.paper.identification import CHOU, EXPERIMENTAL, RIG, plant_of
from mckibben.paper.settings import FREE, SETTINGS, Setting, StiffnessReference
from mckibben.paper.tables import SECTIONS, name_of
from mckibben.paper.tracking import BP, PID, TUNED_BP, ControllerRun
from mckibben.report.drawing import draw_joint
from mckibben.report.joint import attainable_stiffness, torque_stiffness_map
from mckibben.report.muscle import isobaric_curves, law_comparison, measured_muscles
from mckibben.report.robot import posture, robot_tracking
from mckibben.report.tracking import control_results, error_curves, gain_histories
from mckibben.scenario.robot import read_robot
from mckibben.units import bar, deg

if TYPE_CHECKING:
    from mckibben.paper import Reproduction


@dataclass(frozen=True, eq=False)
class ReportFigure:
    """Figure of a page.

    Parameters
    ----------
    name
        Name of its files.
    section
        Part of the page, a key of `SECTIONS`.
    title, caption, alternative
        Heading; what is seen, with numbers; what is drawn, for those who do not see it.
    figure
        The drawing; None for a schematic, which is an SVG of this package.
    """

    name: str
    section: str
    title: str
    caption: str
    alternative: str
    figure: Figure | None

    def __post_init__(self) -> None:
        assert self.section in SECTIONS


def figures(reproduction: Reproduction) -> Iterator[ReportFigure]:
    """Figures 1 to 8 of the paper, and our own of the attainable set, the measured muscles and all controllers.

    Parameters
    ----------
    reproduction
        Results of `mckibben.paper.reproduce`.

    Yields
    ------
    ReportFigure
        In the order of the report.
    """
    yield described("fig2-test-rig", None)
    yield from _of_the_muscle(reproduction)
    leg = read_robot("lei-leg")
    yield described("fig1-leg", posture(leg, [5 * deg, 0.0, -30 * deg], [2 * bar, 4 * bar] * len(leg.joints)))
    yield described("fig6-knee", draw_joint(plant_of(SETTINGS[0]), 25 * deg, (2 * bar, 4 * bar)))
    yield from _of_the_joint(reproduction)
    yield described("fig5-control-loop", None)
    for setting in SETTINGS:
        yield from _of_the_control(reproduction, setting)
    yield from _of_the_methods(reproduction)
    yield described("leg-control", robot_tracking(reproduction.leg), errors=reproduction.leg.verdict())


def described(key: str, figure: Figure | None, suffix: str = "", **values: object) -> ReportFigure:
    """A figure with its texts from figures.toml.

    Parameters
    ----------
    key
        Key of the texts, and name of the figure.
    figure
        The drawing.
    suffix
        End of the name, for figures with the same texts.
    values
        Objects whose attributes and items fill the braces of the texts.
    """
    texts = tomllib.loads((resources.files("mckibben.paper") / "figures.toml").read_text(encoding="utf-8"))[key]
    written = {name: text.format(**values).replace("N*m/rad", "N·m/rad") for name, text in texts.items()}
    return ReportFigure(key + suffix, figure=figure, **written)


def _of_the_muscle(reproduction: Reproduction) -> Iterator[ReportFigure]:
    """Figs. 3 and 4, and Eq. 2 on measured muscles."""
    identification = reproduction.identification
    rig = identification.rig
    levels, points = len(rig.test.pressures), len(rig.test)
    yield described("fig3-isobaric-curves", isobaric_curves(rig.test), rig=rig, levels=levels, points=points)
    laws = {EXPERIMENTAL: identification.fits[RIG].law, CHOU: ChouLaw.of(rig.muscle.specimen)}
    yield described("fig4-law-comparison", law_comparison(rig.retest, laws, identification.retested))
    measured = {
        name_of(name): (identification.data[name], identification.fits[name]) for name in identification.measured
    }
    yield described("measured-muscles", measured_muscles(measured))


def _of_the_joint(reproduction: Reproduction) -> Iterator[ReportFigure]:
    """Attainable stiffness of both geometries, over angle, and over angle and torque."""
    knees = {setting.name: reproduction.joint[setting.key] for setting in SETTINGS}
    references = {
        setting.name: {
            reference.value: reproduction.tracking.runs[setting.key, reference, PID].result
            for reference in StiffnessReference
        }
        for setting in SETTINGS
    }
    at_rest = {name: static.at(0.0) for name, static in knees.items()}
    ranges = "; ".join(f"{name}: {low:.1f} to {high:.1f} N·m/rad at 0 degrees" for name, (low, high) in at_rest.items())
    yield described("attainable-stiffness", attainable_stiffness(knees, references), ranges=ranges)
    yield described("torque-stiffness-map", torque_stiffness_map(knees))


def _of_the_control(reproduction: Reproduction, setting: Setting) -> Iterator[ReportFigure]:
    """Figs. 7 and 8 in a geometry."""
    runs, suffix = reproduction.tracking.runs, f"-{setting.key.replace('_', '-')}"
    numbers = ("7", "8") if setting is SETTINGS[0] else ("A4", "A5")
    columns = {
        f"{reference.value} stiffness": {name: runs[setting.key, reference, name].result for name in (PID, BP)}
        for reference in StiffnessReference
    }
    panels = {f"{name}, {title}": (name, results[name]) for name in (PID, BP) for title, results in columns.items()}
    step = f"{setting.before} to {setting.after}".replace(" N*m/rad to", " to")
    yield described(
        "fig7-control-results", control_results(panels), suffix, number=numbers[0], setting=setting, step=step
    )
    constant = columns[f"{StiffnessReference.CONSTANT.value} stiffness"]
    rmse = {name: result.metrics["angle_rmse"] / deg for name, result in constant.items()}
    yield described("fig8-errors", error_curves(columns), suffix, number=numbers[1], setting=setting, rmse=rmse)


def _of_the_methods(reproduction: Reproduction) -> Iterator[ReportFigure]:
    """All controllers over seeds, and the gains of BP."""
    runs, seeds = reproduction.tracking.runs, reproduction.tracking.seeds
    compared: dict[str, dict[str, dict[str, ControllerRun]]] = {}
    for setting in SETTINGS:
        for reference in StiffnessReference:
            compared.setdefault(setting.name, {})[reference.value] = {
                name: run for (key, w, name), run in runs.items() if key == setting.key and w is reference
            }
    yield described("controller-comparison", controller_comparison(compared), seeds=seeds)
    histories = {}
    for setting in SETTINGS:
        for name in (BP, TUNED_BP):
            run = runs[setting.key, StiffnessReference.STEP, name]
            histories[f"{setting.name},\n{name}"] = (run.result, gain_ratio(run))
    yield described("bp-gains", gain_histories(histories), free=FREE)


def gain_ratio(run: ControllerRun) -> float:
    """Largest gain ratio of the position loop of a BP run."""
    loop = getattr(run.scenario.controller, "position", None)
    return float(loop.gain_ratio) if isinstance(loop, BackpropPID) else 1.0
