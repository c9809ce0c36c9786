"""The next test: which points to measure so that a quantity becomes surest, and what those at hand cannot see."""

from mckibben.experiment_design.planning import plan
from mckibben.experiment_design.quantities import (
    Coefficients,
    Force,
    JointStiffness,
    JointTorque,
    Quantity,
    joint_named,
    read_quantity,
)
from mckibben.experiment_design.result import ErrorMap, Plan, PlannedPoint

__all__ = [
    "Coefficients",
    "ErrorMap",
    "Force",
    "JointStiffness",
    "JointTorque",
    "Plan",
    "PlannedPoint",
    "Quantity",
    "joint_named",
    "plan",
    "read_quantity",
]
