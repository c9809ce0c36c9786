"""Readers of Excel workbooks and TDMS files."""

from __future__ import annotations

import functools
import io
import logging
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset.headers import is_unit
from mckibben.dataset.sheet import RawColumn, RawTable, RowProblem, as_column, at_type_limit, not_applied, unreadable
from mckibben.dataset.summaries import MOST_POINTS
from mckibben.errors import DatasetError, Problem

_LATEST = 1e9  # s
_HEADER = 60  # rows searched for a header
_MOST_COLUMNS = 4096
_LISTED = 10  # hidden rows in a warning
_MERGES = 2**17  # bytes at the end of a sheet, where merged cells are listed
_FEW = 0.1  # of the rows: coloured ones that may be marked
_UNIT_FORMAT = re.compile(r'[0#.,]+ ?"\s*([^"]+)"')
_PERCENT_FORMAT = re.compile(r"[0#.,]+ ?%")  # shows 0.05 as 5 %
_NOTES = re.compile(r"xl/(?:comments/)?comments?[0-9]*\.xml")
_NOTED = re.compile(rb'<(?:[a-z]+:)?comment\b[^<>]*\bref="([A-Z]{1,3}[0-9]{1,7})"')
_HIDDEN = re.compile(rb'<(?:[a-z]+:)?(?:row|col)\b[^<>]*\bhidden="(?:1|true)"[^<>]*>')
_MERGED = re.compile(rb'<(?:[a-z]+:)?mergeCell\b[^<>]*\bref="([A-Z]{1,3})([0-9]{1,7}):([A-Z]{1,3})([0-9]{1,7})"')


def read_excel(path: Path, data: bytes, known: Callable[[str, str], bool]) -> RawTable:
    """Columns of the sheets with a header (formulas as saved values); with several named ``sheet/column``."""
    try:
        from openpyxl import load_workbook
    except ImportError:
        remedy = 'pip install "mckibben[excel]", or save the sheet as CSV'
        raise DatasetError(
            str(path), [Problem("is a workbook, and openpyxl is not installed", remedy=remedy)]
        ) from None
    try:
        book = load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
        tables = {sheet.title: _rows(path, sheet) for sheet in book.worksheets}
        shown_units = {sheet.title: _shown_units(sheet) for sheet in book.worksheets}
        hidden = {sheet.title for sheet in book.worksheets if sheet.sheet_state != "visible"}
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            sheets: list[Any] = book.worksheets
            notes = {sheet.title: _hidden(archive, sheet._worksheet_path) for sheet in sheets}
            for sheet in sheets:
                _fill_merged(tables[sheet.title], archive, sheet._worksheet_path)
            noted = _noted(archive)
        used: Any = book
        styled = any(fill.fill_type == "solid" for fill in used._fills)
        styled |= any(font.strike or _is_coloured(font) for font in used._fonts)
        marked = {sheet.title: _marked(sheet) for sheet in sheets if styled}
    except (DatasetError, MemoryError):
        raise
    except Exception as error:  # openpyxl raises almost any exception on a damaged file
        raise unreadable(path, "a workbook", error, "save it again, or as CSV") from error
    sheet = RawTable(kind=RowProblem, suspect=noted)
    found = {title: _table(rows, known, shown_units[title]) for title, rows in tables.items()}
    filled = {title: channels for title, channels in found.items() if channels}
    shown = [title for title in filled if title not in hidden]
    if any(known(each.name, each.unit) for title in shown for each in filled[title]):
        skipped = [
            title
            for title in filled
            if title in hidden and not any(known(f"{title}/{each.name}", "") for each in filled[title])
        ]
        sheet.suspect += [f"the hidden sheet {title!r} is not read" for title in skipped]
        filled = {title: channels for title, channels in filled.items() if title not in skipped}
    for title in filled:
        found = [*(["is hidden"] if title in hidden else []), *filter(None, (notes[title], marked.get(title, "")))]
        note = "; ".join(found)
        sheet.suspect += [f"sheet {title!r} {note}"] if note else []
    for title, channels in filled.items():
        prefix = f"{title}/" if len(filled) > 1 else ""
        sheet.channels += [
            RawColumn(f"{prefix}{each.name}" if each.name else "", each.cells, each.lines, each.name, each.unit)
            for each in channels
        ]
    if not sheet.channels:
        raise DatasetError(str(path), [Problem("has no sheet with a header and rows")])
    return sheet


