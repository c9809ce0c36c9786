"""Controllers and references. A controller knows a model of the joint, never the plant."""

from mckibben.control.backprop import BackpropPID, Jacobian
from mckibben.control.base import Controller, Loop, Measurement, Reference, Setpoint
from mckibben.control.friction import FrictionCompensation
from mckibben.control.pid import PID
from mckibben.control.position_stiffness import PositionStiffnessControl
from mckibben.control.signal import Constant, Multisine, Samples, Signal, Sine, Step

__all__ = [
    "PID",
    "BackpropPID",
    "Constant",
    "Controller",
    "FrictionCompensation",
    "Jacobian",
    "Loop",
    "Measurement",
    "Multisine",
    "PositionStiffnessControl",
    "Reference",
    "Samples",
    "Setpoint",
    "Signal",
    "Sine",
    "Step",
]
