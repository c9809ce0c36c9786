"""Compile a function once per structure of its arguments, not per value."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar, cast

import jax
import jax.core
import numpy as np
from jax.stages import Wrapped as JitWrapped
from jax.tree_util import PyTreeDef
from jaxtyping import Array, PyTree

from mckibben.numerics.batching import fusion_barrier, trace_mode
from mckibben.numerics.program_cache import ARRAY, ARRAYS, load_or_compile
from mckibben.numerics.runtime import batch_options, xla_programs_folder

jax.config.update("jax_cpu_enable_async_dispatch", False)  # a change of threads takes longer than a small program

P = ParamSpec("P")
R = TypeVar("R")


def numeric(tree: PyTree) -> Any:
    """Tree with its Python and NumPy numbers as NumPy arrays (JAX's would be put on the device one by one).

    Booleans, texts and other leaves stay as they are: they are static in programs.

    Examples
    --------
    >>> numeric({"pressure": 2e5, "count": 3, "law": "Chou", "fixed": True})
    {'count': array(3), 'fixed': True, 'law': 'Chou', 'pressure': array(200000.)}
    """

    def convert(leaf: object) -> object:
        if isinstance(leaf, float):  # the common case, and the quicker check
            return np.asarray(leaf, float)
        if isinstance(leaf, Integral) and not isinstance(leaf, bool):
            return np.asarray(leaf)
        if isinstance(leaf, Real) and not isinstance(leaf, bool):
            return np.asarray(leaf, float)
        return leaf

    return jax.tree.map(convert, tree)


def jit(function: Callable[P, R]) -> Callable[P, R]:
    """`equinox.filter_jit` that traces Python numbers too: a new value does not recompile.

    The program is kept in the user's program cache, if that is in use (`numerics.program_cache`).

    Examples
    --------
    >>> traced = []
    >>> double = jit(lambda x: (traced.append(x), 2 * x)[1])
    >>> float(double(1.5)), float(double(4.0)), len(traced)
    (3.0, 8.0, 1)
    """
    program = Program(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        args, kwargs = numeric((args, kwargs))
        return program(*args, **kwargs)

    return call


def jit_inline(function: Callable[P, R]) -> Callable[P, R]:
    """`jit` for concrete arguments; inlined when traced by another program."""
    alone = jit(function)

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        return (function if _is_traced((args, kwargs)) else alone)(*args, **kwargs)

    return call


def cached_trace(function: Callable[P, R]) -> Callable[P, R]:
    """Decorator for functions and methods that are always called by `fusion_barrier`, and traced once per structure.

    It is for expensive parts of a larger program that occur several times in it.
    """
    program = Program(function)

    @functools.wraps(function)
    def once(*args: P.args, **kwargs: P.kwargs) -> R:
        call = program if _is_traced((args, kwargs)) else function
        return fusion_barrier(lambda: call(*args, **kwargs))

    return once


def _is_traced(tree: PyTree) -> bool:
    """Whether a tree contains tracers of another program."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def jit_arrays(function: Callable[P, R], options: Callable[[], dict[str, int]] = dict) -> Callable[P, R]:
    """`jit` with only arrays traced and numbers static; pass trees through `numeric` first.

    `options` are compiler options of XLA, asked for when a program is compiled.
    """
    return cast(Any, functools.update_wrapper(Program(function, options), function))


def jit_lanes(function: Callable[P, R]) -> Callable[P, R]:
    """`jit_arrays` with the compiler options for many lanes."""
    return jit_arrays(function, batch_options)


class Program:
    """Pure function of arrays, compiled once per structure of its arguments; all other leaves are static.

    A call with tracers becomes part of the program that is being traced. One thread compiles a program, others that
    need the same one wait for it.

    Parameters
    ----------
    function
        Function of trees.
    options
        Compiler options of XLA, asked for when a program is compiled.
    """

    def __init__(self, function: Callable[..., PyTree], options: Callable[[], dict[str, int]] = dict) -> None:
        self._function = function
        self._options = options
        self._programs: dict[object, Callable[..., PyTree]] = {}
        self._inner: dict[object, Callable[..., PyTree]] = {}
        self._locks: dict[object, threading.RLock] = {}

    def __call__(self, *args: PyTree, **kwargs: PyTree) -> PyTree:
        leaves, structure = jax.tree.flatten((args, kwargs))
        static = tuple(ARRAY if isinstance(leaf, ARRAYS) else leaf for leaf in leaves)
        arrays = [leaf for leaf, mark in zip(leaves, static, strict=True) if mark is ARRAY]
        if _is_traced(arrays):  # part of another program
            program_key = (structure, static, tuple(map(type, static)), trace_mode())
            if (program := self._inner.get(program_key)) is None:
                program = self._inner[program_key] = self._jitted(structure, static, inline=True)
            return program(*arrays)
        kinds = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in arrays)
        folder = xla_programs_folder()
        key = (structure, static, tuple(map(type, static)), kinds, trace_mode(), folder)
        if (program := self._programs.get(key)) is None:
            with self._locks.setdefault(key, threading.RLock()):
                if (program := self._programs.get(key)) is None:
                    program = self._jitted(structure, static)
                    if folder is not None and jax.default_backend() == "cpu":
                        described = (structure, static, kinds, trace_mode(), self._options())
                        program = load_or_compile(folder, program, arrays, self._function, *described)
                    answer = program(*arrays)  # `jax.jit` compiles here
                    self._programs[key] = program
                    return answer
        return program(*arrays)

    def _jitted(self, structure: PyTreeDef, static: tuple[object, ...], *, inline: bool = False) -> JitWrapped:
        """`jax.jit` of the function over its array leaves."""

        def call(*arrays: Array) -> PyTree:
            traced = iter(arrays)
            args, kwargs = jax.tree.unflatten(structure, [next(traced) if leaf is ARRAY else leaf for leaf in static])
            return self._function(*args, **kwargs)

        if inline:
            return jax.jit(call, inline=True)
        return jax.jit(call, compiler_options=self._options() or None)
