"""Tables of workbooks."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mckibben.dataset.raw import Budget, RawColumn, RawTable, several, unreadable
from mckibben.dataset.text import NUMBER, decimal_sign, score_of
from mckibben.dataset.vocabulary import dimension_of, parse_header
from mckibben.errors import DatasetError, Problem

if TYPE_CHECKING:
    from openpyxl.worksheet.worksheet import Worksheet

_SHEET_BYTES = 2**24  # of XML of a workbook


def read_workbook(path: Path, data: bytes, mapping: Mapping[str, str], part: str, budget: Budget) -> RawTable:
    """Columns of the only sheet with a header (formulas as saved values)."""
    try:
        from openpyxl import load_workbook
    except ImportError:
        remedy = 'pip install "mckibben[excel]", or save the sheet as CSV'
        raise DatasetError(str(path), [Problem("needs openpyxl, which is not installed", remedy=remedy)]) from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            names = archive.namelist()
            size = sum(info.file_size for info in archive.infolist())
        if "[Content_Types].xml" not in names:
            raise DatasetError(str(path), [Problem("is a ZIP archive, not a workbook", remedy="extract it")])
        if size > _SHEET_BYTES:
            text = f"has {size / 1e6:.0f} MB of XML, more than {_SHEET_BYTES / 1e6:.0f}"
            raise DatasetError(str(path), [Problem(text, remedy="save the sheet as CSV")])
        book = load_workbook(io.BytesIO(data), data_only=True, keep_links=False)
    except DatasetError:
        raise
    except Exception as error:  # openpyxl raises nearly any exception on a damaged workbook
        raise unreadable(path, "a workbook", error) from error
    tables: dict[str, RawTable] = {}
    others: list[tuple[int | None, str]] = []
    for sheet in book.worksheets:
        budget.spend()
        if part and sheet.title != part:
            continue
        if (table := _sheet(sheet, mapping, budget)) is not None:
            tables[sheet.title] = table
        else:
            others += [
                (None, text) for row in sheet.iter_rows(values_only=True, max_row=200) if (text := _text_of(row))
            ]
    if not tables:
        text = f"no sheet has a header that is understood; it has {', '.join(book.sheetnames[:20])}"
        remedy = "name the columns: columns={'HEADER': 'force_N'} (command line: --column 'HEADER=force_N')"
        raise DatasetError(str(path), [Problem(text, remedy=remedy)])
    if len(tables) > 1:
        raise DatasetError(str(path), [several("sheets", list(tables))])
    (table,) = tables.values()
    table.words += others
    return table


def _text_of(row: Sequence[object]) -> str:
    return " ".join(str(cell) for cell in row if cell is not None).strip()


def _sheet(sheet: Worksheet, mapping: Mapping[str, str], budget: Budget) -> RawTable | None:
    """Columns of a sheet; None without a header."""
    budget.spend(rows=sheet.max_row, columns=sheet.max_column, size=8 * sheet.max_row * sheet.max_column)
    grid: list[list[object]] = [list(row) for row in sheet.iter_rows(values_only=True)]
    texts = [[_trimmed(cell) for cell in row] for row in grid[:100]]
    scores = [score_of(row, mapping) for row in texts]
    if not scores or max(scores) < 1:
        return None
    at = int(np.argmax(scores))
    header, first = texts[at], at + 1
    units = _units_below(header, texts[first : first + 1])
    first += any(units)
    table = RawTable(
        words=[(number, _text_of(row)) for number, row in enumerate(grid[:at], 1) if any(texts[number - 1])]
    )
    places = [column for column, name in enumerate(header) if name]
    rows = _rows_of_sheet(table, grid, first, header)
    table.lines = [number for number, _ in rows]
    written = [[str(row[column]) for _, row in rows if isinstance(row[column], str)] for column in places]
    table.decimal, table.ambiguous = decimal_sign(written, ";")
    for column in places:
        cells = [row[column] for _, row in rows]
        table.columns.append(_column_of_cells(header[column], cells, units[column], sheet, table.lines, column))
    for column in {*range(len(header))} - {*places}:
        table.words += [(number, str(row[column])) for number, row in rows if row[column] is not None]
    _ask_of_layout(table, sheet, {*places}, at)
    return table


def _trimmed(cell: object) -> str:
    return "" if cell is None else str(cell).strip()


def _units_below(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Units in the row below a header; empty texts if it has numbers or no units."""
    if not rows or any(map(NUMBER.fullmatch, rows[0])) or not any(map(dimension_of, rows[0])):
        return [""] * len(header)
    return [cell.strip("[]()") for cell in rows[0]]


