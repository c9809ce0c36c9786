"""Cache of compiled programs in the user's cache folder, so that a command neither traces nor compiles.

A program is keyed by a fingerprint of everything it depends on: function, structure and static values of its arguments,
compiler options, versions, processor, and our source files. Native code is loaded only from files in a folder that this
user owns and nobody else can write to.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import os
import pickle
import stat
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from types import FunctionType

import equinox
import jax
import jaxlib.version
import numpy as np
from jax.stages import Wrapped as JitWrapped
from jax.tree_util import PyTreeDef
from jaxtyping import Array, PyTree

from mckibben.errors import McKibbenWarning
from mckibben.numerics.runtime import processor
from mckibben.storage.private import SOURCES, is_private, read_private, source_files, write_private

_KNOWN = frozenset({"mckibben", "builtins", "jax", "jaxlib", "equinox", "numpy"})
_PLAIN = (type(None), bool, int, float, complex, str, bytes)
_CONTAINERS = (tuple, list, set, frozenset, dict)


class _Array:
    """Placeholder for an array among static leaves."""

    def __repr__(self) -> str:
        return "array"


ARRAY = _Array()
ARRAYS = (np.ndarray, np.generic, jax.Array)  # in this order: it is slow to ask whether something is JAX's


class FingerprintError(ValueError):
    """A value has no fingerprint that is valid in other processes."""


def program_path(
    folder: Path, function: Callable[..., PyTree], static: Sequence[PyTree], *details: PyTree
) -> Path | None:
    """File of a program in `folder`; None without fingerprint or trusted folder.

    The folder is made for this user alone. One that another user owns or may write to is not used, which is warned of
    once.

    Parameters
    ----------
    function, static
        Function of the program and the static values of its arguments, of which fingerprints are taken.
    rest
        Further values that it depends on, by their `repr`.
    """
    try:
        words = [code_fingerprint(function), *map(fingerprint, static)]
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (FingerprintError, OSError):
        return None
    if not is_private(folder.lstat(), stat.S_ISDIR):
        _warn_of_strangers(folder)
        return None
    text = "\n".join([*words, repr(details), _environment()])
    return folder / f"{hashlib.sha256(text.encode()).hexdigest()[:40]}.program"


@functools.cache
def _warn_of_strangers(folder: Path) -> None:
    """Warn once that a folder is not used."""
    message = f"compiled programs are neither read nor kept: others than this user own {folder}, or may write to it"
    remedy = "make it yours alone (chown, chmod 700), or set MCKIBBEN_PROGRAMS_DIR to another folder"
    if os.name != "nt":
        warnings.warn(f"{message}; {remedy}", McKibbenWarning, stacklevel=2)


def read_program(path: Path) -> bytes | None:
    """Content of a program's file; None if it is missing, damaged or not private."""
    try:
        return read_private(path)
    except (OSError, ValueError):
        return None


def write_program(path: Path, content: bytes) -> None:
    """Store a program, unless our sources were edited since import or storing is impossible."""
    if source_files() == SOURCES:  # else some of it may run as edited, some as imported
        with suppress(OSError):
            write_private(path, content)


def load_or_compile(
    folder: Path,
    jitted: JitWrapped,
    arrays: list[Array],
    function: Callable[..., PyTree],
    structure: PyTreeDef,
    static: PyTree,
    *details: PyTree,
) -> Callable[..., PyTree]:
    """Program from its file in `folder`, or compiled and written; `jitted` without fingerprint or trusted folder.

    One that calls LAPACK is not written, as JAX makes these functions known only where it is traced: it would crash.

    Parameters
    ----------
    jitted, arrays
        The program to be compiled, and its arguments.
    function, structure, static, rest
        What identifies it, see `program_path`.
    """
    from jax.experimental.serialize_executable import deserialize_and_load, serialize

    path = program_path(folder, function, (structure, *static), *details)
    if path is None:
        return jitted
    arguments = jax.tree.structure((tuple(arrays), {}))
    try:
        payload, answer = pickle.loads(read_private(path))
        return deserialize_and_load(payload, arguments, jax.tree.structure(answer))
    except Exception:  # missing, damaged, not private, or of another JAX
        lowered = jitted.lower(*arrays)
        program = lowered.compile()
        if "lapack" in lowered.as_text():
            return program
    try:
        payload, _, answer = serialize(program)
        jax.block_until_ready(deserialize_and_load(payload, arguments, answer)(*arrays))  # not every one loads again
        write_program(path, pickle.dumps((payload, jax.tree.unflatten(answer, [0] * answer.num_leaves))))
    except Exception:  # it runs even where it cannot be stored, such as on a full disk
        pass
    return program


@functools.cache
def _environment() -> str:
    """Everything that a program depends on in addition to its function and arguments."""
    versions = jax.__version__, jaxlib.version.__version__, equinox.__version__, np.__version__, sys.version
    flags = os.environ.get("XLA_FLAGS"), jax.config.jax_enable_x64  # type: ignore[attr-defined]
    return repr((SOURCES, versions, flags, processor()))


def code_fingerprint(thing: object) -> str:
    """Qualified name of a class or function; `FingerprintError` for a foreign or local one, or a closure."""
    name = f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', '<nothing>')}"
    is_closure = getattr(thing, "__closure__", None) is not None and not isinstance(thing, type)
    if name.partition(".")[0] not in _KNOWN or "<" in name or is_closure:
        raise FingerprintError(name)
    return name


def structure_fingerprint(structure: PyTreeDef) -> str:
    """Classes and static values of a JAX tree structure."""
    node = structure.node_data()
    if node is None:
        return "*"
    kind, static = node
    children = " ".join(structure_fingerprint(child) for child in structure.children())
    return f"{code_fingerprint(kind)}(={fingerprint(static)}{' ' if children else ''}{children})"


def fingerprint(value: object) -> str:
    """Text that identifies a static value uniquely; raises `FingerprintError` if there is none.

    >>> fingerprint((1, "a", 2.5)), fingerprint({"b": None})
    ("builtins.tuple(1 'a' 2.5)", "builtins.dict('b':None)")
    """
    if isinstance(value, jax.tree_util.PyTreeDef):
        return structure_fingerprint(value)
    if isinstance(value, type | FunctionType):
        return code_fingerprint(value)
    if isinstance(value, _PLAIN):
        text = repr(value)
    elif isinstance(value, enum.Enum):
        text = value.name
    elif isinstance(value, np.dtype):
        text = f"{value.str} {value.name}"
    elif isinstance(value, dict):
        text = " ".join(f"{fingerprint(key)}:{fingerprint(item)}" for key, item in value.items())
    elif isinstance(value, _CONTAINERS):
        names = [fingerprint(item) for item in value]
        text = " ".join(sorted(names) if isinstance(value, set | frozenset) else names)
    elif dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        text = " ".join(f"{field.name}={fingerprint(getattr(value, field.name))}" for field in fields)
    elif type(value).__mro__ == (type(value), object) and getattr(value, "__dict__", None) == {}:
        text = ""  # a sentinel
    else:
        raise FingerprintError(f"{type(value).__module__}.{type(value).__qualname__}")
    return text if type(value) in _PLAIN else f"{code_fingerprint(type(value))}({text})"
