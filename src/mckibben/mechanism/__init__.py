"""Mechanisms that muscles move: their protocol, and robots of bodies on hinges, with ground and disturbances."""

from mckibben.mechanism.base import Mechanism, RobotMeasurement
from mckibben.mechanism.bodies import Body, BodyPoint, Foot, Joint, Place
from mckibben.mechanism.disturbance import Disturbance, NoDisturbance, TorquePulses
from mckibben.mechanism.ground import Ground
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.mechanism.muscles import MusclePair, MuscleUnit, OverJoint, PathMuscle
from mckibben.mechanism.point_stiffness import PointStiffness, point_stiffness, stiffness_matrix
from mckibben.mechanism.robot import Robot

__all__ = [
    "Body",
    "BodyPoint",
    "Disturbance",
    "Foot",
    "Ground",
    "Joint",
    "JointFriction",
    "Mechanism",
    "MusclePair",
    "MuscleUnit",
    "NoDisturbance",
    "OverJoint",
    "PathMuscle",
    "Place",
    "PointStiffness",
    "Robot",
    "RobotMeasurement",
    "TorquePulses",
    "point_stiffness",
    "stiffness_matrix",
]
