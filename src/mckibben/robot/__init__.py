"""Robots with air muscles: bodies on hinges, muscles, ground contact; landing and jumping."""

from mckibben.robot.attainable import attainable_foot_stiffness
from mckibben.robot.bodies import Body, BodyPoint, Foot, Joint, Place
from mckibben.robot.control import (
    CoupledControl,
    JointwiseControl,
    PressureSchedule,
    RobotController,
    RobotReference,
    TimedReference,
)
from mckibben.robot.foot import FootStiffness, foot_stiffness
from mckibben.robot.foot_pressures import FootPressures, foot_matrix, pressures_for_foot_stiffness
from mckibben.robot.ground import Ground
from mckibben.robot.jumping import JumpStudy, study_jump
from mckibben.robot.landing import LandingStudy, study_landing
from mckibben.robot.mechanism import Robot
from mckibben.robot.metrics import EnergyBalance, RobotMetrics
from mckibben.robot.muscles import MusclePair, MuscleUnit, OverJoint, PathMuscle
from mckibben.robot.plant import RobotMeasurement, RobotPlant, RobotStart, RobotState
from mckibben.robot.reading import ReadRobot, read_mjcf
from mckibben.robot.scenario import RobotScenario, read_robot
from mckibben.robot.simulate import RobotResult, robot_metrics, simulate_robot, simulate_robots

__all__ = [
    "Body",
    "BodyPoint",
    "CoupledControl",
    "EnergyBalance",
    "Foot",
    "FootPressures",
    "FootStiffness",
    "Ground",
    "Joint",
    "JointwiseControl",
    "JumpStudy",
    "LandingStudy",
    "MusclePair",
    "MuscleUnit",
    "OverJoint",
    "PathMuscle",
    "Place",
    "PressureSchedule",
    "ReadRobot",
    "Robot",
    "RobotController",
    "RobotMeasurement",
    "RobotMetrics",
    "RobotPlant",
    "RobotReference",
    "RobotResult",
    "RobotScenario",
    "RobotStart",
    "RobotState",
    "TimedReference",
    "attainable_foot_stiffness",
    "foot_matrix",
    "foot_stiffness",
    "pressures_for_foot_stiffness",
    "read_mjcf",
    "read_robot",
    "robot_metrics",
    "simulate_robot",
    "simulate_robots",
    "study_jump",
    "study_landing",
]
