"""Identification of force laws and friction from measured points: least squares, uncertainty, cross-validation."""

from mckibben.identification.creep import CreepFit, identify_pressure_creep
from mckibben.identification.estimator import Interval, IntervalEstimate
from mckibben.identification.fit import Fit
from mckibben.identification.fitting import fit_law
from mckibben.identification.friction import HysteresisFit, SensorDrift, identify_hysteresis
from mckibben.identification.friction_model import FrictionForm
from mckibben.identification.grouping import Grouping
from mckibben.identification.inverse import InverseTable, inverse_table
from mckibben.identification.least_squares import design_matrix
from mckibben.identification.outliers import find_outliers
from mckibben.identification.ranking import RankedLaw, Ranking, rank
from mckibben.identification.regression import ForceIntervals
from mckibben.identification.storage import read_law
from mckibben.identification.summary import DatasetSummary, LeaveOnePressureOut, Outlier
from mckibben.identification.torque import TorqueFit, identify_torque
from mckibben.identification.validation import ErrorStatistics, Validation, validate
from mckibben.identification.with_friction import FitWithFriction, identify_with_friction, shows_hysteresis

__all__ = [
    "CreepFit",
    "DatasetSummary",
    "ErrorStatistics",
    "Fit",
    "FitWithFriction",
    "ForceIntervals",
    "FrictionForm",
    "Grouping",
    "HysteresisFit",
    "Interval",
    "IntervalEstimate",
    "InverseTable",
    "LeaveOnePressureOut",
    "Outlier",
    "RankedLaw",
    "Ranking",
    "SensorDrift",
    "TorqueFit",
    "Validation",
    "design_matrix",
    "find_outliers",
    "fit_law",
    "identify_hysteresis",
    "identify_pressure_creep",
    "identify_torque",
    "identify_with_friction",
    "inverse_table",
    "rank",
    "read_law",
    "shows_hysteresis",
    "validate",
]
