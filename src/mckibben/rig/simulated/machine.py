"""State of the simulated rig: muscle, air, motor and carriage over time."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array

from mckibben.actuator import AirState, AirVolume, PressureRegulator
from mckibben.muscle import Muscle, MuscleState
from mckibben.muscle.air import TEMPERATURE, exchange_rate
from mckibben.numerics.calculus import rk4, value_and_derivative
from mckibben.numerics.compiled import numeric
from mckibben.plant.base import STABILITY_LIMIT
from mckibben.rig.bench import Drive
from mckibben.rig.compiled import FlatTree, flat_program
from mckibben.rig.simulated.faults import Burst, Fault, Stalled, SupplyLost, ValveStuck
from mckibben.rig.simulated.parts import Motor, Regulator
from mckibben.rig.simulated.sampling import INSTANT
from mckibben.units import ms

_LONGEST, _MOVING = 100 * ms, 10 * ms  # between two knots, at rest and in motion
_STEPS = 10  # of the integration between two knots
_STILL = 0.5  # Pa/s and mK/s, highest rates at rest
_NOTHING = 1.0  # Pa, a signal of zero
_FAR = 1e9  # Pa, an error of the pressure that opens a valve fully
_ADIABATIC = 1.4**1.5  # as `AirActuator.fastest_index`


class ClampedMuscle(NamedTuple):
    """State of a muscle between clamps and its air: stretch [m] since it was mounted, gauge pressure [Pa], valve."""

    stretch: Any
    pressures: tuple[Any]
    air: AirState
    muscle: MuscleState


class Rig(NamedTuple):
    """Muscle, regulator, and contraction [-] at which the muscle is mounted."""

    muscle: Muscle
    valve: PressureRegulator
    mounted_at: Any

    def contraction(self, stretch: Any) -> Any:
        """Contraction [-] at a stretch [m]."""
        return self.mounted_at - stretch / self.muscle.specimen.initial_length

    def wall(self, stretch: Any) -> Any:
        """Lateral area of a cylinder with the length and the volume of the muscle, relative to that as mounted."""

        def squared(stretch: Any) -> Any:
            contraction = self.contraction(stretch)
            return self.muscle.specimen.volume(contraction) * (1 - contraction)

        return jnp.sqrt(squared(stretch) / squared(0.0))


def advance_flat(numbers: FlatTree, states: FlatTree, packed: Array, state: Array, inputs: Array) -> Array:
    """State after a move at constant speed, followed by the force [N] at its end.

    Inputs are the command [Pa], the stretch at the end [m], the duration [s], the side to which the valve is stuck (-1
    or 1; above 1: none), its conductance and that of all leaks [m^3/(s*Pa)], and the supply [Pa].
    """
    rig: Rig = numbers.unpack(packed)
    command, end, duration, stuck, conductance, leak, supply = inputs
    valve = dataclasses.replace(rig.valve, conductance=conductance, leak=leak, supply=supply)
    begin: ClampedMuscle = states.unpack(state)
    step, speed = duration / _STEPS, (end - begin.stretch) / duration

    def rate(stretch: Any, pressures: Any, air: AirState, creep: Any, *, muscle: MuscleState) -> Any:
        volume, growth = value_and_derivative(lambda at: rig.muscle.specimen.volume(rig.contraction(at)), stretch)
        here = valve
        if valve.wall_conductance is not None:
            here = dataclasses.replace(valve, wall_conductance=valve.wall_conductance * rig.wall(stretch))
        room = AirVolume(volume + valve.dead_volume, growth * speed)
        rates, air_rates = here.air_rate(pressures, air, (command,), (room,))
        creeping = rig.muscle.state_rate(muscle._replace(creep=creep), speed, pressures[0]).creep
        return speed, rates, air_rates, creeping

    def integrate(_: Any, at: ClampedMuscle) -> ClampedMuscle:
        sensed = at.pressures[0] + stuck * _FAR
        air = at.air._replace(valves=(jnp.where(stuck > 1, at.air.valves[0], sensed),))
        motion = at.stretch, at.pressures, air, at.muscle.creep
        stretch, pressures, air, creep = rk4(lambda now: rate(*now, muscle=at.muscle), motion, step)
        muscle = rig.muscle.update_state(at.muscle._replace(creep=creep), rig.contraction(stretch), pressures[0])
        return ClampedMuscle(stretch, pressures, air, muscle)

    after = lax.fori_loop(0, _STEPS, integrate, begin)
    contraction, pressure = rig.contraction(end), after.pressures[0]
    force = rig.muscle.tension(contraction, pressure, after.muscle)
    force = force + rig.muscle.viscous_force(contraction, pressure, speed, after.muscle)
    return jnp.concatenate([states.pack(after, jnp), jnp.reshape(force, 1)])


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
    vented
        Whether the vent valve is open.
    temperature
        Temperature [K] of the air in muscle and tube.
    """

    time: float
    pressure: float
    force: float
    stretch: float
    contraction: float
    vented: bool
    temperature: float


