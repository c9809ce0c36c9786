"""Statics of mechanisms: attainable torques and stiffness, and the pressures for a stiffness, in a posture."""

from mckibben.statics.attainable import JointRange, attainable_point_stiffness, attainable_statics
from mckibben.statics.posture import holding_torques
from mckibben.statics.pressures import StaticPressures, pressures_for_joint_stiffness, pressures_for_point_stiffness

__all__ = [
    "JointRange",
    "StaticPressures",
    "attainable_point_stiffness",
    "attainable_statics",
    "holding_torques",
    "pressures_for_joint_stiffness",
    "pressures_for_point_stiffness",
]
