"""Interface of the hardware of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from numpy import float64, int64
from numpy.typing import NDArray


class AnalogChannel(NamedTuple):
    """Analog input or output of a rig, in volts.

    Attributes
    ----------
    name
        "force", "pressure", "angle", "pressure1" ... of an input; "valve", "valve1", "valve2" of an output.
    low, high
        Range of the converter [V].
    where
        Terminal, such as "Dev1/ai0".
    """

    name: str
    low: float
    high: float
    where: str = ""


class Block(NamedTuple):
    """Consecutive samples of all channels.

    Attributes
    ----------
    first
        Number of the first sample since the backend was opened; above the expected number if samples were dropped.
    time
        Time since the backend was opened [s], by its clock, shape (samples,).
    volts
        Shape (samples, channels), in the order of `Backend.inputs`.
    pulses
        Position of the motor in pulses since it was opened, positive = stretching, shape (samples,); zeros without a
        motor.
    """

    first: int
    time: NDArray[float64]
    volts: NDArray[float64]
    pulses: NDArray[int64]


@runtime_checkable
class Backend(Protocol):
    """Sensors and valves of a rig, simulated or physical, in volts.

    A backend is vented and at rest when it is opened. Its watchdog expires when `heartbeat` was not called for
    `patience` seconds (by its own clock): then it vents and stops by itself, until it is reopened.
    """

    rate: float
    """Sampling rate of each input [Hz]."""

    patience: float
    """Timeout of the watchdog [s]."""

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
        """Open the devices; vented, at rest, the clock at 0.

        Raises
        ------
        RigError
            If a driver or a device is missing.
        """
        ...

    def clock(self) -> float:
        """Time since it was opened [s]."""
        ...

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Wait for a number of samples, and return them.

        Raises
        ------
        SilentError
            If they have not come within the timeout [s] after their duration.
        RigError
            If the device is lost.
        """
        ...

    def set_valves(self, volts: Sequence[float]) -> None:
        """Set the signals of the valves [V], one per output."""
        ...

    def heartbeat(self) -> None:
        """Reset the watchdog."""
        ...

    def vent(self) -> None:
        """Vent at once. May be called at any time, repeatedly; never raises."""
        ...

    def close(self) -> None:
        """Vent, stop, and close the devices. Never raises."""
        ...


@runtime_checkable
class MovingBackend(Backend, Protocol):
    """A backend with a motor that stretches the muscle."""

    def move(self, pulses: int, rate: float) -> None:
        """Begin a move by a number of pulses, positive = stretching, at a rate [Hz]; returns at once.

        Raises
        ------
        RigError
            If it is moving, or the rate is too high.
        """
        ...

    @property
    def moving(self) -> bool:
        """Whether the motor is moving."""
        ...

    def stop(self) -> None:
        """Stop the motor at once. Never raises."""
        ...


class Watchdog:
    """Watchdog of a rig: expires where it is not reset within a timeout, and stays so until it is started again.

    Parameters
    ----------
    timeout
        [s].
    """

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
