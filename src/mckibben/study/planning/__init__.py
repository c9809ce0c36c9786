"""The next test: which points to measure so that a quantity becomes surest, and what those at hand cannot see."""

from mckibben.study.planning.planning import plan
from mckibben.study.planning.quantities import Coefficients, Force, JointStiffness, JointTorque, Quantity
from mckibben.study.planning.reading import joint_named, read_quantity, span
from mckibben.study.planning.result import ErrorMap, Plan, PlannedPoint

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
    "span",
]
