"""Overview of the catalog: force laws, published parameters, specimens, datasets and valves, with their sources."""

from __future__ import annotations

import math
from collections.abc import Iterator

from mckibben import catalog
from mckibben.muscle import LAWS
from mckibben.result import Column, Listing, Result


class Overview(Result):
    """Laws and entries of the catalog; `mckibben.catalog.cite` gives the source of an entry."""

    def verdict(self) -> str:
        kinds = ((kind, len(catalog.names(kind))) for kind in catalog.KINDS)
        return ", ".join([f"{len(LAWS)} force laws", *(f"{count} {kind}" for kind, count in kinds if kind != "laws")])

    def listings(self) -> Iterator[Listing]:
        name, source = Column(title="name"), Column(title="source")
        yield Listing(
            "Force laws",
            {
                "law": (Column(title="law"), list(LAWS)),
                "equation": (Column(title="equation"), [law.equation for law in LAWS.values()]),
                "source": (source, [law.source for law in LAWS.values()]),
            },
        )
        laws = {entry: catalog.law(entry) for entry in catalog.names("laws")}
        yield Listing(
            "Published parameters",
            {
                "name": (name, list(laws)),
                "law": (Column(title="law"), [type(law).__name__ for law in laws.values()]),
                "domain": (Column(title="domain"), [str(law.domain) for law in laws.values()]),
            },
        )
        specimens = {entry: catalog.specimen(entry) for entry in catalog.names("specimens")}
        yield Listing(
            "Specimens",
            {
                "name": (name, list(specimens)),
                "initial_length": (Column("m", "length", "mm"), [s.initial_length for s in specimens.values()]),
                "initial_diameter": (
                    Column("m", "diameter", "mm"),
                    [s.initial_diameter or math.nan for s in specimens.values()],
                ),
                "rated_force": (Column("N", "rated force"), [s.rated_force for s in specimens.values()]),
                "domain": (Column(title="domain"), [str(s.domain) for s in specimens.values()]),
            },
        )
        for kind in ("datasets", "valves"):
            entries = catalog.names(kind)
            sources = [catalog.cite(entry).splitlines()[0] for entry in entries]
            yield Listing(kind.capitalize(), {"name": (name, entries), "source": (source, sources)})
