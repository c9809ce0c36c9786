"""Simulated rig behind the interface of a physical one, with its faults."""

from mckibben.rig.simulated.faults import (
    Burst,
    Fault,
    HostDelayed,
    SamplesDelayed,
    SamplesDropped,
    SamplesStopped,
    SensorDisconnected,
    Slipped,
    Stalled,
    SupplyLost,
    ValveStuck,
)
from mckibben.rig.simulated.machine import Truth
from mckibben.rig.simulated.parts import Regulator, Stretcher
from mckibben.rig.simulated.rig import RealTimeRig, SimulatedRig
from mckibben.rig.simulated.sensing import FORCE_SENSOR, PRESSURE_SENSOR, VALVE, Converter, Sensor

__all__ = [
    "FORCE_SENSOR",
    "PRESSURE_SENSOR",
    "VALVE",
    "Burst",
    "Converter",
    "Fault",
    "HostDelayed",
    "RealTimeRig",
    "Regulator",
    "SamplesDelayed",
    "SamplesDropped",
    "SamplesStopped",
    "Sensor",
    "SensorDisconnected",
    "SimulatedRig",
    "Slipped",
    "Stalled",
    "Stretcher",
    "SupplyLost",
    "Truth",
    "ValveStuck",
]
