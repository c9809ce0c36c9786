"""Classes and catalog entries that files can name for a base class."""

from __future__ import annotations

import dataclasses
import inspect
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from mckibben.binding import call
from mckibben.component.extensions import module_origin
from mckibben.errors import RangeError, quoted


@dataclass(frozen=True)
class Catalog:
    """Named components of a base; see `register`.

    Attributes
    ----------
    noun
        What an entry is, for messages.
    names
        Function that returns the names of all entries.
    entry
        Function that returns the component of a name, or its section in a file if it lacks fields.
    read
        Reader of a file of the base, where that is not a section.
    """

    noun: str
    names: Callable[[], Sequence[str]]
    entry: Callable[[str], Any]
    read: Callable[[Path], Any] | None = None


_CATALOGS: dict[type, Catalog] = {}


def catalog_of(base: type) -> Catalog | None:
    """Return the catalog of a base, or of a class that it derives from."""
    call("register_catalog")  # when a file names an entry
    return next((_CATALOGS[kind] for kind in base.__mro__ if kind in _CATALOGS), None)


def register(base: type, catalog: Catalog) -> None:
    """Let files name entries of a catalog in place of components of a base."""
    _CATALOGS[base] = catalog


def concrete_subclasses(base: type) -> Iterator[type]:
    """Yield the subclasses of a class that are not abstract, in imported modules.

    >>> from mckibben.joint import Tendon
    >>> sorted(kind.__name__ for kind in concrete_subclasses(Tendon) if kind.__module__.startswith("mckibben."))
    ['RigidTendon', 'SeriesSpring']
    """
    for kind in base.__subclasses__():
        yield from concrete_subclasses(kind)
        if not inspect.isabstract(kind):
            yield kind


def classes_of(base: type) -> dict[str, type]:
    """Return the classes of a base that a file can name, by their name in files, or in full where two share a name.

    These are all concrete dataclasses in imported modules whose name does not begin with an underscore; a class needs
    no registration.
    """
    kinds = {(kind.__module__, kind.__qualname__): kind for kind in [*concrete_subclasses(base), base]}
    named = [kind for kind in kinds.values() if not (kind.__name__.startswith("_") or is_abstract(kind))]
    count = Counter(map(class_name, named))
    return {class_name(kind) if count[class_name(kind)] == 1 else full_name(kind): kind for kind in named}


def is_abstract(kind: type) -> bool:
    """Whether a class is abstract or has no fields, so that a file cannot name it."""
    return inspect.isabstract(kind) or not dataclasses.is_dataclass(kind)


def class_name(kind: type) -> str:
    """Return the name of a class in files: its short or class name."""
    return kind.__dict__.get("short_name") or kind.__name__


def full_name(kind: type) -> str:
    """Return the name of a class, preceded by that of its module or file."""
    package = kind.__module__.partition(".")[0]
    return f"{package if package == 'mckibben' else module_origin(kind.__module__)}:{kind.__name__}"


def name_in_files(base: type, kind: type) -> str:
    """Return the name by which files find a class of a base: in full where another has the same name."""
    short = class_name(kind)
    return short if len(_named(base, short)) < 2 else full_name(kind)


def find_class(base: type, name: str) -> type | None:
    """Return the class of a base that a file names, by class or short name; None if there is none.

    A name may follow that of its package, module or file, as in ``acme_parts:AcmeValve``. Raises `RangeError` if there
    are several.

        >>> from mckibben.joint import Tendon
        >>> find_class(Tendon, "spring").__name__
        'SeriesSpring'
    """
    named = _named(base, name)
    if len(named) > 1:
        several = " and ".join(f"{module_origin(kind.__module__)}:{kind.__name__}" for kind in named)
        raise RangeError(f"{quoted(name)} may be {several}", value=name, remedy="write package:Class")
    return named[0] if named else None


def _named(base: type, name: str) -> list[type]:
    """Classes of a base with a name in files, which may follow that of a package, module or file."""
    origin, _, plain = name.rpartition(":")
    named = [kind for kind in classes_of(base).values() if plain in (kind.__name__, kind.__dict__.get("short_name"))]
    return [kind for kind in named if not origin or _is_from(kind, origin)]


def _is_from(kind: type, origin: str) -> bool:
    return any(f"{module}.".startswith(f"{origin}.") for module in (kind.__module__, module_origin(kind.__module__)))


def default_class(base: type) -> type | None:
    """Return the class of a section without the key `class`; None if it needs one."""
    named = getattr(base, "default_class", "")
    inherited = find_class(base, named) if named else None  # which may be another class of the base of this one
    return inherited or (None if is_abstract(base) else base)


class Keyed:
    """Base of classes whose section may stand below their short name, as in ``isobaric: {repeats: 2}``."""

    short_name: ClassVar[str] = ""
    shorthand: ClassVar[str] = ""
    """Field of a section that is one value, as in ``move: 10 %``."""

    @classmethod
    def from_file(cls, value: object) -> object:
        """Return the section with its class of one below a short name."""
        if cls.short_name or not isinstance(value, dict) or len(value) != 1:
            return value
        ((name, section),) = value.items()
        kind = find_class(cls, name)
        if kind is None:
            return value
        if section == "":
            section = {}
        return {"class": name, **(section if isinstance(section, dict) else {getattr(kind, "shorthand", ""): section})}

    @classmethod
    def to_file(cls, section: dict[str, object]) -> object:
        """Return a section below the short name of its class."""
        if cls.short_name:  # a field of one class
            return section
        name, inner = str(section.pop("class")), section
        shorthand = getattr(find_class(cls, name), "shorthand", "")
        if not inner:
            return name
        return {name: inner[shorthand] if list(inner) == [shorthand] else inner}


def short_key(written: object, section: object) -> tuple[str, ...]:
    """Return the key of a section or value below the name of its class, as in ``move: 10 %``; none of another form."""
    named = isinstance(written, dict) and isinstance(section, dict) and list(written) == [section.get("class")]
    return tuple(written) if named else ()
