"""The joint rig: the controllers of the simulation on a joint that is there, or on one that runs as if it were."""

from mckibben.realtime.compiled_step import ControlProgram, compute_in_this_thread
from mckibben.realtime.config import JointRig, Wiring
from mckibben.realtime.limits import JointLimits, RunOutcome, RunPlan, RunProgress
from mckibben.realtime.loop import Timing
from mckibben.realtime.session import JointRunResult, JointSession, control, prepare
from mckibben.realtime.simulated import PERFECT, Sensing, SimulatedJoint

__all__ = [
    "PERFECT",
    "ControlProgram",
    "JointLimits",
    "JointRig",
    "JointRunResult",
    "JointSession",
    "RunOutcome",
    "RunPlan",
    "RunProgress",
    "Sensing",
    "SimulatedJoint",
    "Timing",
    "Wiring",
    "compute_in_this_thread",
    "control",
    "prepare",
]
