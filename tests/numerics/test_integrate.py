import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.numerics.batching import batched_program
from mckibben.numerics.calculus import SEMI_IMPLICIT_LIMIT, rk4, semi_implicit


def pendulum(state):
    angle, velocity = state
    return velocity, -jnp.sin(angle)


@jax.jit
def swing(steps):
    start = (jnp.asarray(1.0), jnp.asarray(0.5))
    return lax.fori_loop(0, steps, lambda _, x: rk4(pendulum, x, 2.0 / steps), start)


@pytest.mark.parametrize("rolled", [False, True])
def test_inputs_known_over_the_step_are_taken_at_its_stages(rolled):
    given = lambda t: (jnp.asarray(5 * t**3 - 2 * t**2 + 1),)  # noqa: E731
    with batched_program(rolled=rolled):
        x = rk4(lambda x, slope: slope + 0 * x, jnp.asarray(0.0), 1.5, (given(0.5), given(1.25), given(2.0)))
    exact = lambda t: 5 / 4 * t**4 - 2 / 3 * t**3 + t  # noqa: E731
    assert float(x) == pytest.approx(exact(2.0) - exact(0.5), rel=1e-14)


def test_halving_the_step_divides_the_error_by_sixteen():
    from scipy.integrate import solve_ivp

    exact = solve_ivp(lambda t, y: [y[1], -np.sin(y[0])], (0, 2), [1.0, 0.5], method="DOP853", rtol=1e-13, atol=1e-14)
    errors = [abs(float(swing(n)[0]) - exact.y[0, -1]) for n in (8, 16, 32, 64)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 4) < 0.25), orders


def test_any_pytree_is_a_state_and_keeps_its_structure_and_precision():
    state = {"a": jnp.float32(1.0), "b": (jnp.float32(2.0), jnp.float32(3.0))}
    moved = rk4(lambda s: jax.tree.map(lambda x: -x, s), state, jnp.float32(0.1))
    assert jax.tree.structure(moved) == jax.tree.structure(state)
    assert {x.dtype for x in jax.tree.leaves(moved)} == {jnp.dtype(jnp.float32)}
    assert float(moved["b"][1]) == pytest.approx(3 * np.exp(-0.1), rel=1e-6)


def relaxing(stiffness):
    """Rate of x towards cos t with a factor k (1 + x^2 / 2), implicit in the x that k multiplies, and of the time t."""

    def rate(state, ahead):
        (x, time), ((begun, _), length) = state, ahead
        factor = stiffness * (1 + x**2 / 2)
        return factor * (jnp.cos(time) - begun) / (1 + length * factor), jnp.ones_like(time)

    return rate


def relaxed(stiffness, steps, start=0.2):
    step = lambda _, state: semi_implicit(relaxing(stiffness), state, 1.0 / steps)  # noqa: E731
    return float(jax.jit(lambda x: lax.fori_loop(0, steps, step, (x, 0.0 * x)))(jnp.asarray(start))[0])


def test_halving_a_semi_implicit_step_divides_the_error_by_eight():
    from scipy.integrate import solve_ivp

    rate = lambda t, x: 3.0 * (1 + x**2 / 2) * (np.cos(t) - x)  # noqa: E731
    exact = solve_ivp(rate, (0, 1), [0.2], method="DOP853", rtol=1e-13, atol=1e-14).y[0, -1]
    errors = [abs(relaxed(3.0, n) - exact) for n in (16, 32, 64, 128)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 3) < 0.25), orders


@pytest.mark.parametrize("steps", [10, 100])
def test_a_semi_implicit_step_is_stable_at_any_stiffness(steps):
    assert relaxed(1e7, steps) == pytest.approx(np.cos(1.0), abs=np.sin(1.0) / steps)  # the change in one step


@pytest.mark.parametrize("rolled", [False, True])
def test_inputs_of_a_semi_implicit_step_are_taken_at_its_stages(rolled):
    given = lambda t: (jnp.asarray(5 * t**3 - 2 * t**2 + 1),)  # noqa: E731
    rate = lambda x, slope, ahead: slope + 0 * x  # noqa: E731
    with batched_program(rolled=rolled):
        x = semi_implicit(rate, jnp.asarray(0.0), 1.5, (given(0.5), given(1.25), given(2.0)))
    exact = lambda t: 5 / 4 * t**4 - 2 / 3 * t**3 + t  # noqa: E731
    assert float(x) == pytest.approx(exact(2.0) - exact(0.5), rel=1e-14)


def test_the_explicit_part_of_a_semi_implicit_step_is_stable_to_its_limit():
    grown = [
        abs(float(semi_implicit(lambda x, ahead: -x, jnp.asarray(1.0), SEMI_IMPLICIT_LIMIT * f)))
        for f in (0.999, 1.001)
    ]
    assert grown[0] < 1 < grown[1]
