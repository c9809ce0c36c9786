"""Typed steps of a test, and whole tests made of them: isobaric, isometric and isotonic."""

from __future__ import annotations

import abc
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from mckibben.component.base import Checked, check_fields, field_problems
from mckibben.component.classes import Keyed
from mckibben.component.schema import write_text
from mckibben.errors import Problem, RangeError, refuse_problems
from mckibben.muscle import Muscle, Specimen, forces
from mckibben.rig.bench import Bench
from mckibben.rig.protocol import (
    PAPER_PRESSURES,
    IsobaricProtocol,
    Protocol,
    SetPressure,
    StepTravel,
    boundaries,
    specimen_of,
)
from mckibben.units import (
    Contraction,
    Duration,
    Force,
    N,
    PressureRate,
    Repeats,
    Samples,
    Speed,
    Tension,
    WaitTime,
    bar,
    mm,
    percent,
    s,
)

Phase = Literal["", "filling", "venting"]

SPEED = 0.2 * mm / s
"""Speed of the paper [m/s]: a step of 1 mm takes 5 s."""


class ProtocolStep(Keyed, Checked):
    """A step of a test."""


@dataclass(frozen=True, kw_only=True)
class Move(ProtocolStep):
    """Move of the motor to a contraction.

    Parameters
    ----------
    to
        Contraction [-].
    speed
        Speed [m/s]; by default that of the paper.
    """

    short_name = "move"
    shorthand = "to"

    to: Contraction
    speed: Speed = SPEED


@dataclass(frozen=True, kw_only=True)
class Dwell(ProtocolStep):
    """Wait.

    Parameters
    ----------
    duration
        Duration [s].
    """

    short_name = "dwell"
    shorthand = "duration"

    duration: WaitTime


@dataclass(frozen=True, kw_only=True)
class Pressurise(ProtocolStep):
    """Change of the set pressure, until the muscle has it.

    Parameters
    ----------
    pressure
        Set pressure [Pa].
    rate
        Rate of the set pressure [Pa/s]. Default: a step.
    holding
        Force [N] that is held meanwhile by moving, see `HoldForce`. Default: constant length.
    """

    short_name = "pressurise"
    shorthand = "pressure"

    pressure: SetPressure
    rate: PressureRate | None = None
    holding: Tension | None = None


@dataclass(frozen=True, kw_only=True)
class HoldForce(ProtocolStep):
    """Move until the muscle has a force, by feedback of the force.

    Parameters
    ----------
    force
        Force [N].
    tolerance
        Tolerance of the mean force over a cycle [N].
    speed
        Highest speed [m/s].
    longest
        Time [s] after which the test is stopped.
    """

    short_name = "hold_force"
    shorthand = "force"

    force: Tension
    tolerance: Tension = 2 * N
    speed: Speed = SPEED
    longest: Duration = 300 * s


@dataclass(frozen=True, kw_only=True)
class Acquire(ProtocolStep):
    """Acquisition of a point: the samples of a plateau.

    Parameters
    ----------
    samples, duration
        Number of samples, and their duration [s].
    direction, phase
        Words for the dataset: loading or unloading; filling or venting.
    keep
        Whether it is a point of the dataset, not one that only finds a boundary.
    """

    short_name = "acquire"

    samples: Samples = 1000
    duration: Duration = 1 * s
    direction: Literal["", "loading", "unloading"] = ""
    phase: Phase = ""
    keep: bool = True


@dataclass(frozen=True, kw_only=True)
class Walk(ProtocolStep):
    """Pass from plateau to plateau: acquire a point, then repeatedly move a step, wait, and acquire.

    Parameters
    ----------
    to
        Contraction [-] of the last plateau. Default: the start of the walk before.
    step, speed, dwell
        Distance [m] and speed [m/s] of each move, and the wait [s] after it.
    acquire
        The acquisition at each plateau.
    force
        Force [N] before which the walk ends, predicted for the next step.
    slack
        Number of plateaus after the last one above `slack_force` at which the walk ends.
    slack_force
        Highest force [N] of a slack muscle.
    """

    short_name = "walk"

    to: Contraction | None = None
    step: StepTravel = 1 * mm
    speed: Speed = SPEED
    dwell: WaitTime = 5 * s
    acquire: Acquire = field(default_factory=Acquire)
    force: Tension | None = None
    slack: Repeats | None = None
    slack_force: Force = 1 * N


