"""Accelerations of a tree of bodies, in a number of operations that grows with that of its hinges.

R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008, ch. 7: the articulated-body algorithm, in world axes,
with moments about the hinge of each body. Accelerations of bodies are those that the motions add: what velocities and
gravity take is among the forces on each body (`mckibben.mechanism.tree.moved_bodies`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mckibben.mechanism.tree import BodyInertia, Composite, Frame, TreeHinge, moved_bodies, solve_symmetric
from mckibben.numerics.elementary import Number
from mckibben.numerics.spatial import ZERO, Rotation, Tensor, Vector, X, Y, Z, difference, product, total


class _Step(NamedTuple):
    """Acceleration of a hinge: what is `free` of the motion of its parent, times `mobility`."""

    mobility: Number
    free: Number  # torque [N*m]
    turning: Vector  # torque per acceleration
    linear: Vector

    def acceleration(self, spin: Vector, linear: Vector) -> Number:
        """Return it [rad/s^2] where the parent moves the hinge along."""
        taken = total(self.turning.dot(spin), self.linear.dot(linear))
        return product(difference(self.free, taken), self.mobility)


class _Articulated(NamedTuple):
    """Bodies from a hinge on, which the hinges beyond it let move: force and moment for accelerations of the first."""

    load: Vector  # without acceleration [N]
    moment: Vector  # without acceleration, about the hinge [N*m]
    mass: Tensor  # by direction [kg]
    coupling: Rotation  # columns: moment per linear acceleration [kg*m]
    inertia: Tensor  # about the hinge [kg*m^2]

    @classmethod
    def of(cls, body: Composite) -> _Articulated:
        """Return one rigid body."""
        coupling = Rotation(*(body.first.cross(axis) for axis in (X, Y, Z)))
        return cls(body.load, body.moment, Tensor.diagonal(body.mass), coupling, body.second)

    def __add__(self, other: _Articulated) -> _Articulated:  # type: ignore[override]
        coupling = Rotation(*map(Vector.__add__, self.coupling, other.coupling))
        load, moment, mass = self.load + other.load, self.moment + other.moment, self.mass + other.mass
        return _Articulated(load, moment, mass, coupling, self.inertia + other.inertia)

    def about(self, arm: Vector) -> _Articulated:
        """Return it about the hinge of the parent, from which there is an arm."""
        columns = zip(self.coupling, self.mass.columns, strict=True)
        coupling = Rotation(*(column + arm.cross(force) for column, force in columns))
        rows = zip(*map(Vector.__add__, self.coupling, coupling), strict=True)
        inertia = self.inertia + Tensor.symmetric(*(arm.cross(Vector(*row)) for row in rows))
        return _Articulated(self.load, self.moment + arm.cross(self.load), self.mass, coupling, inertia)

    def let_go(self, axis: Vector, torque: Number, rotor: Number) -> tuple[_Articulated, _Step]:
        """Return it as felt through its hinge, which a torque [N*m] drives, and the step of that."""
        turning, linear = self.inertia.apply(axis), Vector(*map(axis.dot, self.coupling))
        mobility = 1 / total(axis.dot(turning), rotor)
        step = _Step(mobility, difference(torque, axis.dot(self.moment)), turning, linear)
        driven, less = product(step.free, mobility), difference(0.0, mobility)
        taken = linear.scaled(less)
        coupling = Rotation(*(old + turning.scaled(part) for old, part in zip(self.coupling, taken, strict=True)))
        mass, inertia = self.mass + Tensor.square(linear, less), self.inertia + Tensor.square(turning, less)
        load, moment = self.load + linear.scaled(driven), self.moment + turning.scaled(driven)
        return _Articulated(load, moment, mass, coupling, inertia), step


def accelerations(
    slides: Sequence[Vector],
    hinges: Sequence[TreeHinge],
    bodies: Sequence[BodyInertia],
    frames: Sequence[Frame],
    support: Vector,
    torques: Sequence[Number],
    forces: Sequence[tuple[int, Vector, Vector]] = (),
) -> list[Any]:
    """Return the accelerations of slides and free hinges under forces [N] and torques [N*m] on them.

    The arguments are those of `mckibben.mechanism.tree.equations`, whose solution they are.
    """
    beyond = list(map(_Articulated.of, moved_bodies(hinges, bodies, frames, support, forces)))
    driving, steps = list(torques), dict[int, _Step]()
    for index in range(len(hinges), 0, -1):
        frame, hinge, moved = frames[index], hinges[index - 1], beyond[index]
        if hinge.free:
            moved, steps[index] = moved.let_go(frame.axis, driving.pop(), hinge.rotor)
        beyond[hinge.parent] += moved.about(frame.arm)
    base = beyond[0]
    matrix = [[slide.dot(base.mass.apply(other)) for other in slides[: row + 1]] for row, slide in enumerate(slides)]
    right = [difference(force, slide.dot(base.load)) for force, slide in zip(driving, slides, strict=True)]
    rates = solve_symmetric(matrix, right)
    linear = ZERO
    for slide, rate in zip(slides, rates, strict=True):
        linear = linear + slide.scaled(rate)
    moving = [(ZERO, linear)]
    for index, (hinge, frame) in enumerate(zip(hinges, frames[1:], strict=True), 1):
        spin, linear = moving[hinge.parent]
        linear = linear + spin.cross(frame.arm)
        if index in steps:
            rates.append(steps[index].acceleration(spin, linear))
            spin = spin + frame.axis.scaled(rates[-1])
        moving.append((spin, linear))
    return rates
