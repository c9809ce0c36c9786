import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.numerics import elementary

FORMS = {"eager": lambda f: f, "compiled": jax.jit, "vmapped and compiled": lambda f: jax.jit(jax.vmap(f))}
TYPES = [np.float64, np.float32]


def samples(dtype, low, high, count=20001):
    near = np.random.default_rng(1).uniform(-1, 1, 2000)
    return np.concatenate([np.linspace(low, high, count), near, [0.0]]).astype(dtype)


def ulps(got, exact, dtype):
    """Error in units of the last place of the exact value."""
    spacing = np.spacing(np.abs(exact).astype(dtype)).astype(np.longdouble)
    return np.max(np.abs(np.asarray(got).astype(np.longdouble) - exact) / spacing)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dtype", TYPES)
def test_exp_is_within_about_one_ulp_over_its_whole_range(form, dtype):
    x = samples(dtype, *((-708, 709.7) if dtype is np.float64 else (-86.8, 88.7)))
    got = FORMS[form](elementary.exp)(jnp.asarray(x))
    assert got.dtype == dtype
    assert ulps(got, np.exp(x.astype(np.longdouble)), dtype) < 1.25


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("reach", [1.0, 30.0, 1e3, 1e5])
@pytest.mark.parametrize("dtype", TYPES)
def test_sin_and_cos_are_within_an_ulp_of_one_and_lose_at_most_a_digit_up_to_1e5(form, reach, dtype):
    x = samples(dtype, -reach, reach)
    sine, cosine = FORMS[form](elementary.sincos)(jnp.asarray(x))
    far = {np.float64: 3e-16, np.float32: 1.3e-6}[dtype]
    wide, most = x.astype(np.longdouble), far if reach > 1e3 else np.finfo(dtype).eps
    assert sine.dtype == cosine.dtype == dtype
    assert np.max(np.abs(np.asarray(sine) - np.sin(wide))) < most
    assert np.max(np.abs(np.asarray(cosine) - np.cos(wide))) < most


@pytest.mark.parametrize("form", FORMS)
def test_sine_keeps_its_relative_accuracy_around_the_multiples_of_pi(form):
    x = (np.arange(-40, 41) * np.pi)[:, None] + np.array([0.0, 1e-7, -1e-3])
    got = FORMS[form](elementary.sin)(jnp.asarray(x.ravel()))
    exact = np.sin(x.ravel().astype(np.longdouble))
    assert np.max(np.abs(np.asarray(got) - exact)) < 2e-16
    small = np.abs(exact) < 1e-8
    assert np.allclose(np.asarray(got)[small], exact[small].astype(float), rtol=1e-4, atol=1e-33)


@pytest.mark.parametrize(("dtype", "low", "high"), [(np.float64, -708.0, 709.79), (np.float32, -86.9, 88.73)])
def test_exp_is_zero_below_its_range_and_infinite_above(dtype, low, high):
    x = np.array([1.001 * low, 1.2 * low, 1.9 * low, 1e4 * low, high, 1.2 * high, 1.9 * high, 1e4 * high], dtype)
    np.testing.assert_array_equal(elementary.exp(jnp.asarray(x)), [0.0] * 4 + [np.inf] * 4)


@pytest.mark.parametrize("form", ["eager", "compiled"])
def test_special_values_are_those_of_numpy(form):
    x = jnp.array([0.0, -0.0, jnp.inf, -jnp.inf, jnp.nan, 710.0, -1000.0, 1e300, -1e300])
    got = FORMS[form](elementary.exp)(x)
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(got, np.exp(np.asarray(x)))
    sine, cosine = FORMS[form](elementary.sincos)(x[:5])
    np.testing.assert_array_equal(sine, [0.0, -0.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(cosine, [1.0, 1.0, np.nan, np.nan, np.nan])


ORDERS = {1: jax.grad, 2: lambda f: jax.grad(jax.grad(f)), 3: lambda f: jax.jacfwd(jax.jacrev(jax.grad(f)))}


@pytest.mark.slow
@pytest.mark.parametrize("order", ORDERS)
def test_derivatives_are_those_of_jax(order):
    x, differentiate = jnp.linspace(-6.0, 6.0, 41), ORDERS[order]
    ours = lambda v: elementary.exp(v) + 3 * elementary.sin(v) * elementary.cos(2 * v)  # noqa: E731
    theirs = lambda v: jnp.exp(v) + 3 * jnp.sin(v) * jnp.cos(2 * v)  # noqa: E731
    exact = jax.jit(jax.vmap(differentiate(theirs)))(x)
    np.testing.assert_allclose(jax.jit(jax.vmap(differentiate(ours)))(x), exact, rtol=1e-13, atol=1e-13)
    np.testing.assert_allclose(differentiate(ours)(x[7]), exact[7], rtol=1e-13, atol=1e-13)


def test_whole_numbers_are_taken_as_floats():
    assert float(elementary.exp(1)) == pytest.approx(np.e, rel=1e-15)
    assert elementary.exp(jnp.arange(3)).dtype == jnp.float64


def test_other_precisions_are_refused_by_name():
    with pytest.raises(TypeError, match="float16"):
        elementary.exp(jnp.float16(1.0))
