"""Drawings and the animation of the documentation, to docs/images, with figures of the gallery that `make docs` drew.

python docs/pictures.py
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from diagrams import TEST_RIG, WORKFLOWS, draw_control_loop, draw_workflow
from matplotlib.figure import Figure
from PIL import Image

import mckibben as mk
from mckibben.report.palette import BLUE, GREY, ORANGE, VERMILLION
from mckibben.report.style import DOUBLE, blank, legend_above, letter, plain_numbers, save, styled
from mckibben.scenario import batched, run_scenario, with_values
from mckibben.scenario.statics import solve_statics
from mckibben.study.felt import felt_stiffness
from mckibben.study.stiffness import FeltStiffness
from mckibben.units import bar, deg, mm

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
REST = 162 * mm

BONES = mk.PairedPaths(
    mk.TwoBonePath(-30 * mm, REST, -35 * mm, -10 * mm), mk.TwoBonePath(30 * mm, REST, 35 * mm, -10 * mm)
)

OF_GALLERY = {
    "uncertainty": "03_uncertainty",
    "friction": "04_friction",
    "sweep": "11_sweep",
    "batch": "12_batch",
    "plan": "16_plan",
}


def main() -> None:
    """Write all pictures."""
    scenario = mk.Scenario.read(ROOT / "examples" / "pre-contracted-step-pid.yaml")
    plant = scenario.plant()
    bones = mk.AntagonisticJoint(BONES, plant.joint.muscle1, plant.joint.muscle2)
    drawings = {
        "drawing-knee": mk.report.draw_joint(plant, 25 * deg, (2 * bar, 4 * bar)),
        "drawing-two-bone-path": mk.report.draw_joint(bones, 15 * deg, labels=False),
        "control-loop": draw_control_loop(),
    }
    for name, figure in drawings.items():
        png, _ = save(figure, IMAGES, name)
        png.unlink()  # the pages show the SVG
    of_report = {"fig2-test-rig": draw_workflow(*TEST_RIG), "fig5-control-loop": draw_control_loop()}
    for name, figure in of_report.items():
        png, _ = save(figure, ROOT / "src" / "mckibben" / "report", name)
        png.unlink()
    mk.report.animate(run_scenario(scenario), IMAGES / "knee.webp", overwrite=True)
    for name, workflow in WORKFLOWS.items():
        png, _ = save(draw_workflow(*workflow), IMAGES, name)
        png.unlink()
    _results(scenario)
    _size()
    _stiffness()
    _robot()
    _gallery()


def _results(scenario: mk.Scenario) -> None:
    """First pictures of the pages on data, laws, scenarios, tuning and valves, in 64 colors."""
    found = mk.identify(ROOT / "examples" / "rig.csv")
    measured = mk.catalog.dataset("dmsp-10-250-martens2017")
    some = measured.select(np.isin(measured.levels, np.array([3.35, 6.5]) * bar))
    laws = {
        "Eq. 2": mk.identify(measured).law,
        "Chou (Eq. 1)": mk.ChouLaw.of(mk.catalog.specimen("DMSP-10-250")),
    }
    valves = {
        name: mk.Scenario.read(ROOT / "examples" / "valves" / f"{name.lower()}-decoupling.yaml").simulate()
        for name in ("ITV0050", "VPPE-6")
    }
    figures = {
        "data": found.plot(),
        "laws": mk.report.law_comparison(some, laws),
        "scenario": mk.report.control_results({"two PID loops": ("PID", scenario.simulate())}),
        "tuning": mk.tune(scenario, iterations=15).plot(),
        "valves": mk.report.control_results({name: ("decoupling", run) for name, run in valves.items()}),
    }
    for name, figure in figures.items():
        png, _ = save(figure, IMAGES, name, preview=True)
        with Image.open(png) as drawn:
            small = drawn.convert("RGB").quantize(64)
        small.save(png, optimize=True)


def _gallery() -> None:
    """Figures of the gallery that are the first of a page, in 256 colors."""
    for name, example in OF_GALLERY.items():
        with Image.open(ROOT / "docs" / "gallery" / "images" / f"sphx_glr_plot_{example}_001.png") as drawn:
            drawn.convert("RGB").quantize(256).save(IMAGES / f"{name}.png", optimize=True)


def _size() -> None:
    """Pictures of the page on sizing."""
    found = mk.size(mk.Requirement.read(ROOT / "examples" / "sizing" / "pulleys.yaml"))
    _, svg = save(found.plot(), IMAGES, "size")
    svg.unlink()  # larger than the PNG


def _stiffness() -> None:
    """Picture of what a push feels."""
    scenario = mk.Scenario.read(ROOT / "examples" / "stiffness" / "push.yaml")
    _, svg = save(mk.report.felt_stiffness(FeltStiffness(scenario, felt_stiffness(scenario))), IMAGES, "felt-stiffness")
    svg.unlink()  # larger than the PNG
    _, svg = save(_bandwidth(), IMAGES, "bandwidth")
    svg.unlink()


@styled
def _bandwidth() -> Figure:
    """Error, margin and travel over the bandwidth of the observer, with friction unlike the model's."""
    load = mk.PendulumLoad(1.0, 0.25, damping=0.05)
    muscle = dataclasses.replace(mk.catalog.joint("knee-table-2").muscle1, friction=mk.MaxwellSlip("7.5 N", "0.5 mm"))
    lab = mk.joint(muscle, "pulley", radius=30 * mm).scenario(load).with_fixed_model()
    bandwidths = np.geomspace(10, 400, 14)
    figure = blank(DOUBLE, 2.3)
    panels = figure.subplots(1, 3)
    for half_width, colour in ((1.0, BLUE), (7.5, ORANGE), (15.0, VERMILLION)):
        friction = {f"joint.muscle{number}.friction.half_width": half_width for number in (1, 2)}
        runs = batched(with_values(lab, friction), {"controller.observer.bandwidth": bandwidths})
        found = runs.run_many().metrics
        rows = found["angle_rmse"] / deg, runs.disk_margins(4).clip(0), found["command_travel"] / bar
        for axes, values in zip(panels, rows, strict=True):
            axes.plot(bandwidths, values, color=colour, label=f"half width {half_width:g} N")
    for i, title in enumerate(("angle, RMS error [deg]", "disk margin", "travel of commands [bar/s]")):
        letter(panels[i], i, title)
        panels[i].set(xscale="log", xlabel="observer bandwidth [rad/s]", yscale="linear" if i == 1 else "log")
        plain_numbers(panels[i].xaxis)
    for i in (0, 2):
        plain_numbers(panels[i].yaxis)
    panels[1].axhline(0.2, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)))
    legend_above(figure, panels[0])
    return figure


def _robot() -> None:
    """Pictures of the page on the robot."""
    robot = mk.robot.RobotScenario.read(ROOT / "examples" / "robot" / "lei-leg.yaml")
    jumps = mk.robot.study_jump(robot)
    stiffness = robot.stiffness
    assert stiffness is not None
    posture = robot.robot.posture_angles(stiffness.posture)
    figures = {
        "leg-foot-stiffness": mk.report.point_ellipses(robot.robot, posture, found=solve_statics(robot)[1]),
        "leg-landing": mk.report.landing_forces(mk.robot.study_landing(robot)),
        "leg-jump": mk.report.jump_traces(jumps),
    }
    for name, figure in figures.items():
        _, svg = save(figure, IMAGES, name)
        svg.unlink()  # larger than the PNG


if __name__ == "__main__":
    main()
