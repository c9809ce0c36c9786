"""Batches of runs as lanes of one program."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import ArrayLike

from mckibben.errors import ParameterError

Tree = TypeVar("Tree")
R = TypeVar("R")
P = ParamSpec("P")

RANK = "rank"
"""Metadata of a field that holds arrays by nature, such as samples over time: their number of axes."""


def lanes_of(tree: Any, name: str = "") -> tuple[int | None, Any]:
    """How many lanes a tree has, and which of its leaves vary over them.

    A leaf varies if it has one axis more than it would have in a single run; that axis comes first.

    Parameters
    ----------
    tree
        Of modules, tuples and arrays.
    name
        What the tree is called, for messages.

    Returns
    -------
    count, varying
        The number of lanes, None if no leaf varies; and a tree of flags, for `equinox.partition`.

    Raises
    ------
    ParameterError
        If leaves vary over different numbers of lanes, or over none, or have two axes too many.
    """
    count, first, flags = None, "", []
    leaves, structure = jax.tree.flatten(tree)
    if not any(np.ndim(leaf) for leaf in leaves if eqx.is_array_like(leaf)):
        return None, jax.tree.unflatten(structure, [False] * len(leaves))
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        axes = np.ndim(leaf) if eqx.is_array_like(leaf) else 0
        if axes == 0:
            flags.append(False)
            continue
        extra = axes - _rank(tree, path)
        where = ".".join(part for part in (name, jax.tree_util.keystr(path, simple=True, separator=".")) if part)
        if extra not in (0, 1):
            raise ParameterError(
                f"{where} has the shape {np.shape(leaf)}", remedy="give a number, or an array of one axis over the runs"
            )
        flags.append(extra == 1)
        if extra == 1:
            size = np.shape(leaf)[0]
            if size == 0:
                raise ParameterError(f"{where} holds no value", remedy="give one a run")
            if count is not None and size != count:
                raise ParameterError(f"{where} has {size} values, {first} has {count}", remedy="give one of each a run")
            count, first = size, where
    return count, jax.tree_util.tree_unflatten(structure, flags)


def with_leaves(trees: Mapping[str, Any], values: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """The same trees with other values at some leaves, addressed by dotted names such as ``plant.load.mass2``.

    Raises
    ------
    ParameterError
        If there is no such leaf; the nearest name is suggested. If a value is no number, or no whole one where the leaf
        is one by nature.
    """
    if not values:
        return dict(trees)
    known = leaves_named(trees, list(values))
    return replaced(trees, {name: _numbers(trees, name, known[name], value) for name, value in values.items()})


def _numbers(trees: Mapping[str, Any], name: str, leaf: Any, value: ArrayLike) -> np.ndarray:
    """Values of a leaf as an array, of the kind that it takes."""
    try:
        given = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # rows of different lengths, or nothing that NumPy can hold
        given = np.asarray(None)
    whole = jnp.issubdtype(given.dtype, jnp.integer)
    if not (whole or jnp.issubdtype(given.dtype, jnp.floating)):
        raise ParameterError(
            f"the values of {name} are no numbers", value=value, remedy="give one, or an array of one a run"
        )
    if not whole and _is_whole(trees, name):
        raise ParameterError(f"{name} is a whole number", value=value, remedy="give integers")
    keeps = whole and jnp.issubdtype(np.asarray(leaf).dtype, jnp.integer)
    return given if keeps else given.astype(float)


def _is_whole(trees: Mapping[str, Any], name: str) -> bool:
    """Whether a leaf is a whole number by nature, such as a seed, and not a float that was written without a point."""
    root, *steps = name.split(".")
    owner = _descend(trees[root], tuple(steps[:-1])) if steps else trees
    kind = getattr(type(owner), "__annotations__", {}).get(steps[-1] if steps else root, "")
    fields = {field.name: field.type for field in dataclasses.fields(owner)} if dataclasses.is_dataclass(owner) else {}
    kind = fields.get(steps[-1] if steps else root, kind)
    return kind is int or str(kind).startswith("int ") or kind == "int"


def leaves_named(trees: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """The leaves of dotted names; raises as `with_leaves` does."""
    known = by_name(trees)
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, 1, cutoff=0.5)
            remedy = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(known)}"
            raise ParameterError(f"there is no parameter {name!r}", value=name, remedy=remedy)
    return {name: known[name] for name in names}


def by_name(trees: Mapping[str, Any]) -> dict[str, Any]:
    """All leaves that are numbers or arrays, by their dotted names."""
    found = {}
    for root, tree in trees.items():
        leaves, structure = jax.tree.flatten(tree)
        for name, leaf in zip(_names(structure), leaves, strict=True):
            if eqx.is_array_like(leaf) and not isinstance(leaf, bool):
                found[f"{root}.{name}"] = leaf
    return found


@functools.lru_cache(maxsize=256)
def _names(structure: Any) -> tuple[str, ...]:
    """The dotted names of the leaves of a structure."""
    tree = jax.tree.unflatten(structure, range(structure.num_leaves))
    paths = jax.tree_util.tree_leaves_with_path(tree)
    return tuple(jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in paths)


def replaced(trees: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The same trees with other values at leaves that exist."""
    changed = dict(trees)
    for name, value in values.items():
        root, *steps = name.split(".")
        changed[root] = eqx.tree_at(lambda tree, steps=tuple(steps): _descend(tree, steps), changed[root], value)
    return changed


