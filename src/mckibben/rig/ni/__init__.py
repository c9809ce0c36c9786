"""Rigs on cards of National Instruments; needs the extra `daq` and the driver NI-DAQmx."""

from mckibben.rig.backend import ChannelStatus
from mckibben.rig.ni.backend import NiBackend, NiRig, channel_status
from mckibben.rig.ni.driver import Terminals

__all__ = ["ChannelStatus", "NiBackend", "NiRig", "Terminals", "channel_status"]
