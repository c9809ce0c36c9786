"""Compiled programs kept whole between processes.

JAX's own compile cache spares a new process the compiler, but not the tracing and lowering before it: a third of a
second of a command that takes one. Here a finished program is written to a file and taken up again, under a key of all
that made it: function, structure, shapes and types of the arguments, our source files, the versions, XLA's flags, and
the processor. What code from elsewhere has a part in is not kept: it may be other code the next time.
"""

from __future__ import annotations

import functools
import hashlib
import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.core
import numpy as np

from mckibben.files import whole
from mckibben.numerics.lasting import (
    NamelessError,
    name_of_code,
    name_of_structure,
    name_of_value,
    source_is_as_imported,
    surroundings,
)
from mckibben.numerics.many import traced_for
from mckibben.numerics.runtime import programs_folder

Program = Callable[..., Any]

_MOST = 200
"""Files in the folder; the oldest go."""


_ARRAYS = (jax.Array, np.ndarray, np.generic)


class _Array:
    """Stands for an array among arguments that are not."""

    def __repr__(self) -> str:
        return "array"


_ARRAY = _Array()


class KeptProgram:
    """A function of arrays as programs, one for each structure of its arguments.

    Arrays are traced, everything else is static (and hashable), as with `equinox.filter_jit`; the answers are arrays.
    Where several threads ask for a program that is yet to be made, one makes it, and the others wait.

    Parameters
    ----------
    function
        Pure.
    options
        Of the compiler, or what gives them at the first call: they may depend on the device.
    """

    def __init__(self, function: Program, options: dict[str, Any] | Callable[[], dict[str, Any]] | None = None) -> None:
        self._function = function
        self._options = options if callable(options) else lambda: options
        self._traced: dict[Any, Program] = {}
        self._programs: dict[Any, Program] = {}
        self._making = _OneAtATime()

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        leaves, structure = jax.tree.flatten((args, kwargs))
        arrays = [leaf for leaf in leaves if isinstance(leaf, _ARRAYS)]
        fixed = tuple(_ARRAY if isinstance(leaf, _ARRAYS) else leaf for leaf in leaves)
        # What is traced for many runs is another program, even of the same arguments.
        key = (structure, fixed, tuple(map(type, fixed)), traced_for())
        if any(isinstance(leaf, jax.core.Tracer) for leaf in arrays):  # a part of another program
            return self._to_trace(key)(*arrays)
        kinds = tuple((leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)) for leaf in arrays)
        folder = programs_folder()
        whole_key = (key, kinds, None if folder is None else str(folder))
        program = self._programs.get(whole_key)
        if program is not None:
            return program(*arrays)
        with self._making(whole_key):
            program = self._programs.get(whole_key)
            if program is None:
                if folder is not None and jax.default_backend() == "cpu":
                    program = self._taken_up(folder, key, kinds, arrays)
                else:
                    program = self._to_trace(key)
                answer = program(*arrays)  # which is when JAX compiles
                self._programs[whole_key] = program
                return answer
        return program(*arrays)

    def _to_trace(self, key: Any) -> Any:
        """The function as JAX traces it, for a structure of arguments."""
        traced = self._traced.get(key)
        if traced is None:
            function = functools.partial(self._called, *key[:2])
            traced = self._traced.setdefault(key, jax.jit(function, compiler_options=self._options() or None))
        return traced

    def _called(self, structure: Any, fixed: tuple[Any, ...], *arrays: Any) -> Any:
        """The function, on arguments put together again."""
        rest = iter(arrays)
        leaves = [next(rest) if leaf is _ARRAY else leaf for leaf in fixed]
        args, kwargs = jax.tree.unflatten(structure, leaves)
        return self._function(*args, **kwargs)

    def _taken_up(self, folder: Path, key: Any, kinds: tuple[Any, ...], leaves: list[Any]) -> Program:
        """The program from its file, or made and written to it."""
        from jax.experimental.serialize_executable import deserialize_and_load, serialize

        traced = self._to_trace(key)
        try:
            name = self._name(key, kinds)
        except (NamelessError, OSError):
            return traced
        if not source_is_as_imported():
            return traced
        path = folder / f"{name}.program"
        taken = jax.tree.structure((tuple(leaves), {}))
        try:
            payload, skeleton = _read(path)
            return deserialize_and_load(payload, taken, jax.tree.structure(skeleton))
        except Exception:  # missing, damaged, or of a JAX that cannot read it: then it is made
            program = traced.lower(*leaves).compile()
        try:
            payload, _, given = serialize(program)
            jax.block_until_ready(deserialize_and_load(payload, taken, given)(*leaves))  # does it run again?
            folder.mkdir(parents=True, exist_ok=True)
            if source_is_as_imported():
                _write(path, (payload, jax.tree.unflatten(given, [0] * given.num_leaves)))
                _thin_out(folder)
        except Exception:  # a program that cannot be kept still runs; nor does a full disk matter to it
            pass
        return program

    def _name(self, key: Any, kinds: tuple[Any, ...]) -> str:
        """A name of the program that no other has, in any process."""
        structure, fixed, _, context = key
        words = [
            name_of_code(self._function),
            name_of_structure(structure),
            *("array" if leaf is _ARRAY else name_of_value(leaf) for leaf in fixed),
            repr([(shape, str(dtype), weak) for shape, dtype, weak in kinds]),
            repr(context),
            repr(self._options() or None),
            surroundings(),
        ]
        return hashlib.sha256("\n".join(words).encode()).hexdigest()[:40]


class _OneAtATime:
    """A lock for each of several things, as long as someone makes it; whoever has one may ask for it again."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._locks: dict[Any, tuple[Any, int]] = {}

    @contextmanager
    def __call__(self, thing: Any) -> Iterator[None]:
        with self._lock:
            lock, waiting = self._locks.get(thing) or (threading.RLock(), 0)
            self._locks[thing] = (lock, waiting + 1)
        try:
            with lock:
                yield
        finally:
            with self._lock:
                lock, waiting = self._locks[thing]
                if waiting > 1:
                    self._locks[thing] = (lock, waiting - 1)
                else:
                    del self._locks[thing]


def _write(path: Path, content: Any) -> None:
    """Keep something with a seal: native code that is damaged does not fail, it crashes."""
    pickled = pickle.dumps(content)
    with whole(path) as part:
        part.write_bytes(_seal(path, pickled) + pickled)


def _read(path: Path) -> Any:
    """What was kept.

    Raises
    ------
    OSError, ValueError
        If it is not there, or not as it was written.
    """
    seal, newline, pickled = path.read_bytes().partition(b"\n")
    if seal + newline != _seal(path, pickled):
        raise ValueError(f"{path} is damaged")
    return pickle.loads(pickled)


def _seal(path: Path, pickled: bytes) -> bytes:
    """A line that only this content of this program has."""
    return hashlib.sha256(path.name.encode() + pickled).hexdigest().encode() + b"\n"


def _thin_out(folder: Path) -> None:
    files = sorted(folder.glob("*.program"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in files[_MOST:]:
        path.unlink(missing_ok=True)
