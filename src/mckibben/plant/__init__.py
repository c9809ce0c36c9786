"""The plant: joint, load (Eq. 6), valves, sensors and disturbances."""

from mckibben.plant.actuator import Actuator
from mckibben.plant.air_valve import AirValve, FlowValve, PressureRegulator, SwitchingValves
from mckibben.plant.base import IOState, Plant
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.joint_plant import JointPlant, PlantState
from mckibben.plant.second_order_valve import SecondOrderValve
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, SampledSensors, Sensors, TorquePulses
from mckibben.plant.valve import FirstOrderValve, IdealValve, Valve

__all__ = [
    "Actuator",
    "AirValve",
    "Disturbance",
    "FirstOrderValve",
    "FlowValve",
    "IOState",
    "IdealValve",
    "JointFriction",
    "JointPlant",
    "NoDisturbance",
    "PerfectSensors",
    "Plant",
    "PlantState",
    "PressureRegulator",
    "SampledSensors",
    "SecondOrderValve",
    "Sensors",
    "SwitchingValves",
    "TorquePulses",
    "Valve",
]
