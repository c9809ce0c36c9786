"""Delimited text files."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from mckibben.dataset.arrangement import labelled, titles
from mckibben.dataset.columns import SUBTRACT
from mckibben.dataset.headers import ABSOLUTE, is_unit, named_quantity, parse_header, same_unit
from mckibben.dataset.sheet import (
    COMMENTS,
    MENTIONED,
    NOT_APPLIED,
    RawColumn,
    RawTable,
    evidence,
    numeric_bytes,
    parse_numbers,
)
from mckibben.errors import DatasetError, Problem

_DELIMITERS = (",", ";", "\t", "|")
_PREAMBLE = 60  # lines searched for a header
_MOST_COLUMNS = 4096
_OF_PRESSURE = re.compile(r"press|druck|presi|(?<![a-z])(?:bar|psi|[km]?pa)(?![a-z])", re.IGNORECASE)
_LONGEST_HEADER = 2**18  # characters of a line searched for a header
_SHOWN = 80  # characters of a line in a message
_FIRST = 5  # lines in a message
_SEEN = 2**14  # texts of cells that are stored once
_PROBED = 200  # rows in which a cell may determine the decimal sign of a text of numbers
_JOINED = 20  # lines that a quoted cell may span
_NUMBER = re.compile(r"\s*[+-]?[.,]?[0-9][0-9.,]*(?:[eE][+-]?[0-9]+)?\s*")
_LINE = re.compile(r"[^\r\n]*(?:\r\n?|\n)|[^\r\n]+")
_ROW_NUMBER = re.compile(r"\s*[0-9]{1,15}\s*")
_TIME_STAMP = re.compile(r"^[0-9]{2}:[0-9]{2}:[0-9]{2}\.[0-9]{3} -> ", re.MULTILINE)  # of the Arduino IDE
_QUOTED = re.compile(r"""(?<![^;,\t|\n])(?:'([^'"\n]*)'|="([^"\n]*)"|""\"([^"\n]*)""\")(?=[;,\t|\r\n]|$)""")
_APOSTROPHE = re.compile(r"(?<![^;,\t|\n])'(?=[-+]?[.,]?[0-9][^';\t|\n]*(?:[;\t|\n]|$))")  # a number as text in Excel
_WORDS = re.compile(r"[^\W\d_]+|[^\s#:;,.()\[\]]")
_PLAIN = frozenset("hint note units unit in is are and all values hinweis einheit einheiten und".split())
_SPACED = re.compile(r"\"[^\"]*\"|[^\s\[(]+(?:[ \t]*[\[(][^\])]{0,99}[\])])?|\S+")

_Known = Callable[[str, str], bool]


