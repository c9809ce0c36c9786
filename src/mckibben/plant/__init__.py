"""The plant: joint, load (Eq. 6), valves, sensors and disturbances."""

from mckibben.actuator import (
    Actuator,
    AirValve,
    FirstOrderValve,
    FlowValve,
    IdealValve,
    PressureRegulator,
    SecondOrderValve,
    SwitchingValves,
    Tube,
    UnequalValves,
    Valve,
)
from mckibben.plant.base import IOState, Plant
from mckibben.plant.joint_friction import JointFriction
from mckibben.plant.joint_plant import JointPlant, PlantState
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors, SampledSensors, Sensors, TorquePulses

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
    "Tube",
    "UnequalValves",
    "Valve",
]
