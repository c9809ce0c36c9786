"""From measured points to a force law: least squares, uncertainty, errors at unseen points."""

from mckibben.identification.design import design_matrix
from mckibben.identification.fit import DatasetSummary, Fit, LeaveOnePressureOut
from mckibben.identification.fitting import identify
from mckibben.identification.storage import read_law
from mckibben.identification.validation import Errors, HoldOut, Validation, hold_out, validate

__all__ = [
    "DatasetSummary",
    "Errors",
    "Fit",
    "HoldOut",
    "LeaveOnePressureOut",
    "Validation",
    "design_matrix",
    "hold_out",
    "identify",
    "read_law",
    "validate",
]
