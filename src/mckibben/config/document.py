"""YAML text as plain data with the line of every value, and back."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from mckibben.errors import Problem

Place = tuple[str | int, ...]
"""Where something is in a document: keys and indices, from the top."""

LONGEST_TEXT = 262_144
"""Characters of a scenario; a real one has a few thousand."""

_DEEPEST = 12


@dataclass
class Document:
    """Mappings, tuples and text, and where they stand.

    Attributes
    ----------
    data
        Mappings (of text), tuples, text; None where something was refused.
    lines
        The line of each key and each item of a list; the empty place is the document's.
    problems
        What was wrong with the text itself.
    refused
        Places whose value is among the problems: nothing more need be said of them.
    readable
        False if the text was no YAML: `data` then means nothing.
    """

    data: Any = None
    lines: dict[Place, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    refused: set[Place] = field(default_factory=set)
    readable: bool = True

    def line(self, place: Place) -> int | None:
        """The line of a place, or of the nearest thing around it."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place)

    def refuse(self, place: Place, line: int, message: str, remedy: str) -> None:
        """Note that a place holds something that no scenario may hold."""
        self.problems.append(Problem(message, line, dotted(place), remedy))
        self.refused.add(place)


def dotted(place: Place) -> str:
    """A place as people write it.

    >>> dotted(("reference", "angle", "multisine", "amplitudes", 2))
    'reference.angle.multisine.amplitudes[2]'
    """
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{_short(part)}" for part in place)
    return text.removeprefix(".")


