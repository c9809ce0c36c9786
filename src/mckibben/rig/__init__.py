"""The test rig: protocols, runner, recorder and safety monitor; simulated rig and NI cards."""

from mckibben.rig.protocol import Boundaries, IsobaricProtocol, Plateaus, away_from_turns, boundaries
from mckibben.rig.simulated.isobaric import SimulatedIsobaricTest

__all__ = ["Boundaries", "IsobaricProtocol", "Plateaus", "SimulatedIsobaricTest", "away_from_turns", "boundaries"]
