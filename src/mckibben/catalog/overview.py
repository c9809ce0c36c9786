"""Overview of the catalog: force laws, published parameters, specimens, datasets and valves, with their sources."""

from __future__ import annotations

import math

from mckibben import catalog
from mckibben.muscle import LAWS
from mckibben.result import Column, Result, TableColumns, table


class Overview(Result):
    """Laws and entries of the catalog; `mckibben.catalog.cite` gives the source of an entry."""

    def verdict(self) -> str:
        kinds = ((kind, len(catalog.names(kind))) for kind in catalog.KINDS)
        return ", ".join([f"{len(LAWS)} force laws", *(f"{count} {kind}" for kind, count in kinds if kind != "laws")])

    @table("Force laws")
    def laws(self) -> TableColumns:
        """Force laws with their equations and sources."""
        return {
            "law": (Column(), list(LAWS)),
            "equation": (Column(), [law.equation for law in LAWS.values()]),
            "source": (Column(), [law.source for law in LAWS.values()]),
        }

    @table("Published parameters")
    def parameters(self) -> TableColumns:
        """Laws with published parameters."""
        laws = {entry: catalog.law(entry) for entry in catalog.names("laws")}
        return {
            "name": (Column(), list(laws)),
            "law": (Column(), [type(law).__name__ for law in laws.values()]),
            "domain": (Column(), [str(law.domain) for law in laws.values()]),
        }

    @table("Specimens")
    def specimens(self) -> TableColumns:
        """Specimens with their sizes."""
        specimens = {entry: catalog.specimen(entry) for entry in catalog.names("specimens")}
        diameters = [specimen.initial_diameter or math.nan for specimen in specimens.values()]
        return {
            "name": (Column(), list(specimens)),
            "initial_length": (Column("m", "length", "mm"), [s.initial_length for s in specimens.values()]),
            "initial_diameter": (Column("m", "diameter", "mm"), diameters),
            "rated_force": (Column("N", "rated force"), [s.rated_force for s in specimens.values()]),
            "domain": (Column(), [str(s.domain) for s in specimens.values()]),
        }

    @table("Datasets")
    def datasets(self) -> TableColumns:
        """Datasets with their sources."""
        return _with_sources("datasets")

    @table("Valves")
    def valves(self) -> TableColumns:
        """Valves with their sources."""
        return _with_sources("valves")


def _with_sources(kind: str) -> TableColumns:
    entries = catalog.names(kind)
    sources = [catalog.cite(entry).splitlines()[0] for entry in entries]
    return {"name": (Column(), entries), "source": (Column(), sources)}
