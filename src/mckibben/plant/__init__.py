"""The plant: a joint with its load, valves and friction, the sensors that observe it and what disturbs it."""

from mckibben.mechanism.base import Mechanism
from mckibben.mechanism.disturbance import Disturbance, NoDisturbance, TorquePulses
from mckibben.mechanism.hinge import Hinge
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.plant.base import Plant
from mckibben.plant.joint_plant import JointPlant
from mckibben.plant.sensors import PerfectSensors, SampledSensors, Sensors
from mckibben.plant.state import IOState, PlantState

__all__ = [
    "Disturbance",
    "Hinge",
    "IOState",
    "JointFriction",
    "JointPlant",
    "Mechanism",
    "NoDisturbance",
    "PerfectSensors",
    "Plant",
    "PlantState",
    "SampledSensors",
    "Sensors",
    "TorquePulses",
]
