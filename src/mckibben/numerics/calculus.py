"""Derivatives of elementwise functions, root finding and fixed-step integration."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Float, PyTree
from numpy.typing import NDArray

from mckibben.numerics.batching import trace_mode
from mckibben.numerics.elementary import floating

Values = TypeVar("Values")


def derivative(function: Callable[[Array], Array], x: ArrayLike) -> Float[Array, "..."]:
    """Derivative of an elementwise function at each element of `x`, exact to rounding (forward mode).

    The result has the shape of ``function(x)``; integers in `x` become floats.
    """
    return value_and_derivative(function, x)[1]


def value_and_derivative(function: Callable[[Array], Values], x: ArrayLike) -> tuple[Values, Values]:
    """`function(x)` and its derivative, from one pass; both have the structure that the function returns.

    >>> value, slope = value_and_derivative(lambda x: x**3, 2.0)
    >>> float(value), float(slope)
    (8.0, 12.0)
    """
    x = floating(x)
    return jax.jvp(function, (x,), (jnp.ones_like(x),))


_BISECTIONS, _NEWTON_STEPS = 24, 4


def bracketed_root(function: Callable[[Array], Array], low: ArrayLike, high: ArrayLike) -> Float[Array, "..."]:
    """Root of a monotone elementwise function between two bounds; NaN where they do not bracket a root.

    24 bisections and four Newton steps with exact derivatives find it to rounding, also next to a pole. Its own
    derivatives, of any order, are those of the implicit function: with f(x, a) = 0, dx/da = -(df/da) / (df/dx).

    Parameters
    ----------
    function
        Rises or falls between the bounds; called with arrays of the shape of the result.
    low, high
        Bounds, of shapes that broadcast with the values of the function.
    """
    low, high = floating(low), floating(high)
    at_low, at_high = function(low), function(high)
    shape = jnp.broadcast_shapes(at_low.shape, at_high.shape)
    low, high = jnp.broadcast_to(low, shape), jnp.broadcast_to(high, shape)
    rising = at_low <= at_high
    exists = jnp.where(rising, (at_low <= 0) & (at_high >= 0), (at_low >= 0) & (at_high <= 0))

    def solve(function: Callable[[Array], Array], start: Array) -> Array:
        def bisect(_: int, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
            low, high = bounds
            middle = (low + high) / 2
            beyond = (function(middle) > 0) == rising
            return jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)

        below, above = lax.fori_loop(0, _BISECTIONS, bisect, (low, high))
        root = (below + above) / 2
        for _ in range(_NEWTON_STEPS):
            value, slope = value_and_derivative(function, root)
            root = root - value / slope
        return root

    # Derivatives of any order are those of the implicit function.
    root = lax.custom_root(function, low, solve, lambda tangent, y: y / tangent(jnp.ones_like(y)))
    return jnp.where(exists, root, jnp.nan)


State = TypeVar("State")

Inputs = tuple[tuple[PyTree, ...], ...]
"""Further arguments of a rate at the beginning, in the middle and at the end of a step."""


def rk4(
    rate: Callable[..., State], state: State, step: ArrayLike, inputs: Inputs = ((), (), ()), *, rolled: bool = False
) -> State:
    """State after one step of the classical Runge-Kutta method, of order 4.

    Parameters
    ----------
    rate
        Time derivative of a state and of the inputs at its time, a pytree like the state.
    state
        Pytree of arrays of any shape; its precision is kept.
    step
        Time step, in the unit of time of the rate.
    inputs
        Further arguments of `rate` at the beginning, in the middle and at the end of the step.
    rolled
        Whether the stages are a loop: a long rate compiles in less time, a short one is faster without.
    """

    def moved(slope: State, length: ArrayLike) -> State:
        return jax.tree.map(lambda x, dx: x + length * dx, state, slope)

    if rolled or trace_mode()[1]:
        kind = jnp.result_type(step)
        places, weights = (jnp.asarray(row, kind) for row in ((0.0, 0.5, 0.5, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)))

        def next_stage(i: Array, carry: tuple[State, State]) -> tuple[State, State]:
            slope, total = carry
            here = jax.tree.map(lambda b, m, e: jnp.where(i == 0, b, jnp.where(i == 3, e, m)), *inputs)
            slope = rate(moved(slope, places[i] * step), *here)
            return slope, jax.tree.map(lambda t, dx: t + weights[i] * step * dx, total, slope)

        return lax.fori_loop(0, 4, next_stage, (jax.tree.map(jnp.zeros_like, state), state))[1]

    # The barrier keeps XLA from computing parts of one stage's derivative again inside the next stage's fusion.
    @functools.partial(jax.jit, inline=True)  # traced once for all stages
    def stage(at: State, inputs: tuple[PyTree, ...]) -> State:
        return lax.optimization_barrier(rate(at, *inputs))

    k1 = stage(state, inputs[0])
    k2 = stage(moved(k1, step / 2), inputs[1])
    k3 = stage(moved(k2, step / 2), inputs[1])
    k4 = stage(moved(k3, step), inputs[2])
    return jax.tree.map(lambda x, a, b, c, d: x + step / 6 * (a + 2 * (b + c) + d), state, k1, k2, k3, k4)


def evenly_spaced(count: int, most: int) -> NDArray[np.int_]:
    """Indices of at most `most` of `count` samples, in equal distances from the first to the last.

    Examples
    --------
    >>> evenly_spaced(11, 3), evenly_spaced(3, 11), evenly_spaced(1, 4)
    (array([ 0,  5, 10]), array([0, 1, 2]), array([0]))
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
