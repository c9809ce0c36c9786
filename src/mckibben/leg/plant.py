"""The simulated leg: bodies, muscles, valves, and the ground."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError
from mckibben.joint import RigidTendon
from mckibben.leg.dynamics import Contact, Posture, Velocity, acceleration, contact, frames, motion
from mckibben.leg.mechanism import Leg, LegJoint, RoutedMuscle
from mckibben.muscle import MuscleState
from mckibben.numerics.calculus import rk4, value_and_derivative
from mckibben.numerics.elementary import floating
from mckibben.plant.actuator import Actuator, AirState, AirVolume
from mckibben.units import Gravity, Quantity, Share, Speed, bar, deg, mm

ContactDamping = Annotated[float, Quantity("s/m", "s/m", 0, 1e3)]
ContactStiffness = Annotated[float, Quantity("N/m", "kN/m", 0, 1e6, open_lower=True)]

Scalar = Float[Array, ""]


def compliant_force(depth: ArrayLike, rate: ArrayLike, stiffness: ArrayLike, damping: ArrayLike) -> Array:
    """Return k d (1 + c d') at a depth d, 0 outside and never pulling.

    K. H. Hunt and F. R. E. Crossley, Coefficient of restitution interpreted as damping in vibroimpact, Journal of
    Applied Mechanics 42 (1975), with the exponent 1: continuous at the first touch, as a damper beside a spring is not.
    """
    pressed = jnp.maximum(jnp.asarray(depth), 0.0)
    return jnp.asarray(stiffness) * pressed * jnp.maximum(1 + jnp.asarray(damping) * rate, 0.0)


class Ground(Component):
    """Level ground at the height 0: a compliant contact with friction.

    Parameters
    ----------
    stiffness, damping
        k [N/m] and c [s/m] of the normal force k d (1 + c d') at a depth d [m], never pulling (`compliant_force`).
    friction
        Coefficient of friction.
    slip_speed
        Speed [m/s] v0 that regularises it: the force is -mu N v / sqrt(v^2 + v0^2).
    """

    stiffness: ContactStiffness = 20e3
    damping: ContactDamping = 0.5
    friction: Share = 0.8
    slip_speed: Speed = 100 * mm

    def force(self, point: Contact) -> tuple[Array, Array]:
        """Return the force [N] on the foot, forward and up."""
        normal = compliant_force(-point.z, -point.vz, self.stiffness, self.damping)
        slip = jnp.sqrt(point.vx * point.vx + self.slip_speed * self.slip_speed)
        return -self.friction * normal * point.vx / slip, normal


class LegState(NamedTuple):
    """State of a `LegPlant`; `muscles` has no leaves without friction and creep, `air` none without actuator states."""

    posture: Posture
    velocity: Velocity
    pressures: tuple[Scalar, ...]
    muscles: tuple[MuscleState, ...]
    air: AirState | tuple[()] = ()


class _Integrated(NamedTuple):
    """Integrated part of a `LegState`, or its rate."""

    posture: Any
    velocity: Any
    creep: tuple[Any, ...]
    pressures: Any = ()
    air: Any = ()

    @classmethod
    def of(cls, state: LegState) -> _Integrated:
        pressures = state.pressures if isinstance(state.air, AirState) else ()
        return cls(state.posture, state.velocity, tuple(one.creep for one in state.muscles), pressures, state.air)

    def applied_to(self, state: LegState, pressures: tuple[Scalar, ...]) -> LegState:
        """Return a state with this part, and other pressures [Pa] unless they belong to it."""
        muscles = tuple(
            MuscleState(held.friction, creep) for held, creep in zip(state.muscles, self.creep, strict=True)
        )
        return LegState(self.posture, self.velocity, self.pressures or pressures, muscles, self.air)


class LegForces(NamedTuple):
    """Tensions [N] and contractions of the muscles, torques [N*m] of the joints, and the force of the ground [N].

    Torques include damping and stops; `stops` are those of the stops alone.
    """

    tensions: tuple[Array, ...]
    contractions: tuple[Array, ...]
    path_rates: tuple[Array, ...]
    torques: tuple[Array, ...]
    stops: tuple[Array, ...]
    ground: tuple[Array, Array]


class LegPlant(Component):
    """The simulated leg, of bodies, muscles, valves and ground; controllers have no access to it.

    Parameters
    ----------
    leg, valve, ground
        The leg, the valve of each muscle, and the ground.
    gravity
        g [m/s^2].
    """

    leg: Leg
    valve: Actuator
    ground: Ground = Ground()
    gravity: Gravity = 9.81

    def __repr__(self) -> str:
        return f"LegPlant({self.leg!r}, {type(self.valve).__name__})"

    def init_state(
        self,
        angles: Sequence[ArrayLike],
        pressures: Sequence[ArrayLike],
        *,
        clearance: ArrayLike = 0.0,
        upward_speed: ArrayLike = 0.0,
    ) -> LegState:
        """Return the state of a posture at gauge pressures [Pa], all of it moving upwards at a speed [m/s].

        Parameters
        ----------
        angles
            Angles of the joints [rad].
        clearance
            Height of the foot above the ground [m].

        Raises
        ------
        RangeError
            If there is not one angle for each joint and one pressure for each muscle, an angle is beyond its stop, or
            the foot is in the ground.
        """
        leg = self.leg
        _check_count("angles", len(angles), [joint.name for joint in leg.joints])
        _check_count("pressures", len(pressures), leg.muscle_names)
        for joint, angle in zip(leg.joints, angles, strict=True):
            _check_angle(joint, angle)
        supply = getattr(self.valve, "supply", None)
        for name, muscle, pressure in zip(leg.muscle_names, leg.muscles, pressures, strict=True):
            highest = muscle.specimen.domain.pressure_max
            _check_pressure(name, pressure, highest)
            _check_pressure(f"{name} (supply)", pressure, highest if supply is None else supply)
        check_positive("LegPlant", "m", zero=True, clearance=clearance)
        if leg.trunk.freedom == "fixed" and not (isinstance(upward_speed, Real) and upward_speed == 0):
            raise RangeError(
                "a fixed trunk has no speed",
                field="upward_speed",
                value=upward_speed,
                remedy="give the trunk the freedom vertical, planar or free",
            )
        held = tuple(map(floating, leg.held(angles)))
        zero, speed = jnp.zeros(()), floating(upward_speed)
        posture = Posture(zero, zero, zero, held)
        velocity = Velocity(zero, speed, zero, tuple(zero for _ in held))
        posture = posture._replace(z=floating(clearance) - contact(leg, frames(leg, posture, velocity)).z)
        inside = tuple(map(floating, pressures))
        muscles = tuple(
            unit.muscle.init_state(unit.tendon.contraction(unit.muscle, unit.path, pressure))
            for unit, pressure in zip(leg.routed_muscles(held), inside, strict=True)
        )
        air = self.valve.init_states(inside)
        return LegState(posture, velocity, inside, muscles, air)

    def clip_commands(self, commands: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] within rated pressures and supply; `RangeError` unless one for each muscle."""
        _check_count("commands", len(commands), self.leg.muscle_names)
        rated = (muscle.specimen.domain for muscle in self.leg.muscles)
        return tuple(map(self.valve.clip_command, commands, rated))

    def forces(self, state: LegState) -> LegForces:
        """Return the forces in a state."""
        leg = self.leg
        angles, rates = state.posture.angles, state.velocity.angles
        torques: list[Array] = [-joint.damping * rate for joint, rate in zip(leg.joints, rates, strict=True)]
        tensions, contractions, path_rates = [], [], []
        for unit, pressure, held in zip(leg.routed_muscles(angles), state.pressures, state.muscles, strict=True):
            path_rate = _path_rate(unit, rates)
            contraction = unit.tendon.contraction(unit.muscle, unit.path, pressure, held)
            tension = unit.muscle.tension(contraction, pressure, held)
            tension = tension + unit.muscle.viscous_force(contraction, pressure, path_rate, held)
            for joint, slope in unit.slopes.items():
                torques[joint] = torques[joint] - tension * slope
            tensions.append(tension)
            contractions.append(contraction)
            path_rates.append(path_rate)
        stops = []
        for joint, angle, rate in zip(leg.joints, angles, rates, strict=True):
            stiffness, damping = joint.stop_stiffness, joint.stop_damping
            beyond = compliant_force(angle - joint.upper, rate, stiffness, damping)
            stops.append(compliant_force(joint.lower - angle, -rate, stiffness, damping) - beyond)
        total = tuple(one + stop for one, stop in zip(torques, stops, strict=True))
        ground = self.ground_force(state)
        return LegForces(tuple(tensions), tuple(contractions), tuple(path_rates), total, tuple(stops), ground)

    def ground_force(self, state: LegState) -> tuple[Array, Array]:
        """Return the force [N] of the ground on the foot, forward and up."""
        return self.ground.force(contact(self.leg, frames(self.leg, state.posture, state.velocity)))

    def _rate(self, state: LegState) -> _Integrated:
        """Time derivative of the motion at the pressures of a state."""
        forces, velocity = self.forces(state), state.velocity
        moved = acceleration(self.leg, state.posture, velocity, forces.torques, forces.ground, self.gravity)
        creep = tuple(
            muscle.state_rate(held, rate).creep
            for muscle, held, rate in zip(self.leg.muscles, state.muscles, forces.path_rates, strict=True)
        )
        return _Integrated(Posture(*velocity), moved, creep)

    def advance(self, state: LegState, commands: Sequence[ArrayLike], duration: ArrayLike, substeps: int) -> LegState:
        """Return the state after a duration [s] under constant commands [Pa], by Runge-Kutta steps of equal length."""
        step = duration / substeps
        valve: Any = self.valve
        if valve.holds_air:
            return lax.fori_loop(0, substeps, lambda _, one: self._step_with_air(valve, one, commands, step), state)

        def integrate(_: Array, state: LegState) -> LegState:
            def rate(part: _Integrated, *pressures: Array) -> _Integrated:
                return self._rate(part.applied_to(state, pressures))

            end, held = valve.all_after(state.pressures, state.air, commands, step)
            middle, _ = valve.all_after(state.pressures, state.air, commands, step / 2)
            state = state._replace(air=())
            moved = rk4(rate, _Integrated.of(state), step, (state.pressures, middle, end))
            return self._settled(moved.applied_to(state, end))._replace(air=held)

        begun = tuple(map(valve.after_command, state.pressures, commands))
        return lax.fori_loop(0, substeps, integrate, state._replace(pressures=begun))

    def _step_with_air(self, valve: Any, state: LegState, commands: Sequence[ArrayLike], step: ArrayLike) -> LegState:
        """State after a step [s] in which motion and air are integrated together."""
        assert isinstance(state.air, AirState)
        opened = tuple(
            valve.before_step(*each, step) for each in zip(state.air.valves, commands, state.pressures, strict=True)
        )
        state = state._replace(air=state.air._replace(valves=opened))

        def rate(part: _Integrated) -> _Integrated:
            at = part.applied_to(state, state.pressures)
            assert isinstance(at.air, AirState)
            pressures, air = valve.air_rate(at.pressures, at.air, commands, self.air_volumes(at))
            return self._rate(at)._replace(pressures=pressures, air=air)

        return self._settled(rk4(rate, _Integrated.of(state), step).applied_to(state, state.pressures))

    def air_volumes(self, state: LegState) -> list[AirVolume]:
        """Return the volume of the air of each muscle, dead volume included."""
        dead = self.valve.dead_volume
        volumes = []
        units = self.leg.routed_muscles(state.posture.angles)
        for unit, pressure, held in zip(units, state.pressures, state.muscles, strict=True):

            def volume(path: Array, pressure: Array, unit: RoutedMuscle = unit, held: MuscleState = held) -> Array:
                contraction = unit.tendon.contraction(unit.muscle, path, pressure, held)
                return unit.muscle.specimen.volume(contraction) + dead

            at, slope = value_and_derivative(lambda path, p=pressure: volume(path, p), unit.path)
            by_pressure = None
            if not isinstance(unit.tendon, RigidTendon):
                by_pressure = value_and_derivative(lambda p, path=unit.path: volume(path, p), pressure)[1]
            volumes.append(AirVolume(at, slope * _path_rate(unit, state.velocity.angles), by_pressure))
        return volumes

    def _settled(self, state: LegState) -> LegState:
        """State after a step with updated internal states of the muscles; no force changes by it."""
        if not any(one.friction or one.creep for one in state.muscles):
            return state
        muscles = []
        units = self.leg.routed_muscles(state.posture.angles)
        for unit, pressure, held in zip(units, state.pressures, state.muscles, strict=True):
            contraction = unit.tendon.contraction(unit.muscle, unit.path, pressure, held)
            muscles.append(unit.muscle.update_state(held, contraction, pressure))
        return state._replace(muscles=tuple(muscles))

    def energy(self, state: LegState) -> Float[Array, ""]:
        """Return the mechanical energy of the bodies [J]."""
        found = motion(self.leg, state.posture, state.velocity, self.gravity)
        return found.kinetic + found.potential


def _path_rate(unit: RoutedMuscle, rates: Sequence[Array]) -> Array:
    """Rate of the length of a muscle's path [m/s]."""
    return sum((slope * rates[joint] for joint, slope in unit.slopes.items()), start=jnp.zeros(()))


def _check_count(field: str, given: int, names: Sequence[str]) -> None:
    if given != len(names):
        raise RangeError(
            f"{given} {field} for {len(names)}",
            field=field,
            value=given,
            remedy=f"give one for each of {', '.join(names)}",
        )


def _check_angle(joint: LegJoint, angle: ArrayLike) -> None:
    """Raise where a given angle is beyond a stop."""
    if not all(isinstance(one, Real) for one in (angle, joint.lower, joint.upper)):
        return
    at, lower, upper = float(angle), float(joint.lower), float(joint.upper)  # type: ignore[arg-type]
    if not lower - 1e-9 <= at <= upper + 1e-9:
        raise RangeError(
            f"{joint.name}: the start is at {at / deg:.4g} deg",
            field="angles",
            value=at,
            lower=lower,
            upper=upper,
            unit="rad",
            remedy="start within the range of the joint",
        )


def _check_pressure(name: str, pressure: ArrayLike, highest: ArrayLike) -> None:
    """Raise where a given pressure cannot be supplied."""
    if not (isinstance(pressure, Real) and isinstance(highest, Real)):
        return
    at, upper = float(pressure), float(highest)  # type: ignore[arg-type]
    if not 0 <= at <= upper + 1e-3:
        raise RangeError(
            f"{name}: the start is at {at / bar:.4g} bar",
            field="pressures",
            value=at,
            lower=0.0,
            upper=upper,
            unit="Pa",
            remedy="give a pressure that muscle and supply permit",
        )