def _noted(archive: zipfile.ZipFile) -> list[str]:
    """Warning of notes at cells, which are not read; empty if there are none."""
    found: list[str] = []
    for name in filter(_NOTES.fullmatch, archive.namelist()):
        with archive.open(name) as stream:
            found += [cell.decode() for cell in _NOTED.findall(stream.read(2**20))]
    shown = f"{', '.join(found[:_LISTED])}{' ...' if len(found) > _LISTED else ''}"
    return [f"the notes at the cells {shown} are not read: they may mark invalid rows"] if found else []


def _hidden(archive: zipfile.ZipFile, part: str) -> str:
    """Hidden rows and columns of a sheet, which are read as all others; empty if there are none."""
    rows, columns, rest = [], 0, b""
    with archive.open(part.lstrip("/")) as stream:
        while block := stream.read(2**20):
            text, _, after = (rest + block).rpartition(b">")
            for tag in _HIDDEN.findall(text + b">"):
                if number := re.search(rb'\br="([0-9]+)"', tag):
                    rows.append(number[1].decode())
                else:
                    columns += tag.lstrip(b"<").startswith((b"col", b"x:col"))
            rest = after
    shown = f"{', '.join(rows[:_LISTED])}{' ...' if len(rows) > _LISTED else ''}"
    found = [f"rows {shown}"] if rows else []
    found += [f"{columns} column{'s' if columns > 1 else ''}"] if columns else []
    return f"has hidden {' and '.join(found)}, which are read" if found else ""


def _fill_merged(rows: list[tuple[int, tuple[Any, ...]]], archive: zipfile.ZipFile, part: str) -> None:
    """Give merged cells of a sheet the value of the one above them, or the name of the one on their left."""
    with archive.open(part.lstrip("/")) as stream:
        tail = b""
        while block := stream.read(2**20):
            tail = (tail + block)[-_MERGES:]
    at = {number: index for index, (number, _) in enumerate(rows)}
    for left, top, right, bottom in _MERGED.findall(tail):
        first = at.get(int(top))
        if first is None:
            continue
        column, end = (
            functools.reduce(lambda value, letter: 26 * value + letter - 64, one, 0) for one in (left, right)
        )
        number, row = rows[first]
        value = row[column - 1] if column <= len(row) else None
        if left != right:
            if isinstance(value, str) and value[:1].isalpha() and end <= _MOST_COLUMNS:  # no number of another column
                rows[first] = number, (*row[:column], *[value] * (end - column), *row[end:])
            continue
        for index in range(first + 1, len(rows)):
            number, row = rows[index]
            if number > int(bottom):
                break
            row = (*row, *[None] * (column - len(row)))  # a row ends with its last value
            if row[column - 1] is None:
                rows[index] = number, (*row[: column - 1], value, *row[column:])


def _is_without_number(cell: object) -> bool:
    """True for an empty cell, and for a text without digits."""
    return cell is None or (isinstance(cell, str) and not any(map(str.isdigit, cell)))


def _is_coloured(font: Any) -> bool:
    """True for a font with a colour other than black or that of the theme, such as red, or white on white."""
    return font.color is not None and font.color.type == "rgb" and not str(font.color.rgb).endswith("000000")