@dataclass(frozen=True, kw_only=True)
class Vent(ProtocolStep):
    """Vent, and wait until the muscle is empty."""

    short_name = "vent"


@dataclass(frozen=True, kw_only=True)
class Repeat(ProtocolStep):
    """Repeated steps; points inside have the number of the innermost repeat, from 0.

    Parameters
    ----------
    times
        Number of repeats.
    steps
        Steps of one of them, at least one.
    """

    short_name = "repeat"

    times: Repeats
    steps: tuple[ProtocolStep, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        check_fields(self)
        if not self.steps:
            raise RangeError("Repeat: no steps", field="steps", remedy="give at least one")


@dataclass(frozen=True, kw_only=True)
class Steps(Protocol):
    """Protocol of steps one after another.

    Parameters
    ----------
    steps
        At least one.

    Examples
    --------
    >>> protocol = Steps(steps=(Pressurise(pressure=2 * bar), Dwell(duration=5.0), Vent()))
    >>> print(steps_text(protocol.steps), end="")
    steps:
      - pressurise: 2 bar
      - dwell: 5 s
      - vent
    """

    short_name = "steps"
    shorthand = "steps"

    steps: tuple[ProtocolStep, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.steps:
            raise RangeError("a protocol of no steps", field="steps", remedy="give at least one")


def steps_text(steps: Sequence[ProtocolStep]) -> str:
    """Steps as a protocol of a file."""
    return write_text(Steps(steps=tuple(steps)), base=Protocol)


TURNING = 5 * mm
"""Travel after a reversal that changes the direction of the friction [m]: after 2 mm 2 % of a loop are left, 0.5 N."""


def isobaric_steps(protocol: IsobaricProtocol, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
    """Return the steps of the paper's procedure: adjust, find the boundary values, unloading test, loading test, vent.

    A muscle has its `boundaries` by its law. For a specimen they are found at each pressure: from the shortest length
    until the next step would exceed the rated force, and back until the muscle is slack.

    Raises
    ------
    RangeError
        As the `check` of the protocol; or if the specimen has neither a law nor a rated force.
    """
    protocol.check(of)
    unloading, loading = (
        Acquire(samples=protocol.samples, duration=protocol.acquisition, direction=direction)
        for direction in ("unloading", "loading")
    )

    def walk(to: float | None, acquire: Acquire, *, force: float | None = None, slack: int | None = None) -> Walk:
        each = {"step": protocol.step, "speed": protocol.speed, "dwell": protocol.dwell}
        return Walk(to=to, acquire=acquire, force=force, slack=slack, **each)

    steps: list[ProtocolStep] = []
    if isinstance(of, Muscle):
        for pressure, low, high in zip(*boundaries(of, protocol), strict=True):
            passes = (walk(float(high), unloading), walk(float(low), loading))
            steps += [
                Vent(),
                Move(to=_short_of(float(low), protocol, of), speed=protocol.speed),
                Pressurise(pressure=float(pressure)),
                Move(to=float(low), speed=protocol.speed),
                Dwell(duration=protocol.dwell),
                Repeat(times=protocol.repeats, steps=passes),
            ]
        return (*steps, Vent())
    # without a law: from the shortest length until the next step would exceed the limit, and back until it is slack
    first, last = protocol.stroke(of)
    if of.rated_force is None:
        message = f"a test without a law goes up to the rated force of {of.name}, which is unknown"
        raise RangeError(message, field="rated_force", remedy="give the specimen its rated_force, or the muscle a law")
    limit = float(of.rated_force) * (1 - protocol.force_reserve)
    found = Acquire(samples=protocol.samples, duration=protocol.acquisition, keep=False)
    for pressure in protocol.pressures:
        passes = (walk(last, unloading, slack=protocol.slack_steps), walk(None, loading))
        steps += [
            Vent(),
            Move(to=last, speed=protocol.speed),
            Pressurise(pressure=pressure),
            walk(first, found, force=limit),
            Repeat(times=protocol.repeats, steps=passes),
        ]
    return (*steps, Vent())


def _short_of(low: float, protocol: IsobaricProtocol, of: Muscle) -> float:
    """Contraction before the stretched end, far enough for the friction to change its direction until there."""
    return min(low + TURNING / float(of.specimen.initial_length), protocol.stroke(of)[1])


@dataclass(frozen=True, kw_only=True)
class SteppedProtocol(Protocol, abc.ABC):
    """Base of tests in which the pressure is stepped up and down at each value of another quantity.

    Parameters
    ----------
    pressures
        Set pressures [Pa], rising.
    rate
        Rate of the set pressure [Pa/s]. Default: steps.
    speed, dwell
        Speed of moves [m/s], and wait [s] before each point.
    acquisition, samples
        Duration [s] and number of samples of each point.
    repeats
        Number of repeats.

    Raises
    ------
    RangeError
        With all fields out of range, or if the pressures do not rise.
    """

    held: ClassVar[str]
    """Field of the values of the other quantity."""

    pressures: Sequence[SetPressure] = PAPER_PRESSURES
    rate: PressureRate | None = None
    speed: Speed = SPEED
    dwell: WaitTime = 5 * s
    acquisition: Duration = 1 * s
    samples: Samples = 1000
    repeats: Repeats = 1

    def __post_init__(self) -> None:
        for name in (self.held, "pressures"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        problems = field_problems(self)
        if not (self.pressures and all(a < b for a, b in itertools.pairwise(self.pressures))):
            problems.append(Problem("do not rise", field="pressures", remedy="give at least one, ascending"))
        if not getattr(self, self.held):
            problems.append(Problem("give at least one", field=self.held))
        refuse_problems(f"{self.short_name} protocol", problems)

    @abc.abstractmethod
    def steps(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Return the steps of the test; `dry_run` checks them."""


@dataclass(frozen=True, kw_only=True)
class IsometricProtocol(SteppedProtocol):
    """Isometric test: constant length, the pressure stepped up and down.

    Parameters
    ----------
    contractions
        Contractions [-] (ours by default). Other parameters are those of `SteppedProtocol`.
    """

    short_name = "isometric"
    held = "contractions"

    contractions: Sequence[Contraction] = tuple(value * percent for value in (-3, 0, 5, 10, 15, 20))

    def steps(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Steps of the test, without pressures whose force by the law exceeds the rated one; `dry_run` checks them."""
        steps: list[ProtocolStep] = []
        for contraction in self.contractions:
            pressures = _within_rating(of, contraction, self.pressures)
            steps += [
                Vent(),
                Move(to=contraction, speed=self.speed),
                Repeat(
                    times=self.repeats,
                    steps=(*self._pass(pressures, "filling"), *self._pass(pressures[::-1], "venting")),
                ),
            ]
        return (*steps, Vent())

    def _pass(self, pressures: Sequence[float], phase: Phase) -> list[ProtocolStep]:
        acquire = Acquire(samples=self.samples, duration=self.acquisition, phase=phase)
        return [
            step
            for pressure in pressures
            for step in (Pressurise(pressure=pressure, rate=self.rate), Dwell(duration=self.dwell), acquire)
        ]


@dataclass(frozen=True, kw_only=True)
class IsotonicProtocol(SteppedProtocol):
    """Isotonic test: constant force, the pressure stepped up and down.

    Parameters
    ----------
    forces
        Forces [N] (ours by default); 300 N take about 2 bar, so that the pressures begin there.
    rate
        Rate of the set pressure [Pa/s] (ours), slow enough for the motor.
    tolerance
        Tolerance of the force at a point [N]. Other parameters are those of `SteppedProtocol`.
    """

    short_name = "isotonic"
    held = "forces"

    forces: Sequence[Tension] = (50.0, 100.0, 200.0, 300.0)
    pressures: Sequence[SetPressure] = PAPER_PRESSURES[4:]
    rate: PressureRate = 0.1 * bar / s
    tolerance: Force = 2.0

    def steps(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Steps of the test, from the vented muscle at its initial length; `dry_run` checks them."""
        steps: list[ProtocolStep] = []
        for force in self.forces:
            steps += [Vent(), Move(to=0.0, speed=self.speed)]
            inside: list[ProtocolStep] = []
            passes: tuple[tuple[Literal["unloading", "loading"], Sequence[float]], ...]
            passes = ("unloading", self.pressures), ("loading", self.pressures[::-1])
            for direction, pressure in [(word, pressure) for word, pressures in passes for pressure in pressures]:
                inside += [
                    Pressurise(pressure=pressure, rate=self.rate, holding=force),
                    HoldForce(force=force, tolerance=self.tolerance, speed=self.speed),
                    Dwell(duration=self.dwell),
                    HoldForce(force=force, tolerance=self.tolerance, speed=self.speed),
                    Acquire(samples=self.samples, duration=self.acquisition, direction=direction),
                ]
            steps.append(Repeat(times=self.repeats, steps=tuple(inside)))
        return (*steps, Vent())


def steps_of(protocol: Protocol, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
    """Return the steps of a protocol for a muscle, or for a specimen without a law.

    Raises
    ------
    RangeError
        As the `check` of the protocol.

    Examples
    --------
    >>> from mckibben import catalog
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> len(steps_of(IsometricProtocol(contractions=[0.05], pressures=[1 * bar, 2 * bar]), muscle))
    4
    """
    if isinstance(protocol, Steps):
        return protocol.steps
    assert isinstance(protocol, IsobaricProtocol | SteppedProtocol)
    return isobaric_steps(protocol, of) if isinstance(protocol, IsobaricProtocol) else protocol.steps(of)


def _within_rating(of: Muscle | Specimen, contraction: float, pressures: Sequence[float]) -> list[float]:
    if not isinstance(of, Muscle):
        return list(pressures)
    there = forces(of, contraction, np.array(pressures))
    return [p for p, force in zip(pressures, there, strict=True) if force <= float(specimen_of(of).force_limit) * 0.95]


class StepInterpreter(abc.ABC):
    """Iteration over the steps of a test: the same on a rig (`Runner`) and in a dry run (`DryRun`)."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.position = 0.0
        self._repeat = 0
        self._walked_from = 0.0

    def _do(self, steps: Sequence[ProtocolStep], place: str = "") -> None:
        for index, step in enumerate(steps):
            here = f"{place}[{index}]"
            self._begin(step, here)
            match step:
                case Repeat():
                    around = self._repeat
                    for number in range(step.times):
                        self._repeat = number
                        self._do(step.steps, f"{here}.repeat.steps")
                    self._repeat = around
                case Move():
                    self._move_to(self.bench.position_at(step.to), step.speed)
                case Dwell():
                    self._rest(step.duration)
                case Pressurise():
                    self._pressurise(step.pressure, step.rate, step.holding)
                case HoldForce():
                    self._hold(step)
                case Acquire():
                    self._acquire(step)
                case Walk():
                    self._walk(step)
                case Vent():
                    self._vent()

    def _walk(self, walk: Walk) -> None:
        begin = self.position
        to = self._walk_end(walk)
        self._walked_from = begin
        sign = 1 if to > begin else -1
        forces = [self._acquire(walk.acquire)]
        slack = 0
        for count in range(1, math.floor(abs(to - begin) / walk.step + 0.01) + 1):
            if walk.force is not None and forces[-1] + 1.5 * (forces[-1] - (forces[-2:][0])) > walk.force:
                return  # the force rises progressively with the stretch: half of a rise is added
            slack = slack + 1 if forces[-1] <= walk.slack_force else 0
            if walk.slack is not None and slack >= walk.slack:
                return
            self._move_to(begin + sign * walk.step * count, walk.speed)
            self._rest(walk.dwell)
            forces.append(self._acquire(walk.acquire))

    def _walk_end(self, walk: Walk) -> float:
        return self._walked_from if walk.to is None else self.bench.position_at(walk.to)

    def _begin(self, step: ProtocolStep, place: str) -> None:
        """Prepare a step at a place of the protocol."""
        return

    @abc.abstractmethod
    def _move_to(self, position: float, speed: float) -> None: ...

    @abc.abstractmethod
    def _rest(self, duration: float) -> None: ...

    @abc.abstractmethod
    def _pressurise(self, pressure: float, rate: float | None, holding: float | None) -> None: ...

    @abc.abstractmethod
    def _hold(self, step: HoldForce) -> None: ...

    @abc.abstractmethod
    def _acquire(self, acquire: Acquire) -> float: ...

    @abc.abstractmethod
    def _vent(self) -> None: ...
