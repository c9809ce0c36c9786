"""Interface of the hardware of a rig, and of the rig that a protocol file names."""

from __future__ import annotations

import abc
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import ClassVar, NamedTuple, Self

from numpy import asarray, float64
from numpy.typing import ArrayLike, NDArray
from pydantic import ConfigDict, field_validator, model_validator

from mckibben.component.base import check_fields
from mckibben.component.classes import Keyed
from mckibben.config.model import ConfigModel, fail_validation
from mckibben.errors import RigError
from mckibben.rig.bench import FASTEST
from mckibben.units import bar, deg, mm, ms

SHOWN = {"Pa": ("bar", bar), "rad": ("deg", deg), "m": ("mm", mm)}
"""Units in messages by those of channels, with their scales."""
_UNITS = {"angle": ("rad", "m"), "force": ("N",), "pressure": ("Pa",), "valve": ("Pa",)}


class Channel(NamedTuple):
    """Sensor or valve of a rig.

    Attributes
    ----------
    name
        "force", "pressure", "angle", "pressure1", "angle.hip" ... of an input; "valve", "valve1", "valve.hip1" ... of
        an output.
    unit
        SI unit of its values.
    low, high
        Range of a working sensor, or of the commands of a valve, in the unit; a reading outside is of a lost sensor.
    where
        Terminal, such as "Dev1/ai0".
    """

    name: str
    unit: str
    low: float = -math.inf
    high: float = math.inf
    where: str = ""

    @property
    def quantity(self) -> str:
        """Its name without that of the joint or muscle, such as "pressure".

        >>> [Channel(name, "Pa").quantity for name in ("pressure", "pressure1", "pressure.hip1")]
        ['pressure', 'pressure', 'pressure']
        """
        return self.name.partition(".")[0].rstrip("12")


def check_unit(channel: Channel, *units: str) -> None:
    """Raise `RigError` unless a channel is in one of some SI units."""
    if channel.unit not in units:
        message = f"{channel.name} is in {channel.unit}, and has to be in {' or '.join(units)}"
        raise RigError(message, field=channel.name, remedy="give its gain, offset and range in SI")


class ScaledChannel(ConfigModel):
    """Line from the numbers of a device (counts, volts) to SI: value = gain * number + offset.

    Attributes
    ----------
    gain, offset, unit
        The line; the gain is negative for a sensor that is wired in reverse. SI unit, such as Pa, N, rad.
    low, high
        Range of a working sensor, or of the commands of a valve, in SI.
    """

    model_config = ConfigDict(strict=False, allow_inf_nan=False)  # numbers of YAML are text

    gain: float
    offset: float = 0.0
    unit: str
    low: float
    high: float

    @field_validator("gain")
    @classmethod
    def _nonzero(cls, gain: float) -> float:
        return gain or fail_validation("is no line", "give SI units per count or volt")

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if not self.low < self.high:
            fail_validation(f"is not below high, {self.high:g}", "give the lower end first", field="low")
        return self

    def si(self, numbers: ArrayLike) -> NDArray[float64]:
        """Quantity in SI; any shape."""
        return asarray(numbers, float64) * self.gain + self.offset

    def raw(self, si: ArrayLike) -> NDArray[float64]:
        """Numbers of the device; any shape."""
        return (asarray(si, float64) - self.offset) / self.gain


class Block(NamedTuple):
    """Consecutive samples of all inputs.

    Attributes
    ----------
    first
        Number of the first sample since opening; above the expected one if samples were dropped.
    time
        Times since opening [s] by the clock of the backend, shape (samples,).
    values
        Readings in the units of the inputs, shape (samples, inputs), in the order of `Backend.inputs`.
    position
        Position of the motor [m] since opening, positive = stretched, shape (samples,); zeros without a motor.
    """

    first: int
    time: NDArray[float64]
    values: NDArray[float64]
    position: NDArray[float64]


class ChannelStatus(NamedTuple):
    """Status of a channel, device or driver: its reading as text, or its problem and the remedy."""

    name: str
    where: str
    reading: str
    problem: str = ""


