"""Compiled programs, kept in files between processes."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import importlib.metadata
import os
import pickle
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import jax.core
import numpy as np

from mckibben.numerics.batching import traced_for
from mckibben.numerics.runtime import processor, programs_folder
from mckibben.storage.files import atomic_write

_PACKAGES = ("jax", "jaxlib", "equinox", "numpy")
_KNOWN = frozenset({"mckibben", "builtins", *_PACKAGES})
_PLAIN = (type(None), bool, int, float, complex, str, bytes)
_CONTAINERS = (tuple, list, set, frozenset, dict)


class NamelessError(ValueError):
    """Something comes of code that may be another under the same name."""


def name_of_code(thing: Any) -> str:
    """The full name of a class or function.

    Raises
    ------
    NamelessError
        If it comes from elsewhere, or is one of many under its name: a closure, a lambda, a class in a function.

    Examples
    --------
    >>> name_of_code(name_of_code)
    'mckibben.numerics.program_cache.name_of_code'
    >>> name_of_code(lambda: 0)
    Traceback (most recent call last):
        ...
    mckibben.numerics.lasting.NamelessError: mckibben.numerics.lasting.<lambda>
    """
    name = f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', '<nothing>')}"
    closed_over = getattr(thing, "__closure__", None) is not None and not isinstance(thing, type)
    if name.partition(".")[0] not in _KNOWN or "<" in name or closed_over:
        raise NamelessError(name)
    return name


def name_of_structure(structure: Any) -> str:
    """The classes of a tree of JAX, and what is static in it.

    Raises
    ------
    NamelessError
        As for `name_of_code`.

    Examples
    --------
    >>> name_of_structure(jax.tree.structure(([1.0], None)))
    'builtins.tuple(=None builtins.list(=None *) builtins.NoneType(=None))'
    """
    node = structure.node_data()
    if node is None:
        return "*"
    kind, static = node
    parts = " ".join(name_of_structure(child) for child in structure.children())
    return f"{name_of_code(kind)}(={name_of_value(static)}{' ' if parts else ''}{parts})"


def name_of_value(value: Any) -> str:
    """A value that is no array, in words that no other value has.

    Raises
    ------
    NamelessError
        If it, or something in it, is of code without a lasting name.
    """
    if isinstance(value, _PLAIN):
        return repr(value) if type(value) in _PLAIN else _of(value, repr(value))
    if isinstance(value, type | FunctionType):
        return name_of_code(value)
    if isinstance(value, enum.Enum):
        return _of(value, value.name)
    if isinstance(value, np.dtype):
        return _of(value, f"{value.str} {value.name}")
    if isinstance(value, dict):
        return _of(value, " ".join(f"{name_of_value(key)}:{name_of_value(one)}" for key, one in value.items()))
    if isinstance(value, _CONTAINERS):
        names = [name_of_value(one) for one in value]
        return _of(value, " ".join(sorted(names) if isinstance(value, set | frozenset) else names))
    if dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        return _of(value, " ".join(f"{field.name}={name_of_value(getattr(value, field.name))}" for field in fields))
    if type(value).__mro__ == (type(value), object) and getattr(value, "__dict__", None) == {}:
        return _of(value, "")  # a sentinel: nothing is in it
    raise NamelessError(f"{type(value).__module__}.{type(value).__qualname__}")


def _of(value: Any, text: str) -> str:
    return f"{name_of_code(type(value))}({text})"


def _files() -> tuple[tuple[str, int, int], ...]:
    """Our source files: path, size and time of change; none where they are no files of their own."""
    found: list[tuple[str, int, int]] = []

    def look(folder: str) -> None:
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name.endswith(".py"):
                    about = entry.stat()
                    found.append((entry.path, about.st_size, about.st_mtime_ns))
                elif entry.is_dir() and entry.name != "__pycache__":
                    look(entry.path)

    try:
        look(str(Path(__file__).parents[1]))
    except OSError:
        return ()
    return tuple(sorted(found))


_AT_IMPORT = _files()


def source_is_as_imported() -> bool:
    """Whether no source file of ours has changed since this process began: else it does not run what stands there."""
    return _files() == _AT_IMPORT != ()


@functools.cache
def surroundings() -> str:
    """All that a program depends on beside its function and arguments, as a digest.

    It is that of this process as long as `source_is_as_imported`, asked after it, says so.
    """
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for name, _, _ in _AT_IMPORT:
        content = Path(name).read_bytes()
        digest.update(f"{Path(name).relative_to(root).as_posix()} {len(content)} ".encode() + content)
    versions = [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
    flags, wide = os.environ.get("XLA_FLAGS"), jax.config.jax_enable_x64  # type: ignore[attr-defined]
    digest.update(repr((versions, sys.version, flags, wide, processor())).encode())
    return digest.hexdigest()


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
    with atomic_write(path, overwrite=True) as part:
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
