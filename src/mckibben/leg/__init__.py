"""The musculoskeletal leg: joints with pairs of muscles, biarticular muscles, ground contact; landing and jumping."""

from mckibben.leg.control import (
    JointwiseControl,
    LegController,
    LegMeasurement,
    LegReference,
    PhasedReference,
    PressureSchedule,
    TimedReference,
)
from mckibben.leg.mechanism import BiarticularMuscle, Leg, LegJoint, Link, Trunk
from mckibben.leg.plant import Ground, LegPlant, LegState
from mckibben.leg.simulate import LegMetrics, LegStart, leg_metrics, simulate_leg, simulate_legs

__all__ = [
    "BiarticularMuscle",
    "Ground",
    "JointwiseControl",
    "Leg",
    "LegController",
    "LegJoint",
    "LegMeasurement",
    "LegMetrics",
    "LegPlant",
    "LegReference",
    "LegStart",
    "LegState",
    "Link",
    "PhasedReference",
    "PressureSchedule",
    "TimedReference",
    "Trunk",
    "leg_metrics",
    "simulate_leg",
    "simulate_legs",
]
