"""The watch over a test: every block of samples goes past it before anything else is done with it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mckibben.errors import RangeError, StoppedError
from mckibben.rig.backend import AnalogChannel, Block, Drive
from mckibben.rig.calibration import Calibration
from mckibben.units import bar, mm, ms, s


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What may not be exceeded; a single sample beyond stops a test.

    Parameters
    ----------
    pressure
        Highest [Pa, gauge].
    force
        Highest [N].
    stretch, shorten
        How far the rig may go from where the muscle was mounted [m], either way.
    pressure_rate
        How fast the pressure may change [Pa/s], from the mean over one cycle to the next: 50 bar/s. Venting may be
        faster.
    pressure_error
        How far the pressure may be from the one that was set [Pa] once it had the time to get there: 0.3 bar.
    settling
        That time [s]: 10 s. A regulator without supply, or a muscle that has burst, is found by it.
    gap
        How long there may be no readings [s], or how old they may be when they come: 0.5 s.
    frozen
        For how long a sensor may give the very same volts [s] until it counts as lost; no limit unless given. Give one
        where readings have noise.
    deviation
        How far the mean force of a point may be from the law [N], where the muscle has one; no limit unless given. A
        motor that stands, a muscle that slipped, and a force sensor that hangs are found by it.

    Raises
    ------
    RangeError
        If one is not above 0, or one that has to be there is not finite.
    """

    pressure: float
    force: float
    stretch: float
    shorten: float
    pressure_rate: float = 50 * bar / s
    pressure_error: float = 0.3 * bar
    settling: float = 10 * s
    gap: float = 500 * ms
    frozen: float = math.inf
    deviation: float = math.inf

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0 or (value == math.inf and name not in ("frozen", "deviation")):
                raise RangeError(f"limits: {name} is {value:g}", value=value, remedy="it has to be finite and above 0")


class BlockMeans(NamedTuple):
    """What a block says.

    Attributes
    ----------
    time
        Of its last sample [s].
    force, pressure
        Means over it [N], [Pa].
    position
        Where the motor stood at its end [m], positive = stretched.
    """

    time: float
    force: float
    pressure: float
    position: float


