"""The musculoskeletal leg: joints with pairs of muscles, biarticular muscles, ground contact; landing and jumping."""

from mckibben.leg.attainable import attainable_foot_stiffness
from mckibben.leg.control import (
    CoupledControl,
    JointwiseControl,
    LegController,
    LegReference,
    PhasedReference,
    PressureSchedule,
    TimedReference,
)
from mckibben.leg.foot import FootStiffness, foot_stiffness
from mckibben.leg.foot_pressures import (
    FootPressures,
    foot_matrix,
    pressures_for_foot_stiffness,
)
from mckibben.leg.ground import Ground
from mckibben.leg.jumping import JumpStudy, study_jump
from mckibben.leg.landing import LandingStudy, study_landing
from mckibben.leg.mechanism import BiarticularMuscle, BodyPoint, Leg, LegJoint, Link, SpanningMuscle, Trunk
from mckibben.leg.metrics import EnergyBalance, LegMetrics
from mckibben.leg.plant import LegMeasurement, LegPlant, LegStart, LegState
from mckibben.leg.scenario import LegScenario, read_leg
from mckibben.leg.simulate import LegResult, leg_metrics, simulate_leg, simulate_legs

__all__ = [
    "BiarticularMuscle",
    "BodyPoint",
    "CoupledControl",
    "EnergyBalance",
    "FootPressures",
    "FootStiffness",
    "Ground",
    "JointwiseControl",
    "JumpStudy",
    "LandingStudy",
    "Leg",
    "LegController",
    "LegJoint",
    "LegMeasurement",
    "LegMetrics",
    "LegPlant",
    "LegReference",
    "LegResult",
    "LegScenario",
    "LegStart",
    "LegState",
    "Link",
    "PhasedReference",
    "PressureSchedule",
    "SpanningMuscle",
    "TimedReference",
    "Trunk",
    "attainable_foot_stiffness",
    "foot_matrix",
    "foot_stiffness",
    "leg_metrics",
    "pressures_for_foot_stiffness",
    "read_leg",
    "simulate_leg",
    "simulate_legs",
    "study_jump",
    "study_landing",
]
