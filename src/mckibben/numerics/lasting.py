"""What stays the same from one process to the next: names of structures and values, our source, and what compiles it.

A compiled program depends on all the code that it was traced from. Of ours, and of the packages below, that is known:
by content and by version. Code from elsewhere may be another under the same name tomorrow; it has no lasting name.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import importlib.metadata
import os
import sys
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import numpy as np

from mckibben.numerics.runtime import processor

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
    'mckibben.numerics.lasting.name_of_code'
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
