"""Which column of a file is which quantity, and in which unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mckibben.dataset.headers import ACCEPTED, Column, foreign_unit, names, recognise
from mckibben.dataset.sheet import Sheet
from mckibben.errors import Problem

_SHOWN = 40  # names of the file's columns in a message


@dataclass
class Layout:
    """Where the columns of a file are.

    Attributes
    ----------
    places
        Index and meaning of each column of ours, by quantity.
    ignored
        The other headers.
    problems
        What is wrong with the header.
    """

    places: dict[str, tuple[int, Column]] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


def lay_out(sheet: Sheet, mapping: Mapping[str, str], needed: Sequence[str]) -> Layout:
    """Find the columns of ours in a file.

    Parameters
    ----------
    sheet
        Its columns.
    mapping
        From names in the file to names of ours. They go before what a header says by itself.
    needed
        The quantities that must be there; a length does for a contraction.

    Examples
    --------
    >>> from mckibben.dataset.sheet import Channel
    >>> headers = ["Druck [bar]", "contraction_percent", "note"]
    >>> sheet = Sheet([Channel(header, [], []) for header in headers], header_line=1)
    >>> layout = lay_out(sheet, {"Druck [bar]": "pressure_bar"}, ["pressure", "contraction", "force"])
    >>> layout.places["pressure"], layout.ignored
    ((0, Column(quantity='pressure', unit='bar')), ['note'])
    >>> print(*layout.problems)
    line 1: no column for force; the file has 'Druck [bar]', 'contraction_percent', 'note'; name it force_N ...
    """
    layout = Layout(ignored=list(sheet.ignored))
    header = sheet.names
    shown = ", ".join(map(repr, header[:_SHOWN])) + (f" ... ({len(header)} in all)" if len(header) > _SHOWN else "")

    def problem(message: str, field: str = "", remedy: str = "") -> None:
        layout.problems.append(sheet.kind(message, line=sheet.header_line, field=field, remedy=remedy))

    asked: set[str] = set()
    for given, name in mapping.items():
        column = recognise(name)
        if given not in header:
            problem(f"columns has {given!r}, the file {shown}")
        if column is None:
            problem(f"columns gives {given!r} the unknown name {name!r}", remedy=f"accepted are {_accepted()}")
        else:
            asked.add(column.quantity)
    for index, channel in enumerate(sheet.channels):
        text = channel.name
        mapped = text in mapping
        column = recognise(mapping[text]) if mapped else recognise(channel.label, channel.unit)
        if text and text in header[:index]:
            problem("stands twice in the header", text)
        elif column is None or (column.quantity in asked and not mapped):
            if column is None and not mapped and (reason := foreign_unit(channel.label, channel.unit)):
                problem(reason, text, f"accepted are {_accepted(channel.label)}")
            layout.ignored += [text] if text else []
        elif column.quantity in layout.places:
            first = header[layout.places[column.quantity][0]]
            remedy = "keep one of them, or tell by columns={...} which it is"
            problem(f"gives {column.quantity} again, after {first!r}", text, remedy)
        else:
            layout.places[column.quantity] = index, column
    for name in needed:
        if name not in layout.places and not (name == "contraction" and "length" in layout.places):
            wanted = names(name) + (f" (or {names('length')})" if name == "contraction" else "")
            remedy = f"name it {wanted}, or tell by columns={{...}} which it is"
            problem(f"no column for {name}; the file has {shown}", remedy=remedy)
    _same_length(sheet, layout)
    return layout


def _same_length(sheet: Sheet, layout: Layout) -> None:
    """Columns are read together row by row: they must be of one length."""
    read = [sheet.channels[index] for index, _ in layout.places.values()]
    for channel in read[1:]:
        if len(channel.cells) != len(read[0].cells):
            message = f"has {len(channel.cells)} values, {read[0].name!r} {len(read[0].cells)}"
            remedy = "read columns of one length"
            layout.problems.append(sheet.kind(message, field=channel.name, remedy=remedy))


def _accepted(header: str = "") -> str:
    quantities = [name for name in ACCEPTED if header.lower().startswith(name)] or list(ACCEPTED)
    return ", ".join(names(name) for name in quantities)
