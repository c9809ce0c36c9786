"""Mechanisms: what the muscles of a plant move."""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxtyping import Array, ArrayLike, Float, PyTree

from mckibben.component.base import Component
from mckibben.joint.route import Route
from mckibben.mechanism.joint_friction import JointFriction
from mckibben.muscle import Muscle, MuscleState
from mckibben.units import HINGE, JointType

Scalar = Float[Array, ""]


class Statics(NamedTuple):
    """Torque [N*m] and stiffness [N*m/rad] of each joint, in the form of a torque, and of each muscle the force [N]
    and the contraction.

    Torque and forces include the friction and creep of the muscles; the stiffness is that of their laws.
    """

    torque: PyTree
    stiffness: PyTree
    forces: tuple[Array, ...]
    contractions: tuple[Array, ...]


class Mechanism(abc.ABC):
    """Joints with their loads, and the routes of the muscles over them.

    Its position and velocity are trees of numbers: one number for a single joint without a name, whose quantities have
    no axis; `by_joint` gives those of the joints as a tuple, and `like_joints` the reverse.
    """

    @property
    @abc.abstractmethod
    def muscles(self) -> tuple[Muscle, ...]:
        """All muscles, in the order of their routes, commands and pressures."""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints; none of a single joint without a name."""
        return ()

    @property
    def joint_type(self) -> JointType:
        """How its joints move."""
        return HINGE

    @property
    def muscle_names(self) -> tuple[str, ...]:
        """Names of the muscles of named joints."""
        return ()

    @property
    @abc.abstractmethod
    def parts(self) -> tuple[Component, ...]:
        """Parts that a controller's model may have as well."""

    @property
    @abc.abstractmethod
    def frictions(self) -> tuple[JointFriction | None, ...]:
        """Dry friction of each joint."""

    @property
    @abc.abstractmethod
    def coordinates(self) -> int:
        """Number of the coordinates that move: of the joints, and of a base that is not fixed."""

    @property
    def has_contacts(self) -> bool:
        """Whether it may touch the ground."""
        return False

    def names_along(self, axis: str) -> tuple[str, ...]:
        """Return the names along an axis "joint" or "muscle" of results; muscles of an unnamed joint have numbers."""
        numbers = tuple(str(number) for number, _ in enumerate(self.muscles, 1))
        return {"joint": self.joint_names, "muscle": self.muscle_names or numbers}.get(axis, ())

    @abc.abstractmethod
    def by_joint(self, value: PyTree) -> tuple[PyTree, ...]:
        """Return a position, velocity, torque or state of friction as a tuple over the joints."""

    @abc.abstractmethod
    def like_joints(self, values: Sequence[PyTree], template: PyTree = None) -> PyTree:
        """Return a tuple over the joints in the form of a template, by default that of a torque."""

    def moving(self, value: PyTree) -> PyTree:
        """Return a position or velocity with None for the coordinates of the base that are held."""
        return value

    def coordinates_of(self, position: PyTree) -> tuple[Array, ...]:
        """Return the numbers of a position: the angles [rad] of all joints, then those of a base [m], [rad]."""
        return self.by_joint(position)

    def routes_over(self, position: PyTree, joint: int) -> Callable[[ArrayLike], Sequence[Route]]:
        """Return the routes as a function of the angle [rad] of one joint, by its number; the others are held."""
        held = self.by_joint(position)

        def routes(angle: ArrayLike) -> Sequence[Route]:
            return self.routes(self.like_joints((*held[:joint], angle, *held[joint + 1 :]), position))

        return routes

    @abc.abstractmethod
    def routes(self, position: PyTree) -> Sequence[Route]:
        """Return all muscles with their paths in a position."""

    @abc.abstractmethod
    def stiffness(self, position: PyTree, pressures: Sequence[Array]) -> tuple[Array, ...]:
        """Return the isobaric stiffness [N*m/rad] of each joint, the others held, at gauge pressures [Pa]."""

    @abc.abstractmethod
    def gravity_stiffness(self, position: PyTree) -> PyTree:
        """Return the stiffness [N*m/rad] of each joint by gravity, the others held, in the form of a torque."""

    @abc.abstractmethod
    def statics(
        self,
        position: PyTree,
        velocity: PyTree,
        pressures: Sequence[Array],
        muscles: Sequence[MuscleState],
        amplitude: ArrayLike | None = None,
    ) -> Statics:
        """Return what the muscles do in a position, at a velocity and gauge pressures [Pa], with their states.

        The stiffness is the isobaric one, or that of a motion with an `amplitude` [rad].
        """

    @abc.abstractmethod
    def acceleration(self, position: PyTree, velocity: PyTree, torques: Sequence[Array]) -> PyTree:
        """Return the acceleration [rad/s^2, m/s^2] under torques [N*m] of muscles, friction and disturbance by joint.

        It has the form of a velocity. Gravity, damping, stops and ground act as well.
        """


def over_joints(function: Callable[..., PyTree], first: PyTree, *others: PyTree) -> PyTree:
    """Apply a function to the values of the unnamed joint, or to those of each joint, which are in tuples.

    >>> over_joints(max, 1.0, 2.0), over_joints(max, (1.0, 5.0), (2.0, 3.0))
    (2.0, (2.0, 5.0))
    """
    if type(first) is tuple:
        return tuple(map(function, first, *others))
    return function(first, *others)


def joints_in(value: PyTree) -> tuple[PyTree, ...]:
    """Return the values of all joints as a tuple, also that of an unnamed one."""
    return value if type(value) is tuple else (value,)


def angles_of(position: PyTree) -> PyTree:
    """Return the angle [rad] of an unnamed joint, whose position it is, or the angles of a posture, by joint."""
    return getattr(position, "angles", position)


class RobotMeasurement(NamedTuple):
    """Measured angles of the joints [rad], pressures of the muscles [Pa], and force on the foot [N]."""

    angles: tuple[Scalar, ...]
    pressures: tuple[Scalar, ...]
    ground_force: Scalar
