"""Steps of a test on a rig."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from mckibben.component.base import Checked, check_fields
from mckibben.component.classes import Keyed
from mckibben.errors import RangeError
from mckibben.muscle.muscle import LEAST_PRESSURE
from mckibben.units import (
    Contraction,
    Duration,
    Force,
    N,
    PressureRate,
    Quantity,
    Repeats,
    Samples,
    Speed,
    Tension,
    WaitTime,
    bar,
    mm,
    s,
)

Phase = Literal["", "filling", "venting"]

SPEED = 0.2 * mm / s
"""Speed of the paper [m/s]: a step of 1 mm takes 5 s."""


class _SetPressureRange(Quantity):
    """Range without values in bar or kPa that were given as Pa."""

    def holds(self, number: Any) -> Any:
        return super().holds(number) & ((number <= 0) | (number >= LEAST_PRESSURE))

    @property
    def range(self) -> str:
        return f"{self.lower:g} to 0 bar, or {LEAST_PRESSURE / bar:g} to {self.upper:g} bar"


SetPressure = Annotated[float, _SetPressureRange("Pa", "bar", -1, 1e3)]


StepTravel = Annotated[float, Quantity("m", "mm", 0, 100, open_lower=True)]  # more is one in millimetres


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
