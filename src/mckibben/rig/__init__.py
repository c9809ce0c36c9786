"""The test rig: protocols, and a virtual rig that runs them on a force law."""

from mckibben.rig.protocol import Boundaries, IsobaricProtocol, Plateaus, away_from_turns, boundaries
from mckibben.rig.virtual import VirtualRig

__all__ = ["Boundaries", "IsobaricProtocol", "Plateaus", "VirtualRig", "away_from_turns", "boundaries"]
