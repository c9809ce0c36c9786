"""From measured points to a force law: least squares, uncertainty, errors at unseen points."""

from mckibben.identification.design import design_matrix
from mckibben.identification.fit import DatasetSummary, Fit, LeaveOnePressureOut
from mckibben.identification.fitting import identify

__all__ = ["DatasetSummary", "Fit", "LeaveOnePressureOut", "design_matrix", "identify"]
