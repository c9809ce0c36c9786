"""Drawings and the animation of the documentation, to docs/images.

python docs/pictures.py
"""

from __future__ import annotations

from pathlib import Path

import mckibben as mk
from mckibben.leg.foot_pressures import solve_foot_stiffness
from mckibben.report.style import save
from mckibben.scenario import run_scenario
from mckibben.units import bar, deg, mm

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
REST = 162 * mm

GEOMETRIES = {
    "pulley": mk.PairedPaths(mk.Pulley(30 * mm, REST), mk.Pulley(30 * mm, REST)),
    "cam": mk.PairedPaths(mk.Cam(30 * mm, REST, arm_slope=8 * mm), mk.Cam(30 * mm, REST, arm_slope=-8 * mm)),
    "two-bone-path": mk.PairedPaths(
        mk.TwoBonePath(-30 * mm, REST, -35 * mm, -10 * mm), mk.TwoBonePath(30 * mm, REST, 35 * mm, -10 * mm)
    ),
    "tabulated-path": mk.PairedPaths(
        *(
            mk.TabulatedPath(
                [angle * deg for angle in (-40, -20, 0, 20, 40)],
                arms=[arm * mm for arm in (26, 29, 30, 29, 26.5)],
                rest_length=REST,
            )
            for _ in range(2)
        )
    ),
}


def main() -> None:
    """Write all pictures."""
    scenario = mk.Scenario.read(ROOT / "examples" / "pre-contracted-step-pid.yaml")
    plant = scenario.plant()
    drawings = {"drawing-knee": mk.report.draw_joint(plant, 25 * deg, (2 * bar, 4 * bar))}
    for name, geometry in GEOMETRIES.items():
        joint = mk.AntagonisticJoint(geometry, plant.joint.muscle1, plant.joint.muscle2)
        drawings[f"drawing-{name}"] = mk.report.draw_joint(joint, 15 * deg, labels=False)
    drawings["control-loop"] = mk.report.draw_control_loop()
    for name, figure in drawings.items():
        png, _ = save(figure, IMAGES, name)
        png.unlink()  # the pages show the SVG
    mk.report.animate(run_scenario(scenario).result, IMAGES / "knee.webp", overwrite=True)
    _leg()


def _leg() -> None:
    """Pictures of the page on the leg."""
    leg = mk.leg.LegScenario.read(ROOT / "examples" / "leg" / "lei-leg.yaml")
    jumps = mk.leg.study_jump(leg)
    stiffness = leg.stiffness
    assert stiffness is not None
    posture = leg.leg.posture_angles(stiffness.posture)
    figures = {
        "leg-foot-stiffness": mk.report.foot_ellipses(leg.leg, posture, found=solve_foot_stiffness(leg)),
        "leg-landing": mk.report.landing_forces(mk.leg.study_landing(leg)),
        "leg-jump": mk.report.jump_traces(jumps),
    }
    for name, figure in figures.items():
        _, svg = save(figure, IMAGES, name)
        svg.unlink()  # larger than the PNG
    for name, jump in (("constant", jumps.constant), ("timed", jumps.timed)):
        path = IMAGES / f"leg-jump-{name}.webp"
        mk.report.render_leg(leg.plant(), jump.run, path, frames=48, overwrite=True)


if __name__ == "__main__":
    main()
