"""Where things stand in the text of a scenario, to the character."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from mckibben.study.parameters.survey import Place


@dataclass(frozen=True)
class Span:
    """Where something begins and ends in a text.

    Attributes
    ----------
    start, end
        Of a scalar its text, quotes included; of a mapping the first and the last thing in it.
    mapping
        Whether it is one.
    flow
        Whether it stands in braces, or is one in braces itself.
    column
        Of a mapping's first key.
    """

    start: int
    end: int
    mapping: bool
    flow: bool
    column: int = 0


def spans(text: str) -> dict[Place, Span]:
    """Where the mappings of a scenario's text are, and the scalars in them.

    >>> found = spans("load: {from: knee-table-2, mass2: 0.8 kg}")
    >>> found["load", "mass2"].start, found["load", "mass2"].end
    (34, 40)
    """
    from ruamel.yaml import YAML
    from ruamel.yaml import events as kinds

    found: dict[Place, Span] = {}
    events = YAML(typ="safe", pure=True).parse(text)
    for event in events:
        if isinstance(event, kinds.DocumentStartEvent):
            _read(next(events), events, (), False, found)
            break
    return found


def _read(event: Any, events: Iterator[Any], place: Place, flow: bool, found: dict[Place, Span]) -> int:
    """Take in what begins here; where it ends."""
    from ruamel.yaml import events as kinds

    if isinstance(event, kinds.MappingStartEvent):
        return _read_mapping(event, events, place, found)
    if isinstance(event, kinds.SequenceStartEvent):
        ends = event.end_mark.index
        while not isinstance(following := next(events), kinds.SequenceEndEvent):
            ends = _read(following, events, (*place, ""), flow, found)
        return following.end_mark.index if event.flow_style else ends
    found[place] = Span(event.start_mark.index, event.end_mark.index, mapping=False, flow=flow)
    return event.end_mark.index


def _read_mapping(event: Any, events: Iterator[Any], place: Place, found: dict[Place, Span]) -> int:
    from ruamel.yaml import events as kinds

    flow = bool(event.flow_style)
    start = end = event.start_mark.index + 1 if flow else event.start_mark.index
    column = event.start_mark.column
    while not isinstance(key := next(events), kinds.MappingEndEvent):
        end = _read(next(events), events, (*place, key.value), flow, found)
    found[place] = Span(start, end, mapping=True, flow=flow, column=column)
    return key.end_mark.index if flow else end
