"""The plant: joint, load (Eq. 6), valves, sensors and disturbances."""

from mckibben.plant.joint_plant import IOState, JointPlant, PlantState
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, SampledSensors, Sensors, TorquePulses
from mckibben.plant.valve import FirstOrderValve, IdealValve, Valve

__all__ = [
    "Disturbance",
    "FirstOrderValve",
    "IOState",
    "IdealValve",
    "JointPlant",
    "NoDisturbance",
    "PerfectSensors",
    "PlantState",
    "SampledSensors",
    "Sensors",
    "TorquePulses",
    "Valve",
]
