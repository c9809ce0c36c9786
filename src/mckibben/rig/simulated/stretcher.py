"""The stretching device: a motor that goes by pulses, and a carriage on a lead screw with some play."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RigError
from mckibben.numerics.checks import check_positive
from mckibben.rig.bench import Drive
from mckibben.units import N, mm

_ROUNDING = 1e-6  # pulses


@dataclass(frozen=True, kw_only=True)
class Stretcher:
    """Motor, reducer, lead screw and guide rails.

    Parameters
    ----------
    drive
        Its pulses and their way.
    backlash
        Play of the nut on its screw [m]: 0.02 mm (ours). A pull above the guide's friction takes it up: a taut muscle
        stands where the screw is, a slack one where the carriage was left.
    guide_friction
        What the guide rails hold the carriage with [N]: 5 N (ours).
    acceleration
        Of the motor [Hz/s], pulses a second each second: infinite; at 80 pulses a second it needs no ramp.
    """

    drive: Drive = field(default_factory=Drive)
    backlash: float = 0.02 * mm
    guide_friction: float = 5 * N
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        check_positive("stretcher", "m", zero=True, backlash=self.backlash)
        check_positive("stretcher", "N", zero=True, guide_friction=self.guide_friction)
        if self.acceleration != math.inf:
            check_positive("stretcher", "Hz/s", acceleration=self.acceleration)


@dataclass(frozen=True)
class _Move:
    """Pulses that are sent from a time on: an even ramp up, an even rate, an even ramp down."""

    begin: float
    first: int
    pulses: int
    rate: float
    acceleration: float

    @property
    def end(self) -> float:
        ramp = self.rate / self.acceleration
        return self.begin + abs(self.pulses) / self.rate + ramp

    def sent(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Part of the way [pulses, not whole], never negative, at times [s]."""
        total, since = abs(self.pulses), np.minimum(time, self.end) - self.begin
        if self.acceleration == math.inf:
            return np.clip(since * self.rate, 0.0, total)
        ramp, left = self.rate / self.acceleration, self.end - self.begin - since
        even = self.rate * (since - ramp / 2)
        there = np.where(since < ramp, self.acceleration * since**2 / 2, even)
        there = np.where(left < ramp, total - self.acceleration * left**2 / 2, there)
        return np.clip(there, 0.0, total)


class Motor:
    """Where the motor stands, over time.

    Parameters
    ----------
    stretcher
        What it drives.
    """

    def __init__(self, stretcher: Stretcher) -> None:
        self._acceleration = stretcher.acceleration
        self._per_metre = stretcher.drive.pulses_per_metre
        self._fastest = stretcher.drive.fastest
        self._move: _Move | None = None
        self._counted = 0  # where the last move ended
        self._stalled: float | None = None  # where the shaft stands [pulses]

    def move(self, now: float, pulses: int, rate: float) -> None:
        """Begin a move.

        Raises
        ------
        RigError
            If it is still moving, or not that fast.
        """
        if self.moving(now):
            raise RigError("the motor is still moving", remedy="wait until it stands, or stop it")
        if not 0 < rate <= self._fastest:
            raise RigError(
                f"the motor cannot go at {rate:g} pulses a second",
                value=rate,
                lower=0.0,
                upper=self._fastest,
                unit="Hz",
                remedy=f"it does {self._fastest:g} at most",
            )
        self.stop(now)
        if pulses:
            rate = min(rate, math.sqrt(abs(pulses) * self._acceleration))
            self._move = _Move(now, self._counted, int(pulses), rate, self._acceleration)

    def moving(self, now: float) -> bool:
        """Whether a move goes on."""
        return self._move is not None and now < self._move.end - 1e-9

    def next_end(self, now: float) -> float:
        """When the move ends that goes on [s]; infinite if it stands."""
        return self._move.end if self._move is not None and now < self._move.end else math.inf

    def stop(self, now: float) -> None:
        """Stand still."""
        if self._move is not None:
            self._counted = int(self.counted(np.array([now]))[0])
            self._move = None

    def stall(self, now: float) -> None:
        """From now on the shaft does not turn."""
        self._stalled = self._position(now)

    def counted(self, time: NDArray[np.float64]) -> NDArray[np.int64]:
        """Pulses that were sent until times [s], whole."""
        if self._move is None:
            return np.full(len(time), self._counted, np.int64)
        sent = np.floor(self._move.sent(time) + _ROUNDING).astype(np.int64)
        return self._move.first + (sent if self._move.pulses > 0 else -sent)

    def way(self, now: float) -> float:
        """The way of the screw [m]."""
        return (self._position(now) if self._stalled is None else self._stalled) / self._per_metre

    def _position(self, now: float) -> float:
        move = self._move
        if move is None:
            return float(self._counted)
        if self._acceleration == math.inf:
            sent = min(max((now - move.begin) * move.rate, 0.0), abs(move.pulses))
        else:
            sent = float(move.sent(np.array([now]))[0])
        return move.first + math.copysign(sent, move.pulses)


class Carriage:
    """Where the muscle's end is [m], which the screw draws.

    Parameters
    ----------
    stretcher
        Its play and its friction.
    """

    def __init__(self, stretcher: Stretcher) -> None:
        self._play = stretcher.backlash
        self._friction = stretcher.guide_friction
        self.at = 0.0

    def follow(self, screw: float, pull: float) -> float:
        """Go along with the screw [m], where the muscle pulls [N] towards its other end."""
        if pull > self._friction:
            self.at = screw
        else:
            self.at = min(max(self.at, screw), screw + self._play)
        return self.at
