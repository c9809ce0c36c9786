"""The plant: a joint with its load, valves and friction, the sensors that observe it and what disturbs it."""

from mckibben.plant.base import IOState, Plant
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.joint_plant import Hinge, JointPlant, PlantState
from mckibben.plant.mechanism import Mechanism
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, SampledSensors, Sensors, TorquePulses

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
