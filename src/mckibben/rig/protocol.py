"""Tests on a rig: protocols of steps, isobaric, isometric and isotonic ones."""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import Checked, field_problems
from mckibben.component.classes import Keyed
from mckibben.component.schema import write_text
from mckibben.errors import Problem, RangeError, refuse_problems
from mckibben.muscle import Muscle, Specimen, forces
from mckibben.rig.steps import (
    SPEED,
    Acquire,
    Dwell,
    HoldForce,
    Move,
    Pressurise,
    ProtocolStep,
    Repeat,
    SetPressure,
    StepTravel,
    Vent,
    Walk,
)
from mckibben.units import (
    Contraction,
    Duration,
    Force,
    Percent,
    PressureRate,
    Repeats,
    Samples,
    Speed,
    Tension,
    WaitTime,
    bar,
    factor,
    mm,
    percent,
    s,
    show,
)

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset

ForceReserve = Annotated[float, Percent("1", "%", 0, 100, open_upper=True)]


class Boundaries(NamedTuple):
    """Set pressures [Pa], and contractions [-] of the most stretched and the shortest plateau; shape (pressures,)."""

    pressure: NDArray[np.float64]
    contraction_min: NDArray[np.float64]
    contraction_max: NDArray[np.float64]


def boundaries(of: Muscle | Specimen, protocol: IsobaricProtocol) -> Boundaries:
    """Stroke at each pressure: "determining the boundary values" of the paper's procedure.

    The whole stroke; for a muscle with a law, limited at both ends:

    - Stretched end: no plateau at which the law's force exceeds the rated force minus the protocol's reserve (Eq. 3
      gives 895 N at -3 % and 6 bar; the rating is 630 N).
    - Slack end: `slack_steps` plateaus beyond the last taut one, which show the zero of the force sensor.

    Raises
    ------
    RangeError
        As the protocol's `check`; or if at a pressure the force is too high over the whole stroke.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.rig import IsobaricProtocol
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> limits = boundaries(muscle, IsobaricProtocol())
    >>> [round(float(end[-1]), 4) for end in (limits.contraction_min, limits.contraction_max)]  # at 6 bar
    [0.0033, 0.2478]
    """
    protocol.check(of)
    pressures = np.array(protocol.pressures)
    stroke = positions(of, protocol)
    if isinstance(of, Specimen):
        ends = (np.full(len(pressures), end) for end in (stroke[0], stroke[-1]))
        return Boundaries(pressures, *ends)
    force = forces(of, stroke, pressures[:, None])
    limit = float(of.specimen.force_limit) * (1 - protocol.force_reserve)
    first = _after_last(force > limit)
    last = np.minimum(np.maximum(_after_last(force > 0), first) + protocol.slack_steps, len(stroke)) - 1
    if len(over := pressures[first == len(stroke)]):
        raise RangeError(
            f"at {', '.join(f'{p / bar:g}' for p in over)} bar the force exceeds {limit:g} N over the whole stroke",
            value=float(over[0]),
            unit="Pa",
            remedy="leave the pressure out, or let the stroke reach a higher contraction",
        )
    return Boundaries(pressures, stroke[first], stroke[last])


def positions(of: Muscle | Specimen, protocol: IsobaricProtocol) -> NDArray[np.float64]:
    """Contraction [-] of the plateaus of the whole stroke, ascending."""
    first, last = protocol.stroke(of)
    step = protocol.step / float(specimen_of(of).initial_length)
    return first + step * np.arange(_plateaus_in(protocol.step, first, last, of), dtype=np.float64)


def _plateaus_in(step: float, first: float, last: float, of: Muscle | Specimen) -> int:
    return math.floor((last - first) / (step / float(specimen_of(of).initial_length)) + 1e-9) + 1


