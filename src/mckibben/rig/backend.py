"""Interface of the hardware of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from numpy import float64, int64
from numpy.typing import NDArray


class AnalogChannel(NamedTuple):
    """Analog input or output: its name, the range of the converter [V], and its terminal, such as "Dev1/ai0"."""

    name: str  # "force", "pressure", "angle", "pressure1" ... of an input; "valve", "valve1", "valve2" of an output
    low: float
    high: float
    where: str = ""


class Block(NamedTuple):
    """Consecutive samples of all channels."""

    first: int  # number of the first sample since opening; above the expected one if samples were dropped
    time: NDArray[float64]  # since opening [s], by the clock of the backend, shape (samples,)
    volts: NDArray[float64]  # shape (samples, channels), in the order of `Backend.inputs`
    pulses: NDArray[int64]  # of the motor since opening, positive = stretching, shape (samples,); zeros without a motor


@runtime_checkable
class Backend(Protocol):
    """Sensors and valves of a rig, in volts; vented when opened, and by its watchdog without `heartbeat`."""

    rate: float  # sampling rate of each input [Hz]

    patience: float  # timeout of the watchdog [s], by the clock of the rig; until it is reopened

    @property
    def inputs(self) -> Sequence[AnalogChannel]:
        """Inputs, in the order of the columns of a block."""
        ...

    @property
    def outputs(self) -> Sequence[AnalogChannel]:
        """Valves, in the order of the values of `set_valves`."""
        ...

    @property
    def description(self) -> Mapping[str, str]:
        """Description for the record: kind, devices, serial numbers, driver and versions, seed."""
        ...

    def open(self) -> None:
        """Open the devices; vented, at rest, the clock at 0. `RigError` if a driver or a device is missing."""

    def clock(self) -> float:
        """Time since it was opened [s]."""
        ...

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Wait for samples; `SilentError` if they are later than the timeout [s], `RigError` if the device is lost."""
        ...

    def set_valves(self, volts: Sequence[float]) -> None:
        """Set the signals of the valves [V], one per output."""

    def heartbeat(self) -> None:
        """Reset the watchdog."""

    def vent(self) -> None:
        """Vent at once. May be called at any time, repeatedly; never raises."""

    def close(self) -> None:
        """Vent, stop, and close the devices. Never raises."""


@runtime_checkable
class MovingBackend(Backend, Protocol):
    """A backend with a motor that stretches the muscle."""

    def move(self, pulses: int, rate: float) -> None:
        """Begin a move by pulses, positive = stretching, at a rate [Hz]; `RigError` if it is moving already."""

    @property
    def moving(self) -> bool:
        """Whether the motor is moving."""
        ...

    def stop(self) -> None:
        """Stop the motor at once. Never raises."""


class Watchdog:
    """Watchdog of a rig: expires without a reset within a timeout [s], and stays so until it is started again."""

    def __init__(self, timeout: float) -> None:
        self.timeout = timeout
        self.has_expired = False
        self._reset_at = 0.0

    @property
    def deadline(self) -> float:
        """Time at which it expires [s]."""
        return self._reset_at + self.timeout

    def start(self, now: float) -> None:
        """Start at a time [s]."""
        self.has_expired, self._reset_at = False, now

    def reset(self, now: float) -> None:
        """Take a heartbeat at a time [s]; no effect once it has expired."""
        if not self.has_expired:
            self._reset_at = now

    def expires(self, now: float) -> bool:
        """Whether it expires just now [s]: True once."""
        if self.has_expired or not now > self.deadline:
            return False
        self.has_expired = True
        return True
