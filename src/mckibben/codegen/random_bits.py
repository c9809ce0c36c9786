"""Random numbers of JAX's keys: Threefry-2x32 (Salmon et al. 2011) on words of 32 bits."""

from __future__ import annotations

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, UInt, UInt32

MASK = 0xFFFFFFFF
"""Largest word."""
_PARITY = 0x1BD11BDA
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def seed_key(seed: Int[Array, ""]) -> UInt32[Array, "2"]:
    """Key of an integer seed: its high and its low word."""
    return jnp.stack([seed >> 32, seed]).astype(jnp.uint32)


def fold_in(key: UInt32[Array, "2"], word: UInt32[Array, ""]) -> UInt32[Array, "2"]:
    """Key derived from a key and a word."""
    return jnp.stack(threefry(key, jnp.uint32(0), word))


def random_bits(key: UInt32[Array, "2"], *, bit_width: int, shape: tuple[int, ...]) -> UInt[Array, "..."]:
    """Random words of 32 or 64 bits, each from the key and its index in the array.

    Examples
    --------
    >>> key = jax.random.key(7)
    >>> drawn = random_bits(jax.random.key_data(key), bit_width=64, shape=(3,))
    >>> bool(jnp.all(drawn == jax.random.bits(key, (3,), "uint64")))
    True
    """
    index = np.arange(math.prod(shape)).reshape(shape)
    high, low = threefry(key, jnp.uint32(index >> 32), jnp.uint32(index & MASK))
    return high.astype(jnp.uint64) << 32 | low if bit_width == 64 else high ^ low


def threefry(key: UInt32[Array, "2"], high: Array, low: Array) -> tuple[Array, Array]:
    """Two words from a key and the words of a counter, which may be arrays."""
    keys = key[0], key[1], key[0] ^ key[1] ^ jnp.uint32(_PARITY)
    x, y = high + keys[0], low + keys[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            x = x + y
            y = x ^ (y << rotation | y >> (32 - rotation))
        x, y = x + keys[(group + 1) % 3], y + keys[(group + 2) % 3] + jnp.uint32(group + 1)
    return x, y


def is_supported() -> bool:
    """Whether JAX draws its bits in the same way as `random_bits`."""
    return bool(jax.config.jax_threefry_partitionable)  # type: ignore[attr-defined]


RULES: dict[str, Callable[..., Array]] = {
    "random_seed": seed_key,
    "random_fold_in": fold_in,
    "random_bits": random_bits,
}
"""Primitives of JAX as functions of keys of two words."""
