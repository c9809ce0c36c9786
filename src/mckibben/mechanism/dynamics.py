"""Motion of a robot: its bodies as a tree (`mckibben.mechanism.tree`)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.codegen.engine import compiled
from mckibben.joint import GeneralLoad
from mckibben.mechanism.articulated import accelerations
from mckibben.mechanism.bodies import BodyPoint, Foot
from mckibben.mechanism.robot import Robot
from mckibben.mechanism.tree import MASSLESS, BodyInertia, Equations, Frame, TreeHinge, ancestors, equations, frames_of
from mckibben.numerics.spatial import IDENTITY, ZERO, Vector, X, Y, Z, difference, product, total

Scalar = Float[Array, ""]
Floats = NDArray[np.float64]

SLIDES = {"x": X, "y": Y, "z": Z}
"""Directions of the base's translations."""
TURNS = {"yaw": Z, "pitch": -Y, "roll": X}
"""Axes of the base's rotations, each in the axes after those before it."""


class Posture(NamedTuple):
    """Position of a robot: base [m], pitch of the base [rad], and angles of the joints [rad].

    `y`, `yaw` and `roll` are those of a base that leaves the plane, and None for others.
    """

    x: Scalar
    z: Scalar
    pitch: Scalar
    angles: tuple[Scalar, ...]
    y: Scalar | None = None
    yaw: Scalar | None = None
    roll: Scalar | None = None


Velocity = Posture
"""Rates of a `Posture` [m/s], [rad/s]."""


class Contact(NamedTuple):
    """Point of a sphere nearest to the ground: position [m], velocity [m/s], and arm from the hinge of its body [m].

    `body` is the number of that body among the frames.
    """

    position: Vector
    velocity: Vector
    arm: Vector
    body: int


def posture_of(robot: Robot, angles: Sequence[ArrayLike], *, z: ArrayLike = 0.0) -> Posture:
    """Return the posture of an upright base at a height [m], and locked joints at their place."""
    held = robot.held(angles)
    zero = jnp.zeros_like(held[0])
    others = {name: zero for name in ("y", "yaw", "roll") if name in robot.motions}
    return Posture(zero, jnp.asarray(z), zero, held, **others)


def at_rest(posture: Posture) -> Velocity:
    """Return the velocity of a robot at rest."""
    return Velocity(*jax.tree.map(jnp.zeros_like, posture))


_Arguments = tuple[list[Vector], list[TreeHinge], list[BodyInertia], list[Frame], Vector]


class _Tree(NamedTuple):
    """Bodies of a robot in a posture and at a velocity, and the number of its base."""

    slider: Frame
    hinges: list[TreeHinge]  # of base and joints
    bodies: list[BodyInertia]  # on the slider and on each hinge
    base: int

    def frames(self) -> list[Frame]:
        """Return the frames of all bodies."""
        return frames_of(self.slider, self.hinges)


def _tree(robot: Robot, posture: Posture, velocity: Velocity) -> _Tree:
    turns = [name for name in robot.motions if name in TURNS]
    hinges = [
        TreeHinge(TURNS[name], ZERO, getattr(posture, name), getattr(velocity, name), number)
        for number, name in enumerate(turns)
    ]
    hinges += robot.hinges(posture.angles, velocity.angles, len(turns))
    carried = robot.frame_bodies
    bodies = [MASSLESS if one is None else BodyInertia(one.mass, one.centre.vector, one.tensor) for one in carried]
    position, speed = (Vector(of.x, 0.0 if of.y is None else of.y, of.z) for of in (posture, velocity))
    slider = Frame(IDENTITY, ZERO, position, speed)
    return _Tree(slider, hinges, [*([MASSLESS] * len(turns)), *bodies], len(turns))


def frames(robot: Robot, posture: Posture, velocity: Velocity) -> list[Frame]:
    """Return the frames of the base and of what each joint carries."""
    tree = _tree(robot, posture, velocity)
    return tree.frames()[tree.base :]


