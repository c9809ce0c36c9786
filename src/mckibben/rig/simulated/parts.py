"""Parts of the simulated rig: regulator and motor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mckibben.actuator import PressureRegulator
from mckibben.component.base import Checked
from mckibben.errors import RangeError, RigError
from mckibben.muscle.air import L_PER_S_BAR, CriticalRatio
from mckibben.rig.bench import Drive
from mckibben.units import (
    Conductance,
    HeatConductance,
    PositivePressure,
    PositiveTime,
    PressureNoise,
    PressureScale,
    Quantity,
    ShortTime,
    Volume,
    bar,
    kPa,
    ms,
)


@dataclass(frozen=True, kw_only=True)
class Regulator(Checked):
    """Proportional pressure regulator such as SMC's ITV0050-3ML, with supply, vent valve and tube.

    A `PressureRegulator` whose commands have an offset. Behind it is a shut-off valve, and behind this a 3/2 valve:
    without current its spring shuts off the regulator and vents the muscle.

    Numbers "of the maker" are quoted from memory from the ITV0000 data sheet, unverified; others are ours.

    Parameters
    ----------
    supply
        Supply pressure [Pa]; the maker allows 10 bar.
    conductance
        Sonic conductance C [m^3/(s*Pa)] fully open, in both directions: the maker's 6 dm^3/min at 10 bar.
    critical
        Critical pressure ratio b [-].
    band
        Error of the pressure [Pa] at which it is fully open.
    lag
        Time constant [s] of the command: a third of the maker's response of 0.1 s without a load.
    hysteresis
        Width [Pa] of the command's play: the maker's 0.5 % of 9 bar.
    repeatability
        Largest offset [Pa], drawn at each new command: the maker's 0.5 % of 9 bar.
    highest
        Highest command [Pa] (the maker).
    dead_volume
        Volume [m^3] of tube and fittings: a metre of tube with 2.5 mm inside.
    exhaust, exhaust_delay
        C [m^3/(s*Pa)] of the vent valve with its tube, and its opening time [s].
    leak
        C of a leak [m^3/(s*Pa)].
    wall_conductance
        h A [W/K] of the wall of the muscle as mounted; without it, the air is at room temperature.

    Raises
    ------
    RangeError
        If a number is out of the range of its field.
    """

    supply: PositivePressure = 8 * bar
    conductance: Conductance = 0.0091 * L_PER_S_BAR
    critical: CriticalRatio = 0.3
    band: PressureScale = 0.1 * bar
    lag: PositiveTime = 30 * ms
    hysteresis: PressureNoise = 4.5 * kPa
    repeatability: PressureNoise = 4.5 * kPa
    highest: PositivePressure = 9 * bar
    dead_volume: Volume = 5e-6
    exhaust: Conductance = 0.1 * L_PER_S_BAR
    exhaust_delay: ShortTime = 20 * ms
    leak: Annotated[float, Quantity("m^3/(s*Pa)", "L/(s*bar)", 0, 1e4)] = 1e-5 * L_PER_S_BAR
    wall_conductance: HeatConductance | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.supply <= self.band:
            raise RangeError("regulator: a supply below its band gives no pressure", remedy="raise the supply")

    def valve(self) -> PressureRegulator:
        """The same as an actuator."""
        return PressureRegulator(
            conductance=self.conductance,
            supply=self.supply,
            time_constant=self.lag,
            hysteresis=self.hysteresis,
            critical_ratio=self.critical,
            band=self.band,
            polytropic_index=1.0,
            wall_conductance=self.wall_conductance,
            dead_volume=self.dead_volume,
            leak=self.exhaust,
        )


_ROUNDING = 1e-6  # pulses


@dataclass(frozen=True)
class _Move:
    """A move at a constant rate [Hz], which begins at a time [s] and a position [pulses]."""

    begin: float
    first: int
    pulses: int
    rate: float

    @property
    def end(self) -> float:
        return self.begin + abs(self.pulses) / self.rate


class Motor:
    """Position of the motor over time.

    Examples
    --------
    >>> motor = Motor(Drive())
    >>> motor.move(0.0, 40, 80.0)
    >>> motor.counted(np.array([0.0, 0.25, 1.0])).tolist(), motor.moving(0.4)
    ([0, 20, 40], True)
    """

    def __init__(self, drive: Drive) -> None:
        self._per_metre = drive.pulses_per_metre
        self._fastest = drive.fastest
        self._move: _Move | None = None
        self._counted = 0  # end of the last move
        self._stalled: float | None = None  # position of the blocked shaft [pulses]

    def move(self, now: float, pulses: int, rate: float) -> None:
        """Begin a move by pulses at a rate [Hz]; `RigError` if it is moving, or the rate is too high."""
        if self.moving(now):
            raise RigError("the motor is still moving", remedy="wait until it stops, or stop it")
        if not 0 < rate <= self._fastest:
            message = f"the motor cannot run at {rate:g} pulses per second"
            remedy = f"it reaches {self._fastest:g} at most"
            raise RigError(message, value=rate, lower=0.0, upper=self._fastest, unit="Hz", remedy=remedy)
        self.stop(now)
        if pulses:
            self._move = _Move(now, self._counted, int(pulses), rate)

    def moving(self, now: float) -> bool:
        """Whether it is moving."""
        return self._move is not None and now < self._move.end - 1e-9

    def next_end(self, now: float) -> float:
        """End of the present move [s]; infinite without one."""
        return self._move.end if self._move is not None and now < self._move.end else math.inf

    def stop(self, now: float) -> None:
        """Stop."""
        if self._move is not None:
            self._counted = int(self.counted(np.array([now]))[0])
            self._move = None

    def stall(self, now: float) -> None:
        """Block the shaft."""
        self._stalled = self._position(now)

    def counted(self, time: NDArray[np.float64]) -> NDArray[np.int64]:
        """Whole pulses sent until times [s]."""
        if (move := self._move) is None:
            return np.full(len(time), self._counted, np.int64)
        sent = np.clip((np.minimum(time, move.end) - move.begin) * move.rate, 0.0, abs(move.pulses))
        return move.first + np.sign(move.pulses) * np.floor(sent + _ROUNDING).astype(np.int64)

    def travel(self, now: float) -> float:
        """Travel of the screw [m]."""
        return (self._position(now) if self._stalled is None else self._stalled) / self._per_metre

    def _position(self, now: float) -> float:
        move = self._move
        if move is None:
            return float(self._counted)
        sent = min(max((now - move.begin) * move.rate, 0.0), abs(move.pulses))
        return move.first + math.copysign(sent, move.pulses)
