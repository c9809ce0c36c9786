"""The joint rig: the controllers of the simulation on a joint that is there, or on one that runs as if it were."""

from mckibben.study.joint_rig.course import Course, Ending, Shown
from mckibben.study.joint_rig.document import JointRig
from mckibben.study.joint_rig.limits import JointLimits
from mckibben.study.joint_rig.programs import ControlProgram, compute_in_this_thread
from mckibben.study.joint_rig.running import control
from mckibben.study.joint_rig.session import Ran, Session, prepared
from mckibben.study.joint_rig.timing import Timing
from mckibben.study.joint_rig.virtual import PERFECT, Sensing, VirtualJoint
from mckibben.study.joint_rig.wiring import Wiring

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
