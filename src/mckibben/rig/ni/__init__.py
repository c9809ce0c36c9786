"""Rigs on cards of National Instruments; needs the extra `daq`, and the driver NI-DAQmx."""

from mckibben.rig.ni.backend import NiBackend
from mckibben.rig.ni.moving import NiRig
from mckibben.rig.ni.present import Presence, present
from mckibben.rig.ni.wiring import Wiring

__all__ = ["NiBackend", "NiRig", "Presence", "Wiring", "present"]
