"""YAML text to plain data with the line of every value; plain data to YAML; values edited in place."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mckibben.errors import Problem

Place = tuple[str | int, ...]
"""Keys and indices from the top of a document to a value."""

LONGEST_TEXT = 262_144
"""Characters of a configuration file; a real one has a few thousand."""

_DEEPEST = 12
_NULL = ("null", "~")
_TAGS = {f"tag:yaml.org,2002:{name}" for name in "str int float bool null map seq timestamp merge value".split()}


@dataclass
class Document:
    """Parsed YAML text with the line of every value.

    Attributes
    ----------
    data
        Mappings, tuples and text; scalars are not converted. None if the text is not YAML at all.
    lines
        Line of each key and item, by its place.
    problems
        Mistakes of the text, such as aliases, tags and repeated keys.
    rejected
        Places of values that are among the problems, and not in `data`.
    """

    data: Any = None
    lines: dict[Place, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    rejected: set[Place] = field(default_factory=set)

    def value(self, place: Place) -> object:
        """Return the value at a place; None if there is none."""
        value = self.data
        for key in place:
            try:
                value = value[key]
            except (KeyError, IndexError, TypeError):
                return None
        return value

    def line(self, place: Place) -> int | None:
        """The line of a place, or of the nearest enclosing one; None if the data were not read from a text."""
        while place and place not in self.lines:
            place = place[:-1]
        return self.lines.get(place)

    def known(self, place: Place, outer: Place = ()) -> Place:
        """The innermost place of the text at or above a place, not above an outer one; of no text, the place itself."""
        while self.lines and place and place not in self.lines and place != outer:
            place = place[:-1]
        return place

    def below(self, key: str) -> Document:
        """The document below a key, with the lines of the whole document."""
        lines = {place[1:]: line for place, line in self.lines.items() if place[:1] == (key,)}
        rejected = {place[1:] for place in self.rejected if place[:1] == (key,)}
        return Document(self.data[key], lines, self.problems, rejected)

    def is_rejected(self, place: Place) -> bool:
        """Whether a place, or one around it, already has a problem."""
        return any(place[: len(rejected)] == rejected for rejected in self.rejected)

    def reject(self, place: Place, line: int, message: str, remedy: str) -> None:
        """Add a problem for a value that is not allowed."""
        self.problems.append(Problem(message, line, dotted(place), remedy))
        self.rejected.add(place)

    def fail(self, message: str, *, line: int | None = None, remedy: str = "") -> Document:
        """Add a problem for which nothing can be read."""
        self.problems.append(Problem(message, line, remedy=remedy))
        return self

    def _read(self, node: Any, place: Place) -> object:
        """Return the value of a node; None, and a problem of the document, if it is not allowed."""
        line = self.line(place) or node.start_mark.line + 1
        if len(place) > _DEEPEST:
            return self.reject(place, line, f"is nested more than {_DEEPEST} deep", "use fewer levels")
        if node.anchor is not None:  # of this node, or of the one that an alias repeats
            return self.reject(place, line, f"{_short(node.anchor)} is an anchor", "write the value out where it is")
        if node.tag not in _TAGS:
            self.reject(place, line, f"{_short(str(node.tag))} is a tag", "leave it out")
        if node.id == "mapping":
            return self._read_mapping(node, place)
        if node.id == "sequence":
            return tuple(self._read_item(item, (*place, number)) for number, item in enumerate(node.value))
        if not node.value.isascii() and any("\ud800" <= char <= "\udfff" for char in node.value):
            self.reject(place, line, "has an escape of half a character", "write the character itself")
        if not node.style and node.value.lower() in _NULL:
            self.reject(place, line, "has no value", "write one, or leave the key out")
        return node.value

    def _read_item(self, node: Any, place: Place) -> object:
        """Return the value of an item of a list."""
        self.lines[place] = node.start_mark.line + 1
        return self._read(node, place)

    def _read_mapping(self, node: Any, place: Place) -> dict[str, object]:
        """Return the values of a mapping by their keys, without rejected ones."""
        items: dict[str, object] = {}
        for key, item in node.value:
            line, here = key.start_mark.line + 1, (*place, key.value if key.id == "scalar" else "?")
            if key.id != "scalar":
                self.reject(here, line, "a key is not text", "write `key: value`")
            elif key.value in items:
                message = f"is given twice, first in line {self.lines[here]}"
                self.problems.append(Problem(message, line, dotted(here), "keep one of them"))
            else:
                self.lines[here] = line
                value = self._read(item, here)
                if here not in self.rejected:
                    items[key.value] = value
        return items


def dotted(place: Place) -> str:
    """A place as text.

    >>> dotted(("reference", "angle", "amplitudes", 2))
    'reference.angle.amplitudes[2]'
    """
    text = "".join(f"[{key}]" if isinstance(key, int) else f".{_short(key)}" for key in place)
    return text.removeprefix(".")


def read_document(text: str) -> Document:
    r"""Parse YAML text. Never raises: mistakes are in `Document.problems`, also aliases, tags and repeated keys.

    Scalars stay text, so that ``no`` is not a flag and ``1e3`` not a text: their fields decide.

        >>> document = read_document("load: {mass: 1 kg}\nvalve: *ideal")
        >>> document.data, [str(problem) for problem in document.problems]
        (None, ["line 2: not YAML: found undefined alias 'ideal'; ..."])
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    document = Document()
    if len(text) > LONGEST_TEXT:
        return document.fail(
            f"is longer than {LONGEST_TEXT} characters",
            remedy="give long series of samples in a CSV file (samples: {file: reference.csv})",
        )
    yaml = YAML(typ="safe", pure=True)
    try:
        node = yaml.compose(text)
        if node is None or node.value == "":
            return document.fail("is empty", remedy="see examples/ for files to start from")
        document.lines[()] = node.start_mark.line + 1
        document.data = document._read(node, ())
    except YAMLError as error:
        _explain(error, text, document)
    except RecursionError:
        document.fail(f"is nested more than {_DEEPEST} deep", line=yaml.reader.line + 1)
    except (ValueError, ArithmeticError, AssertionError, LookupError) as error:  # malformed directives and escapes
        document.fail(f"not YAML: {error}", line=yaml.reader.line + 1)
    return document


