"""The plant: a joint with its load, valves and friction, the sensors that observe it and what disturbs it."""

from mckibben.plant.base import IOState, Plant
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.joint_plant import JointPlant, PlantState
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, SampledSensors, Sensors, TorquePulses

__all__ = [
    "Disturbance",
    "IOState",
    "JointFriction",
    "JointPlant",
    "NoDisturbance",
    "PerfectSensors",
    "Plant",
    "PlantState",
    "SampledSensors",
    "Sensors",
    "TorquePulses",
]
