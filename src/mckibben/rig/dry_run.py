"""Dry run of a test: duration, travel, samples and disk space, and all violations, before anything moves."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import numpy as np

from mckibben.errors import Problem
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import Channel
from mckibben.rig.bench import Bench
from mckibben.rig.interpreter import StepInterpreter
from mckibben.rig.protocol import MOST_POINTS, range_problem
from mckibben.rig.steps import Acquire, HoldForce, Move, Pressurise, ProtocolStep, Walk
from mckibben.units import bar, percent


class DryRun(StepInterpreter):
    """Dry run of a test.

    Parameters
    ----------
    bench
        Bench of the test.
    settling, holding
        Times [s] that a change of pressure takes in addition to a ramp, and until a force is reached.

    Attributes
    ----------
    problems
        All violations of limits, and steps that the rig cannot do.
    duration
        Duration [s].
    plateaus, samples
        Numbers of plateaus, and of their samples.
    travel
        Travel of the motor, all moves together [m].
    pressure, contraction, force
        Range of the pressures [Pa] and contractions [-], and highest force by the law [N].
    estimated
        Whether steps end by a measurement, so that numbers are upper bounds.
    """

    def __init__(self, bench: Bench, *, settling: float = 1.5, holding: float = 20.0) -> None:
        super().__init__(bench)
        self._settling, self._holding = settling, holding
        self.duration, self.force = 0.0, 0.0
        self.plateaus = self.samples = 0
        self.travel = 0.0
        self.estimated = False
        self.pressure, self.contraction = (0.0, 0.0), (bench.mounted_at, bench.mounted_at)
        self.problems: list[Problem] = []
        self._acquired, self._steps, self._domain = 0, 0, bench.of.domain
        self._reported: set[str] = set()
        self._place, self._by_force = "", False
        self._set_pressure = 0.0
        self._visited: dict[tuple[float, float], str] = {}  # position and pressure, and the step that reached them

    def run(self, steps: Sequence[ProtocolStep], channels: Sequence[Channel], patience: float) -> None:
        """Go through the steps, and check the bench; arguments as for `dry_run`."""
        bench, limits = self.bench, self.bench.limits
        with contextlib.suppress(_TooLongError):
            self._do(steps)
        if 2 * bench.cycle > patience:
            message = f"{bench.cycle:g} s is more than half of the {patience:g} s after which the rig vents by itself"
            self._report(message, "recording.cycle", "shorten it")
        name, highest = bench.specimen.name, 1.1 * float(self._domain.pressure_max)
        self._check_most(limits.force, float(bench.specimen.force_limit), "N", f"rated for {name}", "limits.force")
        self._check_most(limits.pressure, highest, "bar", f"a tenth above the range of {name}", "limits.pressure")
        if self.duration > 365 * 86400:
            message = f"the test takes {self.duration / 86400:.3g} days, more than a year"
            self._report(message, self._place, "raise the speed or rate, or split it into several tests")
        self._check_law()
        if channels:
            self._check_sensors(channels)

    # what the steps do

    def _begin(self, step: ProtocolStep, place: str) -> None:
        """Check the numbers of a step."""
        bench = self.bench
        self._place = place = f"{place}.{step.short_name}"
        self._steps += 1
        self._check_count(self._steps, "steps")
        self._by_force = isinstance(step, Walk) and step.force is not None
        if isinstance(step, Move | HoldForce | Walk):
            self._check_most(step.speed, bench.fastest, "mm/s", "the speed of the motor", f"{place}.speed")
        match step:
            case Move():
                self._check_reach(step.to)
            case Pressurise():
                self._check_pressure(step.pressure)
            case Acquire():
                self._check_sampling(step, place)
            case Walk():
                self._check_reach(bench.contraction_at(self._walk_end(step)) if step.to is None else step.to)
                self._check_sampling(step.acquire, f"{place}.acquire")
                self.estimated |= step.force is not None or step.slack is not None

    def _move_to(self, position: float, speed: float) -> None:
        distance, self.position = abs(position - self.position), position
        self.travel += distance
        self._rest(distance / speed)
        self._visit()

    def _rest(self, duration: float) -> None:
        self.duration += duration

    def _pressurise(self, pressure: float, rate: float | None, holding: float | None) -> None:
        self._rest(self._settling + (0.0 if rate is None else abs(pressure - self._set_pressure) / rate))
        self._set_pressure = pressure
        self.pressure = min(self.pressure[0], pressure), max(self.pressure[1], pressure)
        self._visit()
        if holding is not None:
            self._hold_at(holding)

    def _hold(self, step: HoldForce) -> None:
        self._rest(self._holding)
        self._hold_at(step.force)

    def _acquire(self, acquire: Acquire) -> float:
        self._acquired += 1
        self._check_count(self._acquired, "points")
        self._rest(acquire.duration)
        if acquire.keep:
            self.plateaus += 1
            self.samples += acquire.samples
        return math.nan  # no measurement: a walk goes to its end

    def _vent(self) -> None:
        self._set_pressure = 0.0
        self._rest(self._settling)

    def _visit(self) -> None:
        contraction = self.bench.contraction_at(self.position)
        self.contraction = min(self.contraction[0], contraction), max(self.contraction[1], contraction)
        if not self._by_force:
            self._visited.setdefault((self.position, self._set_pressure), self._place)

    def _hold_at(self, force: float) -> None:
        """Move to where the muscle has this force [N] by its law, if there is one."""
        bench = self.bench
        self.estimated = True
        self._check_most(force, bench.limits.force, "N", "limits.force", self._place)
        if not isinstance(bench.of, Muscle):
            return
        domain = self._domain
        grid = np.linspace(float(domain.contraction_min), float(domain.contraction_max), 512)
        there = forces(bench.of, grid, self._set_pressure)
        where = f"the force of the muscle at {self._set_pressure / bar:g} bar"
        if not self._check_range(force, (there.min(), there.max()), "N", where, self._place, "choose other pressures"):
            return
        to = float(np.interp(-force, -there, grid))
        self._check_reach(to)
        before, self.position = self.position, bench.position_at(to)
        self.travel += abs(self.position - before)
        self.contraction = min(self.contraction[0], to), max(self.contraction[1], to)

    # the checks

    def _report(self, message: str, place: str, remedy: str) -> None:
        if message not in self._reported:
            self._reported.add(message)
            self.problems.append(Problem(message, field=place, remedy=remedy))

    def _check_count(self, count: int, what: str) -> None:
        if count > MOST_POINTS:
            message = f"the {what} are {count} or more, and {MOST_POINTS} at most are allowed"
            self._report(message, self._place, "repeat less often, lengthen the step of walks, or split the test")
            raise _TooLongError

    def _check_range(
        self, number: float, limits: tuple[float, float], unit: str, what: str, place: str, remedy: str = "stay inside"
    ) -> bool:
        """Report a number outside a range, as `range_problem`; whether it is inside."""
        if problem := range_problem(number, limits, unit, what, place, remedy):
            self._report(problem.message, place, remedy)
        return problem is None

    def _check_most(self, number: float, most: float, unit: str, what: str, place: str) -> None:
        self._check_range(number, (-math.inf, most), unit, what, place, "lower it")

    def _check_reach(self, contraction: float) -> None:
        bench, limits, domain, place = self.bench, self.bench.limits, self._domain, f"{self._place}.to"
        ends = float(domain.contraction_min), float(domain.contraction_max)
        self._check_range(contraction, ends, "%", f"the range of {bench.specimen.name}", place)
        stretch, travel = bench.position_at(contraction), (-limits.shorten, limits.stretch)
        remedy = f"raise limits.{'stretch' if stretch > 0 else 'shorten'}, if the rig has this travel"
        self._check_range(stretch, travel, "mm", "the travel from the mounted position", place, remedy)

    def _check_pressure(self, pressure: float) -> None:
        domain, place = self._domain, f"{self._place}.pressure"
        ends = float(domain.pressure_min), float(domain.pressure_max)
        self._check_range(pressure, ends, "bar", f"the range of {self.bench.specimen.name}", place)
        self._check_most(pressure, self.bench.supply, "bar", "the pressure of supply and regulator", place)
        self._check_most(pressure, self.bench.limits.pressure, "bar", "limits.pressure", place)

    def _check_sampling(self, acquire: Acquire, place: str) -> None:
        rate = self.bench.rate
        every = rate * acquire.duration / acquire.samples
        if every < 1 - 1e-9 or abs(every - round(every)) > 1e-6 * every:
            message = f"{acquire.samples} samples in {acquire.duration:g} s are not a whole part of {rate:g} Hz"
            remedy = f"take {round(rate * acquire.duration)}, or a whole part of it"
            self._report(message, f"{place}.samples", remedy)

    def _check_law(self) -> None:
        """Check the force by the law at all points visited."""
        bench, limit = self.bench, self.bench.limits.force
        if not isinstance(bench.of, Muscle) or not self._visited:
            return
        positions, pressures = np.array(list(self._visited)).T
        contractions = np.array([bench.contraction_at(position) for position in positions])
        there = forces(bench.of, contractions, pressures)
        at = int(np.argmax(there))
        self.force = float(there[at])
        where = f"limits.force, by the law at {contractions[at] / percent:.4g} % and {pressures[at] / bar:g} bar"
        remedy = "stay at higher contractions, or lower the pressure"
        self._check_range(self.force, (-math.inf, limit), "N", where, [*self._visited.values()][at], remedy)

    def _check_sensors(self, channels: Sequence[Channel]) -> None:
        """Check the ranges of sensors and valve."""
        named, limits = {channel.name: channel for channel in channels}, self.bench.limits
        for name, highest in (("force", limits.force), ("pressure", limits.pressure), ("valve", self.pressure[1])):
            channel = named.get(name)
            if channel is None:
                self._report(f"there is no {name}", "rig", "a test needs force, pressure and valve")
                continue
            for end in (0.0, highest):
                ends, remedy = (channel.low, channel.high), "stay within it, or use another one"
                self._check_range(end, ends, channel.unit, "the range of the channel", f"rig.{name}", remedy)


class _TooLongError(Exception):
    """The test is too long to go through."""


def dry_run(
    steps: Sequence[ProtocolStep], bench: Bench, channels: Sequence[Channel] = (), *, patience: float = math.inf
) -> DryRun:
    """Go through the steps of a test without a rig.

    Parameters
    ----------
    steps
        Steps of the test.
    bench
        Its bench: muscle and limits.
    channels
        Inputs and outputs of the rig, which have to have the range of the limits.
    patience
        Timeout of the watchdog [s], which two cycles have to fit into.

    Returns
    -------
    DryRun
        With all problems.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.rig.bench import RigLimits
    >>> from mckibben.units import mm
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> limits = RigLimits(pressure=6.5 * bar, force=630.0, stretch=8 * mm, shorten=50 * mm)
    >>> bench = Bench(of=muscle, limits=limits)
    >>> dry_run([Move(to=0.05), Acquire()], bench).plateaus
    1
    >>> [problem.field for problem in dry_run([Move(to=0.5)], bench).problems]
    ['[0].move.to', '[0].move.to']
    """
    found = DryRun(bench)
    found.run(steps, channels, patience)
    return found
