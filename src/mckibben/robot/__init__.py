"""Robots with air muscles: names of the packages that have their bodies, statics, control, runs and studies.

`simulate_robot` and `simulate_robots` are names for this version alone of `mckibben.simulate` and `simulate_many`.
"""

from jaxtyping import PyTree

from mckibben.control.base import DiscreteTimeSystem
from mckibben.control.computed_torque import ComputedTorque
from mckibben.control.robot_control import (
    JointwiseControl,
    PressureSchedule,
    RobotController,
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
from mckibben.simulation import Batch, SimulationResult, simulate, simulate_many
from mckibben.simulation.robot_metrics import RobotMetrics
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
    "RobotScenario",
    "RobotStart",
    "StaticPressures",
    "attainable_point_stiffness",
    "attainable_statics",
    "holding_torques",
    "point_stiffness",
    "pressures_for_joint_stiffness",
    "pressures_for_point_stiffness",
    "read_mjcf",
    "read_robot",
    "simulate_robot",
    "simulate_robots",
    "stiffness_matrix",
    "study_jump",
    "study_landing",
]


def simulate_robot(
    plant: RobotPlant, controller: DiscreteTimeSystem, start: RobotStart, **options: PyTree
) -> SimulationResult:
    """Return `mckibben.simulate` of a robot that follows no references."""
    return simulate(plant, controller, initial=start, **options)


def simulate_robots(plant: RobotPlant, controller: DiscreteTimeSystem, start: RobotStart, **options: PyTree) -> Batch:
    """Return `mckibben.simulate_many` of a robot that follows no references."""
    return simulate_many(plant, controller, initial=start, **options)
