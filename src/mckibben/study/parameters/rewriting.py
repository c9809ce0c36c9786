"""Scenario files with other parameter values, edited in place."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from mckibben.errors import ScenarioError
from mckibben.study.parameters.parameter import Place, find_parameters
from mckibben.study.parameters.values import with_values
from mckibben.study.scenario import Scenario


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


def edit_yaml(text: str, values: Mapping[str, float | int], *, folder: str | os.PathLike[str] = ".") -> str:
    """The text of a scenario with other numbers; comments, order and layout stay.

    A number that was not written is added to its mapping. Numbers come in the units of `Scenario.dumps`, with all the
    digits that it takes to read them back to the last bit; round them before if fewer will do.

    Parameters
    ----------
    text
        Of a scenario.
    values
        In SI, by name.
    folder
        To which paths in the text are relative.

    Returns
    -------
    text
        Which reads as `with_values` of the scenario. Where YAML's stranger forms defeat the change in place, the
        scenario is written anew, without its comments.

    Raises
    ------
    ScenarioError
        If the text is no scenario.
    ParameterError
        As for `with_values`.

    Examples
    --------
    >>> from pathlib import Path
    >>> text = Path("examples/pre-contracted-step-pid.yaml").read_text()
    >>> changed = edit_yaml(text, {"load.damping": 0.1, "valve.time_constant": 0.03})
    >>> for before, after in zip(text.splitlines(), changed.splitlines()):
    ...     if before != after:
    ...         print(after)
    load: {from: knee-table-2, damping: 0.1 N*m*s/rad}            # or, with a heavier weight, ...
    valve: {time_constant: 30 ms}   # or ideal: the pressure is what is commanded, at once
    """
    scenario = Scenario.parse(text, folder=folder)
    wanted = with_values(scenario, values)
    changed = text
    for parameter, value in zip(find_parameters(scenario, values), values.values(), strict=True):
        changed = _changed(changed, parameter.place, parameter.write(value))
    return changed if _reads_as(changed, wanted, folder) else wanted.dumps(folder=folder)


def _changed(text: str, place: Place, written: str) -> str:
    """The text with one number in it, in place of what stood there or added."""
    found = spans(text)
    *parent, key = place
    here, around = found.get(place), found.get(tuple(parent))
    if here is not None:
        return text[: here.start] + written + text[here.end :]
    if around is None:
        return _changed(text, tuple(parent), f"{{{key}: {written}}}")
    if around.mapping:
        return _added(text, tuple(parent), f"{key}: {written}")
    if key != "constant":  # the name alone stands for `from`
        written = f"{{from: {text[around.start : around.end]}, {key}: {written}}}"
    return text[: around.start] + written + text[around.end :]


def _added(text: str, place: Place, entry: str) -> str:
    """The text with another entry at the end of a mapping."""
    mapping = spans(text)[place]
    before, after = text[: mapping.end], text[mapping.end :]
    if mapping.flow:
        return f"{before}{entry if mapping.start == mapping.end else f', {entry}'}{after}"
    line = f"{' ' * mapping.column}{entry}"
    newline = "\r\n" if "\r\n" in text else "\n"
    if before.endswith("\n"):  # a block of text ends with its line
        return f"{before}{line}{newline}{after}"
    rest, ends, following = after.partition(newline)
    return f"{before}{rest}{newline}{line}{ends}{following}"


def _reads_as(text: str, wanted: Scenario, folder: str | os.PathLike[str]) -> bool:
    try:
        return Scenario.parse(text, folder=folder) == wanted
    except ScenarioError:
        return False
