"""A robot as a mechanism: its bodies with stops, on a base that may move, and the ground."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, PyTree

from mckibben.component.base import Component
from mckibben.joint.route import Route, secant_stiffness
from mckibben.mechanism.base import Mechanism, Statics
from mckibben.mechanism.bodies import MOTIONS
from mckibben.mechanism.dynamics import Contact, Posture, Velocity, acceleration, contacts, frames, joint_equations
from mckibben.mechanism.ground import Ground, compliant_force
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.mechanism.robot import Robot
from mckibben.muscle import Muscle, MuscleState
from mckibben.numerics.calculus import value_and_derivative
from mckibben.numerics.spatial import Vector, difference, product, total


@dataclasses.dataclass(frozen=True)
class Tree(Mechanism):
    """Bodies of a robot on hinges, with stops, on a base that may move, and the ground."""

    robot: Robot
    ground: Ground
    gravity: PyTree

    @property
    def muscles(self) -> tuple[Muscle, ...]:
        return self.robot.all_muscles

    @property
    def parts(self) -> tuple[Component, ...]:
        return (self.robot, *map(self.robot.pair, self.robot.pairs))

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self.robot.joint_names

    @property
    def muscle_names(self) -> tuple[str, ...]:
        return self.robot.muscle_names

    @property
    def frictions(self) -> tuple[JointFriction | None, ...]:
        return tuple(joint.friction for joint in self.robot.joints)

    @property
    def coordinates(self) -> int:
        return len(self.robot.motions) + sum(joint.locked is None for joint in self.robot.joints)

    @property
    def has_contacts(self) -> bool:
        return bool(self.robot.spheres)

    def by_joint(self, value: PyTree) -> tuple[PyTree, ...]:
        return value.angles if isinstance(value, Posture) else value

    def like_joints(self, values: Sequence[PyTree], template: PyTree = None) -> PyTree:
        return tuple(values) if template is None else template._replace(angles=tuple(values))

    def moving(self, value: PyTree) -> PyTree:
        return value._replace(**dict.fromkeys({*MOTIONS["floating"]}.difference(self.robot.motions)))

    def coordinates_of(self, position: Posture) -> tuple[Array, ...]:
        return (*position.angles, *jax.tree.leaves(position._replace(angles=())))

    def routes(self, position: Posture) -> Sequence[Route]:
        return self.robot.routed_muscles(position.angles)

    def stiffness(self, position: Posture, pressures: Sequence[Array]) -> tuple[Array, ...]:
        return self.robot.stiffness(position.angles, pressures)

    def gravity_stiffness(self, position: Posture) -> tuple[Array, ...]:
        angles, robot = position.angles, self.robot
        free = [index for index, joint in enumerate(robot.joints) if joint.locked is None]
        slopes = {index: self._gravity_slope(angles, index, row) for row, index in enumerate(free)}
        return tuple(slopes.get(index, jnp.zeros_like(angle)) for index, angle in enumerate(angles))

    def _gravity_slope(self, angles: Sequence[Array], index: int, row: int) -> Array:
        """Derivative [N*m/rad] of the torque that holds a joint by its angle; of a row of the equations."""

        def holding(angle: Array) -> Array:
            posture = (*angles[:index], angle, *angles[index + 1 :])
            bias = joint_equations(self.robot, posture, (0.0,) * len(posture), self.gravity).bias[row]
            return bias * jnp.ones_like(angle)

        return value_and_derivative(holding, angles[index])[1]

    def statics(
        self,
        position: Posture,
        velocity: Velocity,
        pressures: Sequence[Array],
        muscles: Sequence[MuscleState],
        amplitude: ArrayLike | None = None,
    ) -> Statics:
        resistance: list[Any] = [0.0] * len(self.robot.joints)  # minus the torque
        forces, contractions = [], []
        for route, pressure, held in zip(self.routes(position), pressures, muscles, strict=True):
            force, contraction = route.forces(pressure, held, route.rate(velocity.angles))
            for joint, slope in route.slopes.items():
                resistance[joint] = total(resistance[joint], force * slope)
            forces.append(force)
            contractions.append(contraction)
        torque = tuple(jnp.asarray(difference(0.0, own)) for own in resistance)
        stiffness = self.stiffness(position, pressures)
        if amplitude is not None:
            joints = enumerate(position.angles)
            stiffness = tuple(
                secant_stiffness(self.routes_over(position, joint), joint, angle, pressures, amplitude)
                for joint, angle in joints
            )
        return Statics(torque, stiffness, tuple(forces), tuple(contractions))

    def acceleration(self, position: Posture, velocity: Velocity, torques: Sequence[Array]) -> Velocity:
        robot, stops = self.robot, self.stop_torques(position, velocity)
        joints = zip(robot.joints, torques, velocity.angles, stops, strict=True)
        driven = [difference(torque, product(joint.damping, rate)) + stop for joint, torque, rate, stop in joints]
        forces = self.contact_forces(position, velocity)
        return acceleration(robot, position, velocity, driven, forces, self.gravity, self.ground.normal)

    def stop_torques(self, position: Posture, velocity: Velocity) -> tuple[Array, ...]:
        """Return the torques [N*m] of the stops of all joints."""
        torques = []
        for joint, angle, rate in zip(self.robot.joints, position.angles, velocity.angles, strict=True):
            stiffness, damping = joint.stop_stiffness, joint.stop_damping
            beyond = compliant_force(angle - joint.upper, rate, stiffness, damping)
            torques.append(compliant_force(joint.lower - angle, -rate, stiffness, damping) - beyond)
        return tuple(torques)

    def contacts(self, position: Posture, velocity: Velocity) -> list[Contact]:
        """Return the points of the spheres that are nearest to the ground."""
        if not self.has_contacts:
            return []
        return contacts(self.robot, frames(self.robot, position, velocity), self.ground.normal)

    def contact_forces(self, position: Posture, velocity: Velocity) -> tuple[Vector, ...]:
        """Return the forces [N] of the ground on all spheres."""
        return tuple(map(self.ground.force, self.contacts(position, velocity)))
