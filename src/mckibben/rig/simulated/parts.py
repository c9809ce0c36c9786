"""Parts of the simulated rig: regulator and air chamber, motor and carriage of the stretching device."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mckibben.component.base import Checked
from mckibben.errors import RangeError, RigError
from mckibben.muscle.air import (
    ATMOSPHERE,
    ENERGY,
    FLOATS,
    GAS_CONSTANT,
    HEAT_CAPACITY_RATIO,
    L_PER_S_BAR,
    TEMPERATURE,
    CriticalRatio,
    mass_flow,
)
from mckibben.rig.bench import Drive
from mckibben.units import (
    Conductance,
    Distance,
    Force,
    HeatConductance,
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
class Regulator(Checked):
    """Proportional pressure regulator such as SMC's ITV0050-3ML, with supply, vent valve and tube.

    The command follows the signal with play (hysteresis), offset and lag. The opening is proportional to the pressure
    error within a band, to the supply or to the exhaust. Behind it is a shut-off valve, and behind this a 3/2 valve:
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


_STEP = 2 * kPa  # largest change of pressure in a step: within 0.2 kPa of much shorter steps
_SHORTEST = 1e-5  # s
_REST = 0.05  # Pa from the target of a settled command
_STILL = 0.5  # Pa/s, highest rate of a pressure at rest
_NUDGE = 1.0  # Pa
_COLD = 1e-3  # K from the temperature of the room at rest
_GROWTH = HEAT_CAPACITY_RATIO - 1


