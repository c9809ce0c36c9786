"""The plant: valve, inertia and gravity (Eq. 6), sensors and disturbances; what is simulated."""

from mckibben.plant.disturbance import Disturbance, NoDisturbance, TorquePulses
from mckibben.plant.joint_plant import JointPlant, PlantState
from mckibben.plant.sensors import PerfectSensors, SampledSensors, Sensors
from mckibben.plant.valve import FirstOrderValve, IdealValve, Valve

__all__ = [
    "Disturbance",
    "FirstOrderValve",
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
