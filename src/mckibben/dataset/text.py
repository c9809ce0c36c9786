"""Tables of rows and cells: texts with any declared separator, and sheets of a workbook."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mckibben.dataset.raw import Budget, Floats, RawColumn, RawTable
from mckibben.dataset.vocabulary import dimension_of, parse_header
from mckibben.errors import DatasetError, Problem

_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe\0\0", "utf-32"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_SEPARATORS = ("\t", ";", ",", "|", " ")
_COMMENT = ("#", "%", "//", "'", "!", "*")
_SEARCHED = 300  # lines in which a header is looked for
_SAMPLED = 20_000  # cells of a column that may determine the decimal sign
_LISTED = 1000  # corrupt rows that are named
_LONGEST = 2**16  # characters of a line
_STAMP = re.compile(r"(\d\d:\d\d:\d\d\.\d{3}) -> ")
_SPACED = re.compile(r'"[^"]*"|[^\s\[(]+(?:[ \t]*[\[(][^\])]{0,99}[\])])?|\S+')
_TYPOGRAPHY = str.maketrans("\u2212\uff0d\uff0e\uff0c" + "".join(map(chr, range(0xFF10, 0xFF1A))), "--.,0123456789")
_DASH = re.compile(r"(?<![^\s;,|\"])(?:\u2013|([+-])[ \t]+)(?=[0-9.,])")
NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([.,'’\s])\d{3})(?:\1\d{3})*(?:([.,])\d+)?")
_WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([^\d\s.,;:-][^\s]*)")
_PROCESSED = frozenset(("", "smp", "avg", "ts", "rn", "sample", "mean", "no.", "no"))
_PLAIN = re.compile(r"[0-9+\-.eE\n]*")
KEYS = ("specimen", "source", "initial_length", "slack_force", "preprocessing", "repairs")


class Layout(NamedTuple):
    """Place of the header, and how its cells are separated."""

    row: int
    separator: str
    header: list[str]
    score: float


def decode(data: bytes, path: Path) -> str:
    """Text by its byte order mark, else UTF-16 by its zeros, else UTF-8, else Windows-1252."""
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "")
    if not encoding:
        data = data if b"\0" in data[:2] else data.rstrip(b"\0")
        probe = data[:4096]
        if len(probe) > 1 and probe[1::2].count(0) > 0.9 * len(probe[1::2]):
            encoding = "utf-16-le"
        elif probe.count(0) > 0.01 * len(probe):
            raise DatasetError(str(path), [Problem("is a binary file", remedy="give text, .xlsx, .h5, .mat or .tdms")])
    try:
        return data.decode(encoding or "utf-8")
    except UnicodeDecodeError as error:
        if encoding:
            raise DatasetError(str(path), [Problem(f"is not {encoding}: {error}", remedy="save it as UTF-8")]) from None
        return data.decode("cp1252", "replace")


def read_text(text: str, path: Path, mapping: Mapping[str, str], decimal: str) -> RawTable:
    """Columns of a text: words, a header, at most three rows of units, then one line per row."""
    budget, table = Budget(path), RawTable(place="line")
    text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\ufeff", "").translate(_TYPOGRAPHY)
    text = _DASH.sub(lambda match: match[1] or "-", text)
    lines, stamps = _without_stamps(text.split("\n"))
    budget.spend(rows=len(lines))
    if max(map(len, lines)) > _LONGEST:
        raise DatasetError(str(path), [Problem(f"has a line of more than {_LONGEST} characters", remedy="save rows")])
    layout = _find_layout(lines, mapping)
    if layout is None:
        raise DatasetError(str(path), [_no_header(lines)])
    _take_words(table, enumerate(lines[: layout.row], 1))
    header, first = _with_units(layout, lines)
    rows = _body(table, lines, first, layout, len(header))
    rows, header = _aligned(table, rows, header, lines, layout.separator)
    if not rows:
        none = Problem("has a header, and no rows of numbers", line=layout.row + 1)
        raise DatasetError(str(path), table.corrupt or [none])
    budget.spend(rows=len(rows), columns=len(header), size=8 * len(rows) * len(header))
    table.lines = [number for number, _ in rows]
    _parse_cells(table, [line for _, line in rows], _distinct(header, layout.header), layout.separator, decimal)
    last, *others = [_split(line, layout.separator) for _, line in rows[: -50 - 1 : -1]]
    if not text.endswith("\n") and _is_cut(last, others):
        text = "its last number has fewer digits than all others: was the file truncated?"
        table.corrupt.append(Problem(text, line=rows[-1][0]))
    if stamps:
        table.columns.append(RawColumn("time stamp", [stamps[number - 1] for number in table.lines]))
    return table


def _without_stamps(lines: list[str]) -> tuple[list[str], list[str]]:
    """Lines without the times that the monitor of the Arduino IDE puts before each, and these times."""
    matches = [_STAMP.match(line) for line in lines]
    if 2 * sum(map(bool, matches)) <= sum(bool(line.strip()) for line in lines):
        return lines, []
    return [_STAMP.sub("", line, count=1) for line in lines], [match[1] if match else "" for match in matches]


def _with_units(layout: Layout, lines: Sequence[str]) -> tuple[list[str], int]:
    """Header with the units in the rows below it, and the first line after them."""
    header, first = [*layout.header], layout.row + 1
    for row in range(first, min(first + 4, len(lines))):
        if not lines[row].strip():
            continue
        if not (units := _units_row(_split(lines[row], layout.separator), len(header))):
            break
        header = [f"{name} [{unit}]" if unit else name for name, unit in zip(header, units, strict=True)]
        first = row + 1
    return header, first


def _is_cut(last: Sequence[str], others: Sequence[Sequence[str]]) -> bool:
    """Whether the last cell of a file has fewer decimals than all others of its column, which have the same number."""
    decimals = {
        len(re.split("[.,]", cells[-1])[-1]) if re.search("[.,]", cells[-1]) else 0 for cells in others if cells
    }
    own = len(re.split("[.,]", last[-1])[-1]) if re.search("[.,]", last[-1]) else 0
    return len(others) > 3 and len(decimals) == 1 and own < decimals.pop()


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return [cell.strip('"') for cell in _SPACED.findall(line)]
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    return [cell.strip() for cell in line.split(separator)]


def score_of(cells: Sequence[str], mapping: Mapping[str, str]) -> float:
    """Sum over the cells of a row of 1 for a header that is understood, and 1/2 for a name without a unit."""
    total, quantities = 0.0, set()
    for cell in cells[:200]:
        header = parse_header(cell) if cell else None
        if cell in mapping:
            total += 1
        elif header and header.quantity:
            total += 1 if header.unit and header.quantity not in quantities else 0.5
            quantities.add(header.quantity)
    return total if len(quantities) > 1 or total > 1 else 0.0


def _find_layout(lines: Sequence[str], mapping: Mapping[str, str]) -> Layout | None:
    """Layout by the row with most headers that are understood; by positions where the mapping has numbers."""
    if mapping and all(key.isdigit() for key in mapping):
        return _layout_by_position(lines, max(map(int, mapping)))
    best: Layout | None = None
    for row, line in enumerate(lines[:_SEARCHED]):
        bare = line.lstrip("#%/ \t") if line.lstrip().startswith(_COMMENT[:3]) else line
        for separator in _SEPARATORS:
            cells = _header_cells(bare, separator, mapping)
            if len(cells) < 2 or any(map(NUMBER.fullmatch, cells)):
                continue
            cells = _named_channels(cells, lines[:row], separator)
            score = score_of(cells, mapping)
            comment = bare is not line and not _precedes_rows(lines, row, separator, len(cells))
            if score > (best.score if best else 0.5) and not comment:
                best = Layout(row, separator, cells, score)
    return best


def _layout_by_position(lines: Sequence[str], count: int) -> Layout | None:
    """Layout of rows without a header, by the first that has as many numbers."""
    for row, line in enumerate(lines[:_SEARCHED]):
        for separator in _SEPARATORS:
            cells = _split(line, separator)
            if len(cells) >= count and all(map(NUMBER.fullmatch, filter(None, cells))):
                return Layout(row - 1, separator, [str(at + 1) for at in range(len(cells))], 1.0)
    return None


def _header_cells(line: str, separator: str, mapping: Mapping[str, str]) -> list[str]:
    """Cells of a line that may be a header; names between two or more blanks may have single ones."""
    if separator != " ":
        return _split(line, separator) if separator in line.strip() else []
    cells, wide = _split(line, " "), re.split(r"\s{2,}", line.strip())
    return wide if "  " in line.strip() and score_of(wide, mapping) >= score_of(cells, mapping) else cells


def _precedes_rows(lines: Sequence[str], row: int, separator: str, count: int) -> bool:
    following = next((line for line in lines[row + 1 :] if line.strip()), "")
    cells = following.split() if separator == " " else _split(following, separator)
    return len(cells) == count and any(NUMBER.fullmatch(cell) for cell in cells)


def _no_header(lines: Sequence[str]) -> Problem:
    shown = next((line.strip() for line in lines if line.strip()), "")
    if not shown:
        return Problem("is empty", remedy="give a file with a header and rows")
    remedy = (
        "name its columns by header or, without one, by position: columns={'HEADER': 'force_N', '2': 'pressure_bar'} "
        "(command line: --column 'HEADER=force_N' --column '2=pressure_bar')"
    )
    return Problem(f"has no header that is understood; it begins with {shown[:80]!r}", remedy=remedy)


def _units_row(cells: Sequence[str], count: int) -> list[str]:
    """Units in a row below the header; empty texts for a row of words that say nothing; [] for any other row."""
    if len(cells) > count or not cells:
        return []
    bare = [cell.strip("[]() \"'") for cell in cells] + [""] * (count - len(cells))
    if any(NUMBER.fullmatch(cell) for cell in bare if cell != "1"):
        return []
    units = [cell if dimension_of(cell) or cell in ("-", "1") else "" for cell in bare]
    if any(unit not in ("", "-", "1") for unit in units):
        return units
    return [""] * count if all(cell.lower() in _PROCESSED for cell in bare) and any(bare) else []


def _named_channels(cells: Sequence[str], preamble: Sequence[str], separator: str) -> list[str]:
    """Header with the names that a block above the table gives to its channels (CH1, Force)."""
    if not any(re.fullmatch(r"CH ?\d+", cell) for cell in cells):
        return [*cells]
    rows = [_split(line, separator) for line in preamble]
    named = {row[0]: row[1] for row in rows if len(row) > 2 and parse_header(row[1]).quantity}
    return [named.get(cell, cell) for cell in cells]


def _take_words(table: RawTable, lines: Iterable[tuple[int, str]]) -> None:
    """Keep the words beside the table; keys that this program writes are comments."""
    for number, line in lines:
        bare = line.strip().lstrip("#%").strip()
        key, colon, value = bare.partition(":")
        if line.lstrip().startswith("#") and colon and key.strip() in KEYS:
            table.comments[key.strip()] = value.strip()
        elif bare:
            table.words.append((number, bare))


def _body(table: RawTable, lines: Sequence[str], first: int, layout: Layout, count: int) -> list[tuple[int, str]]:
    """Rows with their line numbers; comments and lines of words are kept as words."""
    rows, words = [], []
    repeated = layout.header
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip(" \t;,|\0"):
            continue
        if line.lstrip().startswith(_COMMENT) and not NUMBER.fullmatch(line.lstrip()[:1]):
            words.append((number, line))
        elif any(character.isdigit() for character in line) and (
            line[0].isdigit() or any(NUMBER.fullmatch(cell) for cell in _split(line, layout.separator))
        ):
            rows.append((number, line))
        elif _split(line, layout.separator) != repeated and not _units_row(_split(line, layout.separator), count):
            (rows if len(_split(line, layout.separator)) == count > 1 else words).append((number, line))
    _take_words(table, words)
    return rows


def _aligned(
    table: RawTable, rows: list[tuple[int, str]], header: list[str], lines: Sequence[str], separator: str
) -> tuple[list[tuple[int, str]], list[str]]:
    """Rows with as many cells as the header; a column of row numbers without a name gets one; others are corrupt."""
    counts = np.array([_count(line, separator) for _, line in rows])
    if len(counts) and counts.min() > len(header):
        begin = [_split(line, separator) for _, line in rows[:1000]]
        if all(not any(cells[len(header) :]) for cells in begin):
            rows = [(number, separator.join(_split(line, separator)[: len(header)])) for number, line in rows]
            counts[:] = len(header)
        elif (counts == len(header) + 1).all() and _are_numbered(begin):
            certain = separator != "," or any("." in line for _, line in rows)  # decimal commas look like row numbers
            header = ["row number", *header] if certain else header
    for at in np.flatnonzero(counts != len(header))[:_LISTED].tolist():
        text = f"has {counts[at]} cell{'s' if counts[at] != 1 else ''}, the header {len(header)}"
        if rows[at][0] == len(lines):
            text += ", and no line end: the file was truncated here"
        table.corrupt.append(Problem(text, line=rows[at][0]))
    return [row for row, count in zip(rows, counts, strict=True) if count == len(header)], header


def _are_numbered(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first cells count the rows from 0 or 1."""
    return [cells[0] for cells in rows] in ([str(at + first) for at in range(len(rows))] for first in (0, 1))


