"""Where an increasing function takes a value: for laws whose inverse has no closed form."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.arrays import floating
from mckibben.numerics.derivative import value_and_derivative

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
