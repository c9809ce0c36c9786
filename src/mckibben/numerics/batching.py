"""Leaves of a tree by name, lanes of a batch, and batched programs."""

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
from typing import ParamSpec, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.tree_util import PyTreeDef
from jax.typing import DTypeLike
from jaxtyping import ArrayLike, PyTree

from mckibben.errors import ParameterError

_UNNAMED = "plant"
"""Tree whose name is left out of the names of its leaves."""

Tree = TypeVar("Tree")
R = TypeVar("R")
P = ParamSpec("P")

RANK = "rank"
"""Metadata key of a field that holds arrays in a single run, such as samples over time: their number of axes."""


def lanes_of(tree: PyTree) -> tuple[int | None, PyTree]:
    """Number of lanes of a tree (None if no leaf varies), and flags of its varying leaves, which have an extra axis.

    A leaf is a number in a single run, unless its field has a `RANK`; in a batch it is a number, shared by all runs, or
    an array of shape (lanes, ...). Raises `ParameterError` for other shapes, empty arrays and different numbers of
    lanes; the message names the leaves.
    """
    count, first, flags = None, "", []
    leaves, structure = jax.tree.flatten(tree)
    if not any(getattr(leaf, "ndim", 0) for leaf in leaves):
        return None, jax.tree.unflatten(structure, [False] * len(leaves))
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        axes = np.ndim(leaf) if eqx.is_array_like(leaf) else 0
        if axes == 0:
            flags.append(False)
            continue
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        field, where = _field(tree, tuple(name.split("."))), name.removeprefix(f"{_UNNAMED}.")
        extra = axes - (0 if field is None else field.metadata.get(RANK, 0))
        if extra not in (0, 1):
            raise ParameterError(
                f"{where} has the shape {np.shape(leaf)}",
                remedy="give a number, or a one-dimensional array with one value per run",
            )
        flags.append(extra == 1)
        if extra == 1:
            size = np.shape(leaf)[0]
            if size == 0:
                raise ParameterError(f"{where} is empty", remedy="give one value per run")
            if count is not None and size != count:
                raise ParameterError(f"{where} has {size} values, {first} has {count}", remedy="give as many")
            count, first = size, where
    return count, jax.tree_util.tree_unflatten(structure, flags)


def with_leaves(trees: Mapping[str, PyTree], values: Mapping[str, ArrayLike]) -> dict[str, PyTree]:
    """Trees with new, checked values at leaves by dotted names; ``joint.muscle.strength`` is that of both muscles.

    Raises `ParameterError` for names that do not exist and for values that are not numbers, or not integers where the
    field is one; `RangeError` for values outside the range of a field.

    Parameters
    ----------
    trees
        Pytrees by name; the name ``plant`` is left out in the names of its leaves.
    values
        Numbers in SI, or arrays of shape (lanes,), by the names of leaves (`named_leaves`).
    """
    if not values:
        return dict(trees)
    values = {address: value for name, value in values.items() for address in _aliased(trees, name)}
    leaves = select_leaves(trees, list(values))
    numbers = {name: _numbers(trees, name, leaves[name], value) for name, value in values.items()}
    changed = replace_leaves(trees, numbers)
    places = [place for place in (_place(trees, name) for name in values) if place[1]]
    owners = {(root, *steps[:depth]) for root, steps in places for depth in range(len(steps))}
    for root, *steps in sorted(owners):
        _check(_descend(changed[root], tuple(steps)))
    return changed


def _place(trees: Mapping[str, PyTree], name: str) -> tuple[str, tuple[str, ...]]:
    """Tree of a leaf, and the steps to it: names of parts of the plant begin at these."""
    root, *steps = name.split(".")
    return (root, tuple(steps)) if root in trees else (_UNNAMED, (root, *steps))


def _aliased(trees: Mapping[str, PyTree], name: str) -> list[str]:
    """Names of the leaves that a name stands for."""
    root, steps = _place(trees, name)
    owner = trees.get(root)
    for depth, step in enumerate(steps):
        if names := getattr(type(owner), "aliases", {}).get(step):
            prefix = [] if root == _UNNAMED else [root]
            addresses = [".".join([*prefix, *steps[:depth], alias, *steps[depth + 1 :]]) for alias in names]
            return [leaf for address in addresses for leaf in _aliased(trees, address)]
        if not hasattr(owner, step):
            break
        owner = getattr(owner, step)
    return [name]


