"""Compile once for a structure, not for each number in it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp

from mckibben.numerics.runtime import batch_options

P = ParamSpec("P")
R = TypeVar("R")


def numeric(tree: Any) -> Any:
    """Python numbers among a tree's leaves as arrays; everything else as it is."""

    def convert(leaf: Any) -> Any:
        if isinstance(leaf, float):
            return jnp.asarray(leaf, float)
        if isinstance(leaf, int) and not isinstance(leaf, bool):
            return jnp.asarray(leaf)
        return leaf

    return jax.tree.map(convert, tree)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Like `equinox.filter_jit`, but Python numbers among the arguments are traced: a new value compiles nothing.

    Numbers that shape the program (counts, flags) have to be static fields, or bound beforehand.
    """
    traced = eqx.filter_jit(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        args, kwargs = numeric((args, kwargs))
        return traced(*args, **kwargs)

    return call


def compiled_batch(function: Callable[P, R]) -> Callable[P, R]:
    """`equinox.filter_jit` for functions over many lanes, with the options that suit the processor.

    Arrays are traced, everything else is static; pass trees through `numeric` first.
    """

    @functools.cache
    def traced() -> Callable[P, R]:  # not before the first call: the options depend on the device
        return eqx.filter_jit(function, compiler_options=batch_options() or None)  # type: ignore[call-overload]

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return traced()(*args, **kwargs)

    return call