def contacts(robot: Robot, found: Sequence[Frame], normal: Vector = Z) -> list[Contact]:
    """Return the point of each sphere that is nearest to a ground with a normal."""
    points = []
    for sphere in robot.spheres:
        body = robot.frame_names.index(sphere.body)
        frame = found[body]
        arm = frame.axes.apply(sphere.place.vector) - normal.scaled(sphere.radius)
        points.append(Contact(frame.position + arm, frame.velocity + frame.rate.cross(arm), arm, body))
    return points


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
    potential, spin = product(moment.dot(-Vector(*robot.gravity)), gravity), spin - centre.cross(momentum)
    for joint, angle in zip(robot.joints, posture.angles, strict=True):
        if joint.spring is not None:
            potential = total(potential, joint.spring_torque(angle) * (angle - joint.spring_angle) / 2)
    found = BodyMotion(kinetic, potential, centre.z, speed.x, speed.z, speed.y, spin)
    return jax.tree.map(jnp.asarray, found)


def _slides(robot: Robot) -> list[Vector]:
    """Directions in which the base moves without turning."""
    return [SLIDES[name] for name in robot.motions if name in SLIDES]


def _velocities(robot: Robot, tree: _Tree, found: Sequence[Frame], body: int, place: Vector) -> list[Vector]:
    """Velocity of a point of a body, at a place in the world, per rate of each motion."""
    line = set(ancestors(tree.hinges, body))
    moved: list[Vector] = _slides(robot)
    for number, (at, hinge) in enumerate(zip(found[1:], tree.hinges, strict=True), 1):
        if hinge.free:
            moved.append(at.axis.cross(place - at.position) if number in line else ZERO)
    return moved


def motion_equations(
    robot: Robot,
    posture: Posture,
    velocity: Velocity,
    gravity: ArrayLike,
    forces: Sequence[Vector] = (),
    normal: Vector = Z,
) -> Equations:
    """Return the equations of motion of base and joints under forces [N] at the points of contact.

    `bias` are the forces of velocities, gravity, springs and contact; damping and stops are not among them.
    """
    moved, acting = _acted_on(robot, posture, velocity, gravity, forces, normal)
    made = equations(*moved, acting)
    free = [(joint, angle) for joint, angle in zip(robot.joints, posture.angles, strict=True) if joint.locked is None]
    springs = [0.0] * len(robot.motions) + [joint.spring_torque(angle) for joint, angle in free]
    return Equations(made.matrix, list(map(total, made.bias, springs)))


def _acted_on(
    robot: Robot,
    posture: Posture,
    velocity: Velocity,
    gravity: ArrayLike,
    forces: Sequence[Vector],
    normal: Vector,
) -> tuple[_Arguments, list[tuple[int, Vector, Vector]]]:
    """Slides, hinges, bodies, frames and support of a tree, and the forces at the points of contact."""
    tree = _tree(robot, posture, velocity)
    found = tree.frames()
    points = contacts(robot, found[tree.base :], normal) if forces else []
    acting = [(tree.base + at.body, force, at.arm) for at, force in zip(points, forces, strict=True)]
    support = (-Vector(*robot.gravity)).scaled(gravity)
    return (_slides(robot), tree.hinges, tree.bodies, found, support), acting


def acceleration(
    robot: Robot,
    posture: Posture,
    velocity: Velocity,
    torques: Sequence[ArrayLike],
    forces: Sequence[Vector],
    gravity: ArrayLike,
    normal: Vector = Z,
) -> Velocity:
    """Return the accelerations under torques [N*m] of the joints and forces [N] at the points of contact.

    There is a force for each sphere of the robot, or none. Locked joints, and motions that the base lacks, have an
    acceleration of 0.
    """
    moved, acting = _acted_on(robot, posture, velocity, gravity, forces, normal)
    joints = zip(robot.joints, torques, posture.angles, strict=True)
    driven = [difference(torque, joint.spring_torque(angle)) for joint, torque, angle in joints if joint.locked is None]
    rates = iter(accelerations(*moved, [*[0.0] * len(robot.motions), *driven], acting))
    of_base = {name: next(rates) for name in robot.motions}
    zero = jnp.zeros_like(posture.x)
    of_joints = tuple(zero if joint.locked is not None else next(rates) for joint in robot.joints)
    x, z, pitch = (of_base.pop(name, zero) for name in ("x", "z", "pitch"))
    return Velocity(x, z, pitch, of_joints, **of_base)


