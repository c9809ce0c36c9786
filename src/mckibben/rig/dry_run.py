"""A test added up before anything moves: its time, way, samples and room; and all that stands against it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mckibben.errors import McKibbenError, Problem
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import Channel
from mckibben.rig.bench import Bench
from mckibben.rig.steps import Acquire, Dwell, HoldForce, Move, Pressurise, Repeat, Step, Vent, Walk
from mckibben.units import bar, mm, percent

_SETTLING = 1.5  # s that a change of pressure takes, besides a ramp
_CHUNK = 64  # bytes that a cycle takes besides its rows, at most


@dataclass
class Outline:
    """What a test takes.

    Attributes
    ----------
    duration
        [s]; where a step ends by what is measured, the longest it may take.
    plateaus
        Points of the data, the same way.
    samples, pulses, rows
        Samples of the points; pulses of the motor, either way; rows of the record.
    at_most
        Whether these are upper bounds.
    pressure, contraction, force
        Lowest and highest [Pa], [-]; highest [N] by the law, 0 where none is known.
    problems
        All that stands against it; the field is the place of the step, such as ``[2].repeat.steps[0]``.
    """

    duration: float = 0.0
    plateaus: int = 0
    samples: int = 0
    pulses: int = 0
    rows: int = 0
    at_most: bool = False
    pressure: tuple[float, float] = (0.0, 0.0)
    contraction: tuple[float, float] = (0.0, 0.0)
    force: float = 0.0
    problems: list[Problem] = field(default_factory=list)

    def bytes(self, row_size: int) -> int:
        """Room on the disk, with a tenth to spare."""
        return math.ceil(1.1 * self.rows * row_size) + (1 << 20)


def outline(
    steps: Sequence[Step], bench: Bench, inputs: Sequence[Channel] = (), *, patience: float = math.inf
) -> Outline:
    """Go through steps without a rig.

    Parameters
    ----------
    steps
        What is to be done.
    bench
        On what; its limits, motor, valve and sensors are held against the steps.
    inputs
        Channels of the backend, where they are known: what they can tell is held against the limits.
    patience
        Of the backend [s]: two cycles have to go into it.
    """
    tour = _Tour(bench)
    tour.go(steps, "")
    if 2 * bench.cycle > patience:
        message = f"{bench.cycle:g} s is more than half of the {patience:g} s after which the rig vents by itself"
        tour.say(message, "recording.cycle", "shorten it")
    return tour.finish(inputs)


class _Tour:
    def __init__(self, bench: Bench) -> None:
        self.bench, self.found = bench, Outline()
        self.contraction, self.pressure = bench.mounted_at, 0.0
        self.walked_from = bench.mounted_at
        self.contractions, self.pressures = [bench.mounted_at], [0.0]
        self.visited: dict[tuple[float, float], str] = {}
        self.said: set[str] = set()

    def go(self, steps: Sequence[Step], place: str) -> None:
        for index, step in enumerate(steps):
            here = f"{place}[{index}]"
            match step:
                case Repeat():
                    for _ in range(step.times):
                        self.go(step.steps, f"{here}.repeat.steps")
                case Move():
                    self._speed(step.speed, f"{here}.move")
                    self._move(step.to, step.speed, f"{here}.move")
                case Dwell():
                    self._spend(step.duration)
                case Pressurise():
                    if step.rate is not None:
                        self._spend(abs(step.pressure - self.pressure) / step.rate)
                    self._press(step.pressure, f"{here}.pressurise")
                    if step.holding is not None:
                        self._held(step.holding, f"{here}.pressurise")
                case HoldForce():
                    self._spend(20.0)
                    self._speed(step.speed, f"{here}.hold_force")
                    self._held(step.force, f"{here}.hold_force")
                case Acquire():
                    self._acquire(step, 1, f"{here}.acquire")
                case Walk():
                    self._walk(step, f"{here}.walk")
                case Vent():
                    self.pressure = 0.0
                    self._spend(_SETTLING)
            self.contractions.append(self.contraction)

    def finish(self, inputs: Sequence[Channel]) -> Outline:
        """The end of it: the law at all places visited, and the sensors' spans."""
        found, bench = self.found, self.bench
        limits, calibrations, name = bench.limits, bench.calibrations, bench.specimen.name
        found.contraction = min(self.contractions), max(self.contractions)
        found.pressure = min(self.pressures), max(self.pressures)
        rated = float(bench.specimen.rated_force)
        if limits.force > rated:
            self.say(f"{limits.force:g} N is above the rated {rated:g} N of {name}", "limits.force", "lower it")
        highest = float(bench.of.domain.pressure_max)
        if limits.pressure > 1.1 * highest:
            message = f"{limits.pressure / bar:g} bar is more than a tenth above the {highest / bar:g} bar of {name}"
            self.say(message, "limits.pressure", "lower it")
        if isinstance(bench.of, Muscle) and self.visited:
            places = np.array(list(self.visited))
            there = forces(bench.of, places[:, 0], places[:, 1])
            at = int(np.argmax(there))
            found.force = float(there[at])
            if found.force > limits.force:
                message = (
                    f"by its law the muscle pulls {found.force:.0f} N at {places[at, 0] / percent:.4g} % and "
                    f"{places[at, 1] / bar:g} bar, above the limit of {limits.force:g} N"
                )
                self.say(message, [*self.visited.values()][at], "stay on the short side there, or lower the pressure")
        channels = {channel.name: channel for channel in inputs}
        for channel in inputs:
            if channel.name not in calibrations:
                self.say(
                    f"{channel.name} has no calibration", f"rig.{channel.name}", "give one, see docs/rig-hardware.md"
                )
        for name, highest in (("force", limits.force), ("pressure", limits.pressure), ("valve", found.pressure[1])):
            if name not in calibrations:
                self.say(f"there is no {name}", "rig", "a test needs force, pressure and valve")
                continue
            for problem in calibrations[name].check(0.0, highest, channels.get(name)):
                self.say(problem.message, f"rig.{problem.field}", problem.remedy)
        return found

    def say(self, message: str, place: str, remedy: str) -> None:
        if message not in self.said:
            self.said.add(message)
            self.found.problems.append(Problem(message, field=place, remedy=remedy))

    def _spend(self, duration: float) -> None:
        self.found.duration += duration
        self.found.rows += math.ceil(duration * self.bench.rate / self.bench.every) + 1

    def _speed(self, speed: float, place: str) -> None:
        try:
            self.bench.drive.rate(speed)
        except McKibbenError as error:
            self.say(error.message, f"{place}.speed", error.remedy)

    def _reach(self, contraction: float, place: str) -> None:
        bench, limits = self.bench, self.bench.limits
        domain = bench.of.domain
        low, high = float(domain.contraction_min), float(domain.contraction_max)
        if not low - 1e-9 <= contraction <= high + 1e-9:
            allowed = f"{low / percent:g}..{high / percent:g} % of {bench.specimen.name}"
            message = f"{contraction / percent:.4g} % is outside {allowed}"
            self.say(message, f"{place}.to", "stay inside")
        stretch = (bench.mounted_at - contraction) * float(bench.specimen.initial_length)
        for way, most, word in ((stretch, limits.stretch, "stretch"), (-stretch, limits.shorten, "shorten")):
            if way > most + 1e-9:
                message = (
                    f"{contraction / percent:.4g} % is {way / mm:.4g} mm from where it was mounted, and the travel"
                )
                self.say(f"{message} is {most / mm:.4g} mm", f"{place}.to", f"raise limits.{word}, if the rig has it")

    def _move(self, to: float, speed: float, place: str) -> None:
        self._reach(to, place)
        pulses = abs(self.bench.pulses_at(to) - self.bench.pulses_at(self.contraction))
        self.found.pulses += pulses
        self._spend(pulses / self.bench.drive.pulses_per_metre / speed)
        self.contraction = to
        self.visited.setdefault((to, self.pressure), place)

    def _press(self, pressure: float, place: str) -> None:
        bench = self.bench
        domain, highest = bench.of.domain, bench.limits.pressure
        low, high = float(domain.pressure_min), float(domain.pressure_max)
        if not low - 1e-3 <= pressure <= high + 1e-3:
            message = f"{pressure / bar:g} bar is outside {low / bar:g}..{high / bar:g} bar of {bench.specimen.name}"
            self.say(message, f"{place}.pressure", "stay inside")
        if pressure > highest:
            message = f"{pressure / bar:g} bar is above the limit of {highest / bar:g} bar"
            self.say(message, f"{place}.pressure", "lower it, or raise limits.pressure")
        self.pressure = pressure
        self.pressures.append(pressure)
        self._spend(_SETTLING)
        self.visited.setdefault((self.contraction, pressure), place)

    def _held(self, force: float, place: str) -> None:
        """A force held by moving: where, the law tells, if there is one."""
        bench, found = self.bench, self.found
        found.at_most = True
        if force > bench.limits.force:
            self.say(f"{force:g} N is above the limit of {bench.limits.force:g} N", place, "lower it")
        if not isinstance(bench.of, Muscle):
            return
        domain = bench.of.domain
        ends = (float(domain.contraction_min), float(domain.contraction_max))
        grid = np.linspace(*ends, 512)
        there = forces(bench.of, grid, self.pressure)
        if not there.min() <= force <= there.max():
            message = (
                f"at {self.pressure / bar:g} bar the muscle pulls {there.min():.0f} to {there.max():.0f} N within its "
                f"range, and {force:g} N are to be held"
            )
            self.say(message, place, "choose another force, or other pressures")
            return
        to = float(np.interp(-force, -there, grid))
        self._reach(to, place)
        found.pulses += abs(bench.pulses_at(to) - bench.pulses_at(self.contraction))
        self.contraction = to
        self.contractions.append(to)

    def _walk(self, walk: Walk, place: str) -> None:
        bench = self.bench
        self._speed(walk.speed, place)
        try:
            bench.drive.pulses(walk.step)
        except McKibbenError as error:
            self.say(error.message, f"{place}.step", error.remedy)
        begin = self.contraction
        to = self.walked_from if walk.to is None else walk.to
        self.walked_from = begin
        self._reach(to, place)
        step = max(1, bench.drive.nearest(walk.step))
        way = bench.pulses_at(to) - bench.pulses_at(begin)
        steps = (abs(way) + step // 100) // step
        self._acquire(walk.acquire, steps + 1, f"{place}.acquire")
        self.found.pulses += steps * step
        each = walk.step / walk.speed + walk.dwell
        self.found.duration += steps * each
        self.found.rows += steps * (math.ceil(each * bench.rate / bench.every) + 2)
        self.found.at_most |= walk.force is not None or walk.slack is not None
        self.contraction = bench.contraction_at(bench.pulses_at(begin) + math.copysign(steps * step, way))
        if walk.force is None:
            self.visited.setdefault((self.contraction, self.pressure), place)

    def _acquire(self, acquire: Acquire, times: int, place: str) -> None:
        every = self.bench.rate * acquire.duration / acquire.samples
        if every < 1 - 1e-9 or abs(every - round(every)) > 1e-6 * every:
            message = f"{acquire.samples} samples in {acquire.duration:g} s are no whole part of {self.bench.rate:g} Hz"
            self.say(
                message, f"{place}.samples", f"take {round(self.bench.rate * acquire.duration)}, or a whole part of it"
            )
        self.found.duration += times * acquire.duration
        self.found.rows += times * ((acquire.samples - 1) * max(1, round(every)) + 1)
        if acquire.keep:
            self.found.plateaus += times
            self.found.samples += times * acquire.samples
