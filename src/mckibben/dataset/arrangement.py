"""Tables with a column, a block or a sheet for each pressure, as tables with a row for each point."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from mckibben.dataset.headers import ACCEPTED, LONGEST_NAME, Header, parse_header, same_unit
from mckibben.dataset.sheet import RawColumn, RawTable

_NUMBER = r"(?P<value>[0-9]+(?:[.,][0-9]+)?)[ _]?(?P<unit>[A-Za-z]+)"
_AT = re.compile(
    rf"[\s_,@]*(?<![A-Za-z])(?:(?:at|for|bei|à)[\s_]+)?\(?(?<![\d+-])(?<!\d[.,]){_NUMBER}\)?(?=\s*(?:[\[(]|$))",
    re.IGNORECASE,
)
_DIRECTION = re.compile(r"[\s_(]*(?<![a-z])((?:un)?loading)\)?(?=\s*(?:[\[(]|$))", re.IGNORECASE)
_TITLE = re.compile(rf"[^\w]*(?P<name>[A-Za-z]+)\s*[=:]\s*{_NUMBER}[^\w]*")
_LABEL = re.compile(
    r"""["']?([A-Za-z][\w /%()[\]-]{0,60}?)["']?\s{0,9}[=:]\s{0,9}"""
    r"([-+]?[0-9][0-9.,]{0,30}(?<=[0-9])(?:[eE][-+]?[0-9]+)?(?: ?[A-Za-z%]+(?![\w ]*[=:]))?)"
)
_BETWEEN = re.compile(r"[{},;\s]*")
_LONGEST = 2000  # characters of a line of labelled numbers
_HEADED = 3  # rows of the smallest block under a pressure
_COVERED = 0.5  # of the range of all contractions: that of each block at a constant pressure
_CONSTANT, _APART = 0.02, 0.05  # of the largest pressure: range within a sheet, and least difference of two
_MOVES = ("contraction", "length", "displacement")


def one_row_per_point(sheet: RawTable, mapping: Mapping[str, str]) -> RawTable:
    """A table with a row for each point; columns of the mapping are left as they are."""
    if not mapping:
        _join_sheets(sheet)
    _stack_columns(sheet, mapping)
    _fill_blocks(sheet, mapping)
    return sheet


def _read(column: RawColumn, mapping: Mapping[str, str]) -> Header | None:
    """Meaning of a column's header, or of the one that it is given."""
    if column.name in mapping:
        return parse_header(mapping[column.name])
    return parse_header(column.label, column.unit, loose=True)


def _pressure_unit(spelled: str) -> str:
    """Accepted unit of a pressure; empty for anything else."""
    return next((unit for unit in ACCEPTED["pressure"] if same_unit(spelled, unit, "pressure")), "")


class _Row(Protocol):
    """Row of a text with its first line."""

    @property
    def cells(self) -> list[str]: ...
    @property
    def line(self) -> int: ...


class _Title(NamedTuple):
    """Title of a block of rows at a constant pressure."""

    name: str
    unit: str
    value: str


class _Condition(NamedTuple):
    """Force without the condition in its name, the pressure there with its unit, and the direction there."""

    label: str
    header: Header
    pressure: float | None
    unit: str
    direction: str


def _condition(column: RawColumn) -> _Condition | None:
    """Condition of a force such as "Force at 2 bar [N]" or "Force loading [N]"; None if there is none."""
    label = column.label[:LONGEST_NAME]
    at, way = _AT.search(label), _DIRECTION.search(label)
    unit = _pressure_unit(at["unit"]) if at else ""
    at = at if unit else None
    for found in sorted(filter(None, (at, way)), key=re.Match.start, reverse=True):
        label = label[: found.start()] + label[found.end() :]
    header = parse_header(label, column.unit)
    if not (at or way) or header is None or header.quantity != "force":
        return None
    pressure = float(at["value"].replace(",", ".")) if at else None
    return _Condition(label, header, pressure, unit, way[1].lower() if way else "")