def read_document(text: str) -> Document:
    r"""Read YAML text; whatever it is, the answer is a document.

    >>> document = read_document("duration: 10 s\nstart: {angle: 5 deg}")
    >>> document.data
    {'duration': '10 s', 'start': {'angle': '5 deg'}}
    >>> document.line(("start", "angle"))
    2
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    document = Document()
    if len(text) > LONGEST_TEXT:
        return _unreadable(
            document,
            f"is longer than {LONGEST_TEXT} characters",
            remedy="give long series of samples in a CSV file (samples: {file: wish.csv})",
        )
    try:
        events = YAML(typ="safe", pure=True).parse(text)
        _read_stream(events, document)
    except YAMLError as error:
        _explain(error, text, document)
    except _TooDeepError as error:
        _unreadable(document, f"is nested more than {_DEEPEST} deep", line=error.line)
    except ValueError as error:  # ruamel lets through what int() and chr() say of malformed directives and escapes
        _unreadable(document, f"not YAML: {error}")
    return document


class _TooDeepError(Exception):
    def __init__(self, line: int) -> None:
        super().__init__()
        self.line = line


def _read_stream(events: Iterator[Any], document: Document) -> None:
    from ruamel.yaml import events as kinds

    documents = 0
    for event in events:
        if not isinstance(event, kinds.DocumentStartEvent):
            continue
        documents += 1
        first = next(events)
        if documents == 1:
            document.lines[()] = first.start_mark.line + 1
            document.data = _read_node(first, events, (), document)
        else:
            line = event.start_mark.line + 1
            _unreadable(document, "a second document starts here", line=line, remedy="keep one scenario a file")
            return
    if document.data in (None, "") and not document.problems:
        _unreadable(document, "is empty", remedy="see examples/ for scenarios to start from")


def _read_node(event: Any, events: Iterator[Any], place: Place, document: Document) -> Any:
    from ruamel.yaml import events as kinds

    line = event.start_mark.line + 1
    if len(place) > _DEEPEST:
        raise _TooDeepError(line)
    if isinstance(event, kinds.AliasEvent):
        document.refuse(place, line, f"*{_short(event.anchor)} is an alias", "write the value out")
        return None
    if event.tag is not None:
        document.refuse(place, line, f"{_short(str(event.tag))} is a tag", "leave it out")
    if isinstance(event, kinds.ScalarEvent):
        return event.value
    if isinstance(event, kinds.SequenceStartEvent):
        return _read_list(events, place, document)
    return _read_mapping(events, place, document)


def _read_list(events: Iterator[Any], place: Place, document: Document) -> tuple[Any, ...]:
    from ruamel.yaml import events as kinds

    items = []
    for event in events:
        if isinstance(event, kinds.SequenceEndEvent):
            break
        here = (*place, len(items))
        document.lines[here] = event.start_mark.line + 1
        items.append(_read_node(event, events, here, document))
    return tuple(items)


def _read_mapping(events: Iterator[Any], place: Place, document: Document) -> dict[str, Any]:
    from ruamel.yaml import events as kinds

    items: dict[str, Any] = {}
    for event in events:
        if isinstance(event, kinds.MappingEndEvent):
            break
        line = event.start_mark.line + 1
        if not isinstance(event, kinds.ScalarEvent):
            _read_node(event, events, (*place, "?"), Document())
            _read_node(next(events), events, (*place, "?"), Document())
            document.refuse((*place, "?"), line, "a key is no word", "write `key: value`")
            continue
        key = event.value
        here = (*place, key)
        if key in items:
            _read_node(next(events), events, here, Document())
            first = document.lines[here]
            document.problems.append(
                Problem(f"stands twice, first in line {first}", line, dotted(here), "keep one of them")
            )
            continue
        document.lines[here] = line
        items[key] = _read_node(next(events), events, here, document)
    return items


def _unreadable(document: Document, message: str, *, line: int | None = None, remedy: str = "") -> Document:
    document.problems.append(Problem(message, line, remedy=remedy))
    document.readable = False
    return document


def _explain(error: Any, text: str, document: Document) -> None:
    """A YAML error in our words, with its line."""
    marks = [getattr(error, name, None) for name in ("problem_mark", "context_mark")]
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it cannot be parsed"
    if "end of stream" in problem:  # where it began says more than that the text ended
        marks.reverse()
    mark = marks[0] or marks[1]
    position = getattr(error, "position", None)
    if mark is None:
        line = text.count("\n", 0, position) + 1 if isinstance(position, int) else None
        _unreadable(document, f"not YAML: {problem}", line=line, remedy="is it a text file?")
        return
    lines = text.splitlines()
    line = mark.line + 1
    written = lines[mark.line] if mark.line < len(lines) else ""
    if "\t" in written[: len(written) - len(written.lstrip())] or written[mark.column : mark.column + 1] == "\t":
        _unreadable(document, "a tab in the indentation", line=line, remedy="indent with spaces")
        return
    remedy = "write `key: value`, one to a line, indented with spaces, and quote text that holds ': ' or ' #'"
    _unreadable(document, f"not YAML: {problem}", line=line, remedy=remedy)


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."


_WIDTH = 100
_PLAIN = re.compile(r"[A-Za-z0-9_./+-](?:[A-Za-z0-9_./*^()+ -]*[A-Za-z0-9_./*^()+-])?")
_PLAIN_IN_BLOCK = re.compile(rf"{_PLAIN.pattern}(?:,(?: ?{_PLAIN.pattern})?)*")
_MEANS_ANOTHER = re.compile(r"(?i)-|---|\.\.\.|true|false|yes|no|on|off|null")


def to_text(data: dict[str, Any]) -> str:
    """YAML text of mappings, lists and scalars; what is None is left out.

    >>> print(to_text({"duration": "10 s", "start": {"angle": "5 deg", "stiffness": None}}), end="")
    duration: 10 s
    start: {angle: 5 deg}
    """
    return "".join(f"{line}\n" for line in _block(data, 0))


def _block(data: dict[str, Any], indent: int) -> list[str]:
    lines = []
    pad = "  " * indent
    for key, value in data.items():
        if value is None:
            continue
        one_line = f"{pad}{key}: {_flow(value) if isinstance(value, dict | list) else _scalar(value)}"
        if not isinstance(value, dict) or (len(one_line) <= _WIDTH and (indent > 0 or not _is_nested(value))):
            lines.append(one_line)
        else:
            lines += [f"{pad}{key}:", *_block(value, indent + 1)]
    return lines


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(item)}" for key, item in value.items() if item is not None) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_flow(item) for item in value) + "]"
    return _scalar(value, flow=True)


def _scalar(value: Any, *, flow: bool = False) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if not isinstance(value, str):
        return str(value)
    plain = (_PLAIN if flow else _PLAIN_IN_BLOCK).fullmatch(value)
    if plain and not _MEANS_ANOTHER.fullmatch(value) and not value.startswith("- "):
        return value
    return json.dumps(value, ensure_ascii=not value.isprintable())


def _is_nested(value: dict[str, Any]) -> bool:
    return any(isinstance(item, dict) for item in value.values())