def read_text(text: str, source: str, known: _Known, *, zeros: int = 0, decimal: str = "") -> RawTable:
    """Columns of a text: header after comments and preamble, an optional row of units, then rows."""
    if _TIME_STAMP.match(text):
        text = _TIME_STAMP.sub("", text)
    if _QUOTED.search(text, 0, _LONGEST_HEADER) or _APOSTROPHE.search(text, 0, _LONGEST_HEADER):
        text = _QUOTED.sub(r'"\1\2\3"', _APOSTROPHE.sub("", text))
    comments: dict[str, tuple[int, str]] = {}
    number = 0
    if table := labelled(text):
        text, number = table, -1
    stream = _Lines(text)
    named = ""  # the last comment, which is the header of a table of numbers, as numpy.savetxt writes it
    for line in stream:
        number += 1
        stripped = line.strip()
        if stripped and not stripped.startswith(("#", "%")):
            break
        named = stripped.lstrip("#% ") or named
        key, colon, value = stripped.lstrip("#%").partition(":")
        if colon and (name := key.strip().lower().replace(" ", "_")) in COMMENTS:
            comments[name] = (number, value.strip())
    else:
        raise DatasetError(source, [Problem("is empty" if not number else "has no header and no rows")])

    if len(line) > _LONGEST_HEADER:
        raise DatasetError(source, [_too_wide(f"{len(line)} characters", number)])
    lines, number = _header(line, stream, number, known)
    lines += islice(stream, max(0, 2 - len(lines)))
    if positions := _positions(lines[0]):
        if len(named) <= _LONGEST_HEADER and sum(known(one, "") for one in _split(named, _delimiter(named, known))) > 1:
            positions = ""
        lines, number = [positions or f"{named}\n", *lines], number - 1
    delimiter = _delimiter(lines[0], known)
    if (others := _delimiter_of_rows(lines, delimiter)) != delimiter:
        lines[0], delimiter = f"{others.join(_split(lines[0], delimiter))}\n", others
    if (count := len(_split(lines[0], delimiter))) > _MOST_COLUMNS:
        raise DatasetError(source, [_too_wide(f"{count} columns", number)])
    sheet = RawTable(header_line=number or None, comments=comments, delimiter=delimiter, has_header=not positions)
    if (numbers := _numbers(lines, stream, number, sheet, decimal, known)) is None:
        used = _cells(lines, stream, number, sheet, known)
    else:
        sheet.channels, used = numbers, set[int]()
    used |= {at for at, _ in comments.values()}
    mentioned: list[str] = []
    for at, line in enumerate(islice(_Lines(text), max(0, number - 1)), 1):
        if ABSOLUTE.search(line) and _OF_PRESSURE.search(line):
            words = repr(line.strip()[:_SHOWN])
            sheet.suspect.append(f"line {at} says {words}: pressures are read as gauge pressures; {SUBTRACT}")
        elif NOT_APPLIED.search(line) and at not in used:
            sheet.suspect.append(f"line {at} says {line.strip()[:_SHOWN]!r}, which is not applied to the numbers")
        elif MENTIONED.search(line) and at not in used and not _repeats_units(line, sheet):
            mentioned.append(f"{at} says {line.strip()[:_SHOWN]!r}")
    if mentioned:  # such as a load cell: in one warning, as most are harmless
        more = f" and {len(mentioned) - _FIRST} more lines" if len(mentioned) > _FIRST else ""
        shown = ", line ".join(mentioned[:_FIRST])
        sheet.suspect.append(f"line {shown}{more}: not applied to the numbers")
    sheet.suspect += split_numbers(sheet, known)
    check_last_line(text, text.count("\n") + 1, zeros, sheet)
    if not any(len(channel.cells) for channel in sheet.channels) and not sheet.problems and not sheet.corrupt:
        raise DatasetError(source, [Problem("has a header and no rows", line=sheet.header_line)])
    return sheet


def _repeats_units(line: str, sheet: RawTable) -> bool:
    """True for a line of quantities and units of the columns alone, such as: Hint: force in N, pressure in bar."""
    columns = [parse_header(each.label, each.unit) for each in sheet.channels]
    units = {column.unit for column in columns if column}
    words = [word for word in _WORDS.findall(line[:_SHOWN]) if word.lower() not in _PLAIN]
    stated = [word for word in words if not MENTIONED.fullmatch(word)]
    agree = all(any(same_unit(word, unit, "pressure") for unit in units) for word in stated)
    return len(line) <= _SHOWN and bool(stated) and agree