class Watch:
    """Looks at each block, and raises if the test has to stop.

    Parameters
    ----------
    limits
        What may not be exceeded.
    inputs
        Of the backend; "force" and "pressure" among them.
    calibrations
        Of those two.
    drive
        Of the motor.
    origin
        Where the motor stood when the backend was opened [pulses], from where the muscle was mounted.

    Attributes
    ----------
    sums
        Of the volts of each input over the block that was looked at last.

    Raises
    ------
    StoppedError
        From `look`: it says what was exceeded.
    """

    def __init__(
        self,
        limits: Limits,
        inputs: Sequence[AnalogChannel],
        calibrations: Mapping[str, Calibration],
        drive: Drive,
        origin: int = 0,
    ) -> None:
        self.limits = limits
        self._ends: list[tuple[int, str, float, float]] = []
        for at, channel in enumerate(inputs):
            if channel.name in calibrations:
                low, high = calibrations[channel.name].limits
                # at a rail the converter can tell nothing, so that those volts themselves are out
                self._ends.append((at, channel.name, max(low, _above(channel.low)), min(high, _below(channel.high))))
        names = [channel.name for channel in inputs]
        self._force, self._pressure = names.index("force"), names.index("pressure")
        self._lines = tuple(
            (calibrations[name].gain, float(calibrations[name].si(0.0))) for name in ("force", "pressure")
        )
        self._per_metre = drive.pulses_per_metre
        self._origin = origin
        self._time: float | None = None
        self._mean: tuple[float, float] | None = None
        self._venting_until = -math.inf
        self.set_pressure: float | None = None
        self.sums = np.zeros(len(inputs))
        self._same: dict[int, tuple[float, float]] = {}
        self.since = 0.0

    def expect(self, pressure: float | None, time: float, *, venting: bool = False) -> None:
        """A pressure [Pa] was set at this time [s]; None is any, as while it ramps."""
        self.set_pressure, self.since = pressure, time
        if venting:
            self._venting_until = time + self.limits.settling

    def look(self, block: Block, clock: float) -> BlockMeans:
        """Means of a block, if nothing is wrong with it.

        Parameters
        ----------
        block
            As read.
        clock
            The backend's, after it was read [s].
        """
        limits = self.limits
        columns = np.ascontiguousarray(block.volts.T)  # along which NumPy is several times as quick
        lowest, highest = columns.min(axis=1).tolist(), columns.max(axis=1).tolist()
        for at, name, low, high in self._ends:
            if not (lowest[at] >= low and highest[at] <= high):
                raise StoppedError(
                    f"the {name} sensor is lost: it gives {lowest[at]:.4g} to {highest[at]:.4g} V, and a working one "
                    f"{low:.4g} to {high:.4g} V",
                    remedy="check its plug and its supply",
                )
        if limits.frozen < math.inf:
            self._alive(lowest, highest, float(block.time[-1]))
        (gain, at_zero), (pressure_gain, pressure_at_zero) = self._lines
        self.sums = columns.sum(axis=1)
        means = (self.sums / columns.shape[1]).tolist()
        force = means[self._force] * gain + at_zero
        pressure = means[self._pressure] * pressure_gain + pressure_at_zero
        top = (highest if pressure_gain > 0 else lowest)[self._pressure] * pressure_gain + pressure_at_zero
        if top > limits.pressure:
            raise beyond("pressure", top / bar, limits.pressure / bar, "bar")
        top = (highest if gain > 0 else lowest)[self._force] * gain + at_zero
        if top > limits.force:
            raise beyond("force", top, limits.force, "N")
        pulses = block.pulses
        for end in (int(pulses[0]), int(pulses[-1])):
            position = (end + self._origin) / self._per_metre
            if position > limits.stretch + 1e-9:
                raise beyond("stretch", position / mm, limits.stretch / mm, "mm")
            if position < -limits.shorten - 1e-9:
                raise beyond("way on the short side", -position / mm, limits.shorten / mm, "mm")
        time, first = float(block.time[-1]), float(block.time[0])
        self._timely(first, time, clock)
        middle = (first + time) / 2
        if self._mean is not None and time > self._venting_until:
            before, at_time = self._mean
            rate = (pressure - before) / max(middle - at_time, 1e-9)
            if abs(rate) > limits.pressure_rate:
                raise beyond("rate of the pressure", rate / bar, limits.pressure_rate / bar, "bar/s")
        self._mean = pressure, middle
        wanted = self.set_pressure
        if wanted is not None and time > self.since + limits.settling:
            error = pressure - wanted
            if abs(error) > limits.pressure_error:
                raise StoppedError(
                    f"the pressure does not follow: {pressure / bar:.3g} bar where {wanted / bar:.3g} bar were set "
                    f"{time - self.since:.3g} s before",
                    value=pressure,
                    unit="Pa",
                    remedy="check the supply, the valve and the muscle",
                )
        return BlockMeans(time, force, pressure, position)

    def _alive(self, lowest: list[float], highest: list[float], time: float) -> None:
        for at, name, _, _ in self._ends:
            same, since = self._same.get(at, (math.nan, time))
            if not lowest[at] == highest[at] == same:
                since = time
            self._same[at] = lowest[at], since
            if time - since > self.limits.frozen:
                raise StoppedError(
                    f"the {name} sensor is lost: it has given {same:.6g} V for {time - since:.3g} s",
                    remedy="check its plug and its supply",
                )

    def _timely(self, first: float, last: float, clock: float) -> None:
        if self._time is not None and not first > self._time:
            raise StoppedError(
                f"the readings go back in time, from {self._time:.6g} s to {first:.6g} s",
                remedy="check the device and its driver",
            )
        if self._time is not None and not first - self._time <= self.limits.gap:
            raise StoppedError(
                f"no readings for {first - self._time:.3g} s: samples were dropped",
                remedy="find out what kept the device or the host busy",
            )
        self._time = last
        if not abs(clock - last) <= self.limits.gap:
            raise StoppedError(
                f"the readings are {clock - last:.3g} s old",
                remedy="find out what kept the device or the host busy",
            )


def beyond(what: str, value: float, limit: float, unit: str) -> StoppedError:
    """What stops a test whose reading is beyond a limit, both in the same unit."""
    return StoppedError(
        f"the {what} of {value:.4g} {unit} is beyond the limit of {limit:.4g} {unit}",
        value=value,
        upper=limit,
        unit=unit,
    )


def _above(volts: float) -> float:
    return math.nextafter(volts, math.inf)


def _below(volts: float) -> float:
    return math.nextafter(volts, -math.inf)
