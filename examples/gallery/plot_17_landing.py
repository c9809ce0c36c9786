"""
Landing of a leg
================

A leg of two joints drops on its foot. How stiff should its knee be, and how does that depend on the valves?
"""

import mckibben as mk
from mckibben.robot import RobotScenario, attainable_point_stiffness, study_landing

robot = RobotScenario.parse(
    """
    name: drop landing
    robot: lei-leg-planar
    valve: {class: PressureRegulator, conductance: 0.5 L/(s*bar), supply: 7 bar, time_constant: 5 ms}
    ground: {stiffness: 20 kN/m, damping: 0.5 s/m, friction: 0}
    landing: {joint: knee, drop: [20 mm, 50 mm], time_constants: [20 ms]}
    uncertainty: {strength: 5 %, mass: 3 %, draws: 32}
    """
)
study = study_landing(robot)
print(study.to_text())

# %%
# Below the best stiffness the knee hits its stop. With closed valves the air is compressed and adds stiffness to that
# of the muscles, so that a softer command is best.

figure = mk.report.landing_forces(study)

# %%
# The attainable stiffness of the foot without joint torque: along the leg it is about 80 times that across.

figure = mk.report.point_ellipses(robot.robot, study.angles)
softest = min(attainable_point_stiffness(robot.robot, study.angles, [0.0, 0.0]), key=lambda one: one.principal[0])
print([round(value) for value in softest.principal], "N/m")
