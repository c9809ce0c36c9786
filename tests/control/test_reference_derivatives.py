"""Derivatives of a reference from its samples: sines, steps, kinks, and rounding."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.control.reference import ReferenceDerivatives

PERIOD = 1e-3


@jax.jit
def derived(samples, period):
    """Velocity, acceleration, jerk and the acceleration 10 ms ahead, at each sample."""

    def one(derivatives, angle):
        derivatives = derivatives.update(angle, period)
        return derivatives, (
            derivatives.velocity,
            derivatives.acceleration,
            derivatives.jerk,
            derivatives.acceleration_after(10 * period, period),
        )

    return lax.scan(one, ReferenceDerivatives.init(samples[0]), samples)[1]


@pytest.mark.parametrize(("kind", "slack"), [(np.float64, 0.05), (np.float32, 0.5)])
def test_a_sine_is_known_with_its_derivatives_and_ahead(kind, slack):
    w, a, times = 2 * np.pi, 0.2, PERIOD * np.arange(1000)
    velocity, acceleration, _, ahead = derived(jnp.asarray(a * np.sin(w * times), kind), jnp.asarray(PERIOD, kind))
    late = slice(20, None)
    assert velocity.dtype == kind
    np.testing.assert_allclose(velocity[late], (a * w * np.cos(w * times))[late], atol=0.006)
    np.testing.assert_allclose(acceleration[late], (-a * w**2 * np.sin(w * times))[late], atol=0.06 + slack / 2)
    np.testing.assert_allclose(ahead[late], (-a * w**2 * np.sin(w * (times + 0.01)))[late], atol=0.1 + slack)


def test_a_step_is_no_motion():
    times = PERIOD * np.arange(200)
    velocity, acceleration, jerk, _ = derived(jnp.asarray(0.1 * times + 0.2 * (times > 0.1)), PERIOD)
    np.testing.assert_allclose(velocity[2:], 0.1, rtol=1e-9)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-6)
    np.testing.assert_allclose(jerk, 0.0, atol=1e-3)


def test_a_kink_changes_the_velocity_one_sample_later():
    times = PERIOD * np.arange(200)
    velocity, acceleration, *_ = derived(jnp.asarray(3.0 * np.abs(times - 0.1)), PERIOD)
    np.testing.assert_allclose(velocity[2:101], -3.0, rtol=1e-9)
    np.testing.assert_allclose(velocity[103:], 3.0, rtol=1e-9)
    np.testing.assert_allclose(acceleration, 0.0, atol=1e-6)


def test_the_first_sample_is_no_motion_either():
    start = ReferenceDerivatives.init(0.0).update(0.3, PERIOD)
    assert float(start.velocity) == float(start.acceleration) == 0.0
    moving = start.update(0.301, PERIOD)
    assert (float(moving.velocity), float(moving.acceleration)) == (pytest.approx(1.0), 0.0)