def _explain(error: Any, text: str, document: Document) -> None:
    """A YAML error with its line and a remedy."""
    marks = [getattr(error, name, None) for name in ("problem_mark", "context_mark")]
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "it cannot be parsed"
    if "end of stream" in problem:  # the start of an unclosed item is more informative than the end of the text
        marks.reverse()
    mark = marks[0] or marks[1]
    position = getattr(error, "position", None)
    if mark is None:
        line = text.count("\n", 0, position) + 1 if isinstance(position, int) else None
        document.fail(f"not YAML: {problem}", line=line, remedy="is it a text file?")
        return
    lines = text.splitlines()
    line = mark.line + 1
    written = lines[mark.line] if mark.line < len(lines) else ""
    if "\t" in written[: len(written) - len(written.lstrip())] or written[mark.column : mark.column + 1] == "\t":
        document.fail("a tab in the indentation", line=line, remedy="indent with spaces")
        return
    if "<block end>, but found '<block mapping start>'" in problem:
        document.fail("is indented otherwise than its section", line=line, remedy="indent keys of a section alike")
        return
    remedy = "write `key: value`, one per line, indented with spaces, and quote text that contains ': ' or ' #'"
    document.fail(f"not YAML: {problem}", line=line, remedy=remedy)


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."


def edit_yaml(text: str, values: Mapping[Place, str]) -> str:
    """Return YAML text with other scalars, by their place; all else stays as it is.

    Missing sections and keys are added; a name in place of a section becomes its key `from`.

        >>> print(edit_yaml("load: knee  # of Table 2", {("load", "damping"): "0.1 N*m*s/rad"}))
        load: {from: knee, damping: 0.1 N*m*s/rad}  # of Table 2
    """
    for place, written in values.items():
        text = _edited(text, place, written)
    return text


def _edited(text: str, place: Place, written: str) -> str:
    from ruamel.yaml import YAML

    node, missing = YAML(typ="safe", pure=True).compose(text), list(place)
    while missing and (inner := _child(node, missing[0])) is not None:
        node = inner
        del missing[0]
    start, end = node.start_mark.index, node.end_mark.index
    if not missing:
        return text[:start] + written + text[end:]
    for key in reversed(missing[1:]):
        written = f"{{{key}: {written}}}"
    entry = f"{missing[0]}: {written}"
    if node.id != "mapping":
        return f"{text[:start]}{{from: {text[start:end]}, {entry}}}{text[end:]}"
    last = _end(node.value[-1][1]) if node.value else start + 1
    before, after = text[:last], text[last:]
    if node.flow_style:
        return f"{before}{', ' if node.value else ''}{entry}{after}"
    line, newline = f"{' ' * node.start_mark.column}{entry}", "\r\n" if "\r\n" in text else "\n"
    if before.endswith("\n"):  # a block scalar ends with its line
        return f"{before}{line}{newline}{after}"
    comment, ends, following = after.partition(newline)
    return f"{before}{comment}{newline}{line}{ends}{following}"