class Machine:
    """State of the simulated rig without sensors and card.

    Parameters
    ----------
    muscle, mounted_at
        The muscle, and its contraction [-] at the beginning.
    regulator, drive
        The other parts.
    """

    def __init__(self, muscle: Muscle, mounted_at: float, regulator: Regulator, drive: Drive) -> None:
        self.now = 0.0  # since the rig was first opened [s]
        self.motor = Motor(drive)
        self.shut, self.exhausting, self._exhaust_at = False, True, math.inf
        self.signal, self._command = 0.0, 0.0  # of the regulator, as pressures [Pa], without and with its offset
        self._part, self._hole, self._supply, self._stuck = regulator, 0.0, regulator.supply, math.inf
        self._resting, self._force = False, 0.0
        self._rig = Rig(muscle, regulator.valve(), float(mounted_at))
        rig: Rig = numeric(self._rig)
        relaxed = jax.eval_shape(functools.partial(_relaxed, rig))
        self._states, numbers = FlatTree.like(relaxed), FlatTree.like(rig)
        self._numbers = numbers.pack(rig)
        self._program = flat_program(advance_flat, numbers.size, self._states.size, 7, static=(numbers, self._states))
        self._state = self._states.pack(jax.tree.map(np.asarray, _relaxed(rig)))
        creep = muscle.creep
        times = [*getattr(creep, "time_constants", ()), *getattr(creep, "pressure_time_constants", ())]
        self._creeps = bool(times)
        self._knot = min([_LONGEST, *(float(time) / _STEPS * 2 for time in times)])
        self._specimen = muscle.specimen
        self._advance(INSTANT, 0.0)

    @property
    def truth(self) -> Truth:
        """True state."""
        _, pressure, _, *temperature = self._air
        stretch = self.motor.travel(self.now)
        contraction = float(self._rig.contraction(stretch))
        kelvin = temperature[0] if temperature else TEMPERATURE
        return Truth(self.now, pressure, self._force, stretch, contraction, self.exhausting, kelvin)

    @property
    def _air(self) -> list[float]:
        """Stretch [m], pressure and command of the regulator [Pa], and temperature [K], if the air has one."""
        return self._state[: 3 + (self._part.wall_conductance is not None)].tolist()

    def differs(self, pressure: float) -> bool:
        """Whether a pressure [Pa] is a new signal of the regulator."""
        return abs(pressure - self.signal) > _NOTHING

    def set_signal(self, pressure: float, offset: float) -> None:
        """Set the signal of the regulator, as a pressure [Pa], with its offset [Pa]."""
        self.signal = min(max(pressure, 0.0), self._part.highest)
        self._command = self.signal + offset if self.signal > 0 else 0.0
        self._resting = False

    def hold(self) -> None:
        """Close the vent valve, if the signal is above 0, and open the shut-off valve."""
        self.shut = self._resting = False
        if self.signal > _NOTHING:
            self.exhausting, self._exhaust_at = False, math.inf

    def close(self) -> None:
        """Close the shut-off valve."""
        self.shut, self._resting = True, False

    def cut(self) -> None:
        """Cut the current of the vent valve, which opens after its delay."""
        if not self.exhausting:
            self._exhaust_at = min(self._exhaust_at, self.now + self._part.exhaust_delay)

    def next_event(self) -> float:
        """Time of the next event [s]."""
        return min(self._exhaust_at, self.motor.next_end(self.now))

    def settle(self) -> None:
        """Apply the events that are due."""
        if self.now >= self._exhaust_at - INSTANT:
            self.exhausting, self._exhaust_at, self._resting = True, math.inf, False

    def pass_until(self, to: float) -> tuple[list[float], list[tuple[float, ...]]]:
        """Integrate until a time [s], before which there are no events; times, and force and pressure at them."""
        pressure = self._air[1]
        times, values = [self.now], list[tuple[float, ...]]([(self._force, pressure)])
        moving = self.motor.moving(self.now)
        while self.now < to:
            idle = self._resting and not moving
            if (not idle or self._creeps) and to - self.now > INSTANT:
                span = min(to - self.now, self._knot if idle else _MOVING, self._stable)
                pressure = self._advance(span, self.motor.travel(self.now + span))
            else:
                span = to - self.now
            self.now = to if self.now + span > to - INSTANT else self.now + span
            times.append(self.now)
            values.append((self._force, pressure))
        return times, values

    def _advance(self, span: float, stretch: float) -> float:
        """Integrate over a span [s] to a stretch [m]; return the pressure [Pa]."""
        side = math.copysign(1.0, self._stuck) if abs(self._stuck) <= 1 else math.inf
        inputs = [self._command, stretch, span, side, *self._conductances, self._supply]
        before, after = self._air, np.asarray(self._program(self._numbers, self._state, np.array(inputs)))
        self._state, self._force = after[:-1], float(after[-1])
        _, *changes = (new - old for new, old in zip(self._air, before, strict=True))
        self._resting = max(map(abs, (*changes[:2], *(1e3 * change for change in changes[2:])))) < _STILL * span
        return self._air[1]

    @property
    def _conductances(self) -> tuple[float, float]:
        """Conductances [m^3/(s*Pa)] of the regulator and of all ways to the atmosphere."""
        leak = self._part.leak + self._hole + (self._part.exhaust if self.exhausting else 0.0)
        share = abs(self._stuck) if abs(self._stuck) <= 1 else 1.0
        return 0.0 if self.shut or self.exhausting else share * self._part.conductance, leak

    @functools.cached_property
    def _stable(self) -> float:
        """Longest span [s] that the steps resolve with all valves open: air, loop and lag of the regulator."""
        domain, part, valve = self._specimen.domain, self._part, self._rig.valve
        ends = domain.contraction_min, domain.contraction_max, self._rig.mounted_at
        volume = min(float(self._specimen.volume(end)) for end in ends) + part.dead_volume
        conductance = part.conductance + part.exhaust + part.leak + self._hole
        rate = exchange_rate(_ADIABATIC, part.critical, conductance, volume)
        return 0.5 * _STEPS * STABILITY_LIMIT / max(rate, valve.fastest_rate_in(volume))

    def apply(self, fault: Fault) -> None:
        """Apply a fault of the machine."""
        match fault:
            case SupplyLost():
                self._supply = 0.0
            case ValveStuck(opening=opening):
                self._stuck = opening
            case Burst(conductance=conductance):
                self._hole += conductance
                del self._stable
            case Stalled():
                self.motor.stall(self.now)
            case _:
                pass
        self._resting = False


def _relaxed(rig: Rig) -> ClampedMuscle:
    """Vented and relaxed, as mounted."""
    pressure = jnp.zeros(())
    air = rig.valve.init_states((pressure,))
    assert isinstance(air, AirState)
    return ClampedMuscle(jnp.zeros(()), (pressure,), air, rig.muscle.init_state(rig.mounted_at, pressure))
