"""A virtual rig behind the interface of a real one, with the faults of a real one."""

from mckibben.rig.twin.air import Regulator
from mckibben.rig.twin.faults import (
    Burst,
    Delaying,
    Dropping,
    Fault,
    HostDelayed,
    Silent,
    Slipped,
    Stalled,
    SupplyLost,
    Unplugged,
    ValveStuck,
)
from mckibben.rig.twin.machine import Truth
from mckibben.rig.twin.rig import Paced, TwinRig
from mckibben.rig.twin.sensing import FORCE_SENSOR, PRESSURE_SENSOR, VALVE, Converter, Sensor
from mckibben.rig.twin.stretcher import Stretcher

__all__ = [
    "FORCE_SENSOR",
    "PRESSURE_SENSOR",
    "VALVE",
    "Burst",
    "Converter",
    "Delaying",
    "Dropping",
    "Fault",
    "HostDelayed",
    "Paced",
    "Regulator",
    "Sensor",
    "Silent",
    "Slipped",
    "Stalled",
    "Stretcher",
    "SupplyLost",
    "Truth",
    "TwinRig",
    "Unplugged",
    "ValveStuck",
]
