"""Statics of the posture that a robot's file asks for."""

from __future__ import annotations

import numpy as np

from mckibben.errors import McKibbenError, Problem, ScenarioError
from mckibben.mechanism.point_stiffness import point_jacobian, stiffness_matrix
from mckibben.scenario.robot import RobotScenario
from mckibben.statics.attainable import JointRange, attainable_statics
from mckibben.statics.posture import holding_torques
from mckibben.statics.pressures import StaticPressures, pressures_for_joint_stiffness, pressures_for_point_stiffness


def solve_statics(scenario: RobotScenario, *, source: str = "") -> tuple[dict[str, JointRange], StaticPressures | None]:
    """Return what is attainable in the posture of the section `stiffness` of a file, and the pressures for it.

    Without that section the posture is that of all angles as near 0 as they can be.

    Raises
    ------
    ScenarioError
        If it cannot be solved.
    """
    wanted, source, robot = scenario.stiffness, source or scenario.name, scenario.robot
    supply = scenario.supply
    angles = robot.posture_angles({} if wanted is None else wanted.posture)
    held = None if wanted is None or not wanted.gravity else holding_torques(robot, angles)
    try:
        if wanted is None or wanted.principal is None:
            attainable = attainable_statics(robot, angles, torques=held, supply=supply)
            if wanted is None or not wanted.joints:
                return attainable, None
            rows = [wanted.joints.get(joint.name) for joint in robot.joints]
            return attainable, pressures_for_joint_stiffness(robot, angles, rows, torques=held, supply=supply)
        matrix = stiffness_matrix(wanted.principal, wanted.direction, wanted.sideways)
        if wanted.force is not None:
            pushing = -point_jacobian(robot, angles, wanted.force, wanted.point)[0].T @ np.asarray(wanted.force)
            held = pushing if held is None else held + pushing
        found = pressures_for_point_stiffness(
            robot, angles, matrix, point=wanted.point, force=wanted.force, torques=held, supply=supply
        )
        return attainable_statics(robot, angles, torques=held, supply=supply), found
    except McKibbenError as error:
        raise ScenarioError(source, [Problem.of(error, field="stiffness")]) from error
