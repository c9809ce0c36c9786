"""Roots of increasing functions, elementwise, compiled, and differentiable in what the function holds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from mckibben.numerics.calculus import bracketed_root


def cubic(x, shift, power=3.0):
    return jnp.sign(x) * jnp.abs(x) ** power + x - shift


def test_it_is_brents_root():
    shifts = np.array([-7.0, 0.0, 1e-6, 3.0, 900.0])
    found = jax.jit(lambda s: bracketed_root(lambda x: cubic(x, s), -10.0, 10.0))(shifts)
    wanted = [brentq(lambda x, s=s: float(x**3 + x - s), -10, 10, xtol=1e-14) for s in shifts]
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-13)


def test_a_pole_at_the_end_is_no_obstacle():
    found = bracketed_root(lambda x: jnp.tan(x) - 1e6, 0.0, np.pi / 2 - 1e-9)
    assert float(found) == pytest.approx(np.arctan(1e6), rel=1e-15)


def test_none_is_nan_and_others_are_not_touched():
    found = bracketed_root(lambda x: x - jnp.array([0.5, 2.0, -3.0]), 0.0, 1.0)
    np.testing.assert_array_equal(np.isnan(found), [False, True, True])


@pytest.mark.slow
def test_its_first_and_second_derivatives_are_those_of_the_implicit_function():
    def root(s):
        return bracketed_root(lambda x: cubic(x, s), -10.0, 10.0)

    x = float(jax.jit(root)(3.0))
    for derivative in (jax.jacfwd(root), jax.grad(root)):
        assert float(jax.jit(derivative)(3.0)) == pytest.approx(1 / (3 * x**2 + 1), rel=1e-13)
    for second in (jax.jacfwd(jax.jacfwd(root)), jax.grad(jax.grad(root))):
        assert float(jax.jit(second)(3.0)) == pytest.approx(-6 * x / (3 * x**2 + 1) ** 3, rel=1e-12)
