"""Rigid bodies in a chain of hinges on a base that slides: frames, mass matrix, and equations of motion.

R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008: the recursive Newton-Euler algorithm (ch. 5) gives the
forces of velocities and gravity, the composite-rigid-body algorithm (ch. 6) the mass matrix, both in world axes, with
moments about the hinge of each body. x is forwards, y to the left, and z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from mckibben.numerics.elementary import Number
from mckibben.numerics.spatial import ZERO, Rotation, Tensor, Vector, Z, difference, product, total


class Hinge(NamedTuple):
    """Hinge between a body and the one above it."""

    axis: Vector  # unit vector of known numbers in the axes of the body above
    place: Vector  # in the body above [m]
    angle: Number  # of the body from the one above [rad]
    rate: Number  # [rad/s]
    free: bool = True  # or held


class Body(NamedTuple):
    """Rigid body with its centre of mass on its own z axis."""

    mass: Number  # [kg]
    centre: Number  # coordinate of the centre of mass [m]
    inertia: Vector  # principal ones about it, along the axes [kg*m^2]

    @property
    def moment(self) -> Any:
        """Mass times the coordinate of the centre of mass [kg*m]."""
        return product(self.mass, self.centre)

    def inertia_about_centre(self, axes: Rotation) -> Tensor:
        """Return the inertia about the centre of mass, in world axes."""
        return _in_axes(self.inertia, axes)

    def inertia_about_hinge(self, axes: Rotation) -> Tensor:
        """Return the inertia [kg*m^2] about the origin of the body, in world axes, by the parallel axis theorem."""
        shift = product(self.moment, self.centre)
        x = total(self.inertia.x, shift)
        y = x if self.inertia.x is self.inertia.y else total(self.inertia.y, shift)
        return _in_axes(Vector(x, y, self.inertia.z), axes)


MASSLESS = Body(0.0, 0.0, ZERO)


def _in_axes(principal: Vector, axes: Rotation) -> Tensor:
    """Tensor with principal values along axes."""
    x, y, z = principal
    if x is y:  # symmetric about the z axis
        return Tensor.diagonal(x) + Tensor.dyad(axes.z.scaled(difference(z, x)), axes.z)
    along_x, along_y, along_z = (
        Tensor.dyad(axis.scaled(moment), axis) for axis, moment in zip(axes, principal, strict=True)
    )
    return along_x + along_y + along_z


class Frame(NamedTuple):
    """Motion of a body in world axes: its axes, angular velocity, and position and velocity of its hinge."""

    axes: Rotation
    rate: Vector
    position: Vector
    velocity: Vector
    axis: Vector = ZERO  # of the hinge
    arm: Vector = ZERO  # from the hinge of the body above

    def point(self, along: Number) -> tuple[Vector, Vector]:
        """Return position [m] and velocity [m/s] of a point at a coordinate [m] on the z axis of the body."""
        arm = self.axes.z.scaled(along)
        return self.position + arm, self.velocity + self.rate.cross(arm)


def frames_of(base: Frame, hinges: Sequence[Hinge]) -> list[Frame]:
    """Return the frames of the base and of the body on each hinge, with one rotation about successive parallel axes."""
    frames = [base]
    before, axis, angle = base.axes, ZERO, 0.0
    for hinge in hinges:
        above = frames[-1]
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
    return frames


class Equations(NamedTuple):
    """Equations of motion: matrix times accelerations = torques and forces on slides and free hinges - bias.

    The motions are the slides of the base, in order, and then the free hinges [N, N*m].
    """

    matrix: list[list[Number]]  # rows up to the diagonal
    bias: list[Number]

    def accelerations(self, torques: Sequence[Any]) -> list[Any]:
        """Return the accelerations under forces and torques on the free motions."""
        return solve_symmetric(self.matrix, [difference(*pair) for pair in zip(torques, self.bias, strict=True)])


def equations(
    slides: Sequence[Vector],  # directions in which the base moves without turning
    hinges: Sequence[Hinge],
    bodies: Sequence[Body],  # of the base and on each hinge
    frames: Sequence[Frame],  # their frames
    gravity: Any,  # downwards [m/s^2]
    force: Vector = ZERO,  # on the last body [N]
    arm: Vector = ZERO,  # of its point from the hinge [m]
) -> Equations:
    r"""Return the equations of motion of a chain.

    .. math:: M(q) \ddot q = \tau - b(q, \dot q)

    The bias b holds the forces of velocities, of gravity and of the force on the last body: those of a motion without
    accelerations (ch. 5). A column of M is the momentum that a unit rate of one motion gives all bodies beyond it,
    taken about each hinge and along each slide above (ch. 6).
    """
    moving = _velocity_accelerations(frames, gravity)
    load, moment = -force, -arm.cross(force)
    mass, first, second = 0.0, ZERO, Tensor.diagonal(0.0)  # of the bodies from here on, about the hinge
    columns: list[list[Number]] = []
    bias: list[Number] = []
    for index in range(len(frames) - 1, -1, -1):
        frame, body, (spin, linear) = frames[index], bodies[index], moving[index]
        if body is not MASSLESS:
            own, inertia = frame.axes.z.scaled(body.moment), body.inertia_about_hinge(frame.axes)
            load += linear.scaled(body.mass) + spin.cross(own) + frame.rate.cross(frame.rate.cross(own))
            moment += inertia.apply(spin) + frame.rate.cross(inertia.apply(frame.rate)) + own.cross(linear)
            mass, first, second = total(mass, body.mass), first + own, second + inertia
        if index == 0:
            break
        if hinges[index - 1].free:
            bias.append(frame.axis.dot(moment))
            columns.append(_column(slides, hinges, frames, index, frame.axis.cross(first), second.apply(frame.axis)))
        moment += frame.arm.cross(load)
        # about the hinge above
        second += Tensor.diagonal(product(2.0, frame.arm.dot(first))) + Tensor.dyad(first.scaled(-2.0), frame.arm)
        second += Tensor.diagonal(product(mass, frame.arm.dot(frame.arm))) + Tensor.dyad(
            frame.arm.scaled(difference(0.0, mass)), frame.arm
        )
        first += frame.arm.scaled(mass)
    base = [[product(mass, slide.dot(other)) for other in slides[: row + 1]] for row, slide in enumerate(slides)]
    return Equations([*base, *reversed(columns)], [*(slide.dot(load) for slide in slides), *reversed(bias)])


def _velocity_accelerations(frames: Sequence[Frame], gravity: Any) -> list[tuple[Vector, Vector]]:
    """Angular and linear acceleration of each frame without those of the motions, and with gravity as one upwards."""
    spin, linear = ZERO, Z.scaled(gravity)
    moving = [(spin, linear)]
    for above, frame in pairwise(frames):
        linear = linear + spin.cross(frame.arm) + above.rate.cross(above.rate.cross(frame.arm))
        spin = spin + above.rate.cross(frame.rate - above.rate)
        moving.append((spin, linear))
    return moving


def _column(
    slides: Sequence[Vector],
    hinges: Sequence[Hinge],
    frames: Sequence[Frame],
    index: int,
    momentum: Vector,
    moment: Vector,
) -> list[Number]:
    """Row of the mass matrix for a hinge, from the momentum of a unit rate and its moment about the hinge."""
    upwards = [frames[index].axis.dot(moment)]
    for above in range(index - 1, 0, -1):
        moment = moment + frames[above + 1].arm.cross(momentum)
        if hinges[above - 1].free:
            upwards.append(frames[above].axis.dot(moment))
    return [*(slide.dot(momentum) for slide in slides), *reversed(upwards)]


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