def _stack_columns(sheet: RawTable, mapping: Mapping[str, str]) -> None:
    """Columns of forces at several pressures, or in both directions, as one, with columns of their conditions."""
    forces = {
        at: found
        for at, one in enumerate(sheet.channels)
        if one.name not in mapping and (found := _condition(one)) is not None
    }
    rest = [one for at, one in enumerate(sheet.channels) if at not in forces]
    given = {header.quantity for one in rest if (header := _read(one, mapping))}
    each = list(forces.values())
    pressures, ways = [one.pressure for one in each], [one.direction for one in each]
    if (
        len(forces) < 2
        or len({*zip(pressures, ways, strict=True)}) < len(forces)
        or len({(one.header, one.unit) for one in each}) > 1
        or (None in pressures) != ("pressure" in given)
        or (None in pressures and pressures.count(None) < len(forces))
        or ("" in ways and any(ways))
        or {"force", "time", *(["direction"] if any(ways) else [])} & given
    ):
        return
    columns = [sheet.channels[at] for at in forces]
    count, lines = len(columns[0].cells), [*columns[0].lines] * len(forces)
    if any(len(one.cells) != count for one in sheet.channels):
        return
    name = f"{columns[0].name} to {columns[-1].name}"
    stacked = [replace(one, cells=_concatenated([one.cells] * len(forces)), lines=lines) for one in rest]
    cells = _concatenated([one.cells for one in columns])
    notes = tuple(dict.fromkeys(note for one in columns for note in one.notes))
    missing = frozenset[int]().union(*(one.missing for one in columns))
    stacked.append(RawColumn(name, cells, lines, each[0].label, columns[0].unit, notes, missing))
    if None not in pressures:
        values = np.repeat(np.array(pressures, float), count)
        stacked.append(RawColumn(f"pressures of {name}", values, lines, f"pressure_{each[0].unit}"))
    if any(ways):
        words = [way for way in ways for _ in range(count)]
        stacked.append(RawColumn(f"directions of {name}", words, lines, "direction"))
    sheet.channels = stacked


def _concatenated(parts: Sequence[Any]) -> Any:
    """Cells of several columns, one after the other: an array of arrays, else a list."""
    if all(isinstance(part, np.ndarray) for part in parts):
        return np.concatenate(parts)
    return [cell if isinstance(cell, str) else repr(float(cell)) for part in parts for cell in part]


def _fill_blocks(sheet: RawTable, mapping: Mapping[str, str]) -> None:
    """Fill a pressure that stands only in the first row of each block, if each block repeats the contractions."""
    headers = [_read(one, mapping) for one in sheet.channels]
    places = {one.quantity: at for at, one in enumerate(headers) if one}
    move = next((places[name] for name in _MOVES if name in places), None)
    if move is None or "pressure" not in places:
        return
    column, moves = sheet.channels[places["pressure"]], sheet.channels[move].cells
    if isinstance(column.cells, np.ndarray) or len(column.cells) != len(moves):
        return
    starts = [at for at, cell in enumerate(column.cells) if cell.strip()]
    titles = [column.cells[at].strip() for at in starts]
    sizes = np.diff([*starts, len(column.cells)])
    changes = all(one != after for one, after in itertools.pairwise(titles))
    if len(starts) < 2 or starts[0] or min(sizes) < _HEADED or not changes:
        return
    try:
        values = np.array([str(cell).strip().replace(",", ".") for cell in moves], float)
    except ValueError:
        return
    ranges = np.array([np.ptp(part) for part in np.split(values, starts[1:])])
    if np.all(ranges > 0) and np.all(ranges >= _COVERED * np.ptp(values)):
        cells = [title for title, size in zip(titles, sizes, strict=True) for _ in range(size)]
        sheet.channels[places["pressure"]] = replace(column, cells=cells)
        count = len(cells) - len(starts)
        sheet.suspect.append(f"{count} empty cells of {column.name!r} are filled with the pressure of their block")