def _count(line: str, separator: str) -> int:
    """Number of the cells of a row."""
    if separator == " ":
        return len(line.split())
    return len(_split(line, separator)) if '"' in line else line.count(separator) + 1


def _distinct(header: Sequence[str], original: Sequence[str]) -> list[RawColumn]:
    """Columns without cells: names as in the file, labels with their units; a repeated name is numbered."""
    offset = len(header) - len(original)
    columns: list[RawColumn] = []
    for at, label in enumerate(header):
        name = original[at - offset] if at >= offset else label
        repeats = sum(column.name.partition(" (")[0] == name for column in columns) if name else 0
        unit = label[len(name) :].strip(" []") if label.startswith(name) else ""
        columns.append(
            RawColumn(
                f"{name} ({at + 1})" if repeats else name or f"column {at + 1}",
                (),
                label=name if unit else label,
                unit=unit,
            )
        )
    return columns


def _parse_numbers(
    table: RawTable, rows: Sequence[str], columns: Sequence[RawColumn], separator: str, decimal: str
) -> bool:
    """Add the cells of a large table if all are numbers with one plain decimal sign; whether they are."""
    import pandas as pd

    sample = [_split(row, separator) for row in rows[:: len(rows) // 1000]]
    sign, ambiguous = (decimal, "") if decimal else decimal_sign(list(zip(*sample, strict=False)), separator)
    if ambiguous:
        return False
    try:
        read = pd.read_csv(
            io.StringIO("\n".join(rows)),
            sep=r"\s+" if separator == " " else separator,
            header=None,
            index_col=False,
            names=range(len(columns)),
            dtype=np.float64,
            decimal=sign,
            na_filter=False,
        )
    except ValueError:
        return False
    table.decimal = sign
    table.columns += [replace(column, cells=read[at].to_numpy()) for at, column in enumerate(columns)]
    return True


def _parse_cells(table: RawTable, rows: Sequence[str], columns: list[RawColumn], separator: str, decimal: str) -> None:
    """Add the cells of all columns, as numbers where all are."""
    import pandas as pd

    if len(rows) > _SAMPLED and _parse_numbers(table, rows, columns, separator, decimal):
        return
    read = pd.read_csv(
        io.StringIO("\n".join(rows)),
        sep=r"\s+" if separator == " " else separator,
        header=None,
        index_col=False,
        names=range(len(columns)),
        dtype=str,
        na_filter=False,
        skipinitialspace=True,
        quoting=csv.QUOTE_MINIMAL if all(row.count('"') % 2 == 0 for row in rows) else csv.QUOTE_NONE,
        engine="c",
    )
    texts = [[cell.strip() for cell in read[at].tolist()] for at in range(len(columns))]
    bare = [_common_unit(cells) for cells in texts]
    measured = [
        cells
        for column, (_, cells) in zip(columns, bare, strict=True)
        if parse_header(column.label, column.unit).quantity != "time"
    ]
    table.decimal, table.ambiguous = (decimal, "") if decimal else decimal_sign(measured, separator)
    for column, (unit, cells) in zip(columns, bare, strict=True):
        numbers = to_numbers(cells, table.decimal, certain=bool(decimal))
        table.columns.append(
            replace(column, cells=cells if np.isnan(numbers).any() else numbers, unit=column.unit or unit)
        )


def _common_unit(cells: Sequence[str]) -> tuple[str, Sequence[str]]:
    """The unit that stands behind each number of a column, and the numbers alone."""
    first = _WITH_UNIT.fullmatch(cells[0]) if cells else None
    if first is None or not dimension_of(first[2]):
        return "", cells
    matches = [_WITH_UNIT.fullmatch(cell) for cell in cells]
    if any(match is None or match[2] != first[2] for match in matches):
        return "", cells
    return first[2], [match[1] for match in matches if match]


def decimal_sign(columns: Sequence[Sequence[str]], separator: str) -> tuple[str, str]:
    """Decimal sign of the numbers of a text, and a number that may be read with either sign, if no other settles it."""
    settled, ambiguous = set(), ""
    for cells in columns:
        for cell in cells if len(cells) <= _SAMPLED else cells[:: len(cells) // _SAMPLED]:
            if ("." in cell or "," in cell) and (NUMBER.fullmatch(cell) or _GROUPED.fullmatch(cell)):
                sign = _sign_of(cell)
                settled |= {sign} - {""}
                ambiguous = ambiguous or ("" if sign else cell)
    if len(settled) > 1:
        return ".", ambiguous or "numbers with decimal points and with commas"
    sign = next(iter(settled), ".")
    if separator == "," and not settled:
        return ".", ambiguous if "," in ambiguous else ""
    return sign, ambiguous if not settled or sign not in ambiguous else ""


def _sign_of(cell: str) -> str:
    """Decimal sign of a number; empty for one such as 1.234, in which it may separate thousands."""
    signs = re.findall("[.,]", cell)
    if len(set(signs)) == 2:
        return signs[-1]
    if len(signs) > 1:
        return "," if signs[0] == "." else "."
    return "" if re.fullmatch(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", cell) else signs[0]


def to_numbers(cells: Sequence[str], decimal: str, *, certain: bool = False) -> Floats:
    """Numbers of texts, NaN where a cell is none; groups of thousands where their sign cannot be the decimal one."""
    joined = "\n".join(cells)
    plain = joined if decimal == "." else joined.replace(",", ".") if "." not in joined else "?"
    if cells and _PLAIN.fullmatch(plain) and "" not in cells:
        with suppress(ValueError):
            return np.array(plain.split("\n"), dtype=np.float64)
    grouped = certain or any(match and match[2] == decimal for match in map(_GROUPED.fullmatch, cells[:100_000]))
    return np.array([_number(cell, decimal, grouped) for cell in cells], np.float64)


def _number(cell: str, decimal: str, grouped: bool) -> float:
    """Number of a cell, NaN if it is none."""
    other = {".": ",", ",": "."}[decimal]
    if NUMBER.fullmatch(cell) is None or other in cell:
        match = _GROUPED.fullmatch(cell)
        if match is None or match[1] == decimal or (match[1] == other and not grouped):
            return np.nan
        cell = cell.replace(match[1], "")
    return float(cell.replace(",", ".").replace("D", "e").replace("d", "e"))
