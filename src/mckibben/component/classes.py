"""Which classes and catalog entries a file can name in place of a base class."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mckibben.component.extensions import installed_package, load_installed
from mckibben.errors import RangeError, quoted


@dataclass(frozen=True)
class Catalog:
    """Named components of a base, and the reader of its files where these are no sections; see `register`."""

    noun: str
    names: Callable[[], Sequence[str]]
    entry: Callable[[str], Any]
    read: Callable[[Path], Any] | None = None


_CATALOGS: dict[type, Catalog] = {}
_BUILT_IN = "mckibben.catalog.entries"
"""Module that registers the published entries: above this one, and loaded when a file names one."""


def catalog_of(base: type) -> Catalog | None:
    """Return the catalog of a base, or of a class that it derives from."""
    importlib.import_module(_BUILT_IN)
    return next((_CATALOGS[one] for one in base.__mro__ if one in _CATALOGS), None)


def register(base: type, catalog: Catalog) -> None:
    """Let files name entries of a catalog in place of components of a base."""
    _CATALOGS[base] = catalog


def concrete_subclasses(base: type) -> Iterator[type]:
    """Yield the subclasses of a class that are not abstract, of modules that are imported."""
    for one in base.__subclasses__():
        yield from concrete_subclasses(one)
        if not inspect.isabstract(one):
            yield one


def classes_of(base: type) -> dict[str, type]:
    """Return the classes of a base that a file can name, by their name in files."""
    kinds = {(one.__module__, one.__qualname__): one for one in [*concrete_subclasses(base), base]}
    return {class_name(one): one for one in kinds.values() if not (one.__name__.startswith("_") or is_abstract(one))}


def is_abstract(kind: type) -> bool:
    """Whether a class is abstract or has no fields, so that a file cannot name it."""
    return inspect.isabstract(kind) or not dataclasses.is_dataclass(kind)


def class_name(kind: type) -> str:
    """Return the name of a class in files: its short name, or else its own, after that of its installed package."""
    package = installed_package(kind.__module__)
    own = kind.__dict__.get("short_name") or kind.__name__
    return f"{package}:{kind.__name__}" if package else own


def find_class(base: type, name: str) -> type | None:
    """Return the class of a base that a file names; None if there is none, `RangeError` if there are several."""
    for known in (classes_of(base), classes_of(base) if load_installed() else {}):
        found = [known[name]] if name in known else [one for one in known.values() if one.__name__ == name]
        if len(found) > 1:
            several = " and ".join(f"{one.__module__}:{one.__name__}" for one in found)
            raise RangeError(f"{quoted(name)} may be {several}", value=name, remedy="write package:Class")
        if found:
            return found[0]
    return None


def default_class(base: type) -> type | None:
    """Return the class of a section without the key `class`; None if it needs one."""
    named = getattr(base, "default_class", "")
    if named:
        return find_class(base, named)
    return None if is_abstract(base) else base
