"""Rigid bodies in a tree of hinges on a base that slides: frames, paths, mass matrix, and equations of motion.

R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008: the recursive Newton-Euler algorithm (ch. 5) gives the
forces of velocities and gravity, the composite-rigid-body algorithm (ch. 6) the mass matrix, both in world axes, with
moments about the hinge of each body. x is forwards, y to the left, and z up. Bodies are numbered from the base, 0, each
after its parent. At the angles 0 the axes of all bodies are those of the base.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp

from mckibben.joint.route import Bends
from mckibben.numerics.elementary import Number
from mckibben.numerics.spatial import ZERO, Rotation, Tensor, Vector, difference, product, total


class TreeHinge(NamedTuple):
    """Hinge between a body and its parent."""

    axis: Vector  # unit vector of known numbers in the axes of the parent
    place: Vector  # in the parent [m]
    angle: Number  # of the body from its parent [rad]
    rate: Number  # [rad/s]
    parent: int  # number of a body
    free: bool = True  # or held
    rotor: Number = 0.0  # inertia that turns with the hinge alone [kg*m^2]


class BodyInertia(NamedTuple):
    """Rigid body."""

    mass: Number  # [kg]
    centre: Vector  # centre of mass [m]
    inertia: Tensor  # about it [kg*m^2]

    @property
    def moment(self) -> Vector:
        """Mass times the centre of mass [kg*m]."""
        return self.centre.scaled(self.mass)

    def inertia_about_centre(self, axes: Rotation) -> Tensor:
        """Return the inertia about the centre of mass, in world axes."""
        return _in_axes(self.inertia, axes)

    def inertia_about_hinge(self, axes: Rotation) -> Tensor:
        """Return the inertia [kg*m^2] about the origin of the body, in world axes, by the parallel axis theorem."""
        inertia, moment, centre = self.inertia, self.moment, self.centre
        square = Vector(*map(product, moment, centre))
        x = total(inertia.xx, total(square.y, square.z))
        on_axis = inertia.xx is inertia.yy and centre.x is centre.y  # symmetric about the z axis, with known zeros
        y = x if on_axis else total(inertia.yy, total(square.x, square.z))
        z = total(inertia.zz, total(square.x, square.y))
        xy = difference(inertia.xy, product(moment.x, centre.y))
        xz = difference(inertia.xz, product(moment.x, centre.z))
        yz = difference(inertia.yz, product(moment.y, centre.z))
        return _in_axes(Tensor(x, xy, xz, y, yz, z), axes)


MASSLESS = BodyInertia(0.0, ZERO, Tensor.diagonal(0.0))


def _in_axes(inertia: Tensor, axes: Rotation) -> Tensor:
    """Tensor of a body in world axes."""
    xx, xy, xz, yy, yz, zz = inertia
    products = [(xy, axes.x, axes.y), (xz, axes.x, axes.z), (yz, axes.y, axes.z)]
    products = [part for part in products if not (isinstance(part[0], float) and part[0] == 0)]
    if xx is yy and not products:  # symmetric about the z axis
        return Tensor.diagonal(xx) + Tensor.square(axes.z, difference(zz, xx))
    found, *others = (Tensor.square(axis, moment) for axis, moment in zip(axes, (xx, yy, zz), strict=True))
    for part in (*others, *(Tensor.dyad(first.scaled(product(2.0, off)), second) for off, first, second in products)):
        found = found + part
    return found


class Frame(NamedTuple):
    """Motion of a body in world axes: its axes, angular velocity, and position and velocity of its hinge."""

    axes: Rotation
    rate: Vector
    position: Vector
    velocity: Vector
    axis: Vector = ZERO  # of the hinge
    arm: Vector = ZERO  # from the hinge of the parent

    def point(self, place: Vector) -> tuple[Vector, Vector]:
        """Return position [m] and velocity [m/s] of a point of the body [m]."""
        arm = self.axes.apply(place)
        return self.position + arm, self.velocity + self.rate.cross(arm)


def frames_of(base: Frame, hinges: Sequence[TreeHinge]) -> list[Frame]:
    """Return the frames of the base and of the body on each hinge, with one rotation about successive parallel axes."""
    frames = [base]
    turns: list[tuple[Rotation, Vector, Any]] = [(base.axes, ZERO, 0.0)]  # of bodies: axes, and a turn about an axis
    for hinge in hinges:
        above, (before, axis, angle) = frames[hinge.parent], turns[hinge.parent]
        if hinge.axis == axis:
            angle = angle + hinge.angle
        elif hinge.axis == -axis:
            angle = angle - hinge.angle
        else:
            before, axis, angle = above.axes, hinge.axis, hinge.angle
        turned = before.then(Rotation.about(axis, angle))
        world, arm = above.axes.apply(hinge.axis), above.axes.apply(hinge.place)
        velocity = above.velocity + above.rate.cross(arm)
        rate = above.rate + world.scaled(hinge.rate if hinge.free else 0.0)
        frames.append(Frame(turned, rate, above.position + arm, velocity, world, arm))
        turns.append((before, axis, angle))
    return frames


def ancestors(hinges: Sequence[TreeHinge], body: int) -> list[int]:
    """Return the numbers of a body and of its parents up to the base, which is left out."""
    found = []
    while body:
        found.append(body)
        body = hinges[body - 1].parent
    return found


def path_through(
    points: Sequence[tuple[int, Vector]], hinges: Sequence[TreeHinge], frames: Sequence[Frame]
) -> tuple[Any, dict[int, Any], Callable[[], Bends]]:
    """Return the length [m] of straight lines through points of bodies, and its derivatives [m/rad] by hinge.

    A hinge has the number of its body; of a line between two bodies only those between them change the length. The
    function computes the second derivatives.
    """
    places = [(body, frames[body].point(place)[0]) for body, place in points]
    length: Any = 0.0
    slopes: dict[int, Any] = {}
    lines = []
    for (body, start), (other, end) in itertools.pairwise(places):
        line = end - start
        span = jnp.sqrt(line.dot(line))
        length = total(length, span)
        before, after = set(ancestors(hinges, body)), set(ancestors(hinges, other))
        moves = {}  # of the line, by hinge, and whether the hinge moves its end
        for index in sorted(before ^ after):
            moved = frames[index].axis.cross((end if index in after else start) - frames[index].position)
            moves[index] = moved if index in after else -moved, index in after
            slopes[index] = total(slopes.get(index, 0.0), line.dot(moves[index][0]) / span)
        lines.append((line, span, moves))

    def bends() -> Bends:
        found: Bends = {}
        for line, span, moves in lines:
            for (i, (first, at_end)), (j, (second, other)) in itertools.combinations_with_replacement(moves.items(), 2):
                bend = difference(first.dot(second), line.dot(first) * line.dot(second) / (span * span))
                if at_end == other:  # the hinge nearer to the base turns the motion by the other
                    bend = total(bend, line.dot(frames[i].axis.cross(second)))
                found[i, j] = total(found.get((i, j), 0.0), bend / span)
        return found

    return length, slopes, bends


class Equations(NamedTuple):
    """Equations of motion: matrix times accelerations = torques and forces on slides and free hinges - bias.

    The motions are the slides of the base, in order, and then the free hinges [N, N*m].
    """

    matrix: list[list[Number]]  # rows up to the diagonal
    bias: list[Number]

    def accelerations(self, torques: Sequence[Any]) -> list[Any]:
        """Return the accelerations under forces and torques on the free motions."""
        return solve_symmetric(self.matrix, [difference(*pair) for pair in zip(torques, self.bias, strict=True)])


class Composite(NamedTuple):
    """Bodies from a hinge on: force and moment that move them, mass, and its moments about the hinge."""

    load: Vector = ZERO
    moment: Vector = ZERO
    mass: Number = 0.0
    first: Vector = ZERO
    second: Tensor = Tensor.diagonal(0.0)

    def __add__(self, other: Composite) -> Composite:  # type: ignore[override]
        mass = total(self.mass, other.mass)
        load, moment, first = self.load + other.load, self.moment + other.moment, self.first + other.first
        return Composite(load, moment, mass, first, self.second + other.second)

    def about(self, arm: Vector) -> Composite:
        """Return it about the hinge of the parent, from which there is an arm."""
        second = self.second + Tensor.diagonal(product(2.0, arm.dot(self.first)))
        second += Tensor.dyad(self.first.scaled(-2.0), arm)
        second += Tensor.diagonal(product(self.mass, arm.dot(arm)))
        second += Tensor.dyad(arm.scaled(difference(0.0, self.mass)), arm)
        moment, first = self.moment + arm.cross(self.load), self.first + arm.scaled(self.mass)
        return Composite(self.load, moment, self.mass, first, second)


def equations(
    slides: Sequence[Vector],  # directions in which the base moves without turning
    hinges: Sequence[TreeHinge],
    bodies: Sequence[BodyInertia],  # of the base and on each hinge
    frames: Sequence[Frame],  # their frames
    support: Vector,  # acceleration against gravity [m/s^2]
    forces: Sequence[tuple[int, Vector, Vector]] = (),  # body, force [N], and its arm from the hinge [m]
) -> Equations:
    r"""Return the equations of motion of a tree.

    .. math:: M(q) \ddot q = \tau - b(q, \dot q)

    The bias b holds the forces of velocities, of gravity and on the bodies: those of a motion without accelerations
    (ch. 5). A column of M is the momentum that a unit rate of one motion gives all bodies beyond it, taken about each
    hinge and along each slide above (ch. 6).
    """
    beyond = moved_bodies(hinges, bodies, frames, support, forces)
    columns: list[list[Number]] = []
    bias: list[Number] = []
    for index in range(len(frames) - 1, 0, -1):
        frame, moved, hinge = frames[index], beyond[index], hinges[index - 1]
        if hinge.free:
            bias.append(frame.axis.dot(moved.moment))
            momentum, moment = frame.axis.cross(moved.first), moved.second.apply(frame.axis)
            columns.append(_column(slides, hinges, frames, index, momentum, moment))
        beyond[hinge.parent] += moved.about(frame.arm)
    mass, load = beyond[0].mass, beyond[0].load
    base = [[product(mass, slide.dot(other)) for other in slides[: row + 1]] for row, slide in enumerate(slides)]
    return Equations([*base, *reversed(columns)], [*(slide.dot(load) for slide in slides), *reversed(bias)])


def moved_bodies(
    hinges: Sequence[TreeHinge],
    bodies: Sequence[BodyInertia],
    frames: Sequence[Frame],
    support: Vector,
    forces: Sequence[tuple[int, Vector, Vector]],
) -> list[Composite]:
    """Return what moves each body alone without accelerations of the motions, as for `equations`."""
    moved, moving = [], _velocity_accelerations(hinges, frames, support)
    for frame, body, (spin, linear) in zip(frames, bodies, moving, strict=True):
        if body is MASSLESS:
            moved.append(Composite())
            continue
        own, inertia = frame.axes.apply(body.moment), body.inertia_about_hinge(frame.axes)
        load = linear.scaled(body.mass) + spin.cross(own) + frame.rate.cross(frame.rate.cross(own))
        moment = inertia.apply(spin) + frame.rate.cross(inertia.apply(frame.rate)) + own.cross(linear)
        moved.append(Composite(load, moment, body.mass, own, inertia))
    for index, force, arm in forces:
        moved[index] += Composite(-force, -arm.cross(force))
    return moved


def _velocity_accelerations(
    hinges: Sequence[TreeHinge], frames: Sequence[Frame], support: Vector
) -> list[tuple[Vector, Vector]]:
    """Angular and linear acceleration of each frame without those of the motions; gravity is one against it."""
    moving = [(ZERO, support)]
    for hinge, frame in zip(hinges, frames[1:], strict=True):
        above, (spin, linear) = frames[hinge.parent], moving[hinge.parent]
        linear = linear + spin.cross(frame.arm) + above.rate.cross(above.rate.cross(frame.arm))
        moving.append((spin + above.rate.cross(frame.rate - above.rate), linear))
    return moving


def _column(
    slides: Sequence[Vector],
    hinges: Sequence[TreeHinge],
    frames: Sequence[Frame],
    index: int,
    momentum: Vector,
    moment: Vector,
) -> list[Number]:
    """Row of the mass matrix for a hinge, from the momentum of a unit rate and its moment about the hinge."""
    upwards: dict[int, Number] = {index: total(frames[index].axis.dot(moment), hinges[index - 1].rotor)}
    line = ancestors(hinges, index)
    for below, above in itertools.pairwise(line):
        moment = moment + frames[below].arm.cross(momentum)
        if hinges[above - 1].free:
            upwards[above] = frames[above].axis.dot(moment)
    free = (number for number in range(1, index + 1) if hinges[number - 1].free)
    return [*(slide.dot(momentum) for slide in slides), *(upwards.get(number, 0.0) for number in free)]


def solve_symmetric(matrix: Sequence[Sequence[Any]], right: Sequence[Any]) -> list[Any]:
    """Return the solution of equations with a positive definite matrix, whose rows go up to the diagonal.

    By its decomposition into L D L^T. Entries that are known numbers when traced, such as the zeros of a chain in a
    plane, take no operations.

    >>> [round(x, 6) for x in solve_symmetric([[4.0], [1.0, 3.0]], [1.0, 2.0])]
    [0.090909, 0.636364]
    """
    rows, right, size = [list(row) for row in matrix], list(right), len(right)
    factors: list[list[Any]] = []
    inverses = []
    for k in range(size):
        inverse = 1 / rows[k][k]
        below = [product(rows[i][k], inverse) for i in range(k + 1, size)]
        for place, i in enumerate(range(k + 1, size)):
            for j in range(k + 1, i + 1):
                rows[i][j] = difference(rows[i][j], product(below[place], rows[j][k]))
            right[i] = difference(right[i], product(below[place], right[k]))
        factors.append(below)
        inverses.append(inverse)
    solution: list[Any] = [None] * size
    for k in range(size - 1, -1, -1):
        solution[k] = product(right[k], inverses[k])
        for place, i in enumerate(range(k + 1, size)):
            solution[k] = difference(solution[k], product(factors[k][place], solution[i]))
    return solution
