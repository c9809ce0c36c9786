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
