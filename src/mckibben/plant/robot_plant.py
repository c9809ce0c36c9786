"""The simulated robot: bodies, muscles, valves, and the ground."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Sequence
from numbers import Real
from typing import Any, NamedTuple, Self, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.actuator.base import Actuator
from mckibben.component.checks import check_count, check_positive, known_numbers
from mckibben.errors import RangeError, SimulationError
from mckibben.mechanism.base import RobotMeasurement
from mckibben.mechanism.disturbance import Disturbance
from mckibben.mechanism.dynamics import (
    at_rest,
    mobilities,
    posture_of,
)
from mckibben.mechanism.ground import Ground
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.robot_tree import Tree
from mckibben.muscle import MuscleState
from mckibben.numerics.elementary import floating
from mckibben.numerics.spatial import Vector
from mckibben.plant.base import Plant
from mckibben.plant.state import PlantState
from mckibben.units import GRAVITY, Gravity, show

Scalar = Float[Array, ""]

_MOST_MOBILE = 1e9  # of a joint [1/(kg*m^2)]
_LONGEST = 0.5  # of a step, times the circular frequency of ground, stops or friction


class RobotStart(NamedTuple):
    """Start of a run: angles [rad], pressures [Pa], clearance of the foot [m], and upward speed [m/s].

    Numbers, or arrays over runs; see `RobotPlant.init_state`.
    """

    angles: tuple[ArrayLike, ...]
    pressures: tuple[ArrayLike, ...]
    clearance: ArrayLike = 0.0
    upward_speed: ArrayLike = 0.0
    exists: ArrayLike = True

    def state(self, plant: RobotPlant, setpoints: PyTree) -> tuple[PlantState, ArrayLike]:
        """Return the state of a plant, and whether it exists, as `AtRest.state`."""
        return plant.begin(self), self.exists


class RobotPlant(Plant):
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
    gravity: Gravity = GRAVITY

    def __repr__(self) -> str:
        return f"RobotPlant({self.robot!r}, {type(self.valve).__name__})"

    @property
    def mechanism(self) -> Tree:
        return Tree(self.robot, self.ground, self.gravity)

    @property
    def disturbances(self) -> tuple[Disturbance, ...]:
        return tuple(joint.disturbance for joint in self.robot.joints)

    def with_disturbances(self, disturbances: Sequence[Disturbance]) -> Self:
        joints = zip(self.robot.joints, disturbances, strict=True)
        disturbed = tuple(dataclasses.replace(joint, disturbance=disturbance) for joint, disturbance in joints)
        return dataclasses.replace(self, robot=dataclasses.replace(self.robot, joints=disturbed))

    def sample(self, state: PlantState, period: ArrayLike) -> tuple[PlantState, RobotMeasurement]:
        state, (angles, pressures) = super().sample(state, period)
        return state, RobotMeasurement(cast(Any, angles), pressures, **self.outputs(state))

    def fastest_rates(self, angles: Any, stiffness: Any = 0.0) -> dict[str, float]:
        """Return the rates [1/s] of stops, ground, friction and air, those of the muscles aside."""
        robot, ground = self.robot, self.ground
        of_joints, points = mobilities(robot, angles)[1], [mobilities(robot, angles, one)[0] for one in robot.spheres]
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
        limit = self.stability_limit / _LONGEST
        rates = {what: math.sqrt(square) * limit for what, square in stiffnesses.items()}
        weight = float(robot.total_mass) * self.gravity
        sideways = max((np.linalg.eigvalsh(mobility[:2, :2])[-1] for mobility in points), default=0.0)
        rates["the friction of the ground"] = ground.friction * weight / ground.slip_speed * sideways
        if self.valve.holds_air:
            muscles = (muscle for muscle in robot.all_muscles if not muscle.law.is_passive)
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
    ) -> PlantState:
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

    def unpressurised(self) -> PlantState:
        return self.init_state(self.robot.posture_angles({}), (0.0,) * len(self.muscles))

    def outputs(self, state: PlantState) -> dict[str, Array]:
        return {"ground_force": self.ground_force(state).dot(self.ground.normal)}

    def check_start(self, start: RobotStart | PlantState | None) -> None:
        """Raise `RangeError` where the plain numbers of a start are not possible, as by `init_state`."""
        if not isinstance(start, RobotStart):
            return
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
            points = self.mechanism.contacts(posture, at_rest(posture))
            nearest = min((float(point.position.dot(self.ground.normal)) for point in points), default=0.0)
            if nearest < -distance:
                remedy = "give other angles, or the plane a greater distance"
                raise RangeError("the start is inside the plane", field="distance", value=distance, remedy=remedy)

    def begin(self, start: RobotStart | PlantState) -> PlantState:
        if isinstance(start, PlantState):
            return super().begin(start)
        self.check_start(start)
        robot = self.robot
        held = tuple(map(floating, robot.held(start.angles)))
        posture, normal = posture_of(robot, held), self.ground.normal
        velocity = at_rest(posture)._replace(z=floating(start.upward_speed))
        depths = [point.position.dot(normal) for point in self.mechanism.contacts(posture, velocity)]
        depth = functools.reduce(jnp.minimum, depths) if depths else 0.0
        if self.ground.distance is None:
            posture = posture._replace(z=(floating(start.clearance) - depth) / normal.z)
        inside = tuple(map(floating, start.pressures))
        muscles = (MuscleState((), ()),) * len(inside)
        return self.complete_state(PlantState(posture, velocity, inside, muscles))

    def clip_commands(self, commands: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """Return the commands [Pa] within rated pressures and supply; `RangeError` unless each muscle has one."""
        check_count("commands", len(commands), len(self.muscles), f"of {', '.join(self.robot.muscle_names)}")
        return super().clip_commands(commands)

    def ground_force(self, state: PlantState) -> Vector:
        """Return the force [N] of the ground on all spheres: forwards, to the left, and up."""
        return _sum(self.mechanism.contact_forces(state.position, state.velocity), state)


def _sum(forces: Sequence[Vector], state: PlantState) -> Vector:
    """Sum of forces [N], of arrays."""
    zero = jnp.zeros_like(state.position.x)
    return functools.reduce(operator.add, forces) if forces else Vector(zero, zero, zero)
