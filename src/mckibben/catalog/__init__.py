"""Published specimens, parameters and tables, one file per publication, in the units of the source.

>>> from mckibben import catalog
>>> catalog.names("laws")
['lei-mas-10-180n', 'sarosi-dmsp-10']
>>> print(catalog.cite("dmsp-10-250-martens2017"))
M. Martens and I. Boblan, "Modeling the Static Force of a Festo Pneumatic Muscle Actuator: ...
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from mckibben.catalog.publications import KINDS as KINDS
from mckibben.catalog.publications import cite, names
from mckibben.catalog.publications import find as find
from mckibben.errors import closest

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


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    if name in __all__:  # entries need JAX; names and sources do not
        from mckibben.catalog import entries

        return getattr(entries, name)
    meant = "" if name.startswith("_") else closest(name, __all__)
    raise AttributeError(f"mckibben.catalog has no {name!r}{f'; did you mean {meant}?' if meant else ''}")
