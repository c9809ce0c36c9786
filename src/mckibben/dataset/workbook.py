"""Sheets of workbooks, read as lines."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Mapping
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import iterparse

from mckibben.dataset.raw import Budget, RawTable, not_installed, readable, several
from mckibben.dataset.table import question
from mckibben.dataset.text import find_layout, read_lines
from mckibben.errors import DatasetError, Problem

if TYPE_CHECKING:
    from openpyxl.worksheet.worksheet import Worksheet

_SHEET_BYTES = 2**24  # of XML of a workbook
_MOST_NESTED = 100  # elements, each of which openpyxl holds in memory until its end
_MARKS: Mapping[str, Callable[[Any], bool]] = {
    "struck out": lambda cell: bool(cell.font and cell.font.strike),
    "noted": lambda cell: cell.comment is not None,
    "coloured": lambda cell: bool(cell.fill and cell.fill.fill_type == "solid"),
}


def read_workbook(path: Path, data: bytes, mapping: Mapping[str, str], part: str, budget: Budget) -> RawTable:
    """Columns of the only sheet with a header, or of the sheet `part`; formulas as saved values.

    Raises a `DatasetError` if there are several such sheets or none, or the file is damaged or too large.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise not_installed(path, "openpyxl", "excel") from None
    with readable(path, "a workbook"):
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            size = sum(info.file_size for info in archive.infolist())
            if size > _SHEET_BYTES:
                text = f"has {size / 1e6:.0f} MB of XML, more than {_SHEET_BYTES / 1e6:.0f}"
                raise DatasetError(str(path), [Problem(text, remedy="save the sheet as CSV")])
            for info in archive.infolist():
                if info.filename.endswith(".xml"):
                    _check_nesting(path, archive.read(info))
        book = load_workbook(io.BytesIO(data), data_only=True, keep_links=False)
    sheets = [sheet for sheet in book.worksheets if part in ("", sheet.title)]
    lines = {sheet.title: _lines(sheet, budget) for sheet in sheets}
    tables = [sheet for sheet in sheets if find_layout(lines[sheet.title], mapping)]
    if not tables:
        text = f"no sheet has a header that is understood; it has {', '.join(book.sheetnames[:20])}"
        remedy = "name the columns: columns={'HEADER': 'force_N'} (command line: --column 'HEADER=force_N')"
        raise DatasetError(str(path), [Problem(text, remedy=remedy)])
    if len(tables) > 1:
        raise DatasetError(str(path), [several("sheets", [sheet.title for sheet in tables])])
    (sheet,) = tables
    texts = lines.pop(sheet.title)
    cells = chain.from_iterable(sheet.iter_rows(values_only=True))
    table = read_lines([*texts, ""], path, mapping, settled="." if any(isinstance(x, float) for x in cells) else "")
    table.place = "row"
    others = chain.from_iterable(lines.values())
    table.words += [(None, " ".join(line.split())) for line in others if line.strip()]
    table.questions += [question(text, "layout", field="layout") for text in _hidden(sheet, table.lines[0])]
    return table


def _check_nesting(path: Path, xml: bytes) -> None:
    """Raise a `DatasetError` if the elements of a part of a workbook are nested deeply."""
    depth = 0
    for event, element in iterparse(io.BytesIO(xml), ("start", "end")):
        depth += 1 if event == "start" else -1
        if depth > _MOST_NESTED:
            problem = Problem(f"has more than {_MOST_NESTED} nested elements of XML", remedy="save the sheet as CSV")
            raise DatasetError(str(path), [problem])
        if event == "end":
            element.clear()


def _lines(sheet: Worksheet, budget: Budget) -> list[str]:
    """Rows of a sheet as lines of cells between tabs."""
    budget.spend(rows=sheet.max_row, columns=sheet.max_column, size=8 * sheet.max_row * sheet.max_column)
    return ["\t".join(map(_text_of, row)) for row in sheet.iter_rows(values_only=True)]


def _text_of(cell: object) -> str:
    return "" if cell is None else repr(cell) if isinstance(cell, float) else re.sub(r'[\s"]+', " ", str(cell))


def _hidden(sheet: Worksheet, first: int) -> list[str]:
    """What a sheet shows of its numbers beside them: hidden and merged areas, and cells with a mark.

    A mark on all cells is a style, one on some of them says something of these.
    """
    rows = [str(row) for row, shape in sheet.row_dimensions.items() if shape.hidden and row >= first]
    columns = [letter for letter, shape in sheet.column_dimensions.items() if shape.hidden]
    hidden = [*rows, *columns, *["the sheet"] * (sheet.sheet_state != "visible")]
    merged = [str(area) for area in sheet.merged_cells.ranges if area.max_row >= first - 1]
    texts = [f"rows or columns are hidden: {', '.join(hidden[:5])}"] * bool(hidden)
    texts += [f"cells are merged: {', '.join(merged[:5])}"] * bool(merged)
    cells = [
        cell for row in sheet.iter_rows(min_row=first, max_row=first + 5000) for cell in row if cell.value is not None
    ]
    for word, is_marked in _MARKS.items():
        if 0 < (count := sum(map(is_marked, cells))) < len(cells):
            texts.append(f"{count} cells are {word}")
    return texts