class Backend(abc.ABC):
    """Sensors and valves of a rig, in SI.

    A backend is vented when it is opened, and by its watchdog when `heartbeat` is not called within `patience`.
    Subclasses give the channels, and `open`, `clock`, `read`, `set_valves`, `heartbeat`, `vent`, `close`.
    """

    physical: ClassVar[bool] = True
    """Whether real air is under pressure."""
    paced: bool = True
    """Whether its clock is real time."""

    rate: float
    """Sampling rate of each input [Hz]."""
    patience: float
    """Timeout of the watchdog [s], by the clock of the rig; an expired watchdog stays expired until it is reopened."""

    @property
    @abc.abstractmethod
    def inputs(self) -> Sequence[Channel]:
        """Inputs, in the order of the columns of a block."""

    @property
    @abc.abstractmethod
    def outputs(self) -> Sequence[Channel]:
        """Valves, in the order of the values of `set_valves`."""

    @property
    @abc.abstractmethod
    def description(self) -> Mapping[str, str]:
        """Description for the record: kind, devices, serial numbers, driver and versions, seed."""

    @abc.abstractmethod
    def open(self) -> None:
        """Open the devices: vented, at rest, the clock at 0.

        Raises
        ------
        RigError
            If a driver or a device is missing.
        """

    @abc.abstractmethod
    def clock(self) -> float:
        """Time since it was opened [s]."""

    @abc.abstractmethod
    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Wait for samples and return them.

        Parameters
        ----------
        count
            Number of samples of each input.
        timeout
            Longest wait [s] after the last of them is due.

        Raises
        ------
        SilentError
            If they are later.
        RigError
            If the device is lost, or samples were overwritten.
        """

    @abc.abstractmethod
    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressures of the valves [Pa], one per output."""

    @abc.abstractmethod
    def heartbeat(self) -> None:
        """Reset the watchdog."""

    @abc.abstractmethod
    def vent(self) -> None:
        """Vent at once. May be called at any time, repeatedly; never raises."""

    @abc.abstractmethod
    def close(self) -> None:
        """Vent, stop, and close the devices. Never raises."""

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Context in which it is open; closed if it cannot be opened, and vented and closed at the end.

        Raises
        ------
        RigError
            As `open`; or if a channel of a joint or a bench has another unit than limits and commands.
        """
        try:
            self.open()
            for channel in (*self.inputs, *self.outputs):
                check_unit(channel, *_UNITS.get(channel.quantity, (channel.unit,)))
        except BaseException:
            self.close()
            raise
        try:
            yield
        finally:
            try:
                self.vent()
            finally:  # even if another signal arrives in between
                self.close()

    @property
    def latency(self) -> float:
        """Longest time [s] by which `clock` can be behind, as a line delays the samples; 0 without one."""
        return 0.0

    @property
    def losses(self) -> str:
        """Losses on the way to the hardware so far, none of them fatal; empty if there are none."""
        return ""

    def status(self) -> Iterator[ChannelStatus]:
        """Status of its channels, vented and at rest; by default, each sensor is read for 0.1 s."""
        kind = self.description["kind"]
        yield ChannelStatus("rig", "", f"{kind}, {self.rate:g} Hz, watchdog timeout {self.patience:g} s")
        with self.opened():
            block = self.read(max(1, round(0.1 * self.rate)))
            if self.latency:
                yield ChannelStatus("line", "", f"a message and its answer take {self.latency / ms:.3g} ms")
        for channel, read in zip(self.inputs, block.values.T, strict=True):
            unit, scale = SHOWN.get(channel.unit, (channel.unit, 1.0))
            reading = f"{read.mean() / scale:.4g} {unit} (noise {read.std() / scale:.2g})"
            works = ((read >= channel.low) & (read <= channel.high)).all()
            problem = "" if works else f"{reading}, lost: check its plug and its supply"
            yield ChannelStatus(channel.name, channel.where, reading, problem)
        for channel in self.outputs:
            unit, scale = SHOWN.get(channel.unit, (channel.unit, 1.0))
            ends = f"{channel.low / scale:g}..{channel.high / scale:g} {unit}"
            yield ChannelStatus(channel.name, channel.where, ends if channel.high < math.inf else "no known range")


class MuscleRig(Keyed, abc.ABC):
    """Rig of a protocol file: a backend, or the settings of one."""

    physical: ClassVar[bool] = True
    """Whether it moves a real muscle."""

    @abc.abstractmethod
    def backend(self, session: int = 0) -> MovingBackend:
        """Return the backend, closed; `session` counts the resumptions of the test."""


class MovingBackend(Backend, MuscleRig):
    """A backend with a motor that stretches the muscle; a protocol can name a dataclass that derives from it."""

    homed: bool = False
    """Whether opening it moves the motor to the mounted position of the muscle."""
    supply: float = math.inf
    """Highest pressure that its supply and its regulator can give [Pa], if known."""
    by_hand: bool = False
    """Whether an operator moves the muscle when asked, see `HandBench`."""

    fastest: float = FASTEST
    """Highest speed of its motor [m/s]."""

    def __post_init__(self) -> None:
        check_fields(self)

    def backend(self, session: int = 0) -> MovingBackend:
        return self

    @abc.abstractmethod
    def move(self, distance: float, speed: float) -> None:
        """Begin a move and return.

        Parameters
        ----------
        distance
            Distance [m], positive = stretching.
        speed
            Speed [m/s].

        Raises
        ------
        RigError
            If the motor is moving already, or cannot run at this speed.
        """

    @property
    @abc.abstractmethod
    def moving(self) -> bool:
        """Whether the motor is moving."""

    @abc.abstractmethod
    def stop(self) -> None:
        """Stop the motor at once. Never raises."""


class Watchdog:
    """Watchdog of a rig: expires without a reset within a timeout, and stays expired until it is started again.

    Parameters
    ----------
    timeout
        Longest time between two heartbeats [s].

    Examples
    --------
    >>> watchdog = Watchdog(0.5)
    >>> watchdog.start(0.0)
    >>> watchdog.reset(0.4)
    >>> watchdog.expires(0.9), watchdog.expires(0.91), watchdog.has_expired
    (False, True, True)
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
        """Register a heartbeat at a time [s]; no effect once it has expired."""
        if not self.has_expired:
            self._reset_at = now

    def expires(self, now: float) -> bool:
        """Whether it has expired since the previous call, by a time [s]: True once."""
        if self.has_expired or not now > self.deadline:
            return False
        self.has_expired = True
        return True