def joint_equations(
    robot: Robot, angles: Sequence[ArrayLike], rates: Sequence[ArrayLike], gravity: ArrayLike
) -> Equations:
    """Return the equations of motion of the joints that can move, with the base held; the matrix has full rows.

    `bias` are the torques [N*m] of velocities and gravity.
    """
    held = robot if robot.base == "fixed" else dataclasses.replace(robot, base="fixed")  # which checks all of it
    posture = posture_of(held, angles)
    velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, rates)))
    made = motion_equations(held, posture, velocity, gravity)
    order = range(len(made.bias))
    return Equations([[made.matrix[max(i, j)][min(i, j)] for j in order] for i in order], made.bias)


def equations_at_rest(robot: Robot, angles: ArrayLike, gravity: ArrayLike = 0.0) -> tuple[Floats, Floats]:
    """Return the mass matrix of base and joints, and their bias, in postures at rest with the base upright.

    Angles [rad] have shape (postures, joints); what is returned has the postures as its first axis.
    """
    matrix, bias = _at_rest((robot, gravity), tuple(np.ascontiguousarray(np.asarray(angles, float).T)))
    size = range(len(bias))
    whole = np.array([[matrix[max(i, j)][min(i, j)] for j in size] for i in size])
    return np.moveaxis(whole, -1, 0), np.stack(bias, axis=-1)


@compiled
def _at_rest(parts: tuple[Robot, ArrayLike], angles: tuple[Array, ...]) -> Equations:
    """Equations of motion at rest, many postures along the last axis."""
    robot, gravity = parts
    posture = posture_of(robot, angles)
    made = motion_equations(robot, posture, at_rest(posture), gravity)
    return jax.tree.map(lambda number: number + jnp.zeros_like(angles[0]), made)


def joint_load(robot: Robot, angles: Sequence[float], index: int, gravity: float) -> GeneralLoad:
    """Return the load on a joint near a posture, the other joints held: inertia, damping, and torque of gravity.

    The torque of a spring has the slope of that at the posture.
    """
    joint, row = robot.joints[index], len(robot.motions) + sum(one.locked is None for one in robot.joints[:index])
    postures = np.array([angles, angles], float)
    postures[1, index] += math.pi / 2  # where gravity has the torque that is its slope at the posture
    matrix, bias = equations_at_rest(robot, postures, gravity)
    torque, slope = bias[:, row] - [0.0, joint.spring_torque(postures[1, index])]
    slope += 0.0 if joint.spring is None else joint.spring
    hanging = postures[0, index] - math.atan2(torque, slope)
    return GeneralLoad(float(matrix[0, row, row]), math.hypot(torque, slope), joint.damping, float(hanging))


def mobilities(
    robot: Robot, angles: Sequence[ArrayLike], point: BodyPoint | Foot | None = None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the acceleration of a point per force on it [1/kg] and those of the joints per torque [1/(kg*m^2)].

    At rest in a posture of angles [rad]. Shapes (3, 3), forwards, to the left and up, and (joints, joints), 0 for
    locked joints; NaN where a joint turns bodies without inertia. The point of a sphere is its lowest; no point has no
    mobility.
    """
    matrix = equations_at_rest(robot, np.array([angles], float))[0][0]
    size = len(matrix)
    singular = np.linalg.matrix_rank(matrix) < size
    inverse = np.full((size, size), np.nan) if singular else np.linalg.inv(matrix)
    free = [index for index, joint in enumerate(robot.joints) if joint.locked is None]
    joints, first = np.zeros((len(robot.joints),) * 2), size - len(free)
    joints[np.ix_(free, free)] = inverse[first:, first:]
    moved = np.zeros((size, 3))
    if point is not None:
        posture = posture_of(robot, angles)
        tree = _tree(robot, posture, at_rest(posture))
        found = tree.frames()
        body = tree.base + robot.frame_names.index(point.body)
        place = found[body].point(point.place.vector)[0]
        if isinstance(point, Foot):
            place = place - Z.scaled(point.radius)
        moved[:] = [tuple(map(float, one)) for one in _velocities(robot, tree, found, body, place)]
    return moved.T @ inverse @ moved, joints
