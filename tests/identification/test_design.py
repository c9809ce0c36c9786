import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.identification import design_matrix
from mckibben.identification.estimator import tsqr_r
from mckibben.muscle import ChouLaw, ExponentialLaw
from mckibben.units import deg, mm

LINEAR = ["a1", "a2", "b1", "b2", "c1", "c2"]
CONTRACTION = np.linspace(-0.03, 0.25, 23)
PRESSURE = np.linspace(0.0, 6e5, 23)[::-1]


def test_of_eq_2_is_the_basis_written_by_hand():
    decayed = np.exp(-30.0 * CONTRACTION)
    one = np.ones_like(CONTRACTION)
    hand = np.stack([one, PRESSURE, CONTRACTION, CONTRACTION * PRESSURE, decayed, decayed * PRESSURE], axis=1)
    law = ExponentialLaw(1.0, 0.2, 3.0, 0.4, 5.0, 0.6, decay=30.0)
    np.testing.assert_allclose(design_matrix(law, LINEAR, CONTRACTION, PRESSURE), hand, rtol=1e-14)


def test_columns_come_in_the_order_asked_for():
    law = ExponentialLaw(1.0, 0.2, 3.0, 0.4, 5.0, 0.6, decay=30.0)
    some = design_matrix(law, ["c2", "a1"], CONTRACTION, PRESSURE)
    every = design_matrix(law, LINEAR, CONTRACTION, PRESSURE)
    np.testing.assert_array_equal(some, every[:, [5, 0]])
    assert design_matrix(law, [], CONTRACTION, PRESSURE).shape == (23, 0)


@given(angle=st.floats(10.0, 50.0), diameter=st.floats(5.0, 40.0))
def test_of_shape_parameters_agrees_with_finite_differences(angle, diameter):
    def force(angle, diameter):
        return np.asarray(ChouLaw(angle * deg, diameter * mm).force(CONTRACTION, PRESSURE))

    law = ChouLaw(angle * deg, diameter * mm)
    by_angle, by_diameter = design_matrix(law, ["braid_angle", "initial_diameter"], CONTRACTION, PRESSURE).T
    h = 1e-4
    for column, difference in (
        (by_angle, (force(angle + h, diameter) - force(angle - h, diameter)) / (2 * h * deg)),
        (by_diameter, (force(angle, diameter + h) - force(angle, diameter - h)) / (2 * h * mm)),
    ):
        np.testing.assert_allclose(column, difference, atol=1e-6 * np.abs(column).max())


@pytest.mark.parametrize("rows", [6, 1000, 1025, 20_000])
def test_triangle_agrees_with_lapack_up_to_signs(rows):
    matrix = np.random.default_rng(rows).normal(size=(rows, 6))
    r = tsqr_r(matrix)
    expected = np.linalg.qr(matrix, mode="r")
    np.testing.assert_allclose(np.abs(r), np.abs(expected), atol=1e-11)
    np.testing.assert_allclose(tsqr_r(np.asfortranarray(matrix)), r, atol=1e-12)
