"""Controllers and references. A controller knows a model of the joint, never the plant."""

from mckibben.control.backprop import BackpropPID
from mckibben.control.base import Controller, JointModel, Loop, Measurement, Reference, Setpoint
from mckibben.control.computed_torque import ComputedTorque
from mckibben.control.cost import AngleLimits, StageCost, StageEnd
from mckibben.control.decoupling import DecouplingControl
from mckibben.control.delay import DelayCompensation
from mckibben.control.dither import Dither
from mckibben.control.feedback import Feedback, PolePlacement, SlidingMode
from mckibben.control.inverse_model import InverseModelControl
from mckibben.control.observer import ExtendedStateObserver, Observer, PressureObserver, VelocityObserver
from mckibben.control.open_loop import OpenLoopControl
from mckibben.control.pid import PID
from mckibben.control.position_stiffness import PositionStiffnessControl
from mckibben.control.predictive import PredictiveControl
from mckibben.control.reference import (
    Constant,
    Multisine,
    Ramp,
    RandomSteps,
    Samples,
    SamplesFile,
    Signal,
    Sine,
    Step,
    Sum,
)

__all__ = [
    "PID",
    "AngleLimits",
    "BackpropPID",
    "ComputedTorque",
    "Constant",
    "Controller",
    "DecouplingControl",
    "DelayCompensation",
    "Dither",
    "ExtendedStateObserver",
    "Feedback",
    "InverseModelControl",
    "JointModel",
    "Loop",
    "Measurement",
    "Multisine",
    "Observer",
    "OpenLoopControl",
    "PolePlacement",
    "PositionStiffnessControl",
    "PredictiveControl",
    "PressureObserver",
    "Ramp",
    "RandomSteps",
    "Reference",
    "Samples",
    "SamplesFile",
    "Setpoint",
    "Signal",
    "Sine",
    "SlidingMode",
    "StageCost",
    "StageEnd",
    "Step",
    "Sum",
    "VelocityObserver",
]