def range_problem(
    number: float, limits: tuple[float, float], unit: str, what: str, field: str, remedy: str = "stay inside"
) -> Problem | None:
    """Problem of a number [SI] outside the limits of something, but for rounding; None if it is inside."""
    low, high = limits
    if low <= number <= high or any(math.isclose(number, end, abs_tol=1e-9) for end in limits):
        return None
    shown = show(high, unit, 4) if low == -math.inf else f"{low / factor(unit):.4g}..{show(high, unit, 4)}"
    relation = "above" if low == -math.inf else "outside"
    return Problem(f"{show(number, unit, 4)} is {relation} {shown}, {what}", field=field, remedy=remedy)


def specimen_of(of: Muscle | Specimen) -> Specimen:
    """Specimen of a muscle, or the specimen itself."""
    return of.specimen if isinstance(of, Muscle) else of


def _after_last(where: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Column after the last true one of each row; 0 if there is none."""
    count = where.shape[1]
    return np.where(where.any(axis=1), count - np.argmax(where[:, ::-1], axis=1), 0).astype(np.int64)


MOST_POINTS = 100_000
"""Largest number of points of a test with all its repeats, and of its steps: more are refused."""

PAPER_PRESSURES = tuple(0.5 * level * bar for level in range(13))


class Protocol(Keyed, Checked, abc.ABC):
    """A test."""

    @abc.abstractmethod
    def steps_for(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Return the steps of the test, which `dry_run` checks, for a muscle, or for a specimen without a law.

        Raises
        ------
        RangeError
            If the protocol does not suit the muscle.
        """


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

    def steps_for(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        return self.steps


def steps_text(steps: Sequence[ProtocolStep]) -> str:
    """Steps as a protocol of a file."""
    return write_text(Steps(steps=tuple(steps)), base=Protocol)


@dataclass(frozen=True, kw_only=True)
class PressureProtocol(Protocol, abc.ABC):
    """Base of tests with plateaus at set pressures.

    Parameters
    ----------
    pressures
        Set pressures [Pa, gauge], all different: 0, 0.5, ... 6 bar.
    speed, dwell
        Speed of moves [m/s], and wait [s] before each point.
    acquisition, samples
        Duration [s] and number of samples of each point.
    repeats
        Number of repeats.

    Raises
    ------
    RangeError
        With all fields out of range.
    """

    lists: ClassVar[tuple[str, ...]] = ("pressures",)
    """Fields of several values."""

    pressures: Sequence[SetPressure] = PAPER_PRESSURES
    speed: Speed = SPEED
    dwell: WaitTime = 5 * s
    acquisition: Duration = 1 * s
    samples: Samples = 1000
    repeats: Repeats = 1

    def __post_init__(self) -> None:
        for name in self.lists:
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        problems = field_problems(self)
        problems += [Problem("give at least one", field=name) for name in self.lists if not getattr(self, name)]
        if len(set(self.pressures)) < len(self.pressures):
            remedy = "raise repeats to test it more often"
            problems.append(Problem("one is given twice", field="pressures", remedy=remedy))
        refuse_problems(f"{self.short_name} protocol", problems)

    def _acquire(self, **words: Any) -> Acquire:
        return Acquire(samples=self.samples, duration=self.acquisition, **words)


TURNING = 5 * mm
"""Travel [m] to the stretched end that changes the direction of the friction: after 2 mm 2 % of a loop are left."""


class Plateaus(NamedTuple):
    """Plateaus of a test in order, one row each."""

    level: NDArray[np.int64]  # index of the pressure in the protocol
    repeat: NDArray[np.int64]  # from 0
    stretching: NDArray[np.bool_]  # whether the plateau belongs to the loading pass
    contraction: NDArray[np.float64]  # [-]
    travel: NDArray[np.float64]  # from the plateau before [m], positive = stretching; 0 on the first of a pass
    time: NDArray[np.float64]  # start of the acquisition [s] after the start of the test


@dataclass(frozen=True, kw_only=True)
class IsobaricProtocol(PressureProtocol):
    """Isobaric test: strokes at constant pressures.

    Defaults are the paper's ("Parameters identification") unless marked as ours.

    At each pressure, `repeats` times: an unloading pass (the muscle shortens from plateau to plateau), then a loading
    pass (it is stretched back). At a plateau the rig waits, then samples. The last plateau of a pass is the first of
    the next one, sampled twice without a move.

    Parameters
    ----------
    pressures
        Set pressures [Pa, gauge], all different, in the order of the test: 0, 0.5, ... 6 bar.
    contraction_min, contraction_max
        Ends of the stroke [-]; by default those of the muscle's range (-3 and 25 % for the paper's).
    step
        Travel between two plateaus [m]: 1 mm.
    speed
        Speed of a move [m/s]: 0.2 mm/s, so that a step takes 5 s.
    dwell
        Wait [s] between a move and the acquisition: 5 s. The paper's "after each 5 s delay" can also be read
        as the 5 s of the move itself: then 0.
    acquisition, samples
        Duration [s] and number of the samples of a plateau: 1000 in 1 s.
    repeats
        Number of repeats: 5.
    force_reserve
        Reserve as a share of the rated force [-], see `boundaries`: 5 % (ours), for hysteresis, offsets and noise.
    slack_steps
        Plateaus beyond the last taut one, see `boundaries`: 3 (ours).

    Raises
    ------
    RangeError
        If numbers are out of range; it lists all of them.

    Examples
    --------
    >>> IsobaricProtocol(step=-1 * mm, repeats=0)
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: isobaric protocol: 2 problems
      repeats: is 0, out of range (1 to 10000); choose a value inside
      step: is -0.001 m, out of range (above 0, up to 100 mm); choose a value inside
    """

    short_name = "isobaric"

    contraction_min: Contraction | None = None
    contraction_max: Contraction | None = None
    step: StepTravel = 1 * mm
    repeats: Repeats = 5
    force_reserve: ForceReserve = 5 * percent
    slack_steps: Repeats = 3

    def stroke(self, of: Muscle | Specimen) -> tuple[float, float]:
        """First and last contraction [-] before the boundaries: as given, or the range of the muscle or specimen."""
        low, high = self.contraction_min, self.contraction_max
        return (
            float(of.domain.contraction_min) if low is None else low,
            float(of.domain.contraction_max) if high is None else high,
        )

    def check(self, of: Muscle | Specimen) -> None:
        """Raise `RangeError` with pressures outside the rating and ends of the stroke outside the range of a muscle."""
        name, domain = specimen_of(of).name, of.domain
        limits = (float(domain.pressure_min), float(domain.pressure_max))
        found = [
            range_problem(pressure, limits, "bar", f"the range of {name}", "pressures") for pressure in self.pressures
        ]
        first, last = self.stroke(of)
        ends, limits = (
            {"contraction_min": first, "contraction_max": last},
            (float(domain.contraction_min), float(domain.contraction_max)),
        )
        for field, end in ends.items():
            if math.isfinite(end):
                found.append(range_problem(end, limits, "%", f"the range of {name}", field))
            else:
                found.append(Problem(f"{name} has no range", field=field, remedy="give the end of the stroke"))
        problems = [problem for problem in found if problem]
        count = 0 if problems else _plateaus_in(self.step, first, last, of)
        total = 2 * count * self.repeats * len(self.pressures)
        if total > MOST_POINTS:
            message = f"{self.step / mm:g} mm make {total} plateaus, and {MOST_POINTS} at most are allowed"
            problems.append(Problem(message, field="step", remedy="lengthen the step, or repeat less often"))
        if not problems and count < 2:
            stroke = f"{first / percent:.1f}..{last / percent:.1f} % of {name}"
            message = f"a step of {self.step / mm:g} mm does not fit into the stroke {stroke}"
            problems.append(Problem(message, field="step", remedy="shorten the step or widen the stroke"))
        refuse_problems(f"the isobaric protocol does not suit {name}", problems)

    def steps_for(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Steps of the paper's procedure: adjust, find the boundary values, unloading test, loading test, vent.

        A muscle has its `boundaries` by its law. For a specimen they are found at each pressure: from the shortest
        length until the next step would exceed the rated force, and back until the muscle is slack.

        Raises
        ------
        RangeError
            As `check`; or if the specimen has neither a law nor a rated force.
        """
        self.check(of)
        unloading, loading = self._acquire(direction="unloading"), self._acquire(direction="loading")
        walk: Callable[..., Walk] = partial(Walk, step=self.step, speed=self.speed, dwell=self.dwell)
        steps: list[ProtocolStep] = []
        first, last = self.stroke(of)
        if isinstance(of, Muscle):
            for pressure, low, high in zip(*boundaries(of, self), strict=True):
                passes = walk(to=float(high), acquire=unloading), walk(to=float(low), acquire=loading)
                turned = min(float(low) + TURNING / float(of.specimen.initial_length), last)
                steps += [
                    Vent(),
                    Move(to=turned, speed=self.speed),
                    Pressurise(pressure=float(pressure)),
                    Move(to=float(low), speed=self.speed),
                    Dwell(duration=self.dwell),
                    Repeat(times=self.repeats, steps=passes),
                ]
            return (*steps, Vent())
        # without a law: from the shortest length until the next step would exceed the limit, and back until it is slack
        if of.rated_force is None:
            message = f"a test without a law goes up to the rated force of {of.name}, which is unknown"
            remedy = "give the specimen its rated_force, or the muscle a law"
            raise RangeError(message, field="rated_force", remedy=remedy)
        limit = float(of.rated_force) * (1 - self.force_reserve)
        passes = walk(to=last, acquire=unloading, slack=self.slack_steps), walk(acquire=loading)
        for pressure in self.pressures:
            steps += [
                Vent(),
                Move(to=last, speed=self.speed),
                Pressurise(pressure=pressure),
                walk(to=first, acquire=self._acquire(keep=False), force=limit),
                Repeat(times=self.repeats, steps=passes),
            ]
        return (*steps, Vent())

    def plateaus(self, of: Muscle | Specimen) -> Plateaus:
        """Plateaus in order, within the `boundaries`."""
        limits, stroke = boundaries(of, self), positions(of, self)
        passes: list[tuple[NDArray[np.float64], int, int, bool]] = []
        for level, (_, low, high) in enumerate(zip(*limits, strict=True)):
            there = stroke[(stroke >= low) & (stroke <= high)]
            for repeat in range(self.repeats):
                passes += [(there, level, repeat, False), (there[::-1], level, repeat, True)]
        counts = [len(one[0]) for one in passes]
        stretching = np.repeat([one[3] for one in passes], counts)
        travel = np.where(stretching, self.step, -self.step)
        travel[np.cumsum([0, *counts[:-1]])] = 0.0
        taken = np.abs(travel) / self.speed + self.dwell + self.acquisition
        return Plateaus(
            level=np.repeat([one[1] for one in passes], counts),
            repeat=np.repeat([one[2] for one in passes], counts),
            stretching=stretching,
            contraction=np.concatenate([one[0] for one in passes]),
            travel=travel,
            time=np.cumsum(taken) - self.acquisition,
        )


@dataclass(frozen=True, kw_only=True)
class IsometricProtocol(PressureProtocol):
    """Isometric test: constant length, the pressure stepped up and down.

    Parameters
    ----------
    contractions
        Contractions [-] (ours by default).
    rate
        Rate of the set pressure [Pa/s]; by default it is stepped. Other parameters are those of `PressureProtocol`.
    """

    short_name = "isometric"
    lists = "pressures", "contractions"

    contractions: Sequence[Contraction] = tuple(value * percent for value in (-3, 0, 5, 10, 15, 20))
    rate: PressureRate | None = None

    def steps_for(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Steps of the test, without pressures whose force by the law exceeds the rated one; `dry_run` checks them."""
        steps: list[ProtocolStep] = []
        for contraction in self.contractions:
            pressures = _within_rating(of, contraction, sorted(self.pressures))
            filling, venting = self._acquire(phase="filling"), self._acquire(phase="venting")
            inside: list[ProtocolStep] = []
            for pressure, acquire in [*((p, filling) for p in pressures), *((p, venting) for p in pressures[::-1])]:
                inside += [Pressurise(pressure=pressure, rate=self.rate), Dwell(duration=self.dwell), acquire]
            repeated = Repeat(times=self.repeats, steps=tuple(inside))
            steps += [Vent(), Move(to=contraction, speed=self.speed), repeated]
        return (*steps, Vent())


@dataclass(frozen=True, kw_only=True)
class IsotonicProtocol(PressureProtocol):
    """Isotonic test: constant force, the pressure ramped up and down.

    Parameters
    ----------
    forces
        Forces [N] (ours by default); 300 N take about 2 bar, so that the pressures begin there.
    rate
        Rate of the set pressure [Pa/s] (ours), slow enough for the motor.
    tolerance
        Tolerance of the force at a point [N]. Other parameters are those of `PressureProtocol`.
    """

    short_name = "isotonic"
    lists = "pressures", "forces"

    forces: Sequence[Tension] = (50.0, 100.0, 200.0, 300.0)
    pressures: Sequence[SetPressure] = PAPER_PRESSURES[4:]
    rate: PressureRate = 0.1 * bar / s
    tolerance: Force = 2.0

    def steps_for(self, of: Muscle | Specimen) -> tuple[ProtocolStep, ...]:
        """Steps of the test, from the vented muscle at its initial length; `dry_run` checks them."""
        steps: list[ProtocolStep] = []
        rising = sorted(self.pressures)
        unloading, loading = self._acquire(direction="unloading"), self._acquire(direction="loading")
        for force in self.forces:
            hold = HoldForce(force=force, tolerance=self.tolerance, speed=self.speed)
            inside: list[ProtocolStep] = []
            for pressure, acquire in [*((p, unloading) for p in rising), *((p, loading) for p in rising[::-1])]:
                ramp = Pressurise(pressure=pressure, rate=self.rate, holding=force)
                inside += [ramp, hold, Dwell(duration=self.dwell), hold, acquire]
            steps += [Vent(), Move(to=0.0, speed=self.speed), Repeat(times=self.repeats, steps=tuple(inside))]
        return (*steps, Vent())


def _within_rating(of: Muscle | Specimen, contraction: float, pressures: Sequence[float]) -> list[float]:
    if not isinstance(of, Muscle):
        return list(pressures)
    there = forces(of, contraction, np.array(pressures))
    return [p for p, force in zip(pressures, there, strict=True) if force <= float(specimen_of(of).force_limit) * 0.95]


def away_from_turns(dataset: IsobaricDataset, *, travel: float = 2 * mm) -> IsobaricDataset:
    """Points of a dataset at least a travel [m] away from both ends of their stroke, in both directions.

    A law fitted to both directions lies between their frictions. Just after a reversal the friction still has its
    previous sign, which biases the fit; the points of the other direction are left out too, for balance.

    Raises
    ------
    RangeError
        If directions or the initial length are not known, or no point is left.
    """
    table = dataset.table
    if "direction" not in table or "initial_length" not in table.attrs:
        raise RangeError(
            "reversals are known only for a dataset with directions and an initial length",
            remedy="give both, or keep all points",
        )
    levels, contraction = dataset.levels, dataset.contraction
    repeats = table["repeat"].to_numpy() if "repeat" in table else np.zeros(len(dataset), int)
    margin = travel / table.attrs["initial_length"] - 1e-9
    keep = np.ones(len(dataset), bool)
    for level, repeat in {*zip(levels, repeats, strict=True)}:
        stroke = (levels == level) & (repeats == repeat)
        ends = contraction[stroke].min(), contraction[stroke].max()
        keep[stroke] = (contraction[stroke] - ends[0] >= margin) & (ends[1] - contraction[stroke] >= margin)
    if not keep.any():
        raise RangeError(
            f"no point lies {travel / mm:g} mm from both ends of its stroke, which excludes all points of one pressure",
            remedy="give a shorter travel, or the nominal pressures (set_pressure) where measured ones scatter",
        )
    return dataset.select(keep)