def check_again(tree: Any) -> None:
    """Let every module of a tree check its numbers, as it did when it was made."""
    for node in jax.tree.leaves(tree, is_leaf=lambda x: isinstance(x, eqx.Module)):
        if isinstance(node, eqx.Module):
            if check := getattr(node, "__check_init__", None):
                check()
            check_again([getattr(node, field.name) for field in dataclasses.fields(node)])


def cast(tree: Tree, kind: Any) -> Tree:
    """The same tree with all its floats of one type, as arrays."""

    def convert(leaf: Any) -> Any:
        return jnp.asarray(leaf, kind) if isinstance(leaf, float) or eqx.is_inexact_array(leaf) else leaf

    return jax.tree.map(convert, tree)


def padded(tree: Tree, chunk: slice, size: int) -> Tree:
    """A piece of every leaf, filled up to a size with its last lane: programs are compiled for one size."""

    def piece(leaf: Any) -> Any:
        part = np.asarray(leaf[chunk])
        return np.concatenate([part, np.repeat(part[-1:], size - len(part), axis=0)]) if len(part) < size else part

    return jax.tree.map(piece, tree)


def worked_off(
    call: Callable[[slice], R], count: int, size: int, workers: int | None = None
) -> Iterator[tuple[slice, R]]:
    """Call a function on pieces of so many lanes, several at once, and yield their answers in order.

    JAX lets go of the interpreter's lock while it computes, so threads keep all cores busy; no piece waits for the
    slowest of a round. At most two pieces a worker are under way, so memory does not grow with the count.
    """
    workers = workers or cores()
    pieces = iter([slice(start, min(start + size, count)) for start in range(0, count, size)])
    waiting: deque[tuple[slice, Future[R]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            while True:
                for piece in pieces:
                    waiting.append((piece, pool.submit(call, piece)))
                    if len(waiting) >= 2 * workers:
                        break
                if not waiting:
                    return
                piece, future = waiting.popleft()
                yield piece, future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def cores() -> int:
    """The processor cores that this process may use; 1 where an accelerator does the work."""
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _rank(tree: Any, path: tuple[Any, ...]) -> int:
    """The number of axes of a leaf in a single run."""
    *owners, last = path
    for step in owners:
        tree = (
            getattr(tree, step.name) if hasattr(step, "name") else tree[step.key if hasattr(step, "key") else step.idx]
        )
    if not (hasattr(last, "name") and dataclasses.is_dataclass(tree)):
        return 0
    field = next(f for f in dataclasses.fields(tree) if f.name == last.name)
    return field.metadata.get(RANK, 0)


def _descend(tree: Any, steps: tuple[str, ...]) -> Any:
    for step in steps:
        tree = tree[int(step)] if step.isdigit() else getattr(tree, step)
    return tree


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


def compute_once(function: Callable[..., R], *args: object) -> R:
    """`function(*args)`; in a program for many runs in a branch, so that XLA does not repeat it in each use.

    The function is pure and its results are arrays. A constant behind a barrier is the condition, so that XLA cannot
    remove the branch.

    Examples
    --------
    >>> with many_runs():
    ...     float(compute_once(lambda x: 2 * x, jnp.asarray(3.0)))
    6.0
    """
    if not _APART.get():
        return function(*args)

    def call() -> R:
        token = _APART.set(False)  # one branch is enough
        try:
            return function(*args)
        finally:
            _APART.reset(token)

    zeros = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), jax.eval_shape(call))
    return lax.cond(lax.optimization_barrier(jnp.asarray(1.0)) > 0, call, lambda: zeros)


def computed_once(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator for functions and methods that are always called by `compute_once`."""

    @functools.wraps(function)
    def once(*args: P.args, **kwargs: P.kwargs) -> R:
        return compute_once(lambda: function(*args, **kwargs))

    return once


def apart(function: Callable[..., R], *args: object, witness: ArrayLike) -> R:
    """Former name of `compute_once`."""
    return compute_once(function, *args)
