"""Parts of the simulated rig: regulator and air chamber, motor and carriage of the stretching device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import check_fields
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError, RigError
from mckibben.muscle.air import ATMOSPHERE, ENERGY, FLOATS, L_PER_S_BAR, CriticalRatio, mass_flow
from mckibben.rig.bench import Drive
from mckibben.units import (
    Conductance,
    Distance,
    Force,
    N,
    PositivePressure,
    PositiveTime,
    PressureNoise,
    PressureScale,
    Quantity,
    ShortTime,
    Volume,
    bar,
    kPa,
    mm,
    ms,
)


@dataclass(frozen=True, kw_only=True)
class Regulator:
    """Proportional pressure regulator such as SMC's ITV0050-3ML, with supply, vent valve and tube.

    The command follows the signal with play (hysteresis), offset and lag. The opening is proportional to the pressure
    error within a band, to the supply or to the exhaust. Behind it is a 3/2 valve: without current its spring shuts off
    the regulator and vents the muscle.

    Numbers "of the maker" are quoted from memory from the data sheet of the ITV0000 series, unverified.

    Parameters
    ----------
    supply
        Gauge pressure [Pa] of the compressed air: 8 bar (ours; the maker allows 10).
    conductance, critical
        C [m^3/(s*Pa)] and b [-] of the fully open regulator, in both directions: 0.0091 dm^3/(s*bar), with which it
        passes the maker's 6 dm^3/min (ANR) at 10 bar, and 0.3 (ours).
    band
        Pressure error at which it is fully open [Pa]: 0.1 bar (ours).
    lag
        Time constant of the command [s]: 30 ms (ours), a third of the maker's response of 0.1 s without a load.
    hysteresis
        Width of the command's play [Pa]: 4.5 kPa, the maker's 0.5 % of 9 bar.
    repeatability
        Largest offset [Pa], drawn at each new command: 4.5 kPa, the maker's 0.5 % of 9 bar.
    highest
        Highest command [Pa]: 9 bar (the maker).
    dead_volume
        Volume of tube and fittings [m^3]: 5 cm^3 (ours; a metre of tube with 2.5 mm inside).
    exhaust, exhaust_delay
        C [m^3/(s*Pa)] of the vent valve with its tube, 0.1 dm^3/(s*bar), and its opening time [s], 20 ms; both ours.
    leak
        C [m^3/(s*Pa)] of all leaks: 1e-5 dm^3/(s*bar) (ours).
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

    def __post_init__(self) -> None:
        check_fields(self)
        if self.supply <= self.band:
            raise RangeError("regulator: a supply below its band gives no pressure", remedy="raise the supply")


_STEP = 2 * kPa  # largest change of pressure in a step: within 0.2 kPa of much shorter steps
_SHORTEST = 1e-5  # s
_REST = 0.05  # Pa from the target of a settled command
_STILL = 0.5  # Pa/s, highest rate of a pressure at rest
_NUDGE = 1.0  # Pa


