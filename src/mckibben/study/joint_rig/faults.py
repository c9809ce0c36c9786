"""What can go wrong with a virtual joint, beside what can with any virtual rig."""

from __future__ import annotations

from dataclasses import dataclass

from mckibben.errors import RangeError
from mckibben.rig.twin.faults import Fault

SENSORS = ("angle", "pressure1", "pressure2")
"""The inputs of a joint rig."""


@dataclass(frozen=True)
class Unplugged(Fault):
    """A sensor's plug comes off.

    Parameters
    ----------
    sensor
        "angle", "pressure1" or "pressure2".
    volts
        What the open input then reads [V]: 0 V, to which a resistor pulls it.
    """

    sensor: str = "angle"
    volts: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sensor not in SENSORS:
            remedy = f"choose of {', '.join(SENSORS)}"
            raise RangeError(f"Unplugged: no sensor {self.sensor!r}", value=self.sensor, remedy=remedy)