def _child(node: Any, key: str | int) -> Any:
    """Node of a key or index; None if there is none."""
    if node.id == "mapping":
        return next((item for name, item in node.value if name.value == key), None)
    return node.value[key] if node.id == "sequence" and isinstance(key, int) and key < len(node.value) else None


def _end(node: Any) -> int:
    """Index of the text behind a node, before comments that follow it."""
    if node.id == "scalar" or node.flow_style or not node.value:
        return node.end_mark.index
    last = node.value[-1]
    return _end(last[1] if node.id == "mapping" else last)


def plain(data: Any) -> Any:
    """The data of a document as mutable dictionaries and lists.

    >>> plain({"times": ("0 s", "1 s")})
    {'times': ['0 s', '1 s']}
    """
    if isinstance(data, dict):
        return {key: plain(value) for key, value in data.items()}
    return [plain(item) for item in data] if isinstance(data, tuple | list) else data


def to_text(data: Mapping[str, object], *, width: int = 100) -> str:
    """Return YAML of plain data, numbers with all digits, None left out; inner mappings up to `width` on one line.

    >>> print(to_text({"valve": {"time_constant": "20 ms", "delay": None}, "seeds": [1, 2]}), end="")
    valve: {time_constant: 20 ms}
    seeds: [1, 2]
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.resolver import VersionedResolver

    yaml, nulls = YAML(), [("tag:yaml.org,2002:null", re.compile("(~|null)?$", re.IGNORECASE))]  # all else is text
    yaml.Resolver = type("TextResolver", (VersionedResolver,), {"versioned_resolver": {None: nulls}})
    yaml.width = LONGEST_TEXT
    yaml.indent(mapping=2, sequence=4, offset=2)
    text = io.StringIO()
    yaml.dump(_node(data, (), width), text)
    return text.getvalue()


def shortened(text: str, known: str, digits: int = 6) -> str:
    """Return YAML whose numbers have at most some digits, but for those that stand in a known text.

    >>> shortened("{mass: 0.55901616813 kg, length: 201.2345678 mm}", "length: 201.2345678 mm")
    '{mass: 0.559016 kg, length: 201.2345678 mm}'
    """
    number = re.compile(r"(?<![\w.])-?\d+\.\d+(?:e[-+]?\d+)?(?![\w.])")
    kept = set(number.findall(known))
    return number.sub(lambda found: found[0] if found[0] in kept else f"{float(found[0]):.{digits}g}", text)


def _node(value: object, place: Place, width: int) -> object:
    """Return a value as it is dumped: scalars as text, mappings and lists of scalars on one line if they fit."""
    from ruamel.yaml.comments import CommentedMap, CommentedSeq
    from ruamel.yaml.scalarstring import SingleQuotedScalarString

    if isinstance(value, dict):
        items = {str(key): item for key, item in value.items() if item is not None}
        node = CommentedMap({_node(key, (), width): _node(item, (*place, key), width) for key, item in items.items()})
        nested = len(place) == 1 and any(isinstance(item, dict) for item in items.values())
        size = 2 * len(place) + len(f"{place[-1:]}{items}".replace("'", ""))
        is_block = nested or size > width or _has_rows(value) or place[-1:] in ((), ("",))
        is_flow = not (items and is_block)
    elif isinstance(value, list):
        node = CommentedSeq([_node(item, (*place, ""), width) for item in value])
        is_flow = not _has_rows(value)
    elif isinstance(value, str):
        return SingleQuotedScalarString(value) if value[:1] in ("?", ":") else value  # ruamel cannot read [?0]
    else:
        text = repr(value)
        return {"True": "true", "False": "false", "nan": ".nan", "inf": ".inf", "-inf": "-.inf"}.get(text, text)
    (node.fa.set_flow_style if is_flow else node.fa.set_block_style)()
    return node


def _has_rows(value: object) -> bool:
    """Whether it contains a list that is written with one item per line."""
    if isinstance(value, dict):
        return any(_has_rows(item) for item in value.values())
    return isinstance(value, list) and any(isinstance(item, dict | list) for item in value)
