"""Files of the catalog: names, sources, and entries in the units of their source."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from importlib import resources
from typing import Any

from mckibben.errors import NotInCatalogError, suggest

KINDS = ("specimens", "laws", "datasets", "geometries", "loads", "joints", "valves", "legs", "robots")
FOLDER = resources.files("mckibben.catalog")


def names(kind: str) -> list[str]:
    """Return the names of a kind: "specimens", "laws", "datasets", "geometries", "loads", "joints", "valves", "legs" or
    "robots".

    Raises `NotInCatalogError` for any other kind.
    """
    if kind not in KINDS:
        raise NotInCatalogError(f"the catalog has no {kind!r}", value=kind, remedy=f"it has {', '.join(KINDS)}")
    return [name for publication in _publications(f"{kind}:") for name in publication.get(kind, {})]


def cite(name: str) -> str:
    """Return the source of an entry, the location within it, and notes; one line each.

    Raises `NotInCatalogError`, with a suggestion, for a name that no kind has.

    >>> cite("lei-mas-10-180n").splitlines()[1]
    '(Eq. 3; identified from 0 to 6 bar)'
    """
    entries = [
        (publication, publication[kind][name])
        for publication in _publications(name)
        for kind in KINDS
        if name in publication.get(kind, {})
    ]
    if not entries:
        raise _unknown("entry", name, [entry_name for kind in KINDS for entry_name in names(kind)])
    publication = entries[0][0]
    places = "; ".join(dict.fromkeys(entry["where"] for _, entry in entries))
    return "\n".join([publication["source"], f"({places})", *(f"- {note}" for note in publication.get("notes", []))])


def find(kind: str, name: str) -> tuple[dict[str, Any], str]:
    """Return an entry in the units of its source, with the source.

    Raises `NotInCatalogError`, with a suggestion, for an unknown name.
    """
    for publication in _publications(name):
        if name in publication.get(kind, {}):
            return publication[kind][name], publication["source"]
    raise _unknown(_SINGULAR[kind], name, names(kind))


_SINGULAR: dict[str, str] = dict(
    zip(KINDS, ("specimen", "law", "dataset", "geometry", "load", "joint", "valve", "leg", "robot"), strict=True)
)


def _publications(words: str) -> Iterator[dict[str, Any]]:
    """Publications whose text contains a part; to parse all of them takes 0.1 s."""
    return (_parsed(text) for text in _texts() if words in text)


@functools.cache
def _texts() -> list[str]:
    files = sorted((f for f in FOLDER.iterdir() if f.name.endswith(".yaml")), key=lambda f: f.name)
    return [file.read_text(encoding="utf-8") for file in files]


@functools.cache
def _parsed(text: str) -> dict[str, Any]:
    from ruamel.yaml import YAML

    return YAML(typ="safe").load(text)


def _unknown(kind: str, name: str, names: list[str]) -> NotInCatalogError:
    remedy = suggest(name, list(dict.fromkeys(names)))
    return NotInCatalogError(f"the catalog has no {kind} {name!r}", value=name, remedy=remedy)
