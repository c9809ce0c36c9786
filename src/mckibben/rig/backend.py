"""Interface of the hardware of a rig."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from numpy import float64, int64
from numpy.typing import NDArray


class AnalogChannel(NamedTuple):
    """One input or output of a rig, in volts; what the volts mean is the calibration's to say.

    Attributes
    ----------
    name
        "force", "pressure", "angle", "pressure1" ... of an input; "valve", "valve1", "valve2" of an output.
    low, high
        What the converter can tell or give [V].
    where
        What it is connected to, in words or as an address: "Dev1/ai0".
    """

    name: str
    low: float
    high: float
    where: str = ""


class Block(NamedTuple):
    """Samples in a row, all channels at once.

    Attributes
    ----------
    first
        Number of the first sample since the backend was opened. One that is more than the number expected tells of
        samples that were dropped.
    time
        By the clock of the backend, since it was opened [s], shape (samples,).
    volts
        Shape (samples, channels), in the order of `Backend.inputs`.
    pulses
        Where the motor stood, in pulses since it was opened, positive = stretching, shape (samples,). Zeros where there
        is no motor.
    """

    first: int
    time: NDArray[float64]
    volts: NDArray[float64]
    pulses: NDArray[int64]


@runtime_checkable
class Backend(Protocol):
    """Sensors and valves. What every rig has, virtual or real; all of it in volts.

    A backend is vented and at rest when it is opened, and whenever the host has not called `heartbeat` for `patience`
    seconds (by its own clock): then it vents and stops without being told, and stays so until it is opened anew.
    """

    rate: float
    """Samples a second [Hz] of each input."""

    patience: float
    """How long [s] it goes on without a heartbeat."""

    @property
    def inputs(self) -> Sequence[AnalogChannel]:
        """What is measured, in the order of the columns of a block."""
        ...

    @property
    def outputs(self) -> Sequence[AnalogChannel]:
        """The valves, in the order of the values that `set_valves` takes."""
        ...

    @property
    def description(self) -> Mapping[str, str]:
        """What it is, for the record: kind, devices, serial numbers, driver and versions, seed."""
        ...

    def open(self) -> None:
        """Take hold of the devices; vented, at rest, the clock at 0.

        Raises
        ------
        RigError
            If a driver or a device is missing; it says which, and what to do.
        """
        ...

    def clock(self) -> float:
        """Since it was opened [s]."""
        ...

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Wait for so many samples, and take them.

        Raises
        ------
        SilentError
            If they have not come after the timeout [s] beyond the time that they take.
        RigError
            If the device is lost.
        """
        ...

    def set_valves(self, volts: Sequence[float]) -> None:
        """Hold these signals at the valves [V], one an output."""
        ...

    def heartbeat(self) -> None:
        """Reset the watchdog."""
        ...

    def vent(self) -> None:
        """Let all air out, at once. May be called at any time and as often as one likes; never raises."""
        ...

    def close(self) -> None:
        """Vent, stop, and let go of the devices. Never raises."""
        ...


@runtime_checkable
class MovingBackend(Backend, Protocol):
    """A backend with a motor that stretches the muscle."""

    def move(self, pulses: int, rate: float) -> None:
        """Begin to move by so many pulses, positive = stretching, at so many a second; returns at once.

        Raises
        ------
        RigError
            If it is still moving, or the motor cannot go at that rate.
        """
        ...

    @property
    def moving(self) -> bool:
        """Whether it still is."""
        ...

    def stop(self) -> None:
        """Stand still, at once. Never raises."""
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
