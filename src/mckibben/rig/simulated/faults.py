"""Faults of the simulated rig and the simulated joint, each at a given time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import Checked
from mckibben.errors import RangeError
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.units import Conductance, Duration, PositiveTime, Quantity, Samples, WaitTime

RAIL = 1.02
"""Reading of a lost sensor over the end of its range."""


@dataclass(frozen=True)
class Fault(Checked):
    """A fault of simulated hardware.

    Parameters
    ----------
    at
        Time since the rig was first opened [s].
    """

    at: WaitTime


@dataclass(frozen=True)
class SupplyLost(Fault):
    """Loss of the supply; an open regulator lets the air of the muscle flow back."""


@dataclass(frozen=True)
class ValveStuck(Fault):
    """Regulator stuck at an opening, whatever its signal.

    Parameters
    ----------
    opening
        From -1 (exhaust) to 1 (supply).
    """

    opening: Annotated[float, Quantity("1", lower=-1, upper=1)] = 1.0


@dataclass(frozen=True)
class SensorDisconnected(Fault):
    """The cable of a sensor is disconnected.

    Parameters
    ----------
    sensor
        Name of its input.
    value
        Its reading, in its unit, by default beyond its range; None: it floats, with hum.
    """

    sensor: str = "force"
    value: float | None = math.inf

    def values_at(self, time: NDArray[np.float64], span: float, *, mains: float = 50.0) -> NDArray[np.float64]:
        """Return readings at times [s], of the same shape, of a sensor whose readings go up to a span; hum in Hz.

        >>> SensorDisconnected(1.0, "force", value=0.7).values_at(np.array([1.0, 2.0]), 9.0).tolist()
        [0.7, 0.7]
        """
        if self.value is None:
            return span * (0.1 + 0.2 * np.sin(2 * np.pi * mains * time))
        return np.full(len(time), min(self.value, span))

    def check(self, sensors: Sequence[str]) -> None:
        """Raise `RangeError` unless the rig has that sensor."""
        if self.sensor not in sensors:
            message = f"SensorDisconnected: no sensor {self.sensor!r}"
            raise RangeError(message, value=self.sensor, remedy=f"choose one of {', '.join(sensors)}")


@dataclass(frozen=True)
class Burst(Fault):
    """Burst bladder.

    Parameters
    ----------
    conductance
        Sonic conductance of the leak [m^3/(s*Pa)], by default 5 dm^3/(s*bar).
    """

    conductance: Conductance = 5 * L_PER_S_BAR


@dataclass(frozen=True)
class Stalled(Fault):
    """Motor stalls; its pulses are counted all the same."""


@dataclass(frozen=True)
class HostDelayed(Fault):
    """Host is busy, by which its next read is delayed.

    Parameters
    ----------
    duration
        Delay [s].
    """

    duration: Duration = 1.0


@dataclass(frozen=True)
class SamplesStopped(Fault):
    """No more samples."""


@dataclass(frozen=True)
class SamplesDropped(Fault):
    """Samples are lost: some, and all that are waiting to be read.

    Parameters
    ----------
    samples
        Number of them.
    """

    samples: Samples = 10


@dataclass(frozen=True)
class SamplesDelayed(Fault):
    """Samples come late.

    Parameters
    ----------
    delay
        Delay [s].
    """

    delay: PositiveTime = 0.2
