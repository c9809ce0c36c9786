"""Vectors, rotations and tensors in scalars against NumPy and SciPy; known numbers cost no operations."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation as Reference

from mckibben.numerics.spatial import IDENTITY, Rotation, Tensor, Vector, Y, unit_vector

A, B = Vector(0.3, -1.2, 2.0), Vector(-0.7, 0.4, 1.1)


def matrix(tensor: Tensor) -> np.ndarray:
    xx, xy, xz, yy, yz, zz = map(float, tensor)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_vectors_are_those_of_numpy() -> None:
    np.testing.assert_allclose(A.cross(B), np.cross(A, B))
    np.testing.assert_allclose(
        [A.dot(B), *(A + B), *(A - B), *-A], [np.dot(A, B), *np.add(A, B), *np.subtract(A, B), *np.negative(A)]
    )
    np.testing.assert_allclose(matrix(Tensor.dyad(A, B)), (np.outer(A, B) + np.outer(B, A)) / 2)
    both = Tensor.dyad(A, B) + Tensor.diagonal(2.0)
    np.testing.assert_allclose(both.apply(A), matrix(both) @ A)


@pytest.mark.parametrize("axis", [(0, -1, 0), (1, 0, 0), (0.3, -0.8, 0.2)])
def test_rotations_are_those_of_scipy(axis) -> None:
    direction = unit_vector(axis)
    expected = Reference.from_rotvec(0.7 * np.array(direction)).as_matrix()
    turned = Rotation.about(direction, 0.7)
    np.testing.assert_allclose(turned.apply(A), expected @ A, rtol=1e-14)
    twice = turned.then(Rotation.about(Y, -0.4))
    inner = Reference.from_rotvec([0, -0.4, 0]).as_matrix()
    np.testing.assert_allclose(np.array(twice).T, expected @ inner, atol=1e-14)


def test_known_zeros_and_ones_cost_no_operations() -> None:
    def planar(x: float, z: float) -> Vector:
        return IDENTITY.apply(Vector(x, 0.0, z)).cross(Y) + Vector(0.0, 0.0, 0.0)

    program = jax.make_jaxpr(planar)(0.5, 1.5)
    assert [one.primitive.name for one in program.eqns] == ["neg"]
