"""The points that a record holds, as its events tell them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Self

from mckibben.rig.record import Event

POINT, PLACE = "point", "place"
"""The kinds of event: a point of the data was taken; one that only found a boundary was."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """A plateau that was recorded whole.

    Attributes
    ----------
    number
        Of all plateaus of the test, from 0.
    first, rows
        Which rows of the record are between its first and its last sample.
    every
        Of these each so manyth is a sample of the point: the card may sample faster than the protocol asks.
    samples
        Of the point.
    time
        Of the first sample, by the record's clock [s].
    pulses
        Where the motor stood, from where the muscle was mounted.
    contraction, force, pressure
        [-], and means [N], [Pa].
    set_pressure
        [Pa].
    direction, phase, repeat
        As in a dataset; the repeat is the number of the innermost one around it.
    keep
        Whether it is a point of the data.
    """

    number: int
    first: int
    rows: int
    every: int
    samples: int
    time: float
    pulses: int
    contraction: float
    force: float
    pressure: float
    set_pressure: float
    direction: str
    phase: str
    repeat: int
    keep: bool

    def to_json(self) -> dict[str, Any]:
        """As the data of an event."""
        return asdict(self)

    @classmethod
    def of(cls, event: Event) -> Self:
        """Of an event."""
        return cls(**event.data)


def points(events: Iterable[Event]) -> list[Point]:
    """The points among events, in the order of their numbers, each once."""
    found: dict[int, Point] = {}
    for event in events:
        if event.kind in (POINT, PLACE):
            point = Point.of(event)
            found.setdefault(point.number, point)
    return [found[number] for number in sorted(found)]
