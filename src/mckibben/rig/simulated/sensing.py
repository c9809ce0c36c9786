"""Sensors and sampling of the simulated rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RigError
from mckibben.rig.backend import Block, Channel
from mckibben.rig.simulated.faults import (
    RAIL,
    Fault,
    SamplesDelayed,
    SamplesDropped,
    SamplesStopped,
    SensorDisconnected,
)
from mckibben.rig.simulated.machine import Knots
from mckibben.rig.simulated.parts import Motor
from mckibben.units import N, bar, kPa

VALVE = Channel("valve", "Pa", 0.0, 9 * bar, "simulated regulator")
"""ITV0050-3, 0 to 9 bar; inferred from its designation, unverified."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
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
        return np.clip(read, RAIL * self.channel.low, RAIL * self.channel.high)


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


class Sampling:
    """Sensors and the buffer of their samples.

    Parameters
    ----------
    sensors
        Sensors of force and pressure, by input.
    rate
        Sampling rate of each input [Hz].
    noise
        Generator of noise.
    buffer
        Samples that wait for the host at most [s] (ours).
    """

    def __init__(
        self, sensors: Mapping[str, Sensor], rate: float, noise: np.random.Generator, *, buffer: float = 10.0
    ) -> None:
        self.rate, self._buffer = rate, buffer
        self.next = 0  # number of the next sample to read
        self.delay = 0.0  # s
        self._noise, self._sensors = noise, sensors
        self._disconnected: dict[str, SensorDisconnected] = {}
        self._sigma = np.array([sensor.noise for sensor in sensors.values()])
        self._began = 0.0
        self._zero = 0  # pulses then
        self._taken = 0
        self._wanted = 0
        self._overrun = False
        self._silent = False
        self._waiting: list[Block] = []

    def begin(self, now: float, pulses: int) -> None:
        """Begin the count of samples, time and pulses."""
        self._began, self._zero = now, pulses
        self._taken = self.next = 0
        self._overrun = False
        self._waiting = []

    def due(self, count: int) -> float:
        """Time at which the next samples are taken [s], since it began."""
        return (self.next + count) / self.rate

    def silent(self, count: int) -> bool:
        """Whether the next samples will never come."""
        return self._silent and self._taken < self.next + count

    def want(self, count: int) -> None:
        """Announce a read of a number of samples: the buffer is at least as long."""
        self._wanted = count

    def sample(self, knots: Knots, motor: Motor) -> None:
        """Take the samples between the first and the last knot."""
        last = math.ceil((knots.time[-1] - self._began) * self.rate - 1e-6)
        if self._silent or last <= self._taken:
            return
        first, self._taken = max(self._taken, self.next), last
        if last <= first:
            return
        if last - self.next > max(self._buffer * self.rate, self._wanted):
            self._overrun, self._waiting = True, []
            return
        since = np.arange(first, last) / self.rate
        time = since + self._began
        noise = self._noise.standard_normal((last - first, len(self._sigma))) * self._sigma
        truths = (np.interp(time, knots.time, truth) for truth in (knots.force, knots.pressure))
        columns = zip(self._sensors, truths, noise.T, strict=True)
        values = np.stack([self._values(name, time, truth, column) for name, truth, column in columns], axis=1)
        self._waiting.append(Block(first, since, values, motor.counted(time) - self._zero))

    def _values(
        self, name: str, time: NDArray[np.float64], truth: NDArray[np.float64], noise: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Readings of a sensor, connected or not."""
        sensor, fault = self._sensors[name], self._disconnected.get(name)
        if fault is None:
            return sensor.values(truth, noise)
        read = fault.values_at(time, RAIL * sensor.channel.high)
        return read if fault.value is not None else read + noise

    def take(self, count: int) -> Block:
        """Return the next samples of the buffer.

        Raises
        ------
        RigError
            If they were overwritten.
        """
        if self._overrun:
            raise RigError(
                f"samples were overwritten: the host did not read for more than {self._buffer:g} s",
                remedy="reopen the rig",
            )
        waiting, first = self._waiting, self.next
        self.next += count
        time, values, pulses = (np.concatenate(parts) for parts in list(zip(*waiting, strict=True))[1:])
        rest = Block(self.next, time[count:], values[count:], pulses[count:])
        self._waiting = [rest] if len(rest.time) else []
        return Block(first, time[:count], values[:count], pulses[:count])

    def forget(self) -> None:
        """Clear the buffer."""
        self._waiting = []

    def apply(self, fault: Fault) -> None:
        """Apply a fault of sensors or card."""
        match fault:
            case SensorDisconnected():
                self._disconnected[fault.sensor] = fault
            case SamplesStopped():
                self._silent = True
            case SamplesDelayed(delay=delay):
                self.delay += delay
            case SamplesDropped(samples=samples):
                self.next = max(self.next, self._taken + samples)
                self._waiting = []
