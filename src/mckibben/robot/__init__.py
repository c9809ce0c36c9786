"""Robots with air muscles: bodies on hinges, muscles, ground contact; landing and jumping."""

from mckibben.robot.attainable import attainable_foot_stiffness
from mckibben.robot.control import (
    CoupledControl,
    JointwiseControl,
    PhasedReference,
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
from mckibben.robot.mechanism import BiarticularMuscle, BodyPoint, Joint, Link, Robot, SpanningMuscle, Trunk
from mckibben.robot.metrics import EnergyBalance, RobotMetrics
from mckibben.robot.plant import RobotMeasurement, RobotPlant, RobotStart, RobotState
from mckibben.robot.scenario import RobotScenario, read_robot
from mckibben.robot.simulate import RobotResult, robot_metrics, simulate_robot, simulate_robots

__all__ = [
    "BiarticularMuscle",
    "BodyPoint",
    "CoupledControl",
    "EnergyBalance",
    "FootPressures",
    "FootStiffness",
    "Ground",
    "Joint",
    "JointwiseControl",
    "JumpStudy",
    "LandingStudy",
    "Link",
    "PhasedReference",
    "PressureSchedule",
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
    "SpanningMuscle",
    "TimedReference",
    "Trunk",
    "attainable_foot_stiffness",
    "foot_matrix",
    "foot_stiffness",
    "pressures_for_foot_stiffness",
    "read_robot",
    "robot_metrics",
    "simulate_robot",
    "simulate_robots",
    "study_jump",
    "study_landing",
]
