"""What a rig is made of, as it goes along with the time: air, muscle, screw and motor, and what can break."""

from __future__ import annotations

import math
from typing import NamedTuple

from mckibben.muscle import Muscle
from mckibben.rig.twin.chamber import Chamber, Regulator
from mckibben.rig.twin.faults import Burst, Fault, Slipped, Stalled, SupplyLost, ValveStuck
from mckibben.rig.twin.grip import Grip
from mckibben.rig.twin.stretcher import Carriage, Motor, Stretcher
from mckibben.units import ms

_LONGEST = 100 * ms  # between two knots, from which the samples are interpolated
_FINE = 5  # knots in the time constant of the quickest creep
_NOTHING = 1.0  # Pa: a signal that is none

INSTANT = 1e-9
"""Times [s] that are nearer to each other are the same."""


class Truth(NamedTuple):
    """What no sensor tells.

    Attributes
    ----------
    time
        Since the rig was first opened [s].
    pressure
        In the muscle [Pa, gauge].
    force
        With which it pulls at its clamps [N].
    stretch
        Way of the carriage [m] since the rig was first opened, positive = stretching.
    contraction
        Of the muscle [-].
    flow, mass
        Of the air: into the muscle [kg/s], and in it and its tube [kg].
    vented
        Whether the spring has opened the way out.
    """

    time: float
    pressure: float
    force: float
    stretch: float
    contraction: float
    flow: float
    mass: float
    vented: bool


class Knots(NamedTuple):
    """What was, at times between which it goes straight.

    Attributes
    ----------
    time
        Since the rig was first opened [s].
    force, pressure
        As in `Truth`.
    """

    time: list[float]
    force: list[float]
    pressure: list[float]


class Machine:
    """All of a rig but its sensors and its card.

    Parameters
    ----------
    muscle, mounted_at
        What is clamped into it, and at which contraction [-].
    regulator, stretcher
        The parts.
    """

    def __init__(self, muscle: Muscle, mounted_at: float, regulator: Regulator, stretcher: Stretcher) -> None:
        self.now = 0.0  # since the rig was first opened [s]
        self.grip = Grip(muscle, mounted_at)
        self.motor = Motor(stretcher)
        self._chamber = Chamber(regulator, self.grip.volume(0.0))
        self._carriage = Carriage(stretcher)
        self._knot = min(_LONGEST, self.grip.shortest_time / _FINE)
        self._pull = self.grip.force(0.0, 0.0, 0.0)
        self._delay = regulator.exhaust_delay
        self._exhaust_at = math.inf

    @property
    def truth(self) -> Truth:
        """What is, now."""
        chamber, stretch = self._chamber, self._carriage.at
        contraction = self.grip.contraction(stretch)
        return Truth(
            self.now,
            chamber.pressure,
            self._pull,
            stretch,
            contraction,
            chamber.flow,
            chamber.mass,
            chamber.exhausting,
        )

    def differs(self, pressure: float) -> bool:
        """Whether this [Pa] would be a new signal to the regulator."""
        return abs(pressure - self._chamber.signal) > _NOTHING

    def tell(self, pressure: float, offset: float) -> None:
        """A new signal of the regulator, as a pressure [Pa], and what it is off [Pa] at it."""
        self._chamber.tell(pressure, offset)

    def hold(self) -> None:
        """Give the spring valve its current, where the signal is above 0: the muscle is at the regulator."""
        if self._chamber.signal > _NOTHING:
            self._chamber.exhausting, self._exhaust_at = False, math.inf
            self._chamber.resting = False

    def cut(self) -> None:
        """Take the spring valve's current: a moment later the muscle is open to the room."""
        if not self._chamber.exhausting:
            self._exhaust_at = min(self._exhaust_at, self.now + self._delay)

    def next_event(self) -> float:
        """When the next thing happens by itself [s]."""
        return min(self._exhaust_at, self.motor.next_end(self.now))

    def settle(self) -> None:
        """Let happen what is due."""
        if self.now >= self._exhaust_at - INSTANT:
            self._chamber.exhausting, self._exhaust_at = True, math.inf
            self._chamber.resting = False

    def pass_until(self, to: float) -> Knots:
        """Go on until then [s], with no event on the way."""
        chamber, grip, motor, carriage = self._chamber, self.grip, self.motor, self._carriage
        now, pull, pressure = self.now, self._pull, chamber.pressure
        knots = Knots([now], [pull], [pressure])
        moving, screw = motor.moving(now), motor.way(now)
        room, growth = grip.volume(screw), 0.0
        while now < to:
            span, after = to - now, screw
            if moving or not chamber.resting:
                span = min(span, self._knot)
                if moving:
                    after = motor.way(now + span)
                    growth = (grip.volume(after) - room) / span
                whole = span
                span = chamber.step(span, lambda time, room=room, growth=growth: room + growth * time)
                pressure = chamber.pressure
                if moving:
                    after = after if span == whole else motor.way(now + span)
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

    def damage(self, fault: Fault) -> None:
        """What a fault does to it; one of sensors, card or host does nothing."""
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
