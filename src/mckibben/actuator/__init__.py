"""Actuators: the pressure in a muscle as a response to its command, in the plant and in a controller's model."""

from mckibben.actuator.air_actuator import AirActuator
from mckibben.actuator.air_valve import AirValve, FlowValve, PressureRegulator, SwitchingValves
from mckibben.actuator.base import Actuator, AirState, AirVolume
from mckibben.actuator.second_order_valve import SecondOrderValve
from mckibben.actuator.tube import Tube
from mckibben.actuator.unequal_valves import UnequalValves
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
    "PressureRegulator",
    "SecondOrderValve",
    "SwitchingValves",
    "Tube",
    "UnequalValves",
    "Valve",
]
