from .protocol import Boundaries as Boundaries
from .protocol import IsobaricProtocol as IsobaricProtocol
from .protocol import Plateaus as Plateaus
from .protocol import away_from_turns as away_from_turns
from .protocol import boundaries as boundaries
from .simulated.isobaric import SimulatedIsobaricTest as SimulatedIsobaricTest
