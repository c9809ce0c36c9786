"""Reader of Excel workbooks (.xlsx)."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from mckibben.dataset.columns import is_unit
from mckibben.dataset.sheet import RawColumn, RawTable, RowProblem, as_column
from mckibben.errors import DatasetError, Problem

_ROWS = 1_048_576  # of a sheet of Excel
_HEADER = 60  # rows in which a header is looked for
_SQUEEZED = 300  # times smaller than its content a workbook may be; sheets of numbers are 3 to 20 times
_LARGEST = 2**30  # bytes of a workbook's content


def read_excel(path: Path, data: bytes, known: Callable[[str, str], bool]) -> RawTable:
    """Read the sheets of a workbook that have a header. Formulas are read as their saved values.

    With one such sheet the columns are named as in it; with several ``sheet/column``.

    Raises
    ------
    DatasetError
        If openpyxl is not installed, the file cannot be read, or no sheet has a column.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        remedy = 'pip install "mckibben[excel]", or save the sheet as CSV'
        raise DatasetError(
            str(path), [Problem("is a workbook, and openpyxl is not installed", remedy=remedy)]
        ) from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
        if size > max(_SQUEEZED * len(data), 2**22) or size > _LARGEST:
            raise DatasetError(str(path), [Problem(f"is a workbook that would unpack to {size} bytes")])
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
        tables = {sheet.title: _rows(path, sheet) for sheet in book.worksheets}
    except DatasetError:
        raise
    except Exception as error:  # openpyxl raises nearly every kind on a damaged file
        text = (str(error) or type(error).__name__).splitlines()[0]
        problem = Problem(f"cannot be read as a workbook: {text}", remedy="save it again, or as CSV")
        raise DatasetError(str(path), [problem]) from error
    sheet = RawTable(kind=RowProblem)
    found = {title: _table(rows, known) for title, rows in tables.items()}
    filled = {title: channels for title, channels in found.items() if channels}
    for title, channels in filled.items():
        prefix = f"{title}/" if len(filled) > 1 else ""
        sheet.channels += [
            RawColumn(f"{prefix}{each.name}" if each.name else "", each.cells, each.lines, each.name, each.unit)
            for each in channels
        ]
    if not sheet.channels:
        raise DatasetError(str(path), [Problem("has no sheet with a header and rows")])
    return sheet


def _rows(path: Path, sheet: Any) -> list[tuple[int, tuple[Any, ...]]]:
    """Rows of a sheet that are not empty, with their numbers."""
    sheet.reset_dimensions()  # what the file says of its size is not always true
    rows = [
        (number, row)
        for number, row in enumerate(islice(sheet.iter_rows(values_only=True), _ROWS + 1), 1)
        if any(cell is not None and cell != "" for cell in row)
    ]
    if rows and rows[-1][0] > _ROWS:
        raise DatasetError(str(path), [Problem(f"sheet {sheet.title!r} has more than {_ROWS} rows")])
    return rows


def _table(rows: Sequence[tuple[int, tuple[Any, ...]]], known: Callable[[str, str], bool]) -> list[RawColumn]:
    """Columns of a sheet."""
    if len(rows) < 2:
        return []
    start = _start(rows, known)
    header = [_name(cell) for cell in rows[start][1]]
    while header and not header[-1]:
        header.pop()
    under = [_name(cell) for cell in rows[start + 1][1]]
    filled = [cell for cell in under if cell]
    has_units = 2 * sum(map(is_unit, filled)) >= len(filled) and not any(
        isinstance(cell, (int, float)) for cell in rows[start + 1][1]
    )
    body = rows[start + 1 + has_units :]
    if not body:
        return []
    units = (under if has_units else []) + [""] * len(header)
    lines = [number for number, _ in body]
    return [
        RawColumn(name, as_column([row[i] if i < len(row) else None for _, row in body]), lines, unit=units[i])
        for i, name in enumerate(header)
    ]


def _start(rows: Sequence[tuple[int, tuple[Any, ...]]], known: Callable[[str, str], bool]) -> int:
    """Index of the header: the first row, or a later one with two known names where the first has none."""
    for index, (_, row) in enumerate(rows[: min(_HEADER, len(rows) - 1)]):
        below = [_name(cell) for cell in rows[index + 1][1]] + [""] * len(row)
        names = [(_name(cell), unit if is_unit(unit) else "") for cell, unit in zip(row, below, strict=False)]
        if sum(known(name, unit) for name, unit in names) >= (1 if index == 0 else 2):
            return index
        if sum(isinstance(cell, (int, float)) for cell in row) >= 2:
            break
    return 0


def _name(cell: object) -> str:
    return "" if cell is None else str(cell).strip()
