"""Sensors and sampling of the simulated rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RigError
from mckibben.rig.backend import Block, Channel
from mckibben.rig.simulated.faults import Fault, SamplesDelayed, SamplesDropped, SamplesStopped, SensorDisconnected
from mckibben.rig.simulated.machine import Knots
from mckibben.rig.simulated.parts import Motor
from mckibben.units import N, bar, kPa

_HOUR = 3600.0
_WANDER = 10.0  # s between two points of the random walk of a zero
_RAIL = 1.02  # reading of a lost sensor over the end of its range
_BUFFER = 10.0  # s of samples that wait for the host at most (ours)
_ROUNDING = 1e-6  # samples

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
    drift, wander
        Drift of its zero, and standard deviation of the random walk of its zero, after an hour, in its unit.
    resolution
        Step of its readings, in its unit; 0 for none.
    gain
        Reading over the true value, of a wrong calibration.
    """

    channel: Channel
    noise: float = 0.0
    drift: float = 0.0
    wander: float = 0.0
    resolution: float = 0.0
    gain: float = 1.0


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


class SensorReadings:
    """Readings of a sensor over time.

    Parameters
    ----------
    sensor
        The sensor.
    generator
        Generator of its wander.
    """

    def __init__(self, sensor: Sensor, generator: np.random.Generator) -> None:
        self._sensor, self._generator, self._walk = sensor, generator, [0.0]
        self.disconnected: SensorDisconnected | None = None

    def values(
        self, time: NDArray[np.float64], truth: NDArray[np.float64], noise: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the readings of a true value.

        Parameters
        ----------
        time, truth, noise
            Times [s], true values and noise in the unit, each of shape (samples,).
        """
        sensor, channel = self._sensor, self._sensor.channel
        if self.disconnected is not None:
            read = self.disconnected.values_at(time, _RAIL * channel.high)
            return read if self.disconnected.value is not None else read + noise
        read = truth * sensor.gain + noise
        if sensor.drift or sensor.wander:
            read += self._zero_error(time)
        if sensor.resolution:
            read = np.rint(read / sensor.resolution) * sensor.resolution
        return np.clip(read, _RAIL * channel.low, _RAIL * channel.high)

    def _zero_error(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Drift and wander of its zero, in the unit."""
        moved = time * (self._sensor.drift / _HOUR)
        if self._sensor.wander:
            last = int(time[-1] / _WANDER) + 2
            if last > len(self._walk):
                steps = self._generator.standard_normal(last - len(self._walk))
                steps *= self._sensor.wander * math.sqrt(_WANDER / _HOUR)
                self._walk.extend((self._walk[-1] + np.cumsum(steps)).tolist())
            first = int(time[0] / _WANDER)
            near = self._walk[first:last]
            moved = moved + np.interp(time, (first + np.arange(len(near))) * _WANDER, near)
        return moved


class Sampling:
    """Sensors and the buffer of their samples.

    Parameters
    ----------
    sensors
        Sensors of force and pressure, by input.
    rate
        Sampling rate of each input [Hz].
    noise, wanders
        Generator of noise, and of the wander of each sensor.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        rate: float,
        noise: np.random.Generator,
        wanders: list[np.random.Generator],
    ) -> None:
        self.rate = rate
        self.next = 0  # number of the next sample to read
        self.delay = 0.0  # s
        self._noise = noise
        self._readings = {
            name: SensorReadings(sensor, wander)
            for (name, sensor), wander in zip(sensors.items(), wanders, strict=True)
        }
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
        last = math.ceil((knots.time[-1] - self._began) * self.rate - _ROUNDING)
        if self._silent or last <= self._taken:
            return
        first, self._taken = max(self._taken, self.next), last
        if last <= first:
            return
        if last - self.next > max(_BUFFER * self.rate, self._wanted):
            self._overrun, self._waiting = True, []
            return
        since = np.arange(first, last) / self.rate
        time = since + self._began
        noise = self._noise.standard_normal((last - first, len(self._sigma))) * self._sigma
        truths = (np.interp(time, knots.time, truth) for truth in (knots.force, knots.pressure))
        columns = zip(self._readings.values(), truths, noise.T, strict=True)
        values = np.stack([readings.values(time, truth, column) for readings, truth, column in columns], axis=1)
        self._waiting.append(Block(first, since, values, motor.counted(time) - self._zero))

    def take(self, count: int) -> Block:
        """Return the next samples of the buffer.

        Raises
        ------
        RigError
            If they were overwritten.
        """
        if self._overrun:
            raise RigError(
                f"samples were overwritten: the host did not read for more than {_BUFFER:g} s",
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
                self._readings[fault.sensor].disconnected = fault
            case SamplesStopped():
                self._silent = True
            case SamplesDelayed(delay=delay):
                self.delay += delay
            case SamplesDropped(samples=samples):
                self.next = max(self.next, self._taken + samples)
                self._waiting = []
            case _:
                pass