def _numbers(trees: Mapping[str, PyTree], name: str, leaf: ArrayLike, value: ArrayLike) -> np.ndarray:
    """Values of a leaf as an array of its type."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # ragged rows, or not an array
        array = np.asarray(None)
    whole = jnp.issubdtype(array.dtype, jnp.integer)
    if not (whole or jnp.issubdtype(array.dtype, jnp.floating)):
        raise ParameterError(
            f"the values of {name} are not numeric", value=value, remedy="give a number, or an array with one per run"
        )
    if not whole and _is_whole(trees, name):
        raise ParameterError(f"{name} is an integer", value=value, remedy="give integers")
    keeps = whole and jnp.issubdtype(np.asarray(leaf).dtype, jnp.integer)
    return array if keeps else array.astype(float)


def _is_whole(trees: Mapping[str, PyTree], name: str) -> bool:
    """Whether a leaf is declared an integer, such as a seed, rather than a float written without a decimal point."""
    root, steps = _place(trees, name)
    field, owner = _field(trees, (root, *steps)), _descend(trees, (root, *steps)[:-1])
    kind = getattr(type(owner), "__annotations__", {}).get(name.rpartition(".")[2], "") if field is None else field.type
    return kind is int or str(kind).startswith("int ") or kind == "int"


def select_leaves(trees: Mapping[str, PyTree], names: Sequence[str]) -> dict[str, PyTree]:
    """Leaves by dotted name; raises as `with_leaves` does.

    >>> select_leaves({"plant": {"load": {"mass": 0.5, "length": 0.3}}}, ["load.mass"])
    {'load.mass': 0.5}
    """
    leaves = named_leaves(trees)
    for name in names:
        if name not in leaves:
            close = difflib.get_close_matches(name, leaves, 1, cutoff=0.5)
            remedy = f"did you mean {close[0]!r}?" if close else f"there are {', '.join(leaves)}"
            raise ParameterError(f"there is no parameter {name!r}", value=name, remedy=remedy)
    return {name: leaves[name] for name in names}


def named_leaves(trees: Mapping[str, PyTree]) -> dict[str, PyTree]:
    """All numeric leaves by dotted name; those of the plant begin with its parts, as in a scenario.

    >>> list(named_leaves({"plant": {"load": {"mass": 0.5}}, "controller": (2.0, 3.0)}))
    ['load.mass', 'controller.0', 'controller.1']
    """
    named = {}
    for root, tree in trees.items():
        leaves, structure = jax.tree.flatten(tree)
        for name, leaf in zip(_names(structure), leaves, strict=True):
            if eqx.is_array_like(leaf) and not isinstance(leaf, bool):
                named[name if root == _UNNAMED else f"{root}.{name}"] = leaf
    return named


@functools.lru_cache(maxsize=256)
def _names(structure: PyTreeDef) -> tuple[str, ...]:
    """Dotted names of the leaves of a structure."""
    tree = jax.tree.unflatten(structure, range(structure.num_leaves))
    paths = jax.tree_util.tree_leaves_with_path(tree)
    return tuple(jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in paths)


def replace_leaves(trees: Mapping[str, PyTree], values: Mapping[str, PyTree]) -> dict[str, PyTree]:
    """Trees with new values at existing leaves, which are not checked.

    >>> replace_leaves({"plant": {"load": {"mass": 0.5}}}, {"load.mass": 0.7})
    {'plant': {'load': {'mass': 0.7}}}
    """
    changed = dict(trees)
    for name, value in values.items():
        root, steps = _place(trees, name)
        changed[root] = eqx.tree_at(lambda tree, steps=steps: _descend(tree, steps), changed[root], value)
    return changed


def recheck(tree: PyTree) -> None:
    """Run the checks of every module in a tree, as at construction."""
    _check(tree)
    tree = vars(tree) if isinstance(tree, eqx.Module) else tree
    if isinstance(tree, dict | tuple | list):
        for value in tree.values() if isinstance(tree, dict) else tree:
            recheck(value)


def _check(module: object) -> None:
    """Run the check of one module."""
    if isinstance(module, eqx.Module) and (check := getattr(type(module), "__check_init__", None)):
        check(module)


def cast(tree: Tree, kind: DTypeLike) -> Tree:
    """Tree with all floats as arrays of one type."""

    def convert(leaf: PyTree) -> PyTree:
        return jnp.asarray(leaf, kind) if isinstance(leaf, float) or eqx.is_inexact_array(leaf) else leaf

    return jax.tree.map(convert, tree)


def pad_chunk(tree: Tree, chunk: slice, size: int) -> Tree:
    """Chunk of every leaf along its first axis, padded to `size` with the last lane: programs have one size.

    >>> pad_chunk({"mass": np.array([0.1, 0.2, 0.3])}, slice(1, 3), 4)
    {'mass': array([0.2, 0.3, 0.3, 0.3])}
    """

    def piece(leaf: PyTree) -> PyTree:
        rows = np.asarray(leaf[chunk])
        return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)]) if len(rows) < size else rows

    return jax.tree.map(piece, tree)


def map_chunks(
    call: Callable[[slice], R], count: int, size: int, workers: int | None = None
) -> Iterator[tuple[slice, R]]:
    """Call a function on chunks of lanes in threads (JAX releases the lock); yield chunks and results in order.

    At most two chunks per thread are computed ahead of their reader. An error in a chunk is raised when its turn comes,
    and ends the others, as closing the iterator does.

    Parameters
    ----------
    count, size
        Numbers of lanes, and of lanes in a chunk.
    workers
        Number of threads. Default: of processor cores.
    """
    workers = workers or cores()
    chunks = iter([slice(start, min(start + size, count)) for start in range(0, count, size)])
    pending: deque[tuple[slice, Future[R]]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            while True:
                for chunk in chunks:
                    pending.append((chunk, pool.submit(call, chunk)))
                    if len(pending) >= 2 * workers:
                        break
                if not pending:
                    return
                chunk, future = pending.popleft()
                yield chunk, future.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def cores() -> int:
    """Number of processor cores available to this process; 1 on an accelerator."""
    if jax.default_backend() != "cpu":
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _field(tree: PyTree, steps: tuple[str, ...]) -> dataclasses.Field[object] | None:
    """Field of a leaf, if it is that of a dataclass."""
    owner = _descend(tree, steps[:-1])
    fields = dataclasses.fields(owner) if dataclasses.is_dataclass(owner) else ()
    return next((field for field in fields if field.name == steps[-1]), None)


def _descend(tree: PyTree, steps: tuple[str, ...]) -> PyTree:
    """Part of a tree below names of fields, keys and indices."""
    for step in steps:
        key = step if isinstance(tree, dict) else int(step) if step.isdigit() else None
        tree = getattr(tree, step) if key is None else tree[key]
    return tree


_BATCHED: ContextVar[bool] = ContextVar("batched program", default=False)
_ROLLED: ContextVar[bool] = ContextVar("rolled integration stages", default=False)


@contextmanager
def batched_program(*, rolled: bool = True) -> Iterator[None]:
    """Trace for many runs in parallel or, if not `rolled`, for one run with its derivatives."""
    tokens = _BATCHED.set(True), _ROLLED.set(rolled)
    try:
        yield
    finally:
        _BATCHED.reset(tokens[0])
        _ROLLED.reset(tokens[1])


def trace_mode() -> tuple[bool, bool]:
    """Context that distinguishes programs of one function: batched or not, stages rolled or not.

    >>> with batched_program(rolled=False):
    ...     trace_mode()
    (True, False)
    """
    return _BATCHED.get(), _ROLLED.get()


def fusion_barrier(function: Callable[..., R], *args: object) -> R:
    """`function(*args)`; in a batched program within a branch, so that XLA does not repeat it at each use.

    XLA fuses an expensive value into each of its users, and computes it in each of them. It does not fuse across a
    branch, whose condition it cannot know. Derivatives and results are those of the function.
    """
    if not _BATCHED.get():
        return function(*args)

    def call() -> R:
        token = _BATCHED.set(False)  # one branch is enough
        try:
            return function(*args)
        finally:
            _BATCHED.reset(token)

    zeros = jax.tree.map(lambda shape: jnp.zeros(shape.shape, shape.dtype), jax.eval_shape(call))
    # The barrier keeps XLA from removing the branch.
    return lax.cond(lax.optimization_barrier(jnp.asarray(1.0)) > 0, call, lambda: zeros)
