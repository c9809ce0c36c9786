"""Reachability: static envelope, trackability, nearest feasible references and sizing of a joint."""

from mckibben.reachability.envelope import Envelope, envelope, save_design, save_reference
from mckibben.reachability.feasible import FeasibleReference, Preserved, nearest_references
from mckibben.reachability.lengths import design_lengths
from mckibben.reachability.sizing import (
    Design,
    DesignTarget,
    DesignVariable,
    design,
    parse_target,
    parse_variable,
)
from mckibben.reachability.static import AttainableRange, StaticEnvelope, static_envelope
from mckibben.reachability.trackability import StiffnessBands, Trackability, check_trackability
from mckibben.reachability.trajectory import ReferenceTrajectory, reference_trajectory

__all__ = [
    "AttainableRange",
    "Design",
    "DesignTarget",
    "DesignVariable",
    "Envelope",
    "FeasibleReference",
    "Preserved",
    "ReferenceTrajectory",
    "StaticEnvelope",
    "StiffnessBands",
    "Trackability",
    "check_trackability",
    "design",
    "design_lengths",
    "envelope",
    "nearest_references",
    "parse_target",
    "parse_variable",
    "reference_trajectory",
    "save_design",
    "save_reference",
    "static_envelope",
]
