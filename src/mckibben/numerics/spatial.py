"""Vectors, rotations and tensors in space as scalars; components that are plain numbers are known when traced.

A product with a known 0 or 1 and a sum with a known 0 emit no operation, so that a chain of bodies in a plane takes no
more operations than planar formulas.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from mckibben.numerics.elementary import sincos

Scalar = Any
"""A number, known when traced if a float, or an array."""


def product(a: Scalar, b: Scalar) -> Scalar:
    """Return a times b."""
    for number, other in ((a, b), (b, a)):
        if isinstance(number, int | float):
            if number == 0:
                return 0.0
            if abs(number) == 1:
                return other if number == 1 else -other
    return a * b


def total(a: Scalar, b: Scalar) -> Scalar:
    """Return a plus b."""
    for number, other in ((a, b), (b, a)):
        if isinstance(number, int | float) and number == 0:
            return other
    return a + b


def difference(a: Scalar, b: Scalar) -> Scalar:
    """Return a minus b."""
    if a is b:
        return 0.0
    if isinstance(b, int | float) and b == 0:
        return a
    return -b if isinstance(a, int | float) and a == 0 else a - b


class Vector(NamedTuple):
    """Vector in space, in the axes of a body or of the ground.

    Sums, differences and products with known components are known themselves.

    Examples
    --------
    >>> X.cross(Y)
    Vector(x=0.0, y=0.0, z=1.0)
    >>> Vector(1.0, 2.0, 3.0).dot(Vector(4.0, 5.0, 6.0))
    32.0
    """

    x: Scalar
    y: Scalar
    z: Scalar

    def __add__(self, other: Sequence[Scalar]) -> Vector:  # type: ignore[override]
        return Vector(*map(total, self, other))

    def __sub__(self, other: Sequence[Scalar]) -> Vector:
        return Vector(*map(difference, self, other))

    def __neg__(self) -> Vector:
        return Vector(0.0, 0.0, 0.0) - self

    def scaled(self, factor: Scalar) -> Vector:
        """Return the vector times a factor."""
        return Vector(*(product(factor, number) for number in self))

    def dot(self, other: Vector) -> Scalar:
        """Return the scalar product."""
        x, y, z = map(product, self, other)
        return total(total(x, y), z)

    def cross(self, other: Vector) -> Vector:
        """Return the vector product."""
        (x, y, z), (u, v, w) = self, other
        return Vector(
            difference(product(y, w), product(z, v)),
            difference(product(z, u), product(x, w)),
            difference(product(x, v), product(y, u)),
        )


ZERO = Vector(0.0, 0.0, 0.0)
X, Y, Z = Vector(1.0, 0.0, 0.0), Vector(0.0, 1.0, 0.0), Vector(0.0, 0.0, 1.0)


def unit_vector(direction: Sequence[float]) -> Vector:
    """Return a vector of known numbers with the length 1.

    Examples
    --------
    >>> unit_vector((3, 0, 4))
    Vector(x=0.6, y=0.0, z=0.8)
    """
    length = math.hypot(*direction)
    return Vector(*(float(number) / length for number in direction))


class Rotation(NamedTuple):
    """Axes of a body in those around it: the columns of its rotation matrix.

    Examples
    --------
    >>> quarter = Rotation(Y, -X, Z)  # a turn by 90 deg about z
    >>> quarter.apply(Vector(2.0, 0.0, 0.0)) == Y.scaled(2.0), quarter.then(quarter).x == -X
    (True, True)
    """

    x: Vector
    y: Vector
    z: Vector

    def apply(self, vector: Vector) -> Vector:
        """Return a vector of the body in the axes around it."""
        return self.x.scaled(vector.x) + self.y.scaled(vector.y) + self.z.scaled(vector.z)

    def then(self, inner: Rotation) -> Rotation:
        """Return the axes of a body that are given in those of this one."""
        return Rotation(*map(self.apply, inner))

    @classmethod
    def about(cls, axis: Vector, angle: Scalar) -> Rotation:
        """Return the axes of a body after a turn by an angle [rad] about a unit vector of known numbers."""
        sine, cosine = sincos(angle)

        def turned(base: Vector) -> Vector:  # by the formula of Rodrigues
            along = base.dot(axis)
            across = base - axis.scaled(along)
            return across.scaled(cosine) + axis.cross(base).scaled(sine) + axis.scaled(along)

        return cls(turned(X), turned(Y), turned(Z))


IDENTITY = Rotation(X, Y, Z)


class Tensor(NamedTuple):
    """Symmetric tensor."""

    xx: Scalar
    xy: Scalar
    xz: Scalar
    yy: Scalar
    yz: Scalar
    zz: Scalar

    def __add__(self, other: Sequence[Scalar]) -> Tensor:  # type: ignore[override]
        return Tensor(*map(total, self, other))

    @property
    def columns(self) -> tuple[Vector, Vector, Vector]:
        """Columns of its matrix."""
        xx, xy, xz, yy, yz, zz = self
        return Vector(xx, xy, xz), Vector(xy, yy, yz), Vector(xz, yz, zz)

    def apply(self, vector: Vector) -> Vector:
        """Return the tensor times a vector."""
        return Vector(*(column.dot(vector) for column in self.columns))

    @classmethod
    def diagonal(cls, number: Scalar) -> Tensor:
        """Return a number times the unit tensor."""
        return cls(number, 0.0, 0.0, number, 0.0, number)

    @classmethod
    def square(cls, a: Vector, factor: Scalar) -> Tensor:
        """Return the dyadic product of a vector and itself, times a factor."""
        x, y, z = a.scaled(factor)
        return cls(product(x, a.x), product(x, a.y), product(x, a.z), product(y, a.y), product(y, a.z), product(z, a.z))

    @classmethod
    def symmetric(cls, a: Vector, b: Vector, c: Vector) -> Tensor:
        """Return the symmetric part of a matrix of columns."""

        def mean(a: Scalar, b: Scalar) -> Scalar:
            return product(0.5, total(a, b))

        return cls(a.x, mean(a.y, b.x), mean(a.z, c.x), b.y, mean(b.z, c.y), c.z)

    @classmethod
    def dyad(cls, a: Vector, b: Vector) -> Tensor:
        """Return the symmetric part of the dyadic product."""
        return cls.symmetric(*(a.scaled(number) for number in b))
