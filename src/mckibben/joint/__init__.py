"""The joint: geometry (Eqs. 4-5), torque and stiffness (Eqs. 7-8), load (Eq. 6) and attainable set."""

from mckibben.joint.antagonistic import AffineMap, AntagonisticJoint, Measurement, TorqueStiffnessMap
from mckibben.joint.build import joint, make_callable
from mckibben.joint.geometry import Geometry, KneeGeometry, ScaledArms
from mckibben.joint.load import GeneralLoad, KneeLoad, Load, PendulumLoad, SlidingMass
from mckibben.joint.paths import Cam, MusclePath, PairedPaths, Pulley, TabulatedPath, TwoBonePath
from mckibben.joint.slide import Slide
from mckibben.joint.tendon import RigidTendon, SeriesSpring, Tendon

__all__ = [
    "AffineMap",
    "AntagonisticJoint",
    "Cam",
    "GeneralLoad",
    "Geometry",
    "KneeGeometry",
    "KneeLoad",
    "Load",
    "Measurement",
    "MusclePath",
    "PairedPaths",
    "PendulumLoad",
    "Pulley",
    "RigidTendon",
    "ScaledArms",
    "SeriesSpring",
    "Slide",
    "SlidingMass",
    "TabulatedPath",
    "Tendon",
    "TorqueStiffnessMap",
    "TwoBonePath",
    "joint",
]

make_callable(__name__)