def _join_sheets(sheet: RawTable) -> None:
    """Sheets or groups with the same columns of numbers, each at its own pressure, as one after the other."""
    groups: dict[str, list[RawColumn]] = {}
    for one in sheet.channels:
        groups.setdefault(one.name.removesuffix(one.short) if one.short else "", []).append(one)
    labels = {tuple((one.short, one.unit) for one in columns) for columns in groups.values()}
    arrays = all(isinstance(one.cells, np.ndarray) for one in sheet.channels)
    if len(groups) < 2 or "" in groups or len(labels) > 1 or not arrays:
        return
    headers = [parse_header(one.label, one.unit) for one in next(iter(groups.values()))]
    at = next((index for index, one in enumerate(headers) if one and one.quantity == "pressure"), None)
    levels = []
    for title, columns in groups.items():
        if len({len(one.cells) for one in columns}) > 1:
            return
        if at is None:  # a sheet named 2 bar
            named = re.search(rf"(?:^|[\s_=]){_NUMBER}[/.]$", title)
            unit = _pressure_unit(named["unit"]) if named else ""
            if named is None or not unit:
                return
            values = np.full(len(columns[0].cells), float(named["value"].replace(",", ".")))
            columns.append(RawColumn(title, values, columns[0].lines, f"pressure_{unit}"))
        pressures = np.asarray(columns[-1 if at is None else at].cells)
        levels.append((float(pressures.min(initial=np.inf)), float(pressures.max(initial=-np.inf))))
    levels.sort()
    most = levels[-1][1]
    steady = all(high - low <= _CONSTANT * most for low, high in levels)
    if not steady or any(after[0] - one[1] < _APART * most for one, after in itertools.pairwise(levels)):
        return
    if len({tuple(one.short for one in columns) for columns in groups.values()}) > 1:  # titles in several units
        return
    sheet.channels = [
        RawColumn(
            each[0].short,
            np.concatenate([one.cells for one in each]),
            [line for one in each for line in one.lines],
            unit=each[0].unit,
            notes=tuple(dict.fromkeys(note for one in each for note in one.notes)),
        )
        for each in zip(*groups.values(), strict=True)
    ]
    shown = ", ".join(repr(title.rstrip("/.")) for title in groups)
    sheet.suspect.append(f"{shown} have the same columns at a pressure each, and are read one after the other")


def titles(above: Sequence[_Row], rows: Sequence[_Row], known: Callable[[str, str], bool]) -> dict[int, _Title]:
    """Titles of blocks, such as "p = 2 bar", by line: at least one under the header, and one before the first point."""
    found, first = {}, next((row.line for row in rows if len(row.cells) > 1), 0)
    for row in [*above, *rows]:
        match = _TITLE.fullmatch(row.cells[0][:LONGEST_NAME]) if len(row.cells) == 1 else None
        if match and known(match["name"], match["unit"]):
            found[row.line] = _Title(*match.group("name", "unit", "value"))
    under = {row.line for row in rows}
    begins = bool(under & {*found}) and min(found) < first
    return found if begins and len({one[:2] for one in found.values()}) == 1 else {}


def labelled(text: str) -> str:
    """Table of a text of lines such as "pressure_bar=2, force_N=100" or of JSON; empty for any other text."""
    if len(_LABEL.findall(text[:_LONGEST].lstrip().partition("\n")[0])) < 2:
        return ""
    rows, names = [], None
    for line in text.splitlines():
        row = _LABEL.findall(line) if len(line) <= _LONGEST else []
        if line.strip():
            names = names or [name for name, _ in row]
            if len(row) < 2 or [name for name, _ in row] != names or not _BETWEEN.fullmatch(_LABEL.sub("", line)):
                return ""
        rows.append(";".join(value for _, value in row))
    return "\n".join([";".join(names or []), *rows, ""]) if names else ""