def _marked(sheet: Any) -> str:
    """Rows of a sheet with struck-out cells, or few with coloured ones, which are read as all others; empty if none."""
    struck, coloured, count = [], [], 0
    for number, row in enumerate(sheet.iter_rows(), 1):
        cells = [cell for cell in row if cell.value is not None]
        if number <= MOST_POINTS and any(isinstance(cell.value, (int, float)) for cell in cells):
            count += 1
            coloured += [str(number)] * any(cell.fill.fill_type == "solid" or _is_coloured(cell.font) for cell in cells)
        struck += [str(number)] * any(cell.font.strike for cell in cells)
    found = {"struck-out": struck, "coloured": coloured if len(coloured) <= _FEW * count else []}
    return "; ".join(
        f"has {what} cells in rows {', '.join(rows[:_LISTED])}{' ...' if len(rows) > _LISTED else ''}, which are read"
        for what, rows in found.items()
        if rows
    )


def _rows(path: Path, sheet: Any) -> list[tuple[int, tuple[Any, ...]]]:
    """Non-empty rows of a sheet, with their numbers."""
    sheet.reset_dimensions()  # the size stated in the file is not always true
    rows: list[tuple[int, tuple[Any, ...]]] = []
    for number, row in enumerate(sheet.iter_rows(values_only=True), 1):
        width = max((i for i, cell in enumerate(row, 1) if cell is not None and cell != ""), default=0)
        if width > _MOST_COLUMNS:
            problem = RowProblem(f"sheet {sheet.title!r} has more than {_MOST_COLUMNS} columns", number)
            raise DatasetError(str(path), [problem])
        if width:
            rows.append((number, row[:width]))
    return rows


def _shown_units(sheet: Any) -> dict[int, str]:
    """Unit that the number formats of the first rows of a sheet show behind a number, of columns from 0."""
    found: dict[int, str] = {}
    for row in sheet.iter_rows(max_row=_HEADER):
        for index, cell in enumerate(row[:_MOST_COLUMNS]):
            if isinstance(cell.value, (int, float)) and _PERCENT_FORMAT.fullmatch(cell.number_format):
                found.setdefault(index, "ratio")
            elif isinstance(cell.value, (int, float)) and (match := _UNIT_FORMAT.fullmatch(cell.number_format)):
                found.setdefault(index, match[1] if is_unit(match[1]) else "")
    return found


def _table(
    rows: Sequence[tuple[int, tuple[Any, ...]]], known: Callable[[str, str], bool], shown_units: Mapping[int, str]
) -> list[RawColumn]:
    """Columns of a sheet; units are in a row under the names, or shown by the number formats."""
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
    units = (under if has_units else [shown_units.get(i, "") for i in range(len(header))]) + [""] * len(header)
    lines = [number for number, _ in body]
    for i in range(len(header) - 1, 0, -1):  # a name over an empty column too, or over one of units or remarks
        if header[i] == header[i - 1] and all(len(row) <= i or _is_without_number(row[i]) for _, row in body):
            header[i] = ""
    columns = [
        RawColumn(name, as_column([row[i] if i < len(row) else None for _, row in body]), lines, unit=units[i])
        for i, name in enumerate(header)
    ]
    return [
        replace(column, cells=100 * column.cells, unit="percent")  # shown as 5 % under a name with %
        if isinstance(column.cells, np.ndarray) and shown_units.get(i) == "ratio" and "%" in column.name
        else column
        for i, column in enumerate(columns)
    ]


def _start(rows: Sequence[tuple[int, tuple[Any, ...]]], known: Callable[[str, str], bool]) -> int:
    """Index of the header: the first row, or a later one with two known names if the first has none."""
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


