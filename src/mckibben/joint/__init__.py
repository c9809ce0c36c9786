"""The joint: geometry (Eqs. 4-5), torque and stiffness (Eqs. 7-8), load (Eq. 6) and attainable set."""

from mckibben.joint.antagonistic import AffineMap, AntagonisticJoint, Measurement, TorqueStiffnessMap
from mckibben.joint.geometry import Geometry, KneeGeometry
from mckibben.joint.load import GeneralLoad, KneeLoad, Load, PendulumLoad
from mckibben.joint.tendon import RigidTendon, SeriesSpring, Tendon

__all__ = [
    "AffineMap",
    "AntagonisticJoint",
    "GeneralLoad",
    "Geometry",
    "KneeGeometry",
    "KneeLoad",
    "Load",
    "Measurement",
    "PendulumLoad",
    "RigidTendon",
    "SeriesSpring",
    "Tendon",
    "TorqueStiffnessMap",
]
