"""The joint rig: the controllers of the simulation on a joint that is there, or on one that runs as if it were."""

from mckibben.realtime.compiled_step import ControlProgram, compute_in_this_thread
from mckibben.realtime.config import JointRig, Wiring
from mckibben.realtime.limits import Course, Ending, JointLimits, Shown
from mckibben.realtime.loop import Timing
from mckibben.realtime.session import Ran, Session, control, prepared
from mckibben.realtime.simulated import PERFECT, Sensing, VirtualJoint

__all__ = [
    "PERFECT",
    "ControlProgram",
    "Course",
    "Ending",
    "JointLimits",
    "JointRig",
    "Ran",
    "Sensing",
    "Session",
    "Shown",
    "Timing",
    "VirtualJoint",
    "Wiring",
    "compute_in_this_thread",
    "control",
    "prepared",
]