class Chamber:
    """Air of the muscle. Its mass is the state, and with a wall its temperature; the pressure follows.

    Parameters
    ----------
    regulator
        Regulator with its vent valve.
    volume
        Volume of the muscle at the beginning [m^3], vented.
    """

    def __init__(self, regulator: Regulator, volume: float) -> None:
        self.regulator = regulator
        self.supply = regulator.supply
        self.hole = 0.0
        self.exhausting = True
        self.shut = False
        self.temperature = TEMPERATURE
        self.wall = regulator.wall_conductance
        self.stuck: float | None = None
        self.offset = 0.0
        self.pressure = 0.0  # gauge [Pa]
        self.flow = 0.0  # into the muscle [kg/s]
        self.mass = ATMOSPHERE * (volume + regulator.dead_volume) / ENERGY
        self.resting = False
        self.signal = 0.0  # of the regulator, as a pressure [Pa]
        self._played = 0.0
        self._command = 0.0
        self._last = _SHORTEST  # length of the last adaptive step

    def set_signal(self, pressure: float, offset: float) -> None:
        """Set a new signal, as a pressure [Pa], with the offset of the regulator [Pa]."""
        half = self.regulator.hysteresis / 2
        self.signal = min(max(pressure, 0.0), self.regulator.highest)
        self._played = min(max(self._played, self.signal - half), self.signal + half)
        self.offset = offset if self.signal > 0 else 0.0
        self.resting = False

    @property
    def target(self) -> float:
        """Target of the command [Pa]; 0 at a signal of 0."""
        return self._played + self.offset if self.signal > 0 else 0.0

    def step(self, span: float, volume: Callable[[float], float]) -> float:
        """Integrate a step.

        Parameters
        ----------
        span
            Longest step [s].
        volume
            Volume of the muscle [m^3], a function of the time from now [s].

        Returns
        -------
        float
            The step [s].
        """
        dead = self.regulator.dead_volume
        decay, wall = self.regulator.lag, self.wall
        target, command = self.target, self._command
        h, warmth, index = min(span, 2 * self._last), self.temperature / TEMPERATURE, 1.0
        if wall is not None:
            index = HEAT_CAPACITY_RATIO
            heating = _GROWTH * wall * abs(self.temperature - TEMPERATURE) / (volume(0.0) + dead)  # Pa/s
            h = min(h, _STEP / max(heating, 1e-9))
        while True:
            half = target + (command - target) * math.exp(-h / (2 * decay))
            room = volume(h / 2) + dead
            now = self.mass * (ENERGY * warmth / room) - ATMOSPHERE
            per_mass = index * ENERGY / room
            flow, nudged = self._into(now, half), self._into(now + _NUDGE, half)
            if flow < 0:  # ISO 6358, with the temperature of the air upstream
                flow, nudged = flow * warmth**-0.5, nudged * warmth**-0.5
            slope = (nudged - flow) / _NUDGE * per_mass * h
            grown = flow * h * (math.expm1(slope) / slope if slope < -1e-9 else 1.0)
            if abs(grown * per_mass) <= _STEP or h <= _SHORTEST:
                break
            h = max(h * max(0.8 * _STEP / abs(grown * per_mass), 0.1), _SHORTEST)
        self._last = h if h < span or h > self._last else self._last  # not of a short span
        before, room = self.pressure, volume(h) + dead
        if wall is not None:
            self._warm(grown, (volume(0.0) + dead) / room, wall * h)
        self.mass += grown
        self.pressure = self.mass * (GAS_CONSTANT * self.temperature) / room - ATMOSPHERE
        self.flow = grown / h
        self._command = target + (command - target) * math.exp(-h / decay)
        self.resting = abs(self.pressure - before) < _STILL * h and abs(self._command - target) < _REST
        self.resting &= abs(self.temperature - TEMPERATURE) < _COLD
        return h

    def _warm(self, grown: float, compression: float, conducted: float) -> None:
        """Change the temperature by a mass that flows in [kg], a ratio of volumes, and heat from the wall [J/K]."""
        mass = self.mass + grown
        left = math.exp(-conducted / 2 * _GROWTH / (mass * GAS_CONSTANT))  # half of the heat before, half after
        warm = TEMPERATURE + (self.temperature - TEMPERATURE) * left
        if grown < 0:  # what is left expands without heat
            warm *= (mass / self.mass) ** _GROWTH
        else:
            warm = (self.mass * warm + HEAT_CAPACITY_RATIO * TEMPERATURE * grown) / mass
        self.temperature = TEMPERATURE + (warm * compression**_GROWTH - TEMPERATURE) * left

    def widen(self, volume: float) -> None:
        """Change the volume of the muscle [m^3] at once, at constant mass."""
        self.pressure = self.mass * (GAS_CONSTANT * self.temperature) / (volume + self.regulator.dead_volume)
        self.pressure -= ATMOSPHERE
        self.resting = False

    def _into(self, gauge: float, command: float) -> float:
        """Flow into the muscle [kg/s] at a pressure and a command [Pa, gauge]."""
        part, pressure = self.regulator, gauge + ATMOSPHERE
        out = part.leak + self.hole  # leaks and hole in parallel
        if self.exhausting:
            return mass_flow(out + part.exhaust, part.critical, ATMOSPHERE, pressure, FLOATS)
        if self.shut:
            return mass_flow(out, part.critical, ATMOSPHERE, pressure, FLOATS)
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
class Stretcher(Checked):
    """Motor, reducer, lead screw and guide rails; the numbers are ours.

    A force above the friction of the guide takes up the backlash: with a taut muscle the carriage follows the screw,
    with a slack one it stays.

    Parameters
    ----------
    drive
        Motor with its gear.
    backlash
        Backlash of the nut [m].
    guide_friction
        Friction of the guide [N].
    """

    drive: Drive = field(default_factory=Drive)
    backlash: Distance = 0.02 * mm
    guide_friction: Force = 5 * N


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
    >>> motor = Motor(Stretcher())
    >>> motor.move(0.0, 40, 80.0)
    >>> motor.counted(np.array([0.0, 0.25, 1.0])).tolist(), motor.moving(0.4)
    ([0, 20, 40], True)
    """

    def __init__(self, stretcher: Stretcher) -> None:
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
