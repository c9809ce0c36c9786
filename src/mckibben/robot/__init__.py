"""Robots with air muscles: names of the packages that have their bodies, statics, control, runs and studies."""

from mckibben.control.computed_torque import ComputedTorque
from mckibben.control.robot_control import (
    JointwiseControl,
    PressureSchedule,
    RobotController,
    RobotReference,
    TimedReference,
    TrackingControl,
)
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.bodies import Body, BodyPoint, Foot, Joint, Place
from mckibben.mechanism.ground import Ground
from mckibben.mechanism.muscles import MusclePair, MuscleUnit, OverJoint, PathMuscle
from mckibben.mechanism.point_stiffness import PointStiffness, point_stiffness, stiffness_matrix
from mckibben.mechanism.robot import Robot
from mckibben.plant.robot_plant import RobotPlant, RobotStart
from mckibben.scenario.reading import ReadRobot, read_mjcf
from mckibben.scenario.robot import RobotScenario, read_robot
from mckibben.scenario.tracking import TrackingResult, run_tracking
from mckibben.simulation.robot_metrics import RobotMetrics
from mckibben.simulation.robots import RobotResult, robot_metrics, simulate_robot, simulate_robots
from mckibben.statics.attainable import JointRange, attainable_point_stiffness, attainable_statics
from mckibben.statics.posture import holding_torques
from mckibben.statics.pressures import (
    StaticPressures,
    pressures_for_joint_stiffness,
    pressures_for_point_stiffness,
)
from mckibben.study.jumping import JumpStudy, study_jump
from mckibben.study.landing import LandingStudy, study_landing

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
