"""The interface of a rig's hardware, and the motor of its stretching device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy import float64, int64
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import RangeError
from mckibben.numerics.checks import check_positive
from mckibben.units import mm


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


_WHOLE = 1e-6  # pulses


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A step motor, a reducer and a lead screw.

    Parameters
    ----------
    steps
        Pulses a revolution of the motor: 200 (ours; the usual motor, full steps).
    reduction
        Revolutions of the motor for one of the screw: 10 (the paper, "Experimental system").
    lead
        Way [m] of one revolution of the screw: 5 mm (the paper).
    fastest
        Pulses a second [Hz] that it follows: 2000 (ours), which is 5 mm/s.

    Raises
    ------
    RangeError
        If a number has no meaning.

    Examples
    --------
    >>> drive = Drive()
    >>> drive.pulses_per_metre, drive.pulses(1 * mm), drive.rate(0.2 * mm)
    (400000.0, 400, 80.0)
    >>> drive.pulses(1.001 * mm)
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: 1.001 mm are 400.4 pulses; take a multiple of 0.0025 mm
    """

    steps: int = 200
    reduction: float = 10.0
    lead: float = 5 * mm
    fastest: float = 2000.0

    def __post_init__(self) -> None:
        check_positive("drive", steps=float(self.steps), reduction=self.reduction)
        check_positive("drive", "m", lead=self.lead)
        check_positive("drive", "Hz", fastest=self.fastest)

    @property
    def pulses_per_metre(self) -> float:
        """Pulses for a way of a metre [1/m]; exact in the decimals that were given."""
        return float(self.steps * Fraction(str(self.reduction)) / Fraction(str(self.lead)))

    def pulses(self, way: float) -> int:
        """Pulses for a way [m].

        Raises
        ------
        RangeError
            If it is no whole number of them.
        """
        exact = way * self.pulses_per_metre
        if not np.isfinite(exact) or abs(exact - round(exact)) > _WHOLE:
            one = 1 / self.pulses_per_metre / mm
            raise RangeError(
                f"{way / mm:g} mm are {exact:g} pulses", value=way, unit="m", remedy=f"take a multiple of {one:g} mm"
            )
        return round(exact)

    def nearest(self, way: float) -> int:
        """Pulses that come nearest to a way [m]."""
        return round(way * self.pulses_per_metre)

    def way(self, pulses: ArrayLike) -> NDArray[np.float64]:
        """The way [m] of so many pulses, of any shape."""
        return np.asarray(pulses, np.float64) / self.pulses_per_metre

    def rate(self, speed: float) -> float:
        """Pulses a second [Hz] for a speed [m/s].

        Raises
        ------
        RangeError
            If the motor is not that fast.
        """
        rate = abs(speed) * self.pulses_per_metre
        if not 0 < rate <= self.fastest:
            raise RangeError(
                f"{speed / mm:g} mm/s are {rate:g} pulses a second; the motor does {self.fastest:g} at most",
                value=rate,
                lower=0.0,
                upper=self.fastest,
                unit="Hz",
                remedy=f"move at up to {self.fastest / self.pulses_per_metre / mm:g} mm/s",
            )
        return rate
