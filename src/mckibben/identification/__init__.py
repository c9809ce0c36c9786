"""Identification of force laws and friction from measured points: least squares, uncertainty, cross-validation."""

from mckibben.identification.bootstrap import Bootstrap, bootstrap
from mckibben.identification.creep import CreepFit, identify_creep
from mckibben.identification.fit import DatasetSummary, Fit, LeaveOnePressureOut, Outlier
from mckibben.identification.fitting import ResidualCorrelation, identify
from mckibben.identification.friction_forms import FormComparison, FrictionForm, LackOfFit
from mckibben.identification.hysteresis import HysteresisFit, SensorDrift, identify_hysteresis
from mckibben.identification.intervals import ForceIntervals, Interval, IntervalEstimate
from mckibben.identification.least_squares import design_matrix
from mckibben.identification.outliers import find_outliers
from mckibben.identification.posterior import Noise, Posterior, posterior
from mckibben.identification.profile import Profile, profile
from mckibben.identification.ranking import RankedLaw, Ranking, rank
from mckibben.identification.storage import read_law
from mckibben.identification.uncertainty import Grouping
from mckibben.identification.validation import ErrorStatistics, HoldOut, Validation, hold_out, validate

__all__ = [
    "Bootstrap",
    "CreepFit",
    "DatasetSummary",
    "ErrorStatistics",
    "Fit",
    "ForceIntervals",
    "FormComparison",
    "FrictionForm",
    "Grouping",
    "HoldOut",
    "HysteresisFit",
    "Interval",
    "IntervalEstimate",
    "LackOfFit",
    "LeaveOnePressureOut",
    "Noise",
    "Outlier",
    "Posterior",
    "Profile",
    "RankedLaw",
    "Ranking",
    "ResidualCorrelation",
    "SensorDrift",
    "Validation",
    "bootstrap",
    "design_matrix",
    "find_outliers",
    "hold_out",
    "identify",
    "identify_creep",
    "identify_hysteresis",
    "posterior",
    "profile",
    "rank",
    "read_law",
    "validate",
]
