"""The simulated robot: bodies, muscles, valves, and the ground."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Sequence
from numbers import Real
from typing import Annotated, Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator.base import Actuator, AirState, AirVolume, at_room_temperature
from mckibben.component.checks import check_count, check_positive, known_numbers
from mckibben.component.columns import Label, labelled
from mckibben.errors import RangeError, SimulationError
from mckibben.joint import Measurement, RigidTendon
from mckibben.muscle import Muscle, MuscleState, SpringLaw
from mckibben.muscle.air import ATMOSPHERE, ENERGY
from mckibben.muscle.friction import FrictionState
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.elementary import floating
from mckibben.numerics.spatial import Vector
from mckibben.plant.base import STABILITY_LIMIT, IOState, Motion, Plant
from mckibben.plant.sensors import Disturbance, NoDisturbance, PerfectSensors
from mckibben.robot.dynamics import (
    Contact,
    Posture,
    Velocity,
    acceleration,
    at_rest,
    contacts,
    frames,
    mobilities,
    motion,
    posture_of,
)
from mckibben.robot.ground import Ground, compliant_force
from mckibben.robot.mechanism import Robot
from mckibben.robot.muscles import Routed
from mckibben.units import Gravity, show

Scalar = Float[Array, ""]

_MOST_MOBILE = 1e9  # of a joint [1/(kg*m^2)]
_LONGEST = 0.5  # of a step, times the circular frequency of ground, stops or friction


class RobotState(NamedTuple):
    """State of a `RobotPlant`; parts that it lacks have no leaves, as in a `PlantState`."""

    posture: Posture
    velocity: Velocity
    pressures: tuple[Scalar, ...]
    muscles: tuple[MuscleState, ...]
    io: IOState | tuple[()] = ()
    air: AirState | tuple[()] = ()
    friction: tuple[FrictionState, ...] = ()
    sent: tuple[tuple[Scalar, ...], ...] = ()


class RobotStart(NamedTuple):
    """Start of a run: angles [rad], pressures [Pa], clearance of the foot [m], and upward speed [m/s].

    Numbers, or arrays over runs; see `RobotPlant.init_state`.
    """

    angles: tuple[ArrayLike, ...]
    pressures: tuple[ArrayLike, ...]
    clearance: ArrayLike = 0.0
    upward_speed: ArrayLike = 0.0


class RobotMeasurement(NamedTuple):
    """Measured angles of the joints [rad], pressures of the muscles [Pa], and force on the foot [N]."""

    angles: tuple[Scalar, ...]
    pressures: tuple[Scalar, ...]
    ground_force: Scalar


@labelled
class RobotSample(NamedTuple):
    """Sample of a run at the start of a control period; tuples are over joints or muscles."""

    x: Annotated[Scalar, Label("m", "position of the base, forwards")]
    y: Annotated[Scalar, Label("m", "position of the base, to the left")]
    z: Annotated[Scalar, Label("m", "height of the base")]
    speed: Annotated[Scalar, Label("m/s", "upward speed of the base")]
    pitch: Annotated[Scalar, Label("rad", "pitch of the base")]
    yaw: Annotated[Scalar, Label("rad", "yaw of the base")]
    roll: Annotated[Scalar, Label("rad", "roll of the base")]
    angle: Annotated[tuple[Scalar, ...], Label("rad", "joint angle", along="joint")]
    velocity: Annotated[tuple[Scalar, ...], Label("rad/s", "angular velocity", along="joint")]
    pressure: Annotated[tuple[Scalar, ...], Label("Pa", "gauge pressure", along="muscle")]
    tension: Annotated[tuple[Scalar, ...], Label("N", "tension of the muscle", along="muscle")]
    contraction: Annotated[tuple[Scalar, ...], Label("1", "contraction of the muscle", along="muscle")]
    stop_torque: Annotated[tuple[Scalar, ...], Label("N*m", "torque of the stops", along="joint")]
    ground_forward: Annotated[Scalar, Label("N", "force of the ground on the foot, forwards")]
    ground_left: Annotated[Scalar, Label("N", "force of the ground on the foot, to the left")]
    ground_up: Annotated[Scalar, Label("N", "force of the ground on the foot, upwards")]
    mass_height: Annotated[Scalar, Label("m", "height of the centre of mass")]
    mass_speed: Annotated[Scalar, Label("m/s", "upward speed of the centre of mass")]
    kinetic: Annotated[Scalar, Label("J", "kinetic energy")]
    muscle_power: Annotated[Scalar, Label("W", "power of the muscles")]
    stop_power: Annotated[Scalar, Label("W", "power of the stops")]
    air_mass: Annotated[tuple[Scalar, ...], Label("kg", "mass of the air", along="muscle")]
    outside: Annotated[Array, Label("1", "a muscle's contraction is outside its domain")]


class RobotForces(NamedTuple):
    """Tensions [N] and contractions of the muscles, torques [N*m] of the joints, forces [N] of the ground by sphere.

    Torques include disturbance, damping, friction and stops; `stops` are those of the stops alone.
    """

    tensions: tuple[Array, ...]
    contractions: tuple[Array, ...]
    path_rates: tuple[Array, ...]
    torques: tuple[Array, ...]
    stops: tuple[Array, ...]
    contacts: tuple[Vector, ...]


class RobotPlant(Plant[RobotState]):
    """The simulated robot: bodies, muscles, valves, ground and sensors; controllers have no access to it.

    Parameters
    ----------
    robot, valve, ground
        The robot, the valve of each muscle, and the ground.
    gravity
        g [m/s^2].
    sensors
        Sensors of angles and pressures; the force on the foot is measured exactly.
    command_delay
        Time from a command to the valves [s].
    """

    robot: Robot
    valve: Actuator
    ground: Ground = Ground()
    gravity: Gravity = 9.81

    def __repr__(self) -> str:
        return f"RobotPlant({self.robot!r}, {type(self.valve).__name__})"

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        return self.robot.all_muscles

    @property
    def disturbances(self) -> tuple[Disturbance, ...]:
        return tuple(joint.disturbance for joint in self.robot.joints)

    def with_ideal_io(self) -> RobotPlant:
        """Return the plant with perfect sensors, and without disturbances and delay of the commands."""
        joints = tuple(dataclasses.replace(joint, disturbance=NoDisturbance()) for joint in self.robot.joints)
        robot = dataclasses.replace(self.robot, joints=joints)
        return dataclasses.replace(self, robot=robot, sensors=PerfectSensors(), command_delay=None, delay_periods=0)

    def true_measurement(self, state: RobotState) -> Measurement:
        angles: Any = state.posture.angles
        pressures: Any = state.pressures
        return Measurement(angles, pressures)

    def sample(self, state: RobotState, period: ArrayLike) -> tuple[RobotState, RobotMeasurement]:
        state, (angles, pressures) = super().sample(state, period)
        return state, RobotMeasurement(cast(Any, angles), pressures, self.ground_force(state).dot(self.ground.normal))

    def disturbing_torque(self, time: ArrayLike) -> tuple[Array, ...]:
        return tuple(floating(one.torque(time)) for one in self.disturbances)

    def observe(self, state: RobotState) -> RobotSample:
        forces, volumes = self.forces(state), self.air_volumes(state)
        moving = motion(self.robot, state.posture, state.velocity, self.gravity)
        contents = enumerate(zip(state.pressures, volumes, strict=True))
        inside = [
            muscle.domain.contains_contraction(one)
            for muscle, one in zip(self.robot.all_muscles, forces.contractions, strict=True)
        ]
        zero, ground = jnp.zeros_like(state.posture.x), _sum(forces.contacts, state)
        base = {name: getattr(state.posture, name) for name in ("x", "y", "z", "pitch", "yaw", "roll")}
        return RobotSample(
            **{name: zero if value is None else value for name, value in base.items()},
            speed=state.velocity.z,
            angle=state.posture.angles,
            velocity=state.velocity.angles,
            pressure=state.pressures,
            tension=forces.tensions,
            contraction=forces.contractions,
            stop_torque=forces.stops,
            ground_forward=ground.x,
            ground_left=ground.y,
            ground_up=ground.z,
            mass_height=moving.height,
            mass_speed=moving.upward_speed,
            kinetic=moving.kinetic,
            muscle_power=-_power(forces.tensions, forces.path_rates),
            stop_power=_power(forces.stops, state.velocity.angles),
            air_mass=tuple(
                at_room_temperature((pressure + ATMOSPHERE) * one.volume / ENERGY, state.air, i)
                for i, (pressure, one) in contents
            ),
            outside=~functools.reduce(operator.and_, inside),
        )

    def fastest_rates(self, angles: Any, stiffness: Any = 0.0) -> dict[str, float]:
        """Return the rates [1/s] of stops, ground, friction and air, those of the muscles aside."""
        robot, ground = self.robot, self.ground
        posture = posture_of(robot, angles)
        of_joints, points = mobilities(robot, posture)[1], [mobilities(robot, posture, one)[0] for one in robot.spheres]
        if not (np.abs(of_joints) < _MOST_MOBILE).all():  # NaN included
            raise SimulationError(
                "a joint turns bodies without inertia about its axis",
                field="inertia",
                remedy="give the bodies an inertia about it, or the joint another axis",
            )
        inertias = [robot.inertia_beyond(index) for index in range(len(robot.joints))]
        bodies = [pair for pair in zip(robot.joints, inertias, strict=True) if pair[0].locked is None]
        stiffnesses = {
            "the ground": ground.stiffness * sum(np.linalg.eigvalsh(mobility)[-1] for mobility in points),
            "the stops": max((joint.stop_stiffness / inertia for joint, inertia in bodies), default=0.0),
            "the friction of the joints": max(
                (joint.friction.steepest / inertia for joint, inertia in bodies if joint.friction), default=0.0
            ),
        }
        rates = {what: math.sqrt(square) * STABILITY_LIMIT / _LONGEST for what, square in stiffnesses.items()}
        weight = float(robot.total_mass) * self.gravity
        sideways = max((np.linalg.eigvalsh(mobility[:2, :2])[-1] for mobility in points), default=0.0)
        rates["the friction of the ground"] = ground.friction * weight / ground.slip_speed * sideways
        if self.valve.holds_air:
            muscles = (muscle for muscle in robot.all_muscles if not isinstance(muscle.law, SpringLaw))
            volumes = (float(muscle.specimen.volume(muscle.domain.contraction_min)) for muscle in muscles)
            rates["the air"] = self.valve.fastest_rate_in(min(volumes))
        return rates

    def init_state(
        self,
        angles: Sequence[ArrayLike],
        pressures: Sequence[ArrayLike],
        *,
        clearance: ArrayLike = 0.0,
        upward_speed: ArrayLike = 0.0,
    ) -> RobotState:
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
        return self.begin(RobotStart(tuple(angles), tuple(pressures), clearance, upward_speed))

    def check_start(self, start: RobotStart) -> None:
        """Raise `RangeError` where the plain numbers of a start are not possible, as by `init_state`."""
        robot = self.robot
        robot.check_posture(start.angles)
        check_count("pressures", len(start.pressures), len(self.muscles), f"of {', '.join(robot.muscle_names)}")
        supply = getattr(self.valve, "supply", None)
        pressures: Any = start.pressures
        for name, muscle, pressure in zip(robot.muscle_names, self.muscles, pressures, strict=True):
            limits: dict[str, Any] = {"rated": muscle.specimen.domain.pressure_max, "supply": supply}
            known = {what: limit for what, limit in limits.items() if isinstance(limit, Real)}
            for what, limit in known.items() if isinstance(pressure, Real) else ():
                if not -1e-3 <= pressure <= limit + 1e-3:
                    message = f"{name} starts at {show(float(pressure), 'bar')} ({what}: {show(float(limit), 'bar')})"
                    details: Any = {"value": float(pressure), "lower": 0.0, "upper": float(limit), "unit": "Pa"}
                    remedy = "give a pressure permitted by muscle and supply"
                    raise RangeError(message, field="pressures", remedy=remedy, **details)
        check_positive("RobotPlant", "m", zero=True, clearance=start.clearance)
        if robot.base == "fixed" and np.any(known_numbers("RobotPlant", "upward_speed", start.upward_speed)):
            raise RangeError(
                "a fixed base has no speed",
                field="upward_speed",
                value=start.upward_speed,
                remedy="give the robot another `base`, such as vertical",
            )
        distance = self.ground.distance
        if distance is not None and all(isinstance(angle, Real) for angle in start.angles):
            posture = posture_of(robot, start.angles)
            points = self._contacts(posture, at_rest(posture))
            nearest = min((float(point.position.dot(self.ground.normal)) for point in points), default=0.0)
            if nearest < -distance:
                remedy = "give other angles, or the plane a greater distance"
                raise RangeError("the start is inside the plane", field="distance", value=distance, remedy=remedy)

    def begin(self, start: RobotStart) -> RobotState:
        self.check_start(start)
        robot = self.robot
        held = tuple(map(floating, robot.held(start.angles)))
        posture, normal = posture_of(robot, held), self.ground.normal
        velocity = at_rest(posture)._replace(z=floating(start.upward_speed))
        depths = [point.position.dot(normal) for point in self._contacts(posture, velocity)]
        depth = functools.reduce(jnp.minimum, depths) if depths else 0.0
        if self.ground.distance is None:
            posture = posture._replace(z=(floating(start.clearance) - depth) / normal.z)
        inside = tuple(map(floating, start.pressures))
        muscles = (MuscleState((), ()),) * len(inside)
        return self.complete_state(RobotState(posture, velocity, inside, muscles))

    def init_muscles(self, state: RobotState) -> tuple[MuscleState, ...]:
        units = zip(self.robot.routed_muscles(state.posture.angles), state.pressures, strict=True)
        return tuple(
            unit.muscle.init_state(unit.tendon.contraction(unit.muscle, unit.path, pressure), pressure)
            for unit, pressure in units
        )

    def init_friction(self, state: RobotState) -> tuple[FrictionState, ...]:
        if all(joint.friction is None for joint in self.robot.joints):
            return ()
        pairs = zip(self.robot.joints, state.posture.angles, strict=True)
        return tuple(() if joint.friction is None else joint.friction.initial(angle) for joint, angle in pairs)

    def clip_commands(self, commands: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] within rated pressures and supply; `RangeError` unless each muscle has one."""
        check_count("commands", len(commands), len(self.muscles), f"of {', '.join(self.robot.muscle_names)}")
        return super().clip_commands(commands)

    def forces(self, state: RobotState) -> RobotForces:
        """Return the forces in a state."""
        robot = self.robot
        angles, rates = state.posture.angles, state.velocity.angles
        torques: list[Array] = [-joint.damping * rate for joint, rate in zip(robot.joints, rates, strict=True)]
        if isinstance(state.io, IOState):
            torques = [one + torque for one, torque in zip(torques, state.io.disturbance, strict=True)]
        for index, held in enumerate(state.friction):
            if friction := robot.joints[index].friction:
                torques[index] = torques[index] - friction.resisting_torque(held, angles[index])
        tensions, contractions, path_rates = [], [], []
        for unit, pressure, held in zip(robot.routed_muscles(angles), state.pressures, state.muscles, strict=True):
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
        for joint, angle, rate in zip(robot.joints, angles, rates, strict=True):
            stiffness, damping = joint.stop_stiffness, joint.stop_damping
            beyond = compliant_force(angle - joint.upper, rate, stiffness, damping)
            stops.append(compliant_force(joint.lower - angle, -rate, stiffness, damping) - beyond)
        total = tuple(one + stop for one, stop in zip(torques, stops, strict=True))
        ground = self._contact_forces(state)
        return RobotForces(tuple(tensions), tuple(contractions), tuple(path_rates), total, tuple(stops), ground)

    def ground_force(self, state: RobotState) -> Vector:
        """Return the force [N] of the ground on all spheres: forwards, to the left, and up."""
        return _sum(self._contact_forces(state), state)

    def _contact_forces(self, state: RobotState) -> tuple[Vector, ...]:
        return tuple(map(self.ground.force, self._contacts(state.posture, state.velocity)))

    def _contacts(self, posture: Posture, velocity: Velocity) -> list[Contact]:
        """Points of the spheres that are nearest to the ground."""
        if not self.robot.spheres:
            return []
        return contacts(self.robot, frames(self.robot, posture, velocity), self.ground.normal)

    def rate(self, state: RobotState) -> Motion:
        forces, velocity = self.forces(state), state.velocity
        moved = acceleration(
            self.robot, state.posture, velocity, forces.torques, forces.contacts, self.gravity, self.ground.normal
        )
        creep = tuple(
            muscle.state_rate(held, rate, pressure).creep
            for muscle, held, rate, pressure in zip(
                self.robot.all_muscles, state.muscles, forces.path_rates, state.pressures, strict=True
            )
        )
        return Motion(Posture(*velocity), moved, creep)

    def air_volumes(self, state: RobotState) -> list[AirVolume]:
        motion = state.posture.angles, state.velocity.angles
        return muscle_air(self.robot, self.valve, *motion, state.pressures, state.muscles)

    def project(self, state: RobotState) -> RobotState:
        if state.friction:
            joints = zip(self.robot.joints, state.friction, state.posture.angles, strict=True)
            friction = tuple(joint.friction.project(held, at) if joint.friction else held for joint, held, at in joints)
            state = state._replace(friction=friction)
        if not any(one.friction or one.creep for one in state.muscles):
            return state
        muscles = []
        units = self.robot.routed_muscles(state.posture.angles)
        for unit, pressure, held in zip(units, state.pressures, state.muscles, strict=True):
            contraction = unit.tendon.contraction(unit.muscle, unit.path, pressure, held)
            muscles.append(unit.muscle.update_state(held, contraction, pressure))
        return state._replace(muscles=tuple(muscles))

    def energy(self, state: RobotState) -> Float[Array, ""]:
        """Return the mechanical energy of the bodies [J]."""
        found = motion(self.robot, state.posture, state.velocity, self.gravity)
        return found.kinetic + found.potential