class _Lines:
    """Iterator of the lines of a text with their ends; `at` is the position of the next one."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if (match := _LINE.match(self.text, self.at)) is None:
            raise StopIteration
        self.at = match.end()
        return match[0]


def _positions(line: str) -> str:
    """Column positions, from 1, as the header for a line of numbers; else empty."""
    for delimiter in (";", "\t", ",", " "):
        cells = _split(line, delimiter)
        if len(cells) > 1 and all(map(_NUMBER.fullmatch, cells)):
            return f"{delimiter.join(map(str, range(1, len(cells) + 1)))}\n"
    return ""


def _too_wide(size: str, line: int) -> Problem:
    remedy = f"give a file of at most {_MOST_COLUMNS} columns, with a header of at most {_LONGEST_HEADER} characters"
    return Problem(f"the header has {size}", line=line, remedy=remedy)


def _header(line: str, stream: _Lines, number: int, known: _Known) -> tuple[list[str], int]:
    """Lines read from the stream, from the header on, and the line number of the header."""
    if _score(line, _delimiter(line, known), known)[0]:
        return [line], number
    lines = [line, *islice(stream, _PREAMBLE)]
    unitless = 0  # line of two quantities without units
    for index, candidate in enumerate(lines):
        if len(candidate) > _LONGEST_HEADER:
            break
        delimiter = _delimiter(candidate, known)
        cells = _split(candidate, delimiter)
        if index and _score(candidate, delimiter, known)[0] + sum(map(_known_word(lines, index, known), cells)) >= 2:
            return lines[index:], number + index
        if index and _is_units(above := _split(lines[index - 1], delimiter)) and sum(map(known, cells, above)) >= 2:
            return [candidate, lines[index - 1], *lines[index + 1 :]], number + index - 1  # units over the names
        numbered = not index and cells == [str(at) for at in range(1, len(cells) + 1)]  # columns, above their names
        if not numbered and max(3, len(cells) / 2) <= sum(bool(_NUMBER.fullmatch(cell)) for cell in cells):
            alike = [len(_split(line, delimiter)) == len(cells) for line in lines[:index]]
            unitless = unitless or next((at for at in range(index) if all(alike[at:])), 0)
            break  # a row: the header is among the lines above it that are as wide
        unitless = unitless or (index if sum(bool(named_quantity(cell)) for cell in cells) >= 2 else 0)
    return lines[unitless:], number + unitless


def _known_word(lines: Sequence[str], index: int, known: _Known) -> Callable[[str], bool]:
    """Predicate: a cell is a known name with the unit under it."""
    below = lines[index + 1] if index + 1 < len(lines) else ""
    delimiter = _delimiter(lines[index], known)
    under = dict(zip(_split(lines[index], delimiter), _split(below, delimiter), strict=False))
    return lambda cell: not known(cell, "") and known(cell, under.get(cell, ""))


def _delimiter(header: str, known: _Known) -> str:
    best = max(_DELIMITERS, key=lambda delimiter: _score(header, delimiter, known))
    words = _score(header, " ", known)
    return best if _score(header, best, known)[1] > 1 or words[1] < 2 else " "


def _delimiter_of_rows(lines: Sequence[str], delimiter: str) -> str:
    """Delimiter of a row of numbers as long as the header, where it is not that of the header."""
    names, row = _split(lines[0], delimiter), "".join(lines[1:2])

    def fits(one: str) -> bool:
        cells = _split(row, one)
        return len(cells) == len(names) > 1 and all(map(_NUMBER.fullmatch, cells))

    others = (one for one in _DELIMITERS if one not in lines[0] and fits(one))
    return delimiter if fits(delimiter) else next(others, delimiter)


def _score(header: str, delimiter: str, known: _Known) -> tuple[int, int]:
    cells = _split(header, delimiter)
    return sum(known(cell, "") for cell in cells), len(cells)


def _split(line: str, delimiter: str) -> list[str]:
    """Cells of a line, stripped; none if it cannot be parsed."""
    try:
        return [cell.strip() for cell in _parsed([line], delimiter)[0]]
    except csv.Error:
        return []


def _parsed(lines: Sequence[str], delimiter: str) -> tuple[list[str], int]:
    """Cells of the row that begins at the first line, and its number of lines."""
    if delimiter == " ":
        return [word.strip('"') for word in _SPACED.findall(lines[0])], 1
    if '"' not in lines[0]:
        return lines[0].rstrip("\r\n").split(delimiter), 1
    reader = csv.reader(lines, delimiter=delimiter)
    return next(reader, []), reader.line_num


def _numbers(
    lines: list[str], stream: _Lines, first: int, sheet: RawTable, decimal: str, known: _Known
) -> list[RawColumn] | None:
    """Columns of a purely numeric file, read by NumPy; None for any other file."""
    header, under = _split(lines[0], sheet.delimiter), _split("".join(lines[1:2]), sheet.delimiter)
    skipped = 1 + _is_units(under)
    body = "".join(lines[skipped:]) + stream.text[stream.at :]
    probed = [_split(line, sheet.delimiter) for line in islice(_Lines(body), _PROBED)]
    sign = "," if "," in body and sheet.delimiter != "," else "."
    if '"' in lines[0] or not body.isascii() or body.encode().translate(None, numeric_bytes(sheet.delimiter, sign)):
        return None
    if sign in body and sheet.delimiter != "," and not decimal and not _decided(header, under, probed, known):
        return None  # 1.234 may be 1234
    if decimal not in ("", sign) and sign in body:
        return None
    raw = body.encode()
    del body  # of a large text
    try:
        numbers = parse_numbers(raw, sheet.delimiter, sign, len(header))
    except ValueError:  # an empty cell, or rows of unequal length: parsed one by one
        return None
    count = len(numbers)
    units = under if skipped > 1 else [""] * len(header)
    rows = range(first + skipped, first + skipped + count)
    columns = np.ascontiguousarray(numbers.T)
    return [
        RawColumn(name, column, rows, unit=unit) for name, column, unit in zip(header, columns, units, strict=False)
    ]


def _decided(header: Sequence[str], units: Sequence[str], rows: Sequence[Sequence[str]], known: _Known) -> bool:
    """True if a cell of a known column in these rows determines the decimal sign; of any column if none is known."""
    spelled = [*units, *[""] * len(header)]
    read = [at for at, name in enumerate(header) if known(name, spelled[at])] or range(len(header))
    return any(evidence(row[at]) in (".", ",") for row in rows for at in read if at < len(row))


class _Row(NamedTuple):
    """Row with its first line."""

    cells: list[str]
    line: int


def _cells(lines: list[str], stream: _Lines, first: int, sheet: RawTable, known: _Known) -> set[int]:
    """Columns of any other file, and its corrupt rows; returns the lines of titles above blocks."""
    lines = [*lines, *_LINE.findall(stream.text, stream.at)]
    rows, comments = [], []
    for row in _rows(lines, first, sheet):
        if len(rows) == 1 and all(map(_RULER.fullmatch, map(str.strip, row.cells))):
            continue  # under the names, as in Markdown
        (comments if _COMMENT.match(row.cells[0].lstrip()) else rows).append(row)
    if not rows:
        return set()
    header = [cell.strip() for cell in rows[0].cells]
    sheet.header_line = rows[0].line or None
    skipped = 1 + (len(rows) > 1 and _is_units(rows[1].cells))
    if skipped > 1 and len(rows) > 2 and _has_no_number(rows[2]):  # the comments of Origin, under names and units
        sheet.suspect.append(f"line {rows[2].line} has no number; it is left out")
        del rows[2]
    while len(rows) > skipped and _is_remark(rows[-1], len(header)):
        sheet.suspect.append(f"line {rows[-1].line}, after the last row, has no number; it is left out")
        del rows[-1]
    units = [cell.strip() for cell in rows[1].cells] if skipped > 1 else []
    repeated = [header, units] if units else [header]
    above = [_Row([line.strip()], at) for at, line in enumerate(islice(_Lines(stream.text), max(0, first - 1)), 1)]
    preamble = {row.cells[0] for row in above}
    headed = titles(above, rows[skipped:], known) if len(header) > 1 else {}
    lonely = [row for row in rows[skipped:] if len(row.cells) == 1 < len(header)]
    words = [] if headed else [row for row in lonely if _WORD.match(row.cells[0].lstrip())]
    sheet.suspect += _remarks(sorted([*comments, *words], key=lambda row: row.line), rows[1:], sheet.delimiter)
    left_out = {row.line for row in words} | {*headed}
    rows = [
        row
        for row in rows[skipped:]
        if row.line not in left_out
        if row.cells[0].strip() not in {one[0] for one in repeated}
        or [cell.strip() for cell in row.cells] not in repeated
    ]
    rows = [row for row in rows if not preamble or sheet.delimiter.join(row.cells).strip() not in preamble]
    others = {row.line for row in rows if _is_other_header(row, known)}
    for line in sorted(others):
        remedy = "split the file there, and read the parts one by one"
        sheet.problems.append(Problem("is another header or row of units", line=line, remedy=remedy))
    rows = [row for row in rows if row.line not in others] if others else rows
    if rows and all(len(row.cells) == len(header) + 1 and _ROW_NUMBER.fullmatch(row.cells[0]) for row in rows):
        index = [int(row.cells[0]) for row in rows]
        counts = np.array_equal(np.diff(index), np.ones(len(rows) - 1)) and index[0] in (0, 1) and len(rows) > 1
        quoted = all(lines[row.line - first].lstrip().startswith('"') for row in rows)
        if counts and (sheet.delimiter not in ", " or quoted or not _may_be_split(rows, sheet.delimiter)):
            header = ["", *header]  # row numbers, which some programs write without a name
    del lines  # of a large text
    good: list[_Row] = []
    filled = sheet.delimiter != "," or known(header[-1], units[-1] if len(units) == len(header) else "")
    names = zip(header, [*units, *[""] * len(header)], strict=False)
    note_last = [known(name, unit) for name, unit in names] == [True] * (len(header) - 1) + [False]
    for row in rows:
        if len(row.cells) > len(header) and (filled or not _may_be_split([row], ",")):
            while len(row.cells) > len(header) and not row.cells[-1].strip():
                row.cells.pop()
        found, expected = len(row.cells), len(header)
        if note_last and found > expected and not _may_be_split([row], sheet.delimiter):
            row.cells[expected - 1 :] = [sheet.delimiter.join(row.cells[expected - 1 :])]  # a note with delimiters
            found = expected
        if found == expected:
            good.append(row)
            continue
        decimals = found > expected and sheet.delimiter == ","
        remedy = "decimal commas need semicolons between the columns" if decimals else ""
        message = f"has {found} cell{'s' if found != 1 else ''}, the header {expected}"
        sheet.corrupt.append(Problem(message, line=row.line, remedy=remedy))
    sheet.corrupt.sort(key=lambda problem: problem.line or 0)
    columns = list(zip(*(row.cells for row in good), strict=True)) or [()] * len(header)
    numbers = [row.line for row in good]
    units += [""] * (len(header) - len(units))
    sheet.channels = [
        RawColumn(name, cells, numbers, unit=unit) for name, cells, unit in zip(header, columns, units, strict=False)
    ]
    if headed:
        starts = sorted(headed)
        values = [headed[starts[at]].value for at in np.searchsorted(starts, numbers) - 1]
        name, unit, _ = headed[starts[0]]
        sheet.channels.append(RawColumn(name, values, numbers, unit=unit))
    return {*headed}


def _is_other_header(row: _Row, known: _Known) -> bool:
    """True for a row that changes names or units in the middle of a file."""
    if not _has_no_number(row):
        return False
    cells = [cell.strip() for cell in row.cells]
    return sum(known(cell, "") for cell in cells) > 1 or (
        _is_units(cells) and any(is_unit(cell) and cell != "-" for cell in cells)
    )


_RULER = re.compile(r":?[-=+]{2,}:?|")
_WORD = re.compile(r"[A-Za-z]{3}")
_COMMENT = re.compile(r"#(?!N/A|DIV/0!|VALUE!|REF!|NAME\?|NUM!|NULL!)")


def _remarks(comments: Sequence[_Row], rows: Sequence[_Row], delimiter: str) -> Iterator[str]:
    """Warnings of comments that look like rows, and of others among the rows; an error of Excel is not a comment."""
    among = []
    for row in comments:
        rest = [row.cells[0].lstrip(" #"), *row.cells[1:]]
        if len(rest) > 1 and all(map(_NUMBER.fullmatch, rest)):
            yield f"line {row.line} is a comment and looks like a row; it is left out"
        elif rows and rows[0].line < row.line < rows[-1].line and any(map(str.strip, rest)):
            among.append(row)
    for row in comments:
        words = delimiter.join(row.cells).strip()[:_SHOWN]
        if rows and row.line > rows[-1].line and (MENTIONED.search(words) or NOT_APPLIED.search(words)):
            yield f"line {row.line} says {words!r}, which is not applied to the numbers"
    if among:
        words = repr(delimiter.join(among[0].cells).strip()[:_SHOWN])
        yield f"line {among[0].line} is a comment among the rows, the first of {len(among)}, and not applied: {words}"


def _is_remark(row: _Row, columns: int) -> bool:
    """True for a row without a number that has another count of cells, or words in the first one alone."""
    alone = columns > 1 and not any(map(str.strip, row.cells[1:]))
    return _has_no_number(row) and (len(row.cells) != columns or alone) and not _positions(" ".join(row.cells))


def _has_no_number(row: _Row) -> bool:
    return not any(map(_NUMBER.fullmatch, row.cells))


def _may_be_split(rows: Sequence[_Row], delimiter: str) -> bool:
    """True if two neighbouring cells of some row can be one number, as 1,5 or 1,234 or 1 234.

    For several rows, only their first two cells are compared, and one row in which these are two numbers decides.
    """
    rest = re.compile(r"[0-9]{3}(?:[.][0-9]*)?" if delimiter == " " else r"[0-9]+|[0-9]{3}[.][0-9]*")
    pairs = [
        pair
        for row in rows
        for pair in list(zip(row.cells, row.cells[1:], strict=False))[: 1 if len(rows) > 1 else None]
    ]
    found = [bool(re.fullmatch(r"[+-]?[0-9]+", a.strip()) and rest.fullmatch(b.strip())) for a, b in pairs]
    return all(found) if len(rows) > 1 else any(found)


def split_numbers(sheet: RawTable, known: _Known) -> Iterator[str]:
    """Warnings of thousands that the delimiter may have split: whole numbers up to 99, then three digits, not read."""
    if sheet.delimiter not in ", ":
        return
    for one, after in zip(sheet.channels, sheet.channels[1:], strict=False):
        if known(one.name, one.unit) and not known(after.name, after.unit):
            pairs: Any = (one.cells, after.cells)
            if not all(isinstance(cells, np.ndarray) for cells in pairs):
                pairs = [(a, b) for a, b in zip(*pairs, strict=True) if str(b).strip()]
                try:
                    pairs = np.array(pairs, np.float64).reshape(-1, 2).T
                except ValueError:
                    continue
            a, b = pairs
            if len(a) and np.all((a % 1 == 0) & (a >= 1) & (a <= 99) & (b % 1 == 0) & (b >= 0) & (b <= 999)):
                found = f"{a[0]:.0f}{b[0]:03.0f}"
                yield f"{one.name!r} and {after.name!r} may be one number, {found}, split by the delimiter"


def _rows(lines: list[str], first: int, sheet: RawTable) -> Iterator[_Row]:
    """Non-blank rows; lines with an unclosed quotation mark are corrupt, the lines after them are not."""
    at = width = 0
    seen: dict[str, str] = {}  # each text once, as many rows repeat those of others
    while at < len(lines):
        try:
            if sheet.delimiter == " " or '"' in lines[at]:
                cells, count = _parsed(lines[at : at + _JOINED], sheet.delimiter)
            else:
                cells, count = lines[at].rstrip("\r\n").split(sheet.delimiter), 1
            blank = not (cells and ((cells[0] and not cells[0].isspace()) or "".join(cells).strip()))
            swallows = count > 1 and width and (len(cells) != width or _inner(lines, at, count, sheet) >= width - 1)
            if swallows or (blank and lines[at].count('"') % 2):
                raise csv.Error("a quotation mark is not closed")
        except csv.Error as error:
            count = 1
            sheet.corrupt.append(Problem(f"cannot be read: {error}", line=first + at))
        else:
            if not blank:
                width = width or len(cells)
                same = seen.setdefault if len(seen) < _SEEN else seen.get
                yield _Row([same(cell, cell) for cell in cells], first + at)
        at += count


def _inner(lines: list[str], at: int, count: int, sheet: RawTable) -> int:
    """Largest number of delimiters in the lines after the first of a row."""
    return max(line.count(sheet.delimiter) for line in lines[at + 1 : at + count])


def _is_units(row: Sequence[str]) -> bool:
    """True if a row has units instead of numbers."""
    cells = [cell.strip() for cell in row if cell.strip()]
    found = sum(map(is_unit, cells))
    return 2 * found >= len(cells) > 0 < found and not any(_NUMBER.fullmatch(cell) for cell in cells)


def check_last_line(text: str, last: int, zeros: int, sheet: RawTable) -> None:
    """Report a truncated last line, with number `last`, of a text or of its end."""
    lengths = [channel.lines[-1] for channel in sheet.channels if len(channel.lines)]
    ends = max([*lengths, *(problem.line or 0 for problem in sheet.corrupt)], default=0)
    if zeros and text.endswith(("\n", "\r")):
        sheet.suspect.append(f"the file ends in {zeros} zero bytes after line {last - 1}: rows may be missing")
    elif zeros:
        message = f"the file ends in {zeros} zero bytes: it was truncated while being written"
        sheet.corrupt.append(Problem(message, line=last))
    if text.endswith(("\n", "\r")) or ends < last:
        return
    if sheet.corrupt and sheet.corrupt[-1].line == last and not zeros:
        cut = sheet.corrupt[-1]
        if "has" in cut.message and not cut.remedy:
            sheet.corrupt[-1] = Problem(f"{cut.message}, and no line end: the file was truncated here", line=last)
    elif sheet.channels and not zeros and (short := _short(text, sheet.delimiter)):
        sheet.suspect.append(f"line {last} has no line end and {short}; the file may be truncated there")


def _short(text: str, delimiter: str) -> str:
    """Evidence of a truncated last number: fewer decimals than all above; empty if there is none."""
    tail = [
        re.search(r"\.([0-9]+)\s*$" if delimiter == "," else r"[.,]([0-9]+)\s*$", line)
        for line in text.rsplit("\n", 12)[-12:]
    ]
    decimals = [len(match[1]) if match else 0 for match in tail]
    if len(decimals) < 5 or len(set(decimals[:-1])) > 1 or decimals[-1] >= decimals[0]:
        return ""
    return f"its last number has {decimals[-1]} decimals where others have {decimals[0]}"
