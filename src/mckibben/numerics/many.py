"""How a program for many runs side by side is written differently from one for a single run.

XLA on the CPU computes every array of a program in a loop of its own over the runs, and whatever cheap things lead to
it once more: a sine that ten arrays need is computed ten times. A loop or a branch in the program is a place that it
does not look across. In a single run, where all is scalar, such places only cost time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import ArrayLike

R = TypeVar("R")

_APART: ContextVar[bool] = ContextVar("pieces apart", default=False)
_ROLLED: ContextVar[bool] = ContextVar("stages in a loop", default=False)


@contextmanager
def many_runs(*, rolled: bool = True) -> Iterator[None]:
    """What is traced inside is for many runs side by side; or, not `rolled`, for one with derivatives beside it."""
    tokens = _APART.set(True), _ROLLED.set(rolled)
    try:
        yield
    finally:
        _APART.reset(tokens[0])
        _ROLLED.reset(tokens[1])


def traced_for() -> tuple[bool, bool]:
    """What makes the same function another program: whether pieces are kept apart, and stages a loop."""
    return _APART.get(), _ROLLED.get()


def rolled() -> bool:
    """Whether the stages of an integration step shall be a loop."""
    return _ROLLED.get()


def apart(function: Callable[..., R], *args: object, witness: ArrayLike) -> R:
    """`function(*args)`, where it is for many runs in a branch of its own, so that it is computed once.

    Parameters
    ----------
    function
        Pure; its answers are arrays.
    args
        Its arguments.
    witness
        A positive number, the same for all runs, that the compiler cannot know: without it there would be no branch.

    Examples
    --------
    >>> with many_runs():
    ...     float(apart(lambda x: 2 * x, jnp.asarray(3.0), witness=0.001))
    6.0
    """
    if not _APART.get():
        return function(*args)
    shapes = jax.eval_shape(function, *args)
    nothing = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), shapes)
    return lax.cond(jnp.asarray(witness) > 0, lambda *given: function(*given), lambda *_: nothing, *args)
