"""Simulated hardware: sensors, samples, watchdog and clock, around a plant over time."""

from __future__ import annotations

import abc
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import Checked
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError, RigError
from mckibben.rig.backend import Backend, Block, Channel, Watchdog
from mckibben.units import N, bar, kPa

INSTANT = 1e-9
"""Tolerance of times [s]."""

_RAIL = 1.02  # reading of a lost sensor over the end of its range


@dataclass(frozen=True, kw_only=True)
class Sensor(Checked):
    """Sensor with its converter; readings end 2 % beyond its range.

    Parameters
    ----------
    channel
        Its name, unit and range.
    noise
        Standard deviation of a sample, white, in its unit.
    resolution
        Step of its readings, in its unit; 0 for none.
    """

    channel: Channel
    noise: float = 0.0
    resolution: float = 0.0

    def values(self, truth: NDArray[np.float64], noise: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the readings of a true value; arguments in the unit, each of shape (samples,)."""
        read = truth + noise
        if self.resolution:
            read = np.rint(read / self.resolution) * self.resolution
        return np.minimum(np.maximum(read, _RAIL * self.channel.low), _RAIL * self.channel.high)  # as clip, sooner


FORCE_SENSOR = Sensor(
    channel=Channel("force", "N", -2000 * N, 2000 * N, "simulated force"), noise=0.5 * N, resolution=4000 / 2**18
)
"""TSH-200, 200 kg, on 18 bits of 20 V; the noise is ours, 0.03 % of the sensor, as in `SimulatedIsobaricTest`."""

PRESSURE_SENSOR = Sensor(
    channel=Channel("pressure", "Pa", -0.2 * bar, 10 * bar, "simulated pressure"),
    noise=0.5 * kPa,
    resolution=20 * bar / 2**18,
)
"""SDE1-D10, 10 bar, on 18 bits of 20 V; the noise is ours, 0.05 % of the sensor, as in `SimulatedIsobaricTest`."""


class SimulatedBackend(Backend, abc.ABC):
    """A plant behind the interface of hardware: sensors, one clock for all samples, and a watchdog.

    Sample k is taken k periods after it was opened; samples wait for the host in a buffer. Time advances only in `read`
    and `pass_time`, unless it is paced by real time. A missed heartbeat vents, and holds until it is reopened.

    Parameters
    ----------
    sensors
        Sensors, one per input.
    rate, patience
        Sampling rate of each input [Hz], timeout of the watchdog [s].
    paced
        Whether it runs in real time.
    seed
        Seed of the noise.
    wall, sleep
        Clock of real time [s], and function that sleeps for a time [s].
    buffer
        Samples that wait for the host at most [s] (ours).

    Raises
    ------
    RangeError
        If a number is out of range.
    """

    physical = False
    immediate = False
    """Whether a sample is there at its own time; otherwise a period later."""

    def __init__(
        self,
        sensors: Sequence[Sensor],
        *,
        rate: float,
        patience: float,
        paced: bool = False,
        seed: int = 0,
        wall: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
        buffer: float = 10.0,
    ) -> None:
        name = type(self).__name__
        check_positive(name, "Hz", rate=rate)
        check_positive(name, "s", patience=patience)
        check_positive(name, zero=True, seed=seed)
        self.sensors, self.seed = tuple(sensors), seed
        self.rate, self.patience, self.paced = float(rate), float(patience), paced
        self.now = 0.0  # since it was first opened [s]
        self.is_open = False
        self._wall, self._sleep, self._buffer = wall, sleep, buffer
        self._opened, self._began = 0.0, wall()
        self._watchdog = Watchdog(self.patience)
        self._noise, self._random = np.random.default_rng(seed).spawn(2)
        self._next = self._taken = self._wanted = 0  # samples
        self._overrun = False
        self._waiting: list[Block] = []

    @abc.abstractmethod
    def _truth(self) -> tuple[float, ...]:
        """Present values of the inputs."""

    @abc.abstractmethod
    def _integrate(self, until: float) -> tuple[list[float], list[tuple[float, ...]]]:
        """Advance the plant and `now` to a time [s] without events; times and values, linear in between."""

    @abc.abstractmethod
    def _rest(self) -> None:
        """Vent and stop the plant."""

    def _next_event(self) -> float:
        """Time of the next event of the plant [s]."""
        return math.inf

    def _settle(self) -> None:
        """Apply the events of the plant that are due."""

    def _begin(self) -> None:
        """Prepare the plant for being opened."""

    def _positions(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions of a motor [m] since it was opened, at times [s] since it was first opened."""
        return np.zeros(len(times))

    @property
    def inputs(self) -> Sequence[Channel]:
        return tuple(sensor.channel for sensor in self.sensors)

    @property
    def description(self) -> Mapping[str, str]:
        """Its sensors and seed."""
        sensors = {f"{sensor.channel.name} sensor": repr(sensor) for sensor in self.sensors}
        return {**sensors, "seed": str(self.seed)}

    def open(self) -> None:
        if self.is_open:
            raise RigError("the simulated rig is already open", remedy="close it first")
        self._rest()
        self._begin()
        self.is_open = True
        self._opened, self._began = self.now, self._wall()
        self._watchdog.start(self.now)
        self._next = self._taken = 0
        self._overrun, self._waiting = False, []
        self._sample([self.now], [self._truth()])

    def clock(self) -> float:
        return self._wall() - self._began if self.paced else self.now - self._opened

    def pass_time(self, duration: float) -> None:
        """Advance the time [s] without a host; samples are buffered."""
        self._advance(self.now + duration)

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self._check_open()
        if count < 1:
            raise RangeError(f"{count} samples cannot be read", value=count, lower=1)
        self._wanted = count
        self._catch_up()
        while self._taken < self._next + count or self.now < self._due(count) - INSTANT:
            self._wait(self._due(count))
        return self._take(count)

    def heartbeat(self) -> None:
        self._catch_up()
        self._watchdog.reset(self.now)

    def close(self) -> None:
        """Vent, stop, and close. Its time stands still until `pass_time`. Never raises."""
        self._catch_up()
        self._rest()
        self.is_open, self._waiting = False, []

    def _due(self, count: int) -> float:
        """Time at which the last of the next samples is there [s]."""
        return self._opened + (self._next + count - self.immediate) / self.rate

    def _wait(self, until: float) -> None:
        """Advance to a time [s], if it is paced with the wall."""
        while self.paced and (left := until - self._opened - self.clock()) > 1e-6:
            self._sleep(left)
        self._advance(until)

    def _catch_up(self) -> None:
        """Advance the time to that of the host, if it is paced."""
        if self.paced:
            self._advance(self._opened + self.clock())

    def _check_open(self) -> None:
        if not self.is_open:
            raise RigError("the simulated rig is not open", remedy="open it first")

    def _check_armed(self) -> None:
        self._catch_up()
        self._check_open()
        if self._watchdog.has_expired:
            raise RigError(
                f"the rig vented and stopped by itself, without a heartbeat for {self.patience:g} s",
                remedy="reopen it, and send heartbeats in time",
            )

    def _advance(self, to: float) -> None:
        """Advance the time to a time [s], from event to event."""
        while self.now < to - INSTANT:
            armed = self.is_open and not self._watchdog.has_expired
            expiry = self._watchdog.deadline if armed else math.inf
            until = min(to, expiry, self._next_event())
            if until > self.now:
                knots = self._integrate(until)
                if self.is_open:
                    self._sample(*knots)
            if armed and self._watchdog.expires(self.now + 2 * INSTANT):
                self._rest()
            self._settle()

    def _sample(self, times: list[float], values: list[tuple[float, ...]]) -> None:
        """Take the samples up to the last of the times between which the inputs are linear."""
        last = math.ceil((times[-1] - self._opened) * self.rate + (1e-6 if self.immediate else -1e-6))
        first, self._taken = self._taken, max(last, self._taken)
        if last <= first:
            return
        if last - self._next > max(self._buffer * self.rate, self._wanted):
            self._overrun, self._waiting = True, []
            return
        since = np.arange(first, last) / self.rate
        at, noise = since + self._opened, self._noise.standard_normal((last - first, len(self.sensors)))
        columns = zip(self.sensors, np.array(values).T, noise.T, strict=True)
        knots = np.array(times)
        read = [sensor.values(np.interp(at, knots, truth), white * sensor.noise) for sensor, truth, white in columns]
        self._waiting.append(Block(first, since, np.array(read).T, self._positions(at)))

    def _take(self, count: int) -> Block:
        """Return the next samples of the buffer; `RigError` if they were overwritten."""
        if self._overrun:
            message = f"samples were overwritten: the host did not read for more than {self._buffer:g} s"
            raise RigError(message, remedy="reopen the rig")
        first, self._next = self._next, self._next + count
        if len(self._waiting) == 1 and len(self._waiting[0].time) == count:
            return self._waiting.pop()
        times, values, positions = (np.concatenate(parts) for parts in list(zip(*self._waiting, strict=True))[1:])
        later = Block(self._next, times[count:], values[count:], positions[count:])
        self._waiting = [later] if len(later.time) else []
        return Block(first, times[:count], values[:count], positions[:count])
