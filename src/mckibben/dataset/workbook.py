"""Sheets of workbooks, read as lines."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import iterparse

from mckibben.dataset.file_names import several
from mckibben.dataset.matrix import MATRIX, find_matrix, matrix_remedy, read_matrix
from mckibben.dataset.raw import Budget, RawTable, needs, readable
from mckibben.dataset.table import question, refusal
from mckibben.dataset.text import find_layout, read_lines

if TYPE_CHECKING:
    from openpyxl import Workbook
    from openpyxl.worksheet.worksheet import Worksheet

_SHEET_BYTES = 2**24  # of XML of a workbook
_QUOTED = re.compile(r'"([^"]*)"|\\(.)')  # texts in a format of numbers
_MOST_NESTED = 100  # elements, each of which openpyxl holds in memory until its end
_MARKS: Mapping[str, Callable[[Any], bool]] = {
    "struck out": lambda cell: bool(cell.font.strike),
    "coloured": lambda cell: bool(cell.fill.fill_type) or _ink(cell) not in ("", "1", "FF000000", "00000000"),
}


def read_workbook(path: Path, data: bytes, mapping: Mapping[str, str], part: str, budget: Budget) -> RawTable:
    """Columns of the only sheet with a header, or of the sheet `part`; formulas as saved values.

    Raises a `DatasetError` if there are several such sheets or none, or the file is damaged or too large.
    """
    texts, book = _opened(path, data)
    lines = {sheet.title: _lines(sheet, budget) for sheet in book.worksheets}
    find, read = (find_matrix, read_matrix) if {*MATRIX} <= {*mapping} else (find_layout, read_lines)
    tables = {title: layout for title, sheet in lines.items() if (layout := find(sheet, mapping))}
    chosen = [title for title in tables if part in ("", title)]
    if len(chosen) > 1:
        raise several(path, "sheets", chosen)
    if not chosen:
        text = f"no sheet has a header that is understood; it has {', '.join(book.sheetnames[:20])}"
        remedy = "name the columns: columns={'HEADER': 'force_N'} (command line: --column 'HEADER=force_N')"
        remedy = next(filter(None, map(matrix_remedy, lines.values())), remedy)
        raise refusal(path, text, remedy)
    sheet: Worksheet = book[chosen[0]]
    cells = chain.from_iterable(sheet.iter_rows(values_only=True))
    settled = "." if any(isinstance(cell, float) for cell in cells) else ""
    table = read([*lines[sheet.title], ""], path, mapping, settled=settled)
    table.place = "row"
    others = chain.from_iterable(lines[title] for title in lines if title not in tables)
    beside = [*others, *(texts[name] for name in texts if name.startswith("xl/drawings/drawing")), *_formats(sheet)]
    table.words += [(None, " ".join(text.split())) for text in beside if text.strip()]
    asked = [*_hidden(sheet, table.lines[0]), *_noted(sheet, texts)]
    table.questions += [question(text, "layout", field="layout") for text in asked]
    return table


@lru_cache(maxsize=1)  # several sheets of a workbook are read in turn
def _opened(path: Path, data: bytes) -> tuple[dict[str, str], Workbook]:
    """Texts of the parts of a workbook by name, and its sheets."""
    with needs(path, "openpyxl", "excel"):
        from openpyxl import load_workbook
    with readable(path, "a workbook"):
        return _parts(path, data), load_workbook(io.BytesIO(data), data_only=True, keep_links=False)


def _parts(path: Path, data: bytes) -> dict[str, str]:
    """Texts of the parts of a workbook by name; raises a `DatasetError` for another archive, or a large one."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(info.file_size for info in archive.infolist())
        if size > _SHEET_BYTES:
            text = f"has {size / 1e6:.0f} MB of XML, more than {_SHEET_BYTES / 1e6:.0f}"
            raise refusal(path, text, "save the sheet as CSV")
        names = [name for name in archive.namelist() if name.endswith(".xml")]
        if "[Content_Types].xml" not in names:
            raise refusal(path, "is an archive (.zip, .ods?), and no .xlsx", "save its table as .xlsx or CSV")
        return {name: _texts(path, archive.read(name)) for name in names}


