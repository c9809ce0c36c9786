"""The joint rig: controllers in real time on a physical or a simulated joint."""

from mckibben.realtime.compiled_step import ControlProgram
from mckibben.realtime.config import JointHardware, JointRig, RunConditions
from mckibben.realtime.loop import RunOutcome, RunPlan, RunProgress, control
from mckibben.realtime.record import Timing
from mckibben.realtime.session import JointRunResult, JointSession, prepare
from mckibben.realtime.simulated import PERFECT, Sensing, SimulatedJoint
from mckibben.realtime.wiring import Wiring
from mckibben.rig.bench import JointLimits

__all__ = [
    "PERFECT",
    "ControlProgram",
    "JointHardware",
    "JointLimits",
    "JointRig",
    "JointRunResult",
    "JointSession",
    "RunConditions",
    "RunOutcome",
    "RunPlan",
    "RunProgress",
    "Sensing",
    "SimulatedJoint",
    "Timing",
    "Wiring",
    "control",
    "prepare",
]
