"""Rigs on cards of National Instruments; needs the extra `daq` and the driver NI-DAQmx."""

from mckibben.rig.ni.backend import NiBackend, NiRig
from mckibben.rig.ni.driver import Terminals

__all__ = ["NiBackend", "NiRig", "Terminals"]