def read_tdms(path: Path, data: bytes) -> RawTable:
    """Scaled channels of a TDMS file, named ``group/channel``; the waveform increment gives the sample interval."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        remedy = 'pip install "mckibben[tdms]"'
        raise DatasetError(str(path), [Problem("is a TDMS file, and npTDMS is not installed", remedy=remedy)]) from None
    sheet = RawTable(kind=RowProblem)
    intervals: set[float] = set()
    starts: dict[str, np.datetime64] = {}
    try:
        with _captured_log() as warned:
            file = TdmsFile.read_metadata(io.BytesIO(data))
            claimed = sum(len(channel) for group in file.groups() for channel in group.channels())
            if claimed > len(data):  # a sample has at least a byte
                raise DatasetError(str(path), [Problem(f"declares {claimed} samples, more than the file contains")])
            file = TdmsFile.read(io.BytesIO(data))
            for group in file.groups():
                for channel in group.channels():
                    _add(sheet, f"{group.name}/{channel.name}", channel, intervals, starts)
            status = file.file_status
    except (DatasetError, MemoryError):
        raise
    except Exception as error:  # npTDMS raises almost any exception on a damaged file
        raise unreadable(path, "TDMS", error, "copy it again from its original") from error
    sheet.corrupt += [RowProblem(f"npTDMS: {text[:120]}") for text in dict.fromkeys(warned)]
    if status.incomplete_final_segment:
        lost = sum(c.expected_length - c.read_length for c in (status.channel_statuses or {}).values())
        what = f" ({lost} values are missing)" if lost > 0 else ""
        sheet.corrupt.append(RowProblem(f"the file was cut off: its last segment is not complete{what}"))
        sheet.channels = _even(sheet.channels)
    if not sheet.channels:
        raise DatasetError(str(path), [Problem("has no channel with samples")])
    if len(intervals) == 1:
        sheet.interval = intervals.pop()
    begin = min(starts.values(), default=np.datetime64(0, "us"))
    sheet.channels = [
        replace(one, notes=(*one.notes, f"begins {late / np.timedelta64(1, 's'):g} s after the first channel"))
        if (late := starts.get(one.name, begin) - begin) > np.timedelta64(1, "ms")
        else one
        for one in sheet.channels
    ]
    return sheet


def _even(channels: list[RawColumn]) -> list[RawColumn]:
    """Pad the channels of each group to the longest, so that incomplete rows are reported."""
    longest: dict[str, int] = {}
    for channel in channels:
        group = channel.name.removesuffix(channel.short)
        longest[group] = max(longest.get(group, 0), len(channel.cells))
    even = []
    for channel in channels:
        count = longest[channel.name.removesuffix(channel.short)]
        missing, cells = count - len(channel.cells), channel.cells
        padded = (
            np.append(cells, np.full(missing, np.nan)) if isinstance(cells, np.ndarray) else [*cells, *[""] * missing]
        )
        even.append(replace(channel, cells=padded, lines=range(1, count + 1)))
    return even


@contextmanager
def _captured_log() -> Iterator[list[str]]:
    """Capture the log of npTDMS, its only report of a corrupt file."""
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())
    loggers = [logging.getLogger(name) for name in list(logging.root.manager.loggerDict) if name.startswith("nptdms.")]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [handler], False
    try:
        yield said
    finally:
        for logger, (handlers, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate


def _add(sheet: RawTable, name: str, channel: Any, intervals: set[float], starts: dict[str, np.datetime64]) -> None:
    values = channel[:]
    if values is None or not len(values):
        sheet.ignored.append(name)
        return
    values = np.asarray(values)
    if values.dtype.kind in "biuf":
        cells = values.astype(np.float64)
    elif values.dtype.kind in "OU":
        cells = as_column(values.tolist())
    else:  # time stamps, complex numbers
        sheet.ignored.append(name)
        return
    properties = channel.properties
    unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
    step = properties.get("wf_increment")
    if isinstance(step, (int, float)) and np.isfinite(step) and step > 0:
        intervals.add(float(step))
        offset = properties.get("wf_start_offset", 0.0)
        if isinstance(start := properties.get("wf_start_time"), np.datetime64) and abs(offset) < _LATEST:
            starts[name] = start.astype("datetime64[us]") + np.timedelta64(round(1e6 * offset), "us")
    rows = range(1, len(cells) + 1)
    others = {key: value for key, value in properties.items() if not key.startswith(("NI_", "wf_"))}
    notes = at_type_limit(values) + not_applied(others)
    sheet.channels.append(RawColumn(name, cells, rows, short=channel.name, unit=unit, notes=notes))
