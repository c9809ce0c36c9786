"""Motion of a robot: its trunk and links as a tree of bodies (`mckibben.robot.tree`)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.numerics.spatial import IDENTITY, ZERO, Tensor, Vector, X, Y, Z, product, total
from mckibben.robot.mechanism import Robot
from mckibben.robot.tree import MASSLESS, Body, Equations, Frame, Hinge, equations, frames_of

Scalar = Float[Array, ""]

SLIDES = {"x": X, "y": Y, "z": Z}
"""Directions of the trunk's translations."""
TURNS = {"yaw": Z, "pitch": -Y, "roll": X}
"""Axes of the trunk's rotations, each in the axes after those before it."""


class Posture(NamedTuple):
    """Position of a robot: hip [m], pitch of the trunk [rad], and angles of the joints [rad].

    `y`, `yaw` and `roll` are those of a trunk that leaves the plane of walking, and None for others.
    """

    x: Scalar
    z: Scalar
    pitch: Scalar
    angles: tuple[Scalar, ...]
    y: Scalar | None = None
    yaw: Scalar | None = None
    roll: Scalar | None = None


class Velocity(NamedTuple):
    """Rates of a `Posture` [m/s], [rad/s]."""

    x: Scalar
    z: Scalar
    pitch: Scalar
    angles: tuple[Scalar, ...]
    y: Scalar | None = None
    yaw: Scalar | None = None
    roll: Scalar | None = None


class Contact(NamedTuple):
    """Point of the foot nearest to the ground: position [m], velocity [m/s], and arm from the last joint [m]."""

    position: Vector
    velocity: Vector
    arm: Vector


def posture_of(robot: Robot, angles: Sequence[ArrayLike], *, z: ArrayLike = 0.0) -> Posture:
    """Return the posture of an upright trunk with the hip at a height [m], and locked joints at their place."""
    held = robot.held(angles)
    zero = jnp.zeros_like(held[0])
    others = {name: zero for name in ("y", "yaw", "roll") if name in robot.trunk.motions}
    return Posture(zero, jnp.asarray(z), zero, held, **others)


def at_rest(posture: Posture) -> Velocity:
    """Return the velocity of a robot at rest."""
    return Velocity(*jax.tree.map(jnp.zeros_like, posture))


class _Tree(NamedTuple):
    """Bodies of a robot in a posture and at a velocity, and the numbers of its trunk and its last link."""

    base: Frame  # slides with the hip
    hinges: list[Hinge]  # of trunk and joints
    bodies: list[Body]  # on the base and on each hinge
    trunk: int
    foot: int

    def frames(self) -> list[Frame]:
        """Return the frames of all bodies."""
        return frames_of(self.base, self.hinges)


def _tree(robot: Robot, posture: Posture, velocity: Velocity) -> _Tree:
    turns = [name for name in robot.trunk.motions if name in TURNS]
    hinges = [
        Hinge(TURNS[name], ZERO, getattr(posture, name), getattr(velocity, name), number)
        for number, name in enumerate(turns)
    ]
    hinges += robot.hinges(posture.angles, velocity.angles, len(turns))
    trunk = Body(robot.trunk.mass, Vector(0.0, 0.0, robot.trunk.centre), _principal(robot.trunk.inertias))
    links = (Body(link.mass, Vector(0.0, 0.0, -link.centre), _principal(link.inertias)) for link in robot.links)
    position, speed = (Vector(of.x, 0.0 if of.y is None else of.y, of.z) for of in (posture, velocity))
    base = Frame(IDENTITY, ZERO, position, speed)
    return _Tree(base, hinges, [*([MASSLESS] * len(turns)), trunk, *links], len(turns), len(hinges))


def _principal(inertias: tuple[Any, Any, Any]) -> Tensor:
    x, y, z = inertias
    return Tensor(x, 0.0, 0.0, y, 0.0, z)


def frames(robot: Robot, posture: Posture, velocity: Velocity) -> list[Frame]:
    """Return the frames of trunk and links; the trunk's is at the hip."""
    tree = _tree(robot, posture, velocity)
    return tree.frames()[tree.trunk :]


def contact(robot: Robot, found: Sequence[Frame], normal: Vector = Z) -> Contact:
    """Return the point of the foot that is nearest to a ground with a normal."""
    last = found[-1]
    arm = last.axes.z.scaled(-robot.links[-1].length) - normal.scaled(robot.foot_radius)
    return Contact(last.position + arm, last.velocity + last.rate.cross(arm), arm)


class BodyMotion(NamedTuple):
    """Mechanical state in sums: energies [J], and height [m], speeds [m/s] of the centre of mass.

    `spin` is the angular momentum about the centre of mass [kg*m^2/s].
    """

    kinetic: Scalar
    potential: Scalar
    height: Scalar
    forward_speed: Scalar
    upward_speed: Scalar
    sideward_speed: Scalar
    spin: Vector


def motion(robot: Robot, posture: Posture, velocity: Velocity, gravity: ArrayLike) -> BodyMotion:
    """Return energies and the motion of the centre of mass; the potential energy of the height 0 is 0."""
    tree = _tree(robot, posture, velocity)
    kinetic: Any = 0.0
    moment = momentum = spin = ZERO
    for frame, body in zip(tree.frames(), tree.bodies, strict=True):
        if body is MASSLESS:
            continue
        place, speed = frame.point(body.centre)
        own = body.inertia_about_centre(frame.axes).apply(frame.rate)
        kinetic = total(kinetic, product(0.5, total(product(body.mass, speed.dot(speed)), own.dot(frame.rate))))
        moment, momentum = moment + place.scaled(body.mass), momentum + speed.scaled(body.mass)
        spin = spin + own + place.cross(speed).scaled(body.mass)
    each = 1 / robot.total_mass
    centre, speed = moment.scaled(each), momentum.scaled(each)
    potential, spin = product(moment.z, gravity), spin - centre.cross(momentum)
    found = BodyMotion(kinetic, potential, centre.z, speed.x, speed.z, speed.y, spin)
    return jax.tree.map(jnp.asarray, found)


