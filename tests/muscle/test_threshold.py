"""A law with a pressure threshold: the pressure that it sees, its inverse, its smoothness, in C and in a joint."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.muscle import ThresholdLaw
from mckibben.units import bar

PRESSURE = np.linspace(0, 6, 61) * bar


@pytest.fixture(scope="module")
def late(law):
    return ThresholdLaw(law=law, threshold=0.4 * bar)


def test_the_law_sees_nothing_below_the_threshold_and_the_rest_above(late, law):
    """The hyperbola with the asymptotes 0 and p - pt: (p_e - (p - pt)) p_e = (s pt)^2 / 4."""
    seen = np.asarray(late.effective_pressure(PRESSURE))
    np.testing.assert_allclose((seen - (PRESSURE - 0.4 * bar)) * seen, (0.2 * 0.4 * bar) ** 2 / 4, rtol=1e-9)
    assert 0 < seen[0] < 0.012 * 0.4 * bar and seen[-1] - 5.6 * bar < 0.001 * bar
    np.testing.assert_allclose(late.force(0.05, PRESSURE), law.force(0.05, seen), rtol=1e-12)
    assert late.domain.pressure_min == law.domain.pressure_min == 0
    assert late.effective_pressure(late.domain.pressure_max) == pytest.approx(law.domain.pressure_max, rel=1e-9)
    assert late.domain.contraction_max == law.domain.contraction_max


def test_pressure_for_inverts_the_force_and_is_nan_below_the_force_at_vacuum(late, law):
    for contraction in (-0.02, 0.05, 0.2):
        back = late.pressure_for(late.force(contraction, PRESSURE), contraction)
        np.testing.assert_allclose(back, PRESSURE, atol=1e-6 * bar)
        assert np.isnan(late.pressure_for(float(law.force(contraction, 0.0)) - 1.0, contraction))


def test_its_derivative_is_continuous_and_rises_from_zero_to_that_of_the_law(late, law):
    slope = jax.vmap(jax.grad(lambda p: late.force(0.02, p)))(jnp.asarray(PRESSURE))
    whole = float(jax.grad(lambda p: law.force(0.02, p))(3e5))
    assert np.all(np.diff(slope) > 0) and slope[0] < 0.02 * whole and slope[-1] == pytest.approx(whole, rel=1e-3)