class Chamber:
    """Air of the muscle at the temperature of the room. Its mass is the state; the pressure follows from the volume."""

    def __init__(self, regulator: Regulator, volume: float) -> None:
        self.regulator = regulator
        self.supply = regulator.supply
        self.hole = 0.0
        self.exhausting = True
        self.stuck: float | None = None
        self.offset = 0.0
        self.pressure = 0.0  # gauge [Pa]
        self.flow = 0.0  # into the muscle [kg/s]
        self.mass = ATMOSPHERE * (volume + regulator.dead_volume) / ENERGY
        self.resting = False
        self._signal = 0.0
        self._played = 0.0
        self._command = 0.0
        self._last = _SHORTEST  # length of the last adaptive step

    @property
    def signal(self) -> float:
        """Signal of the regulator, as a pressure [Pa]."""
        return self._signal

    def set_signal(self, pressure: float, offset: float) -> None:
        """Set a new signal, as a pressure [Pa], with the offset of the regulator [Pa]."""
        half = self.regulator.hysteresis / 2
        self._signal = min(max(pressure, 0.0), self.regulator.highest)
        self._played = min(max(self._played, self._signal - half), self._signal + half)
        self.offset = offset if self._signal > 0 else 0.0
        self.resting = False

    @property
    def target(self) -> float:
        """Target of the command [Pa]; 0 at a signal of 0."""
        return self._played + self.offset if self._signal > 0 else 0.0

    def step(self, span: float, volume: Callable[[float], float]) -> float:
        """Integrate at most a time span [s], with the volume [m^3] as a function of time; return the step [s]."""
        dead = self.regulator.dead_volume
        decay = self.regulator.lag
        target, command = self.target, self._command
        h = min(span, 2 * self._last)
        while True:
            half = target + (command - target) * math.exp(-h / (2 * decay))
            room = volume(h / 2) + dead
            per_mass = ENERGY / room
            now = self.mass * per_mass - ATMOSPHERE
            flow = self._into(now, half)
            slope = (self._into(now + _NUDGE, half) - flow) / _NUDGE * per_mass * h
            grown = flow * h * (math.expm1(slope) / slope if slope < -1e-9 else 1.0)
            if abs(grown * per_mass) <= _STEP or h <= _SHORTEST:
                break
            h = max(h * max(0.8 * _STEP / abs(grown * per_mass), 0.1), _SHORTEST)
        self._last = h if h < span or h > self._last else self._last  # not of a short span
        before = self.pressure
        self.mass += grown
        self.pressure = self.mass * ENERGY / (volume(h) + dead) - ATMOSPHERE
        self.flow = grown / h
        self._command = target + (command - target) * math.exp(-h / decay)
        self.resting = abs(self.pressure - before) < _STILL * h and abs(self._command - target) < _REST
        return h

    def widen(self, volume: float) -> None:
        """Change the volume of the muscle [m^3] at once, at constant mass."""
        self.pressure = self.mass * ENERGY / (volume + self.regulator.dead_volume) - ATMOSPHERE
        self.resting = False

    def _into(self, gauge: float, command: float) -> float:
        """Flow into the muscle [kg/s] at a pressure and a command [Pa, gauge]."""
        part, pressure = self.regulator, gauge + ATMOSPHERE
        out = part.leak + self.hole  # leaks and hole in parallel
        if self.exhausting:
            return mass_flow(out + part.exhaust, part.critical, ATMOSPHERE, pressure, FLOATS)
        opening = min(max((command - gauge) / part.band, -1.0), 1.0) if self.stuck is None else self.stuck
        if opening <= 0:
            return mass_flow(out - part.conductance * opening, part.critical, ATMOSPHERE, pressure, FLOATS)
        flow = mass_flow(part.conductance * opening, part.critical, self.supply + ATMOSPHERE, pressure, FLOATS)
        return flow + mass_flow(out, part.critical, ATMOSPHERE, pressure, FLOATS) if out else flow

    @property
    def opening(self) -> float:
        """Opening of the regulator, -1 (exhaust) to 1 (supply)."""
        if self.stuck is not None:
            return self.stuck
        return min(max((self._command - self.pressure) / self.regulator.band, -1.0), 1.0)


_ROUNDING = 1e-6  # pulses


@dataclass(frozen=True, kw_only=True)
class Stretcher:
    """Motor, reducer, lead screw and guide rails.

    Parameters
    ----------
    drive
        Motor and lead screw.
    backlash
        Backlash of the nut [m]: 0.02 mm (ours). A force above the friction of the guide takes it up: with a taut
        muscle the carriage follows the screw, with a slack one it stays.
    guide_friction
        Friction of the guide rails [N]: 5 N (ours).
    acceleration
        Of the motor [Hz/s]: infinite; at 80 Hz it needs no ramp.
    """

    drive: Drive = field(default_factory=Drive)
    backlash: Distance = 0.02 * mm
    guide_friction: Force = 5 * N
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        check_fields(self)
        if self.acceleration != math.inf:
            check_positive("stretcher", "Hz/s", acceleration=self.acceleration)


@dataclass(frozen=True)
class _Move:
    """Trapezoidal profile of a move: ramp up, constant rate, ramp down."""

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
        """Distance [pulses, fractional], not negative, at times [s]."""
        total, since = abs(self.pulses), np.minimum(time, self.end) - self.begin
        if self.acceleration == math.inf:
            return np.clip(since * self.rate, 0.0, total)
        ramp, left = self.rate / self.acceleration, self.end - self.begin - since
        even = self.rate * (since - ramp / 2)
        there = np.where(since < ramp, self.acceleration * since**2 / 2, even)
        there = np.where(left < ramp, total - self.acceleration * left**2 / 2, there)
        return np.clip(there, 0.0, total)


class Motor:
    """Position of the motor over time."""

    def __init__(self, stretcher: Stretcher) -> None:
        self._acceleration = stretcher.acceleration
        self._per_metre = stretcher.drive.pulses_per_metre
        self._fastest = stretcher.drive.fastest
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
            rate = min(rate, math.sqrt(abs(pulses) * self._acceleration))
            self._move = _Move(now, self._counted, int(pulses), rate, self._acceleration)

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
        if self._move is None:
            return np.full(len(time), self._counted, np.int64)
        sent = np.floor(self._move.sent(time) + _ROUNDING).astype(np.int64)
        return self._move.first + (sent if self._move.pulses > 0 else -sent)

    def travel(self, now: float) -> float:
        """Travel of the screw [m]."""
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
    """Position of the carriage [m], with backlash and friction."""

    def __init__(self, stretcher: Stretcher) -> None:
        self._play = stretcher.backlash
        self._friction = stretcher.guide_friction
        self.at = 0.0

    def follow(self, screw: float, pull: float) -> float:
        """Follow the screw [m] at a force of the muscle [N]."""
        if pull > self._friction:
            self.at = screw
        else:
            self.at = min(max(self.at, screw), screw + self._play)
        return self.at
