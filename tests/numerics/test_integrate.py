import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.numerics.batching import batched_program
from mckibben.numerics.calculus import rk4


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
