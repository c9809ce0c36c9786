"""The steps that a test is made of. They say what is wanted; `Runner` does it, `dry_run` adds it up beforehand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from mckibben.errors import Problem, RangeError
from mckibben.units import N, bar, mm, percent, s

DIRECTIONS = ("", "loading", "unloading")
PHASES = ("", "filling", "venting")

SPEED = 0.2 * mm / s
"""The paper's: a step of 1 mm takes 5 s."""


@dataclass(frozen=True, kw_only=True)
class Move:
    """Stretch the muscle or let it shorten.

    Parameters
    ----------
    to
        Contraction [-] at the end.
    speed
        [m/s].
    """

    to: float
    speed: float = SPEED

    def __post_init__(self) -> None:
        _refuse("move", _contraction("to", self.to), _positive("speed", self.speed, "m/s"))

    def describe(self) -> str:
        """In words."""
        return f"move to {self.to / percent:.4g} % contraction at {self.speed / mm:g} mm/s"


@dataclass(frozen=True, kw_only=True)
class Dwell:
    """Wait for a duration [s]."""

    duration: float

    def __post_init__(self) -> None:
        _refuse("dwell", _positive("duration", self.duration, "s", zero=True))

    def describe(self) -> str:
        """In words."""
        return f"wait {self.duration:g} s"


@dataclass(frozen=True, kw_only=True)
class Pressurise:
    """Set a pressure, and wait until the muscle has it.

    Parameters
    ----------
    pressure
        [Pa, gauge].
    rate
        How fast the set pressure gets there [Pa/s]; at once unless given.
    holding
        A force [N] that is held meanwhile by moving, see `HoldForce`; the position is held unless given.
    """

    pressure: float
    rate: float | None = None
    holding: float | None = None

    def __post_init__(self) -> None:
        _refuse(
            "pressurise",
            None if math.isfinite(self.pressure) else Problem("is not finite", field="pressure"),
            None if self.rate is None else _positive("rate", self.rate, "Pa/s"),
            None if self.holding is None else _positive("holding", self.holding, "N"),
        )

    def describe(self) -> str:
        """In words."""
        rate = f" at {self.rate / bar:g} bar/s" if self.rate is not None else ""
        return f"pressurise to {self.pressure / bar:g} bar{rate}" + (
            f", holding {self.holding:g} N" if self.holding is not None else ""
        )


@dataclass(frozen=True, kw_only=True)
class HoldForce:
    """Move until the muscle pulls with a force, and stays so.

    Parameters
    ----------
    force
        [N].
    tolerance
        How far the mean over a cycle may be off [N].
    speed
        The highest [m/s].
    longest
        After so long [s] without success the test is stopped.
    """

    force: float
    tolerance: float = 2 * N
    speed: float = SPEED
    longest: float = 300 * s

    def __post_init__(self) -> None:
        _refuse(
            "hold_force",
            *(
                _positive(name, getattr(self, name), unit)
                for name, unit in (("force", "N"), ("tolerance", "N"), ("speed", "m/s"), ("longest", "s"))
            ),
        )

    def describe(self) -> str:
        """In words."""
        return f"move until it pulls {self.force:g} N +- {self.tolerance:g} N"


@dataclass(frozen=True, kw_only=True)
class Acquire:
    """Take a point: the samples of a plateau.

    Parameters
    ----------
    samples, duration
        So many, evenly, within so long [s]: 1000 within 1 s.
    direction
        "loading" or "unloading", where the point belongs to a pass.
    phase
        "filling" or "venting", where it belongs to a change of pressure.
    keep
        Whether it is a point of the data; one that only finds a boundary is not.
    """

    samples: int = 1000
    duration: float = 1 * s
    direction: str = ""
    phase: str = ""
    keep: bool = True

    def __post_init__(self) -> None:
        _refuse(
            "acquire",
            _whole("samples", self.samples),
            _positive("duration", self.duration, "s"),
            _among("direction", self.direction, DIRECTIONS),
            _among("phase", self.phase, PHASES),
        )

    def describe(self) -> str:
        """In words."""
        return f"take {self.samples} samples in {self.duration:g} s"


