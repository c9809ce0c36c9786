"""Sensors, converters and sampling of the simulated rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.component.checks import check_positive, check_within
from mckibben.errors import RigError
from mckibben.rig.backend import Block
from mckibben.rig.calibration import Calibration
from mckibben.rig.simulated.faults import Fault, SamplesDelayed, SamplesDropped, SamplesStopped, SensorDisconnected
from mckibben.rig.simulated.machine import Knots
from mckibben.rig.simulated.parts import Motor
from mckibben.units import N, bar, kPa

_HOUR = 3600.0
_WANDER = 10.0  # s between two points of the random walk of a zero

FORCE = Calibration(
    name="force",
    unit="N",
    gain=200 * N,
    low=-2000 * N,
    high=2000 * N,
    method="TSH-200, 200 kg, behind an amplifier to 10 V; the amplifier is ours",
)
PRESSURE = Calibration(
    name="pressure",
    unit="Pa",
    gain=1 * bar,
    low=0.0,
    high=10 * bar,
    method="SDE1-D10, 0 to 10 bar at 0 to 10 V; the output is inferred from its designation, unverified",
)
VALVE = Calibration(
    name="valve",
    unit="Pa",
    gain=0.9 * bar,
    low=0.0,
    high=9 * bar,
    method="ITV0050-3, 0 to 9 bar at 0 to 10 V; inferred from its designation, unverified",
)


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """Sensor with its amplifier.

    Parameters
    ----------
    calibration
        The true calibration, which may differ from that of the host.
    noise
        Standard deviation of a sample, white, in the calibration's unit.
    drift, wander
        Drift of its zero, and standard deviation of the random walk of its zero, after an hour, in that unit.
    saturation
        Highest output of its amplifier, in both directions [V].
    """

    calibration: Calibration
    noise: float = 0.0
    drift: float = 0.0
    wander: float = 0.0
    saturation: float = 10.5

    def __post_init__(self) -> None:
        name, unit = self.calibration.name, self.calibration.unit
        check_positive(name, unit, zero=True, noise=self.noise, wander=self.wander)
        check_within(name, -1e9, 1e9, unit, drift=self.drift)
        check_positive(name, "V", saturation=self.saturation)


FORCE_SENSOR = Sensor(calibration=FORCE, noise=0.5 * N)
"""The noise is ours, 0.03 % of the sensor, as in `SimulatedIsobaricTest`."""

PRESSURE_SENSOR = Sensor(calibration=PRESSURE, noise=0.5 * kPa)
"""The noise is ours, 0.05 % of the sensor, as in `SimulatedIsobaricTest`."""


@dataclass(frozen=True, kw_only=True)
class Converter:
    """Data acquisition card such as the PCI-6281.

    Parameters
    ----------
    bits
        Resolution: 18 bits.
    low, high
        Range [V]; -10 to 10 V is its widest.
    buffer
        Length of its buffer [s] (ours).

    Examples
    --------
    >>> Converter(bits=2, low=-2.0, high=2.0).quantise(np.array([-3.0, 0.4, 0.6])).tolist()
    [-2.0, 0.0, 1.0]
    """

    bits: int = 18
    low: float = -10.0
    high: float = 10.0
    buffer: float = 10.0

    def __post_init__(self) -> None:
        check_within("converter", 1, 64, bits=self.bits)
        check_positive("converter", "V", range=self.high - self.low)
        check_positive("converter", "s", buffer=self.buffer)

    @property
    def step(self) -> float:
        """Resolution [V]."""
        return (self.high - self.low) / 2**self.bits

    def quantise(self, volts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Quantise volts [V] in place, within the range."""
        volts *= 1 / self.step
        np.rint(volts, out=volts)
        volts *= self.step
        return np.clip(volts, self.low, self.high, out=volts)


class SensorChannel:
    """Signal of a sensor over time.

    Parameters
    ----------
    sensor
        The sensor.
    generator
        Generator of its wander.
    """

    def __init__(self, sensor: Sensor, generator: np.random.Generator) -> None:
        self._sensor = sensor
        self._generator = generator
        self._walk = [0.0]
        calibration = sensor.calibration
        self._per_volt = 1 / calibration.gain
        self._zero = calibration.tare / calibration.gain + calibration.offset
        self.noise = sensor.noise / abs(calibration.gain)
        self.disconnected: SensorDisconnected | None = None

    def volts(
        self, time: NDArray[np.float64], truth: NDArray[np.float64], noise: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the volts [V] of a true value.

        Parameters
        ----------
        time, truth, noise
            Times [s], true values in the unit, and noise [V], each of shape (samples,).
        """
        if self.disconnected is not None:
            return self.disconnected.volts_at(time) + (noise if self.disconnected.volts is None else 0.0)
        sensor = self._sensor
        volts = truth * self._per_volt
        volts += noise
        if self._zero:
            volts += self._zero
        if sensor.drift or sensor.wander:
            volts += self._zero_error(time) * self._per_volt
        return np.clip(volts, -sensor.saturation, sensor.saturation, out=volts)

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


_ROUNDING = 1e-6  # samples


class Sampling:
    """Sensors, converter and its buffer.

    Parameters
    ----------
    sensors
        Sensors by input.
    converter, rate
        The converter, and its sampling rate of each input [Hz].
    noise, wanders
        Generator of noise, and of the wander of each sensor.
    """

    def __init__(
        self,
        sensors: Mapping[str, Sensor],
        converter: Converter,
        rate: float,
        noise: np.random.Generator,
        wanders: list[np.random.Generator],
    ) -> None:
        self.rate = rate
        self.next = 0  # number of the next sample to read
        self.delay = 0.0  # s
        self._converter = converter
        self._noise = noise
        self._readings = {
            name: SensorChannel(sensor, wander) for (name, sensor), wander in zip(sensors.items(), wanders, strict=True)
        }
        self._sigma = np.array([reading.noise for reading in self._readings.values()])
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
        if last - self.next > max(self._converter.buffer * self.rate, self._wanted):
            self._overrun, self._waiting = True, []
            return
        since = np.arange(first, last) / self.rate
        time = since + self._began
        noise = self._noise.standard_normal((last - first, len(self._sigma)))
        noise *= self._sigma
        volts = np.empty_like(noise)
        truths = knots.force, knots.pressure
        for column, (reading, truth) in enumerate(zip(self._readings.values(), truths, strict=True)):
            still = len(truth) == 2 and truth[0] == truth[1]
            there = np.full(len(time), truth[0]) if still else np.interp(time, knots.time, truth)
            volts[:, column] = reading.volts(time, there, noise[:, column])
        self._waiting.append(Block(first, since, self._converter.quantise(volts), motor.counted(time) - self._zero))

    def take(self, count: int) -> Block:
        """Return the next samples of the buffer.

        Raises
        ------
        RigError
            If they were overwritten.
        """
        if self._overrun:
            raise RigError(
                f"samples were overwritten: the host did not read for more than {self._converter.buffer:g} s",
                remedy="reopen the rig",
            )
        waiting, first = self._waiting, self.next
        self.next += count
        if len(waiting) == 1 and len(waiting[0].time) == count:
            self._waiting = []
            return waiting[0]
        time = np.concatenate([block.time for block in waiting])
        volts = np.concatenate([block.volts for block in waiting])
        pulses = np.concatenate([block.pulses for block in waiting])
        rest = Block(self.next, time[count:], volts[count:], pulses[count:])
        self._waiting = [rest] if len(rest.time) else []
        return Block(first, time[:count], volts[:count], pulses[:count])

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
