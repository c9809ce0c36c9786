import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.numerics.calculus import derivative


@pytest.mark.parametrize("x", [0.7, [0.1, 0.2, 0.3], [[0.1], [0.9]]])
def test_it_is_the_derivative_at_every_element_in_the_arguments_shape(x):
    x = np.asarray(x)
    got = derivative(lambda v: jnp.sin(v) * v**2, x)
    assert got.shape == x.shape
    np.testing.assert_allclose(got, np.cos(x) * x**2 + 2 * x * np.sin(x), rtol=1e-14)


def test_it_nests():
    assert float(derivative(lambda v: derivative(lambda w: w**4, v), 2.0)) == pytest.approx(48.0, rel=1e-15)


def test_whole_numbers_are_taken_as_floats():
    assert float(derivative(lambda v: v**3, 2)) == 12.0
    np.testing.assert_allclose(derivative(lambda v: v**3, np.array([1, 2])), [3.0, 12.0])


def test_single_precision_stays_single():
    assert derivative(lambda v: v**3, jnp.float32(2.0)).dtype == jnp.float32
