"""A card's samples: taken from the truth, kept for a host that is late, and sometimes lost."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mckibben.errors import RigError
from mckibben.rig.backend import Block
from mckibben.rig.twin.faults import Delaying, Dropping, Fault, Silent, Unplugged
from mckibben.rig.twin.machine import Knots
from mckibben.rig.twin.sensor import Converter, Reading, Sensor
from mckibben.rig.twin.stretcher import Motor

_ROUNDING = 1e-6  # samples


class Sampling:
    """Sensors, converter, and the samples that wait to be read.

    Parameters
    ----------
    sensors
        By the names of the channels, in their order.
    converter
        The card.
    rate
        Samples a second of each [Hz].
    noise
        Generator of the samples' noise.
    wanders
        Generators of the sensors' wander, one each.
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
        self.next = 0  # the number that the next read begins with
        self.delay = 0.0  # s
        self._converter = converter
        self._noise = noise
        self._readings = {
            name: Reading(sensor, wander) for (name, sensor), wander in zip(sensors.items(), wanders, strict=True)
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
        """Count samples, time and pulses from now on."""
        self._began, self._zero = now, pulses
        self._taken = self.next = 0
        self._overrun = False
        self._waiting = []

    def due(self, count: int) -> float:
        """When the next so many are taken [s], since it began."""
        return (self.next + count) / self.rate

    def silent(self, count: int) -> bool:
        """Whether the next so many will never come."""
        return self._silent and self._taken < self.next + count

    def want(self, count: int) -> None:
        """So many will be read in one: the buffer is at least as long."""
        self._wanted = count

    def sample(self, knots: Knots, motor: Motor) -> None:
        """Take the samples that fall between the first and the last of some knots."""
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
        self._waiting.append(Block(first, since, self._converter.told(volts), motor.counted(time) - self._zero))

    def take(self, count: int) -> Block:
        """The next so many of those that wait.

        Raises
        ------
        RigError
            If the buffer ran over.
        """
        if self._overrun:
            raise RigError(
                f"samples were overwritten: the host was away for more than {self._converter.buffer:g} s",
                remedy="open the rig anew",
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
        """Those that wait are not wanted."""
        self._waiting = []

    def damage(self, fault: Fault) -> None:
        """What a fault does to sensors and card; another does nothing."""
        match fault:
            case Unplugged(sensor=sensor, volts=volts):
                self._readings[sensor].unplug(volts)
            case Silent():
                self._silent = True
            case Delaying(delay=delay):
                self.delay += delay
            case Dropping(samples=samples):
                self.next = max(self.next, self._taken + samples)
                self._waiting = []
            case _:
                pass
