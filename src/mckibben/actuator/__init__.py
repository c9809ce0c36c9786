"""Actuators: the pressure in a muscle as a response to its command, in the plant and in a controller's model."""

from mckibben.actuator.air_actuator import AirActuator
from mckibben.actuator.air_valve import AirValve, FlowValve, PressureRegulator, SwitchingValves
from mckibben.actuator.base import Actuator, AirState, AirVolume
from mckibben.actuator.muscle_valves import MuscleValves, UnequalValves, ValveGroup, ValvesByMuscle
from mckibben.actuator.second_order_valve import SecondOrderValve
from mckibben.actuator.tube import Tube
from mckibben.actuator.valve import FirstOrderValve, IdealValve, Valve

__all__ = [
    "Actuator",
    "AirActuator",
    "AirState",
    "AirValve",
    "AirVolume",
    "FirstOrderValve",
    "FlowValve",
    "IdealValve",
    "MuscleValves",
    "PressureRegulator",
    "SecondOrderValve",
    "SwitchingValves",
    "Tube",
    "UnequalValves",
    "Valve",
    "ValveGroup",
    "ValvesByMuscle",
]
