"""Compile once for a structure, not for each number in it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np

from mckibben.numerics.program_cache import KeptProgram
from mckibben.numerics.runtime import batch_options

P = ParamSpec("P")
R = TypeVar("R")


def numeric(tree: Any) -> Any:
    """Python and NumPy numbers among a tree's leaves as arrays; everything else as it is.

    They are NumPy's: JAX's own would each be put on the device on the way, which a command has to wait for.
    """

    def convert(leaf: Any) -> Any:
        if isinstance(leaf, Integral) and not isinstance(leaf, bool):
            return np.asarray(leaf)
        if isinstance(leaf, Real) and not isinstance(leaf, bool):
            return np.asarray(leaf, float)
        return leaf

    return jax.tree.map(convert, tree)


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Like `equinox.filter_jit`, but Python numbers among the arguments are traced: a new value compiles nothing.

    Numbers that shape the program (counts, flags) have to be static fields, or bound beforehand; answers are arrays.
    """
    program = KeptProgram(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        args, kwargs = numeric((args, kwargs))
        return program(*args, **kwargs)

    return call


def compiled_as_given(function: Callable[P, R]) -> Callable[P, R]:
    """The same, but arrays alone are traced, and everything else is static; pass trees through `numeric` first."""
    program = KeptProgram(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return program(*args, **kwargs)

    return call


def compiled_batch(function: Callable[P, R]) -> Callable[P, R]:
    """`compiled_as_given` for functions over many lanes, with the options that suit the processor."""
    program = KeptProgram(function, batch_options)  # not before the first call: they depend on the device

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return program(*args, **kwargs)

    return call
