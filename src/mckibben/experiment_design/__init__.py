"""Optimal experiment design: the measurement points that most reduce the uncertainty of a quantity of interest."""

from mckibben.experiment_design.planning import plan
from mckibben.experiment_design.quantities import (
    Coefficient,
    Force,
    JointStiffness,
    QuantityOfInterest,
    parse_quantity_of_interest,
)
from mckibben.experiment_design.result import ErrorMap, ExperimentPlan, PlannedPoint

__all__ = [
    "Coefficient",
    "ErrorMap",
    "ExperimentPlan",
    "Force",
    "JointStiffness",
    "PlannedPoint",
    "QuantityOfInterest",
    "parse_quantity_of_interest",
    "plan",
]