def _is_number(cell: object) -> bool:
    return isinstance(cell, int | float) or NUMBER.fullmatch(str(cell)) is not None


def _rows_of_sheet(
    table: RawTable, grid: Sequence[list[object]], first: int, header: Sequence[str]
) -> list[tuple[int, list[object]]]:
    """Rows with a number, by their number; others are words."""
    rows = []
    for number, row in enumerate(grid[first:], first + 1):
        filled = [
            cell
            for cell, name in zip(row, header, strict=True)
            if name and str(cell or "0").strip() and cell is not None
        ]
        if any(map(_is_number, filled)):
            rows.append((number, row))
        elif filled and [str(cell) for cell in filled] != [name for name in header if name]:
            table.words.append((number, _text_of(row)))
    return rows


def _column_of_cells(
    name: str, cells: Sequence[object], unit: str, sheet: Worksheet, lines: Sequence[int], column: int
) -> RawColumn:
    """Numbers of cells, or texts; a number format that shows a unit gives it."""
    formats = {str(sheet.cell(line, column + 1).number_format) for line in lines[:200]}
    shown = {match[1] for text in formats if (match := re.search(r'"\s*([^"]+)"', text)) and dimension_of(match[1])}
    percent = {text.rstrip().endswith("%") for text in formats}
    if len(shown) == 1 and len(formats) == 1 and not unit:
        unit = next(iter(shown))
    if percent == {True} and not unit and parse_header(name).quantity == "contraction":
        unit = "ratio"  # 0.05 is shown as 5 %
        name = re.sub(r"\s*[\[(]\s*%\s*[\])]", "", name)
    if all(isinstance(cell, int | float) and not isinstance(cell, bool) for cell in cells):
        return RawColumn(name, np.array(cells, np.float64), unit=unit)
    return RawColumn(name, [_trimmed(cell) for cell in cells], unit=unit)


def _ask_of_layout(table: RawTable, sheet: Worksheet, places: set[int], header: int) -> None:
    """Questions about hidden, merged, struck-out or noted cells, which a table of numbers cannot show."""
    texts = [
        f"{what}: {', '.join(names[:5])}"
        for what, names in (
            ("rows or columns are hidden", _hidden(table, sheet)),
            ("cells are merged", _merged(sheet, max(len(places), 2), header)),
        )
        if names
    ]
    cells = [sheet.cell(line, column + 1) for line in table.lines[:5000] for column in places]
    for word, is_marked in _MARKS.items():
        if 0 < (count := sum(map(is_marked, cells))) < len(cells):
            texts.append(f"{count} cells are {word}")
    remedy = "accept=['layout'] reads these cells as they are (command line: --read accept=layout)"
    table.problems += [Problem(text, field="layout", remedy=remedy) for text in texts]


_MARKS: Mapping[str, Callable[[Any], bool]] = {
    "struck out": lambda cell: bool(cell.font and cell.font.strike),
    "noted": lambda cell: cell.comment is not None,
    "coloured": lambda cell: bool(cell.fill and cell.fill.fill_type == "solid"),
}


def _hidden(table: RawTable, sheet: Worksheet) -> list[str]:
    rows = [str(row) for row in table.lines if sheet.row_dimensions[row].hidden]
    columns = [letter for letter, column in sheet.column_dimensions.items() if column.hidden]
    return [*rows, *columns, *["the sheet"] * (sheet.sheet_state != "visible")]


def _merged(sheet: Worksheet, most: int, header: int) -> list[str]:
    """Merged areas below the header of less than all columns."""
    areas = sheet.merged_cells.ranges
    return [str(area) for area in areas if area.max_row >= header and area.size["columns"] < most]