def muscle_air(
    robot: Robot,
    valve: Actuator,
    angles: Sequence[Array],
    rates: Sequence[Array],
    pressures: Sequence[Array],
    states: Sequence[MuscleState] | None = None,
) -> list[AirVolume]:
    """Return the volumes of the air in the muscles, at angles [rad], rates [rad/s] and gauge pressures [Pa]."""
    volumes = []
    states = [MuscleState((), ())] * len(pressures) if states is None else states
    for unit, pressure, held in zip(robot.routed_muscles(angles), pressures, states, strict=True):

        def volume(path: Array, pressure: Array, unit: Routed = unit, held: MuscleState = held) -> Array:
            contraction = unit.tendon.contraction(unit.muscle, path, pressure, held)
            return unit.muscle.specimen.volume(contraction) + valve.attached_volume

        at, slope = value_and_derivative(lambda path, p=pressure: volume(path, p), unit.path)
        by_pressure = None
        if not isinstance(unit.tendon, RigidTendon):
            by_pressure = value_and_derivative(lambda p, path=unit.path: volume(path, p), pressure)[1]
        volumes.append(AirVolume(at, slope * _path_rate(unit, rates), by_pressure))
    return volumes


def _sum(forces: Sequence[Vector], state: RobotState) -> Vector:
    """Sum of forces [N], of arrays."""
    zero = jnp.zeros_like(state.posture.x)
    return functools.reduce(operator.add, forces) if forces else Vector(zero, zero, zero)


def _path_rate(unit: Routed, rates: Sequence[Array]) -> Array:
    """Rate of the length of a muscle's path [m/s]."""
    return jnp.asarray(sum(slope * rates[joint] for joint, slope in unit.slopes.items()))


def _power(forces: Sequence[Array], rates: Sequence[Array]) -> Array:
    """Power [W] of forces at the rates of their coordinates."""
    return jnp.asarray(sum(force * rate for force, rate in zip(forces, rates, strict=True)))
