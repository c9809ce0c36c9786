"""State of the simulated rig: muscle, air, motor and screw over time."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import RangeError
from mckibben.muscle import MaxwellCreep, MaxwellSlip, Muscle, NoCreep, NoFriction, forces
from mckibben.numerics.elementary import polynomial
from mckibben.rig.simulated.faults import Burst, Fault, Slipped, Stalled, SupplyLost, ValveStuck
from mckibben.rig.simulated.parts import Carriage, Chamber, Motor, Regulator, Stretcher
from mckibben.units import bar, ms, percent

if TYPE_CHECKING:
    from scipy.interpolate import RectBivariateSpline

_BEYOND = 3 * percent  # of contraction, on both sides of the range of the specimen
_HIGHEST = 11 * bar
_CELLS = (320, 88)  # of contraction and of pressure
_WIDEST = (-0.2, 0.6)
_ROUGH = 0.5  # N

# Cubic Hermite interpolation: coefficients of a cell's coordinate from values and slopes at its ends.
_HERMITE = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [-3, 3, -2, -1], [2, -2, 1, 1]], float)


@dataclass(frozen=True)
class ForceTable:
    """Table of a law's force over contraction and pressure, a bicubic spline; constant outside.

    Attributes
    ----------
    contraction, pressure
        Ranges of contraction [-] and gauge pressure [Pa].
    error
        Largest deviation from the law in the centres of cells with a taut muscle [N].
    """

    contraction: tuple[float, float]
    pressure: tuple[float, float]
    error: float
    _cells: NDArray[np.float64]

    def force(self, contraction: float, pressure: float) -> float:
        """Force [N] at a contraction [-] and a gauge pressure [Pa]."""
        (first, last), (low, high) = self.contraction, self.pressure
        rows, columns = _CELLS
        x = (contraction - first) / (last - first) * rows
        y = (pressure - low) / (high - low) * columns
        x, y = min(max(x, 0.0), rows - 1e-9), min(max(y, 0.0), columns - 1e-9)
        i, j = int(x), int(y)
        x, y = x - i, y - j
        a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3, d0, d1, d2, d3 = self._cells[i, j].tolist()
        force = (
            ((d3 * y + d2) * y + d1) * y
            + d0
        ) * x + ((c3 * y + c2) * y + c1) * y + c0  # fmt: skip
        force = force * x + ((b3 * y + b2) * y + b1) * y + b0
        force = force * x + ((a3 * y + a2) * y + a1) * y + a0
        return force if force > 0 else 0.0


def force_table(muscle: Muscle) -> ForceTable:
    """Return the table of the law of a muscle, cached.

    Raises
    ------
    RangeError
        If the law is not smooth enough for a table, or has no finite force.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.units import bar
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> round(force_table(muscle).force(0.0, 6 * bar), 2)  # of Eq. 3
    584.72
    """
    bare = Muscle(muscle.specimen, muscle.law, strength=muscle.strength, correction=muscle.correction)
    try:
        return _cached(bare)
    except TypeError:  # arrays as parameters are not hashable
        return _tabulate(bare)


def _tabulate(muscle: Muscle) -> ForceTable:
    domain = muscle.specimen.domain
    first = max(float(domain.contraction_min) - _BEYOND, _WIDEST[0])
    last = min(float(domain.contraction_max) + _BEYOND, _WIDEST[1])
    x, y = (np.linspace(*ends, cells + 1) for ends, cells in zip(((first, last), (0.0, _HIGHEST)), _CELLS, strict=True))
    middle_x, middle_y = ((axis[1:] + axis[:-1]) / 2 for axis in (x, y))
    at = forces(muscle.force_law, x[:, None], y)
    between = forces(muscle.force_law, middle_x[:, None], middle_y)
    if not np.isfinite(at).all():
        raise RangeError(
            f"the law of {muscle.specimen.name} has no finite force somewhere within {first / percent:.0f}.."
            f"{last / percent:.0f} % and 0..{_HIGHEST / bar:g} bar",
            remedy="give the specimen a narrower range",
        )
    from scipy.interpolate import RectBivariateSpline  # 0.3 s

    spline = RectBivariateSpline(x, y, at)
    error = float(np.abs(spline(middle_x, middle_y) - between)[between > 0].max(initial=0.0))
    if error > _ROUGH:
        message = f"the law of {muscle.specimen.name} is not smooth enough: its table deviates by {error:.2g} N"
        raise RangeError(message, value=error, unit="N")
    return ForceTable((first, last), (0.0, _HIGHEST), error, _coefficients(spline, x, y))


_cached = functools.lru_cache(maxsize=8)(_tabulate)


def _coefficients(spline: RectBivariateSpline, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """Coefficients of each cell, in powers of its coordinates 0..1; shape (len(x) - 1, len(y) - 1, 16)."""
    wide, high = x[1] - x[0], y[1] - y[0]
    corners = np.empty((len(x) - 1, len(y) - 1, 4, 4))
    for dx in (0, 1):
        for dy in (0, 1):
            values = spline(x, y, dx=dx, dy=dy) * wide**dx * high**dy
            for row in (0, 1):
                for column in (0, 1):
                    there = values[row : len(x) - 1 + row, column : len(y) - 1 + column]
                    corners[:, :, 2 * dx + row, 2 * dy + column] = there
    cells = np.einsum("ri,abij,cj->abrc", _HERMITE, corners, _HERMITE)
    return np.ascontiguousarray(cells.reshape(len(x) - 1, len(y) - 1, 16))


_LEAST = 1e-9  # N, least width of a friction band


class Grip:
    """Force of a clamped muscle with `MaxwellSlip` and `MaxwellCreep`, in plain floats.

    Parameters
    ----------
    muscle
        The muscle.
    contraction
        Contraction [-] at which it is clamped, relaxed.
    """

    def __init__(self, muscle: Muscle, contraction: float) -> None:
        specimen, friction, creep = muscle.specimen, muscle.friction, muscle.creep
        for part, kinds in ((friction, (NoFriction, MaxwellSlip)), (creep, (NoCreep, MaxwellCreep))):
            if not isinstance(part, kinds):
                raise RangeError(
                    f"a simulated rig does not support {type(part).__name__}",
                    remedy=f"give the muscle a {kinds[1].__name__}",
                )
        self.table: ForceTable = force_table(muscle)
        self.held = True
        self.start = contraction
        self.length = float(specimen.initial_length)
        self._shortest = float(specimen.domain.contraction_max)
        self._volume_terms = specimen.volume_terms
        if self._volume_terms is None:
            diameter, angle = map(float, specimen.braid("the simulated air volume"))
            self._cylinder = math.pi * diameter**2 / 4 * self.length / math.sin(angle) ** 2
            self._cos2 = math.cos(angle) ** 2
        self._slipping = isinstance(friction, MaxwellSlip)
        self._stiffness: list[float] = []
        if isinstance(friction, MaxwellSlip):
            self._stiffness, shares = friction.stiffnesses.tolist(), friction.shares.tolist()
            self._reach = [share / k for share, k in zip(shares, self._stiffness, strict=True)]
            self._width = float(friction.half_width), float(friction.growth), float(friction.reference_pressure)
            self._by_tension = float(friction.tension_growth or 0.0), float(friction.reference_tension)
            self._viscous = float(friction.viscous)
            self._viscous_growth = float(friction.viscous_growth or 0.0), float(friction.viscous_length_growth or 0.0)
            self._reference_length = float(friction.reference_length or 0.0)
            self._by_rate = float(friction.rate_growth or 0.0), float(friction.rate_speed or 1.0)
            self._follows_rate = friction.follows_rate
        self._deflections = [0.0] * len(self._stiffness)
        self._times: list[float] = []
        self._delays: list[float] = []
        if isinstance(creep, MaxwellCreep):
            self._times = [float(time) for time in creep.time_constants]
            self._delays = [float(time) for time in creep.pressure_time_constants]
            self._share = float(creep.stiffness) / creep.arms
            self._delayed_share = float(creep.pressure_share or 0.0) / creep.arms
        self._relaxing = [0.0] * len(self._times)
        self._lags = [0.0] * len(self._delays)  # of the delayed pressures behind the pressure [Pa]
        self._stretch = self._pressure = 0.0

    @property
    def shortest_time(self) -> float:
        """Shortest time constant of the creep [s]; infinite without creep."""
        return min([*self._times, *self._delays], default=math.inf)

    def contraction(self, stretch: float) -> float:
        """Contraction [-] at a stretch from where it was clamped [m]."""
        return self.start - stretch / self.length if self.held else self._shortest

    def volume(self, stretch: float) -> float:
        """Volume of the muscle [m^3]; `Specimen.volume` as a plain float."""
        if self._volume_terms is not None:
            return polynomial(self.contraction(stretch), self._volume_terms)
        ratio = 1 - self.contraction(stretch)
        return self._cylinder * ratio * (1 - self._cos2 * ratio * ratio)

    def wall(self, stretch: float) -> float:
        """Area of a cylinder with the length and the volume of the muscle, relative to that of the clamped one."""
        length = (1 - self.contraction(stretch)) / (1 - self.start)
        return math.sqrt(self.volume(stretch) / self.volume(0.0) * length)

    def force(self, stretch: float, pressure: float, span: float) -> float:
        """Return the force [N] after a move.

        Parameters
        ----------
        stretch
            Stretch at its end, from where the muscle was clamped [m].
        pressure
            Gauge pressure [Pa].
        span
            Its duration [s].
        """
        if not self.held:
            return 0.0
        travel, self._stretch = stretch - self._stretch, stretch
        rise, self._pressure = pressure - self._pressure, pressure
        tension = self.table.force(self.start - stretch / self.length, pressure)
        total = tension
        if self._slipping:
            base, growth, reference = self._width
            share, middle = self._by_tension
            width = max(base + growth * (pressure - reference) + share * (tension - middle), _LEAST)
            limit = width * math.tanh(tension / (2 * width))
            deflections = self._deflections
            for k, (stiffness, reach) in enumerate(zip(self._stiffness, self._reach, strict=True)):
                most = reach * limit
                now = deflections[k] + travel
                now = most if now > most else -most if now < -most else now
                deflections[k] = now
                total += stiffness * now
            if travel and self._follows_rate and tension > 2 * _LEAST and span > 0:
                rate = travel / span
                by_pressure, by_length = self._viscous_growth
                damping = self._viscous + by_pressure * (pressure - reference)
                damping += by_length * (self.length * (1 - self.start) + stretch - self._reference_length)
                growth, speed = self._by_rate
                drag = max(damping, 0.0) * rate + growth * limit * math.tanh(rate / speed)
                total += min(max(drag, limit - tension), tension - limit)
        for k, time in enumerate(self._times):
            most = tension / (2 * len(self._times))
            now = _followed(self._relaxing[k], self._share * travel, span / time)
            self._relaxing[k] = now = min(max(now, -most), most)
            if self._delays:
                self._lags[k] = lag = _followed(self._lags[k], rise, span / self._delays[k])
                delayed = self.table.force(self.start - stretch / self.length, pressure - lag)
                now = min(max(now + self._delayed_share * (delayed - tension), -most), most)
            total += now
        return total


def _followed(before: float, change: float, ratio: float) -> float:
    """Value that relaxes to zero after a linear change over a time, given as a ratio to the time constant."""
    return before * math.exp(-ratio) + change * (-math.expm1(-ratio) / ratio if ratio > 0 else 1.0)


_LONGEST = 100 * ms  # between two knots of the interpolation
_FINE = 5  # knots in the time constant of the quickest creep
_NOTHING = 1.0  # Pa, a signal of zero

INSTANT = 1e-9
"""Tolerance of times [s]."""


class Truth(NamedTuple):
    """True state of the simulated rig.

    Attributes
    ----------
    time
        Time since the rig was first opened [s].
    pressure
        Gauge pressure in the muscle [Pa].
    force
        Force at the clamps [N].
    stretch
        Travel of the carriage since the rig was first opened [m], positive = stretching.
    contraction
        Contraction [-].
    flow, mass, temperature
        Flow of air into the muscle [kg/s]; mass [kg] and temperature [K] of the air in muscle and tube.
    vented
        Whether the vent valve is open.
    """

    time: float
    pressure: float
    force: float
    stretch: float
    contraction: float
    flow: float
    mass: float
    vented: bool
    temperature: float


class Knots(NamedTuple):
    """Knots of a piecewise linear history.

    Attributes
    ----------
    time
        Times since the first opening [s].
    force, pressure
        Force [N] and pressure [Pa] at these times.
    """

    time: list[float]
    force: list[float]
    pressure: list[float]


class Machine:
    """State of the simulated rig without sensors and card.

    Parameters
    ----------
    muscle, mounted_at
        The muscle, and its contraction [-] at the beginning.
    regulator, stretcher
        The other parts.
    """

    def __init__(self, muscle: Muscle, mounted_at: float, regulator: Regulator, stretcher: Stretcher) -> None:
        self.now = 0.0  # since the rig was first opened [s]
        self.grip = Grip(muscle, mounted_at)
        self.motor = Motor(stretcher)
        self._chamber = Chamber(regulator, self.grip.volume(0.0))
        self._carriage = Carriage(stretcher)
        self._knot = min(_LONGEST, self.grip.shortest_time / _FINE)
        self._pull = self.grip.force(0.0, 0.0, 0.0)
        self._delay, self._wall = regulator.exhaust_delay, regulator.wall_conductance
        self._exhaust_at = math.inf

    @property
    def truth(self) -> Truth:
        """True state."""
        chamber, stretch = self._chamber, self._carriage.at
        contraction = self.grip.contraction(stretch)
        air = chamber.flow, chamber.mass, chamber.exhausting, chamber.temperature
        return Truth(self.now, chamber.pressure, self._pull, stretch, contraction, *air)

    def differs(self, pressure: float) -> bool:
        """Whether a pressure [Pa] is a new signal of the regulator."""
        return abs(pressure - self._chamber.signal) > _NOTHING

    def set_signal(self, pressure: float, offset: float) -> None:
        """Set the signal of the regulator, as a pressure [Pa], with its offset [Pa]."""
        self._chamber.set_signal(pressure, offset)

    def hold(self) -> None:
        """Close the vent valve, if the signal is above 0, and open the shut-off valve."""
        self._chamber.shut = False
        if self._chamber.signal > _NOTHING:
            self._chamber.exhausting, self._exhaust_at = False, math.inf
            self._chamber.resting = False

    def shut(self) -> None:
        """Close the shut-off valve."""
        self._chamber.shut, self._chamber.resting = True, False

    def cut(self) -> None:
        """Cut the current of the vent valve, which opens after its delay."""
        if not self._chamber.exhausting:
            self._exhaust_at = min(self._exhaust_at, self.now + self._delay)

    def next_event(self) -> float:
        """Time of the next event [s]."""
        return min(self._exhaust_at, self.motor.next_end(self.now))

    def settle(self) -> None:
        """Apply the events that are due."""
        if self.now >= self._exhaust_at - INSTANT:
            self._chamber.exhausting, self._exhaust_at = True, math.inf
            self._chamber.resting = False

    def pass_until(self, to: float) -> Knots:
        """Integrate until a time [s], before which there are no events."""
        chamber, grip, motor, carriage = self._chamber, self.grip, self.motor, self._carriage
        now, pull, pressure = self.now, self._pull, chamber.pressure
        knots = Knots([now], [pull], [pressure])
        moving, screw = motor.moving(now), motor.travel(now)
        room, growth = grip.volume(screw), 0.0
        while now < to:
            span, after = to - now, screw
            if moving or not chamber.resting:
                span = min(span, self._knot)
                if moving:
                    after = motor.travel(now + span)
                    growth = (grip.volume(after) - room) / span
                    if self._wall is not None:
                        chamber.wall = self._wall * grip.wall(after)
                whole = span
                span = chamber.step(span, lambda time, room=room, growth=growth: room + growth * time)
                pressure = chamber.pressure
                if moving:
                    after = after if span == whole else motor.travel(now + span)
                    room = grip.volume(after)
            elif self._knot < _LONGEST:
                span = min(span, self._knot)
            now, screw = to if now + span > to - INSTANT else now + span, after
            stretch = carriage.follow(screw, pull)
            pull = grip.force(stretch, pressure, span)
            knots.time.append(now)
            knots.force.append(pull)
            knots.pressure.append(pressure)
        self.now, self._pull = to, pull
        return knots

    def apply(self, fault: Fault) -> None:
        """Apply a fault of the machine."""
        chamber = self._chamber
        match fault:
            case SupplyLost():
                chamber.supply = 0.0
            case ValveStuck(opening=opening):
                chamber.stuck = opening
            case Slipped():
                self.grip.held, self._pull = False, 0.0
                chamber.widen(self.grip.volume(self._carriage.at))
            case Burst(conductance=conductance):
                chamber.hole += conductance
            case Stalled():
                self.motor.stall(self.now)
            case _:
                pass
        chamber.resting = False