@dataclass(frozen=True, kw_only=True)
class Walk:
    """Plateau after plateau: take a point where it stands, then again and again move a step, wait, take one.

    Parameters
    ----------
    to
        Contraction [-] up to which it goes; None is back to where the walk before began.
    step
        Way between two plateaus [m].
    speed, dwell
        Of each move [m/s], and the wait after it [s].
    acquire
        What is taken at each.
    force
        It ends before a step that, by the last two points, would take the force above this [N].
    slack, slack_force
        It ends so many plateaus after the last one at which the force was above `slack_force` [N].
    """

    to: float | None
    step: float = 1 * mm
    speed: float = SPEED
    dwell: float = 5 * s
    acquire: Acquire = field(default_factory=Acquire)
    force: float | None = None
    slack: int | None = None
    slack_force: float = 1 * N

    def __post_init__(self) -> None:
        _refuse(
            "walk",
            None if self.to is None else _contraction("to", self.to),
            _positive("step", self.step, "m"),
            _positive("speed", self.speed, "m/s"),
            _positive("dwell", self.dwell, "s", zero=True),
            None if self.force is None else _positive("force", self.force, "N"),
            None if self.slack is None else _whole("slack", self.slack),
            _positive("slack_force", self.slack_force, "N", zero=True),
        )

    def describe(self) -> str:
        """In words."""
        to = "back" if self.to is None else f"to {self.to / percent:.4g} % contraction"
        ends = [f"until {self.force:g} N"] if self.force is not None else []
        ends += [f"until {self.slack} slack plateaus"] if self.slack is not None else []
        what = f" ({self.acquire.direction})" if self.acquire.direction else ""
        return (
            f"walk {to} in steps of {self.step / mm:g} mm{what}{''.join(f', {end}' for end in ends)}; at each: "
            f"{self.step / self.speed:g} s move, {self.dwell:g} s wait, {self.acquire.describe().removeprefix('take ')}"
        )


@dataclass(frozen=True, kw_only=True)
class Vent:
    """Let the air out, and wait until it is."""

    def describe(self) -> str:
        """In words."""
        return "vent"


@dataclass(frozen=True, kw_only=True)
class Repeat:
    """Steps several times. The points inside carry the number of the innermost repeat, from 0."""

    times: int
    steps: tuple[Step, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "steps", tuple(self.steps))
        _refuse(
            "repeat",
            _whole("times", self.times),
            None if self.steps else Problem("is empty", field="steps", remedy="give at least one"),
        )

    def describe(self) -> str:
        """In words, without its steps."""
        return f"{self.times} times"


Step = Move | Dwell | Pressurise | HoldForce | Acquire | Walk | Vent | Repeat


def describe_steps(steps: Sequence[Step], indent: int = 0) -> list[str]:
    """Steps as lines of text, those of a repeat indented.

    >>> describe_steps([Repeat(times=2, steps=(Dwell(duration=1.0), Vent()))])
    ['2 times', '  wait 1 s', '  vent']
    """
    lines: list[str] = []
    for step in steps:
        lines.append("  " * indent + step.describe())
        if isinstance(step, Repeat):
            lines += describe_steps(step.steps, indent + 1)
    return lines


def _refuse(what: str, *problems: Problem | None) -> None:
    if there := [problem for problem in problems if problem is not None]:
        raise RangeError("; ".join(f"{what}: {problem}" for problem in there))


def _positive(name: str, value: float, unit: str, *, zero: bool = False) -> Problem | None:
    if math.isfinite(value) and (value > 0 or (zero and value == 0)):
        return None
    return Problem(f"{value:g} {unit} is not {'0 or above' if zero else 'above 0'}", field=name)


def _contraction(name: str, value: float) -> Problem | None:
    if math.isfinite(value) and abs(value) < 1:
        return None
    return Problem(f"{value:g} is no contraction", field=name, remedy="it is a ratio below 1: divide percent by 100")


def _whole(name: str, value: object) -> Problem | None:
    if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
        return None
    return Problem(f"{value!r} is not a whole number from 1 up", field=name)


def _among(name: str, value: str, words: Sequence[str]) -> Problem | None:
    return None if value in words else Problem(f"{value!r} is none of {words}", field=name)
