"""Whole tests as steps: the paper's isobaric one, one at constant length, one at constant force."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mckibben.errors import Problem, RangeError
from mckibben.muscle import Muscle, Specimen, forces
from mckibben.rig.protocol import PAPER_PRESSURES, IsobaricProtocol, boundaries, specimen_of
from mckibben.rig.steps import SPEED, Acquire, Dwell, HoldForce, Move, Pressurise, Repeat, Step, Vent, Walk
from mckibben.units import bar, mm, percent, s

_ADJUSTED = 5 * mm  # stretched on the way to the first plateau: after 2 mm 2 % of a loop would be left, some 0.5 N


def isobaric_steps(protocol: IsobaricProtocol, of: Muscle | Specimen) -> tuple[Step, ...]:
    """The paper's procedure as steps: adjust, find the boundary values, unloading test, loading test, vent.

    Of a muscle, whose law tells the boundaries, each pass goes from plateau to plateau between them. Of a specimen
    alone they are found as it goes: at each pressure the rig starts where the muscle is shortest, and stretches it
    step by step until one more would take the force above the rated one less the protocol's reserve; a pass of
    unloading then ends `slack_steps` plateaus after the last taut one, and the loading goes back to where that began.

    Raises
    ------
    RangeError
        As the protocol's `check` and `boundaries` do.
    """
    protocol.check(of)
    unloading, loading = (
        Acquire(samples=protocol.samples, duration=protocol.acquisition, direction=direction)
        for direction in ("unloading", "loading")
    )

    def walk(to: float | None, acquire: Acquire, *, force: float | None = None, slack: int | None = None) -> Walk:
        return Walk(
            to=to,
            step=protocol.step,
            speed=protocol.speed,
            dwell=protocol.dwell,
            acquire=acquire,
            force=force,
            slack=slack,
        )

    steps: list[Step] = []
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
    first, last = protocol.stroke(of)
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
    """A place on the short side of the stretched end, so far that friction has changed sides when this is reached."""
    return min(low + _ADJUSTED / float(of.specimen.initial_length), protocol.stroke(of)[1])


@dataclass(frozen=True, kw_only=True)
class IsometricProtocol:
    """The length held, the pressure stepped up and down.

    Parameters
    ----------
    contractions
        At which it is done [-], in their order: -3, 0, 5, 10, 15, 20 % (ours).
    pressures
        Set pressures [Pa, gauge], ascending; they are filled in this order and vented in the other.
    rate
        How fast the set pressure goes from one to the next [Pa/s]: at once unless given.
    speed
        Of the moves between lengths [m/s].
    dwell, acquisition, samples, repeats
        As in the isobaric test.
    """

    contractions: Sequence[float] = tuple(value * percent for value in (-3, 0, 5, 10, 15, 20))
    pressures: Sequence[float] = PAPER_PRESSURES
    rate: float | None = None
    speed: float = SPEED
    dwell: float = 5 * s
    acquisition: float = 1 * s
    samples: int = 1000
    repeats: int = 1

    def __post_init__(self) -> None:
        for name in ("contractions", "pressures"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        _refuse("isometric protocol", _ascending(self.pressures), _given("contractions", self.contractions))

    def steps(self, of: Muscle | Specimen) -> tuple[Step, ...]:
        """The test as steps; what does not suit the muscle is found by `dry_run`.

        Where a law tells that a pressure would take the force above the rated one, it is left out at that length.
        """
        steps: list[Step] = []
        for contraction in self.contractions:
            pressures = _bearable(of, contraction, self.pressures)
            steps += [
                Vent(),
                Move(to=contraction, speed=self.speed),
                Repeat(
                    times=self.repeats,
                    steps=(*self._passed(pressures, "filling"), *self._passed(pressures[::-1], "venting")),
                ),
            ]
        return (*steps, Vent())

    def _passed(self, pressures: Sequence[float], phase: str) -> list[Step]:
        acquire = Acquire(samples=self.samples, duration=self.acquisition, phase=phase)
        return [
            step
            for pressure in pressures
            for step in (Pressurise(pressure=pressure, rate=self.rate), Dwell(duration=self.dwell), acquire)
        ]


@dataclass(frozen=True, kw_only=True)
class IsotonicProtocol:
    """The tension held by moving, the pressure stepped up and down.

    Parameters
    ----------
    forces
        Tensions held [N], in their order: 50, 100, 200 N (ours).
    pressures
        Set pressures [Pa, gauge], ascending, as in the isometric test: 2, 2.5, ... 6 bar (ours; with less than about
        2 bar the paper's muscle is not short enough to be held at 200 N by its length).
    rate
        How fast the set pressure goes from one to the next [Pa/s]: 0.1 bar/s (ours), so slow that the motor follows.
    tolerance
        How far the force may be off when a point is taken [N].
    speed, dwell, acquisition, samples, repeats
        As in the isobaric test.
    """

    forces: Sequence[float] = (50.0, 100.0, 200.0)
    pressures: Sequence[float] = tuple(0.5 * level * bar for level in range(4, 13))
    rate: float = 0.1 * bar / s
    tolerance: float = 2.0
    speed: float = SPEED
    dwell: float = 5 * s
    acquisition: float = 1 * s
    samples: int = 1000
    repeats: int = 1

    def __post_init__(self) -> None:
        for name in ("forces", "pressures"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        _refuse("isotonic protocol", _ascending(self.pressures), _given("forces", self.forces))

    def steps(self, of: Muscle | Specimen) -> tuple[Step, ...]:
        """The test as steps; what does not suit the muscle is found by `dry_run`.

        It begins at the length at rest with no pressure, and stretches until the muscle pulls.
        """
        steps: list[Step] = []
        for force in self.forces:
            steps += [Vent(), Move(to=0.0, speed=self.speed)]
            passed = [(pressure, "filling") for pressure in self.pressures]
            passed += [(pressure, "venting") for pressure in self.pressures[::-1]]
            inside: list[Step] = []
            for pressure, phase in passed:
                inside += [
                    Pressurise(pressure=pressure, rate=self.rate, holding=force),
                    HoldForce(force=force, tolerance=self.tolerance, speed=self.speed),
                    Dwell(duration=self.dwell),
                    HoldForce(force=force, tolerance=self.tolerance, speed=self.speed),
                    Acquire(samples=self.samples, duration=self.acquisition, phase=phase),
                ]
            steps.append(Repeat(times=self.repeats, steps=tuple(inside)))
        return (*steps, Vent())


Procedure = IsobaricProtocol | IsometricProtocol | IsotonicProtocol


def steps_of(procedure: Procedure, of: Muscle | Specimen) -> tuple[Step, ...]:
    """A whole test as steps, for a muscle or for a specimen whose law is not known."""
    return isobaric_steps(procedure, of) if isinstance(procedure, IsobaricProtocol) else procedure.steps(of)


def _bearable(of: Muscle | Specimen, contraction: float, pressures: Sequence[float]) -> list[float]:
    if not isinstance(of, Muscle):
        return list(pressures)
    there = forces(of, contraction, np.array(pressures))
    return [p for p, force in zip(pressures, there, strict=True) if force <= float(specimen_of(of).rated_force) * 0.95]


def _ascending(pressures: Sequence[float]) -> Problem | None:
    rising = all(a < b for a, b in itertools.pairwise(pressures))
    if pressures and rising and all(map(math.isfinite, pressures)):
        return None
    return Problem("do not rise", field="pressures", remedy="give at least one, ascending; they are vented backwards")


def _given(name: str, values: Sequence[float]) -> Problem | None:
    if values and all(map(math.isfinite, values)):
        return None
    return Problem("give at least one, all finite", field=name)


def _refuse(what: str, *problems: Problem | None) -> None:
    if there := [problem for problem in problems if problem is not None]:
        raise RangeError("\n  ".join([f"{what}: {len(there)} problem(s)", *map(str, there)]))
