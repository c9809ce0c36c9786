"""A delimited text file as cells that know their line."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from mckibben.errors import DatasetError, Problem

_DELIMITERS = (",", ";", "\t")
_SIGNATURES = {
    b"\xff\xfe": "is UTF-16 text",
    b"\xfe\xff": "is UTF-16 text",
    b"PK\x03\x04": "is a workbook or an archive",
    b"\x89HDF": "is a NetCDF or HDF5 file",
}
_REMEDIES = {
    "is UTF-16 text": "save it as UTF-8",
    "is a workbook or an archive": "save the sheet as CSV",
    "is a NetCDF or HDF5 file": "give it the suffix .nc",
}


@dataclass
class Sheet:
    """The cells of a file.

    Attributes
    ----------
    comments
        From the leading ``# key: value`` lines: the number of the line and the value, by key.
    header
        The names of the columns, stripped.
    header_line
        The number of its line.
    rows, lines
        Rows with as many cells as the header, and the number of the line on which each begins.
    problems
        The rows that have another number of cells, and whatever made the file unreadable after a line.
    """

    delimiter: str
    header: list[str]
    header_line: int
    comments: dict[str, tuple[int, str]] = field(default_factory=dict)
    rows: list[list[str]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)


def read_sheet(path: Path, known: Callable[[str], bool]) -> Sheet:
    """Read a file of cells.

    The delimiter is that of comma, semicolon and tab which gives the header most names that are `known`,
    then most names. Blank lines, and rows of empty cells only, are passed over.

    Raises
    ------
    DatasetError
        If the file cannot be opened, is no UTF-8 text, or has no header or no row.
    """
    stream = io.StringIO(_text(path), newline="")
    comments: dict[str, tuple[int, str]] = {}
    number = 0
    for line in stream:
        number += 1
        text = line.strip()
        if text and not text.startswith("#"):
            break
        key, colon, value = text.lstrip("#").partition(":")
        if colon:
            comments[key.strip()] = (number, value.strip())
    else:
        raise DatasetError(str(path), [Problem("is empty" if not number else "has no header and no rows")])

    delimiter = _delimiter(line, known)
    reader = csv.reader(chain([line], stream), delimiter=delimiter)
    rows = _numbered(reader, first=number)
    sheet = Sheet(delimiter, [], number, comments)
    try:
        sheet.header_line, header = next(rows, (number, []))
        sheet.header = [cell.strip() for cell in header]
        for at, row in rows:
            if len(row) == len(sheet.header):
                sheet.rows.append(row)
                sheet.lines.append(at)
            else:
                sheet.problems.append(_miscounted(at, row, sheet))
    except csv.Error as error:
        sheet.problems.append(Problem(f"cannot be read further: {error}", line=number + reader.line_num - 1))
    if not sheet.rows and not sheet.problems:
        raise DatasetError(str(path), [Problem("has a header and no rows", line=sheet.header_line)])
    return sheet


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise DatasetError(str(path), [Problem("there is no such file")]) from None
    except IsADirectoryError:
        raise DatasetError(str(path), [Problem("is a directory", remedy="name a file in it")]) from None
    except (OSError, ValueError) as error:
        raise DatasetError(str(path), [Problem(f"cannot be read: {error}")]) from None
    for signature, what in _SIGNATURES.items():
        if data.startswith(signature):
            raise DatasetError(str(path), [Problem(what, remedy=_REMEDIES[what])])
    if (at := data.find(b"\0")) >= 0:
        problem = Problem("is a binary file", line=data.count(b"\n", 0, at) + 1, remedy="give CSV text or NetCDF (.nc)")
        raise DatasetError(str(path), [problem])
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        message = f"byte 0x{error.object[error.start]:02x} is not UTF-8 text"
        raise DatasetError(str(path), [Problem(message, line=line, remedy="save the file as UTF-8")]) from None


def _delimiter(header: str, known: Callable[[str], bool]) -> str:
    def merit(delimiter: str) -> tuple[int, int]:
        try:
            cells = next(csv.reader([header], delimiter=delimiter), [])
        except csv.Error:
            return 0, 0
        return sum(known(cell.strip()) for cell in cells), len(cells)

    return max(_DELIMITERS, key=merit)


def _numbered(reader: Iterator[list[str]], first: int) -> Iterator[tuple[int, list[str]]]:
    """The rows that are not blank, each with the number of the line on which it begins."""
    begins = first
    for row in reader:
        if row and any(cell and not cell.isspace() for cell in row):
            yield begins, row
        begins = first + reader.line_num  # type: ignore[attr-defined]


def _miscounted(line: int, row: list[str], sheet: Sheet) -> Problem:
    found, expected = len(row), len(sheet.header)
    decimals = found > expected and sheet.delimiter == ","
    remedy = "decimal commas need semicolons between the columns" if decimals else ""
    return Problem(f"has {found} cell{'s' if found != 1 else ''}, the header {expected}", line=line, remedy=remedy)