def _slides(robot: Robot) -> list[Vector]:
    """Directions in which the trunk moves without turning."""
    return [SLIDES[name] for name in robot.trunk.motions if name in SLIDES]


def _foot_velocities(robot: Robot, tree: _Tree, found: Sequence[Frame], point: Contact) -> list[Vector]:
    """Velocity of the foot's point of contact per rate of each motion."""
    pairs = zip(found[1:], tree.hinges, strict=True)
    return [*_slides(robot), *(at.axis.cross(point.position - at.position) for at, hinge in pairs if hinge.free)]


def _equations(
    robot: Robot,
    posture: Posture,
    velocity: Velocity,
    gravity: ArrayLike,
    force: Vector = ZERO,
    normal: Vector = Z,
    slip_mass: ArrayLike | None = None,
) -> Equations:
    tree = _tree(robot, posture, velocity)
    found = tree.frames()
    point = contact(robot, found, normal)
    made = equations(_slides(robot), tree.hinges, tree.bodies, found, gravity, {tree.foot: (force, point.arm)})
    if slip_mass is None:
        return made
    moved = _foot_velocities(robot, tree, found, point)
    slips = [one - normal.scaled(one.dot(normal)) for one in moved]
    rows = [
        [total(entry, product(slip_mass, slips[i].dot(slips[j]))) for j, entry in enumerate(row)]
        for i, row in enumerate(made.matrix)
    ]
    return made._replace(matrix=rows)


def acceleration(
    robot: Robot,
    posture: Posture,
    velocity: Velocity,
    torques: Sequence[ArrayLike],
    force: Vector,
    gravity: ArrayLike,
    normal: Vector = Z,
    slip_mass: ArrayLike | None = None,
) -> Velocity:
    """Return the accelerations under torques [N*m] of the joints and a force [N] at the foot's point of contact.

    `slip_mass` [kg] is added to the inertia of that point along the ground. Locked joints, and motions that the trunk
    lacks, have an acceleration of 0.
    """
    made = _equations(robot, posture, velocity, gravity, force, normal, slip_mass)
    driven = [joint.sign * torque for joint, torque in zip(robot.joints, torques, strict=True) if joint.locked is None]
    rates = iter(made.accelerations([*[0.0] * len(robot.trunk.motions), *driven]))
    of_trunk = {name: next(rates) for name in robot.trunk.motions}
    zero = jnp.zeros_like(posture.x)
    of_joints = tuple(zero if joint.locked is not None else joint.sign * next(rates) for joint in robot.joints)
    x, z, pitch = (of_trunk.pop(name, zero) for name in ("x", "z", "pitch"))
    return Velocity(x, z, pitch, of_joints, **of_trunk)


def joint_equations(
    robot: Robot, angles: Sequence[ArrayLike], rates: Sequence[ArrayLike], gravity: ArrayLike
) -> Equations:
    """Return the equations of motion of the joints that can move, with the trunk held; the matrix has full rows.

    `bias` are the torques [N*m] of velocities and gravity.
    """
    held = dataclasses.replace(robot, trunk=dataclasses.replace(robot.trunk, freedom="fixed"))
    posture = posture_of(held, angles)
    velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, rates)))
    made = _equations(held, posture, velocity, gravity)
    signs = [joint.sign for joint in robot.joints if joint.locked is None]
    order = range(len(signs))
    rows = [[made.matrix[max(i, j)][min(i, j)] * (signs[i] * signs[j]) for j in order] for i in order]
    return Equations(rows, [sign * bias for sign, bias in zip(signs, made.bias, strict=True)])


def mobilities(robot: Robot, posture: Posture) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the acceleration of the foot per force on it [1/kg] and those of the joints per torque [1/(kg*m^2)].

    Shapes (3, 3), forwards, to the left and up, and (joints, joints), 0 for locked joints; NaN where a joint turns
    bodies without inertia.
    """
    still = at_rest(posture)
    tree = _tree(robot, posture, still)
    found = tree.frames()
    moved = np.array([tuple(map(float, one)) for one in _foot_velocities(robot, tree, found, contact(robot, found))])
    rows = [list(map(float, row)) for row in _equations(robot, posture, still, 0.0).matrix]
    size = len(rows)
    lower = np.array([row + [0.0] * (size - len(row)) for row in rows]).reshape(size, size)
    matrix = lower + np.tril(lower, -1).T
    singular = np.linalg.matrix_rank(matrix) < size
    inverse = np.full((size, size), np.nan) if singular else np.linalg.inv(matrix)
    free = [index for index, joint in enumerate(robot.joints) if joint.locked is None]
    signs = np.array([robot.joints[index].sign for index in free])
    joints, first = np.zeros((len(robot.joints),) * 2), size - len(free)
    joints[np.ix_(free, free)] = inverse[first:, first:] * np.outer(signs, signs)
    foot = moved.reshape(size, 3)
    return foot.T @ inverse @ foot, joints
