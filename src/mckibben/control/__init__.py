"""Controllers and references. A controller knows a model of the joint, never the plant."""
from mckibben.control.base import Controller, Loop, Measurement, Reference, Setpoint
from mckibben.control.pid import PID
from mckibben.control.position_stiffness import PositionStiffnessControl
from mckibben.control.signal import Constant, Multisine, Samples, Signal, Sine, Step
