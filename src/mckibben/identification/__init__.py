"""Identification of force laws and friction from measured points: least squares, uncertainty, cross-validation."""

from mckibben.identification.creep import CreepFit, identify_creep
from mckibben.identification.delayed_share import CreepStructure
from mckibben.identification.fit import DatasetSummary, Fit, LeaveOnePressureOut, Outlier
from mckibben.identification.fitting import ResidualCorrelation, identify
from mckibben.identification.friction_forms import FormComparison, FrictionForm, LackOfFit
from mckibben.identification.hysteresis import HysteresisFit, SensorDrift, identify_hysteresis
from mckibben.identification.intervals import ForceIntervals, Interval, IntervalEstimate
from mckibben.identification.least_squares import design_matrix
from mckibben.identification.outliers import find_outliers
from mckibben.identification.pooling import LeftOutSpecimen, PooledFit, PoolForm, identify_pooled
from mckibben.identification.pressure_creep import PressureCreepFit, identify_pressure_creep
from mckibben.identification.profile import Profile, profile
from mckibben.identification.ranking import RankedLaw, Ranking, rank
from mckibben.identification.storage import read_law
from mckibben.identification.threshold import ThresholdFit, identify_threshold
from mckibben.identification.uncertainty import Grouping
from mckibben.identification.validation import ErrorStatistics, Validation, validate
from mckibben.identification.with_friction import FitWithFriction, identify_with_friction, shows_hysteresis

__all__ = [
    "CreepFit",
    "CreepStructure",
    "DatasetSummary",
    "ErrorStatistics",
    "Fit",
    "FitWithFriction",
    "ForceIntervals",
    "FormComparison",
    "FrictionForm",
    "Grouping",
    "HysteresisFit",
    "Interval",
    "IntervalEstimate",
    "LackOfFit",
    "LeaveOnePressureOut",
    "LeftOutSpecimen",
    "Outlier",
    "PoolForm",
    "PooledFit",
    "PressureCreepFit",
    "Profile",
    "RankedLaw",
    "Ranking",
    "ResidualCorrelation",
    "SensorDrift",
    "ThresholdFit",
    "Validation",
    "design_matrix",
    "find_outliers",
    "identify",
    "identify_creep",
    "identify_hysteresis",
    "identify_pooled",
    "identify_pressure_creep",
    "identify_threshold",
    "identify_with_friction",
    "profile",
    "rank",
    "read_law",
    "shows_hysteresis",
    "validate",
]
