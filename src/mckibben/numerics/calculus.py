"""Derivatives of elementwise functions, root finding and fixed-step integration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.batching import rolled
from mckibben.numerics.elementary import floating

Values = TypeVar("Values")


def derivative(function: Callable[[Array], Array], x: ArrayLike) -> Float[Array, "..."]:
    """The derivative of an elementwise function at each element of `x`, exact to rounding (forward mode).

    >>> float(derivative(lambda x: x**3, 2.0))
    12.0
    """
    return value_and_derivative(function, x)[1]


def value_and_derivative(function: Callable[[Array], Values], x: ArrayLike) -> tuple[Values, Values]:
    """`function(x)` and its derivative, from one pass.

    Where `function` broadcasts `x` against something larger, so do both answers; where it returns several arrays, both
    answers have that structure.
    """
    x = floating(x)
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


_HALVINGS = 24
_NEWTON_STEPS = 4


def increasing_root(function: Callable[[Array], Array], low: ArrayLike, high: ArrayLike) -> Float[Array, "..."]:
    """The zero between two bounds of a function that increases, elementwise; NaN where there is none.

    Halving finds it wherever the function increases; Newton's steps take it to rounding, and their last makes the
    answer differentiable with respect to whatever the function holds.

    Parameters
    ----------
    function
        Elementwise, and increasing between the bounds; the bounds broadcast against what it holds.
    low, high
        The bounds.

    Examples
    --------
    >>> float(increasing_root(lambda x: x**3 - 8.0, 0.0, 10.0))
    2.0
    >>> float(increasing_root(lambda x: x**3 + 8.0, 0.0, 10.0))
    nan
    """
    low, high = floating(low), floating(high)
    shape = jnp.broadcast_shapes(function(low).shape, function(high).shape)
    low, high = jnp.broadcast_to(low, shape), jnp.broadcast_to(high, shape)
    exists = (function(low) <= 0) & (function(high) >= 0)

    def halve(_: int, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) / 2
        above = function(middle) > 0
        return jnp.where(above, low, middle), jnp.where(above, middle, high)

    low, high = lax.stop_gradient(lax.fori_loop(0, _HALVINGS, halve, (low, high)))
    found = (low + high) / 2
    for _ in range(_NEWTON_STEPS):
        value, slope = value_and_derivative(function, lax.stop_gradient(found))
        found = lax.stop_gradient(found) - value / lax.stop_gradient(slope)
    return jnp.where(exists, found, jnp.nan)


State = TypeVar("State")


def rk4(
    rate: Callable[..., State], state: State, step: ArrayLike, inputs: tuple[tuple[Any, ...], ...] = ((), (), ())
) -> State:
    """One step of the classical fourth-order Runge-Kutta method.

    In a program for many runs side by side (`mckibben.numerics.batching`) its stages are a loop; results differ by
    rounding.

    Parameters
    ----------
    rate
        The state's derivative with respect to time; same structure as the state.
    state
        Any pytree. Leave it a tuple of scalars: stacking it into a vector is slower on every device.
    step
        The length of the step [s].
    inputs
        What `rate` takes beside the state, at the beginning, the middle and the end of the step.

    Examples
    --------
    >>> import jax.numpy as jnp
    >>> float(rk4(lambda x: -x, jnp.asarray(1.0), 0.1))  # exp(-0.1) = 0.904837418...
    0.9048375
    """

    def moved(slope: State, length: ArrayLike) -> State:
        return jax.tree.map(lambda x, dx: x + length * dx, state, slope)

    if rolled():
        kind = jnp.result_type(step)
        places, weights = (jnp.asarray(row, kind) for row in ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)))

        def next_stage(i: Array, carry: tuple[State, State]) -> tuple[State, State]:
            slope, total = carry
            here = jax.tree.map(lambda b, m, e: jnp.where(i == 0, b, jnp.where(i == 3, e, m)), *inputs)
            slope = rate(moved(slope, places[i] * step), *here)
            return slope, jax.tree.map(lambda t, dx: t + weights[i] * step * dx, total, slope)

        return lax.fori_loop(0, 4, next_stage, (jax.tree.map(jnp.zeros_like, state), state))[1]

    # The barrier keeps XLA from computing parts of one stage's derivative again inside the next stage's fusion.
    def stage(at: State, given: tuple[Any, ...]) -> State:
        return lax.optimization_barrier(rate(at, *given))

    beginning, middle, end = inputs
    k1 = stage(state, beginning)
    k2 = stage(moved(k1, step / 2), middle)
    k3 = stage(moved(k2, step / 2), middle)
    k4 = stage(moved(k3, step), end)
    return jax.tree.map(lambda x, a, b, c, d: x + step / 6 * (a + 2 * (b + c) + d), state, k1, k2, k3, k4)
