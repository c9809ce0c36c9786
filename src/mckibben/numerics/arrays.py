"""Arrays as the core wants them."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


def floating(x: ArrayLike) -> Float[Array, "..."]:
    """As an array of floats, in the precision that it has; integers get the default precision.

    >>> floating(3).dtype
    dtype('float64')
    """
    x = jnp.asarray(x)
    return x if jnp.issubdtype(x.dtype, jnp.floating) else x.astype(jnp.result_type(float))
