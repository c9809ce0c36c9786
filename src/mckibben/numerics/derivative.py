"""Derivatives of elementwise functions: what the paper writes out by hand comes from here."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.arrays import floating

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
