"""The test rig: protocols, and a virtual rig that runs them on a force law."""

from mckibben.rig.boundaries import Boundaries, boundaries
from mckibben.rig.protocol import IsobaricProtocol, Plateaus
from mckibben.rig.turns import away_from_turns
from mckibben.rig.virtual import VirtualRig

__all__ = ["Boundaries", "IsobaricProtocol", "Plateaus", "VirtualRig", "away_from_turns", "boundaries"]
