"""Robots with air muscles: bodies on hinges, muscles, ground contact; landing and jumping."""

from mckibben.robot.attainable import JointRange, attainable_point_stiffness, attainable_statics
from mckibben.robot.bodies import Body, BodyPoint, Foot, Joint, Place
from mckibben.robot.computed_torque import ComputedTorque
from mckibben.robot.control import (
    JointwiseControl,
    PressureSchedule,
    RobotController,
    RobotReference,
    TimedReference,
    TrackingControl,
)
from mckibben.robot.ground import Ground
from mckibben.robot.jumping import JumpStudy, study_jump
from mckibben.robot.landing import LandingStudy, study_landing
from mckibben.robot.mechanism import Robot
from mckibben.robot.metrics import RobotMetrics
from mckibben.robot.muscles import MusclePair, MuscleUnit, OverJoint, PathMuscle
from mckibben.robot.plant import RobotMeasurement, RobotPlant, RobotStart, RobotState
from mckibben.robot.point_stiffness import PointStiffness, point_stiffness, stiffness_matrix
from mckibben.robot.posture import holding_torques
from mckibben.robot.reading import ReadRobot, read_mjcf
from mckibben.robot.scenario import RobotScenario, read_robot
from mckibben.robot.simulate import RobotResult, robot_metrics, simulate_robot, simulate_robots
from mckibben.robot.statics import (
    StaticPressures,
    pressures_for_joint_stiffness,
    pressures_for_point_stiffness,
)
from mckibben.robot.tracking import TrackingResult, run_tracking

__all__ = [
    "Body",
    "BodyPoint",
    "ComputedTorque",
    "Foot",
    "Ground",
    "Joint",
    "JointRange",
    "JointwiseControl",
    "JumpStudy",
    "LandingStudy",
    "MusclePair",
    "MuscleUnit",
    "OverJoint",
    "PathMuscle",
    "Place",
    "PointStiffness",
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
    "StaticPressures",
    "TimedReference",
    "TrackingControl",
    "TrackingResult",
    "attainable_point_stiffness",
    "attainable_statics",
    "holding_torques",
    "point_stiffness",
    "pressures_for_joint_stiffness",
    "pressures_for_point_stiffness",
    "read_mjcf",
    "read_robot",
    "robot_metrics",
    "run_tracking",
    "simulate_robot",
    "simulate_robots",
    "stiffness_matrix",
    "study_jump",
    "study_landing",
]
