"""A joint with its load in closed form, a hinge or a slide."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.component.base import Component
from mckibben.joint import AntagonisticJoint, Load
from mckibben.joint.antagonistic import NO_STATES
from mckibben.joint.route import Route
from mckibben.mechanism.base import Mechanism, Statics
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.muscle import Muscle, MuscleState
from mckibben.numerics.batching import fusion_barrier
from mckibben.units import JointType

Scalar = Float[Array, ""]


@dataclasses.dataclass(frozen=True)
class Hinge(Mechanism):
    """One joint with two muscles and a load in closed form; its motion follows Eq. 6 with the torque of Eq. 7."""

    joint: AntagonisticJoint
    load: Load
    friction: JointFriction | None = None

    @property
    def muscles(self) -> tuple[Muscle, Muscle]:
        return self.joint.muscles

    @property
    def joint_type(self) -> JointType:
        return self.joint.joint_type

    @property
    def parts(self) -> tuple[Component, ...]:
        return (self.joint,)

    @property
    def frictions(self) -> tuple[JointFriction | None]:
        return (self.friction,)

    @property
    def coordinates(self) -> int:
        return 1

    def by_joint(self, value: PyTree) -> tuple[PyTree]:
        return (value,)

    def like_joints(self, values: Sequence[PyTree], template: PyTree = None) -> PyTree:
        (value,) = values
        return value

    def routes(self, position: ArrayLike) -> tuple[Route, Route]:
        return self.joint.routes(position)

    def stiffness(self, position: Scalar, pressures: Sequence[Array]) -> tuple[Array]:
        return (self.joint.evaluate(position, (pressures[0], pressures[1]))[1],)

    def gravity_stiffness(self, position: Scalar) -> Array:
        return self.load.gravity_stiffness(position)

    def statics(
        self,
        position: Scalar,
        velocity: Scalar,
        pressures: Sequence[Array],
        muscles: Sequence[MuscleState],
        amplitude: ArrayLike | None = None,
    ) -> Statics:
        joint, pair, held = self.joint, (pressures[0], pressures[1]), (muscles[0], muscles[1])
        torque, stiffness = fusion_barrier(joint.torque_and_stiffness, position, pair)
        if amplitude is not None:
            stiffness = fusion_barrier(joint.secant_stiffness, position, pair, amplitude)
        if held != NO_STATES:
            forces, torque, contractions = fusion_barrier(joint.forces, position, velocity, pair, held)
            return Statics(torque, stiffness, forces, contractions)
        contractions = fusion_barrier(joint.contractions, position, pair)
        states = zip(joint.muscles, contractions, pair, strict=True)
        forces = tuple(muscle.tension(contraction, pressure) for muscle, contraction, pressure in states)
        return Statics(torque, stiffness, forces, contractions)

    def acceleration(self, position: Scalar, velocity: Scalar, torques: Sequence[Array]) -> Array:
        return self.load.acceleration(position, velocity, *torques)
