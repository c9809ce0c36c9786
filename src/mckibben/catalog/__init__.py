"""Published specimens, parameters and tables, one file per publication, in the units of the source.

>>> from mckibben import catalog
>>> catalog.names("laws")
['lei-mas-10-180n', 'sarosi-dmsp-10']
>>> print(catalog.cite("dmsp-10-250-martens2017"))
M. Martens and I. Boblan, "Modeling the Static Force of a Festo Pneumatic Muscle Actuator: ...
"""

from __future__ import annotations

import functools
import importlib
from importlib import resources
from typing import TYPE_CHECKING, Any

from mckibben.errors import NotInCatalogError, closest, suggest
from mckibben.numerics.runtime import programs_folder
from mckibben.storage.private import listing

if TYPE_CHECKING:
    from mckibben.catalog.entries import (
        dataset,
        geometry,
        joint,
        law,
        leg_section,
        load,
        specimen,
        valve,
        valve_section,
    )

__all__ = [
    "cite",
    "dataset",
    "geometry",
    "joint",
    "law",
    "leg_section",
    "load",
    "names",
    "specimen",
    "valve",
    "valve_section",
]

KINDS = ("specimens", "laws", "datasets", "geometries", "loads", "joints", "valves", "legs", "robots")
FOLDER = resources.files("mckibben.catalog")


def names(kind: str) -> list[str]:
    """Return the names of a kind: "specimens", "laws", "datasets", "geometries", "loads", "joints", "valves", "legs" or
    "robots".

    Raises `NotInCatalogError` for any other kind.
    """
    if kind not in KINDS:
        raise NotInCatalogError(f"the catalog has no {kind!r}", value=kind, remedy=f"it has {', '.join(KINDS)}")
    return [name for publication in _publications() for name in publication.get(kind, {})]


def cite(name: str) -> str:
    """Return the source of an entry, the location within it, and notes."""
    entries = [
        (publication, publication[kind][name])
        for publication in _publications()
        for kind in KINDS
        if name in publication.get(kind, {})
    ]
    if not entries:
        raise _unknown("entry", name, [known for kind in KINDS for known in names(kind)])
    publication = entries[0][0]
    places = "; ".join(dict.fromkeys(entry["where"] for _, entry in entries))
    return "\n".join([publication["source"], f"({places})", *(f"- {note}" for note in publication.get("notes", []))])


def find(kind: str, name: str) -> tuple[dict[str, Any], str]:
    """Return an entry in the units of its source, with the source."""
    for publication in _publications():
        if name in publication.get(kind, {}):
            return publication[kind][name], publication["source"]
    raise _unknown(_SINGULAR[kind], name, names(kind))


_SINGULAR: dict[str, str] = dict(
    zip(KINDS, ("specimen", "law", "dataset", "geometry", "load", "joint", "valve", "leg", "robot"), strict=True)
)


@functools.cache
def _publications() -> tuple[dict[str, Any], ...]:
    return tuple(listing(programs_folder(), "catalog", _read)["publications"])


def _read() -> dict[str, Any]:
    from ruamel.yaml import YAML

    reader = YAML(typ="safe", pure=True)
    files = sorted((f for f in FOLDER.iterdir() if f.name.endswith(".yaml")), key=lambda f: f.name)
    return {"publications": [reader.load(file.read_text(encoding="utf-8")) for file in files]}


def _unknown(kind: str, name: str, known: list[str]) -> NotInCatalogError:
    remedy = suggest(name, list(dict.fromkeys(known)))
    return NotInCatalogError(f"the catalog has no {kind} {name!r}", value=name, remedy=remedy)


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    if name in __all__:  # entries need JAX; names and sources do not
        return getattr(importlib.import_module("mckibben.catalog.entries"), name)
    meant = "" if name.startswith("_") else closest(name, __all__)
    raise AttributeError(f"mckibben.catalog has no {name!r}{f'; did you mean {meant}?' if meant else ''}")
