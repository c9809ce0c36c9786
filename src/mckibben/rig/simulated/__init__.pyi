from .rig import VALVE as VALVE
from .rig import Regulator as Regulator
from .rig import SimulatedRig as SimulatedRig
from .rig import Truth as Truth
from .sampling import FORCE_SENSOR as FORCE_SENSOR
from .sampling import PRESSURE_SENSOR as PRESSURE_SENSOR
from .sampling import Sensor as Sensor
