"""Interface of the hardware of a rig."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

from numpy import float64, int64
from numpy.typing import NDArray

from mckibben.errors import McKibbenWarning

if TYPE_CHECKING:
    from mckibben.rig.bench import Drive
    from mckibben.rig.calibration import Calibration


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


class ChannelStatus(NamedTuple):
    """Status of a channel, device or driver: its reading as text, or its problem and the remedy."""

    name: str
    where: str
    reading: str
    problem: str = ""


@runtime_checkable
class Backend(Protocol):
    """Sensors and valves of a rig, in volts; vented when opened, and by its watchdog without `heartbeat`.

    A class of one's own derives from it, so that it has the defaults of the optional members.
    """

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

    def host_watchdog(self) -> AbstractContextManager[None]:
        """Context in which the rig is vented if this process dies; by default there is none, and a warning."""
        message = f"nothing vents the {self.description['kind']} rig if this process dies, other than its own watchdog"
        warnings.warn(message, McKibbenWarning, stacklevel=3)
        return nullcontext()


@runtime_checkable
class MovingBackend(Backend, Protocol):
    """A backend with a motor that stretches the muscle."""

    @property
    def calibrations(self) -> Mapping[str, Calibration]:
        """Calibrations of the channels `force`, `pressure` and `valve`."""
        ...

    @property
    def drive(self) -> Drive:
        """The motor with its gear, by default the paper's."""
        from mckibben.rig.bench import Drive

        return Drive()

    @property
    def homed(self) -> bool:
        """Whether the motor stands where the muscle was mounted whenever it is opened; by default where it was left."""
        return False

    def status(self) -> Iterator[ChannelStatus]:
        """Status of its channels, vented and at rest: by default each sensor is read for 0.1 s."""
        yield ChannelStatus(
            "rig", "", f"{self.description['kind']}, {self.rate:g} Hz, watchdog timeout {self.patience:g} s"
        )
        self.open()
        try:
            volts = self.read(max(1, round(0.1 * self.rate))).volts
        finally:
            self.close()
        for channel, read in zip(self.inputs, volts.T, strict=True):
            calibration = self.calibrations[channel.name]
            lost = bool(calibration.lost(read, channel).any())
            reading = f"{read.mean():.4f} V, "
            shown = f"{reading}{calibration.si(read).mean():.4g} {calibration.unit}"
            problem = f"{reading}lost: check its plug and its supply" if lost else ""
            yield ChannelStatus(channel.name, channel.where, shown, problem)
        for channel in self.outputs:
            yield ChannelStatus(channel.name, channel.where, f"{channel.low:g}..{channel.high:g} V")

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