def _texts(path: Path, xml: bytes) -> str:
    """Texts of a part of a workbook; raises a `DatasetError` if its elements are nested deeply."""
    depth, texts = 0, []
    for event, element in iterparse(io.BytesIO(xml), ("start", "end")):
        depth += 1 if event == "start" else -1
        if depth > _MOST_NESTED:
            raise refusal(path, f"has more than {_MOST_NESTED} nested elements of XML", "save the sheet as CSV")
        if event == "end":
            texts += [element.text] * bool(element.text and element.tag.endswith(("}t", "}text")))
            element.clear()
    return " ".join(texts)


def _lines(sheet: Worksheet, budget: Budget) -> list[str]:
    """Rows of a sheet as lines of cells between tabs."""
    budget.spend(rows=sheet.max_row, columns=sheet.max_column, size=8 * sheet.max_row * sheet.max_column)
    return ["\t".join(map(_text_of, row)) for row in sheet.iter_rows(values_only=True)]


def _text_of(cell: object) -> str:
    return "" if cell is None else repr(cell) if isinstance(cell, float) else re.sub(r'[\s"]+', " ", str(cell))


def _formats(sheet: Worksheet) -> list[str]:
    """Texts that a sheet shows behind its numbers."""
    cells = chain.from_iterable(sheet.iter_rows())
    formats = {cell.number_format for cell in cells if isinstance(cell.value, int | float)}
    texts = ("".join(chain.from_iterable(_QUOTED.findall(form))) for form in formats)
    return [f"numbers shown in {text}" for text in texts if text.strip()]


def _noted(sheet: Worksheet, texts: Mapping[str, str]) -> list[str]:
    """Notes at cells of a sheet, else comments of the workbook that are threads."""
    threads = [text for name, text in texts.items() if name.startswith("xl/threadedComments/")]
    cells = chain.from_iterable(sheet.iter_rows())
    notes = [f"{cell.coordinate}: {cell.comment.text}" for cell in cells if cell.comment] or threads
    return [f"{len(notes)} cells are noted, first {' '.join(notes[0].split())[:80]!r}"] if notes else []


def _hidden(sheet: Worksheet, first: int) -> list[str]:
    """What a sheet shows of its numbers beside them: hidden and merged areas, and cells with a mark.

    A mark on all cells of a row up to the header, or on all numbers, is a style; one on some of them says something.
    """
    rows = [str(row) for row, shape in sheet.row_dimensions.items() if shape.hidden and row >= first]
    columns = [letter for letter, shape in sheet.column_dimensions.items() if shape.hidden]
    hidden = [*rows, *columns, *["the sheet"] * (sheet.sheet_state != "visible")]
    merged = [str(area) for area in sheet.merged_cells.ranges if area.max_row >= first - 1]
    texts = [f"rows or columns are hidden: {', '.join(hidden[:5])}"] * bool(hidden)
    texts += [f"cells are merged: {', '.join(merged[:5])}"] * bool(merged)
    filled = [[cell for cell in row if cell.value is not None] for row in sheet.iter_rows(max_row=first + 5000)]
    areas = [*filled[: first - 1], list(chain.from_iterable(filled[first - 1 :]))]
    for word, is_marked in _MARKS.items():
        marked = [[cell for cell in area if is_marked(cell)] for area in areas]
        if some := [cells for cells, area in zip(marked, areas, strict=True) if 0 < len(cells) < len(area)]:
            texts.append(f"{sum(map(len, some))} cells are {word}, first {some[0][0].coordinate}")
    return texts


def _ink(cell: Any) -> str:
    """Colour of the text of a cell: a number of the theme, or red, green and blue; empty for the usual one."""
    colour = cell.font.color
    return "" if colour is None or colour.type not in ("rgb", "theme") else str(colour.value)
