"""Tables of lines: texts with any separator, LabVIEW measurements, and sheets of workbooks as lines."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from mckibben.dataset.cells import BEGINS, NUMBER, SEPARATORS, WITH_UNIT, Layout, decimal_of, split_cells, to_numbers
from mckibben.dataset.matrix import matrix_remedy
from mckibben.dataset.raw import MOST_PLAIN, Budget, Floats, RawColumn, RawTable
from mckibben.dataset.table import question, refusal
from mckibben.dataset.vocabulary import dimension_of, parse_header
from mckibben.errors import DatasetError, Problem

_MARKS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe\0\0", "utf-32"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))
_COMMENT = ("#", "%", "//", "!")
_SEARCHED = 300  # lines in which a header is looked for
_LISTED = 1000  # corrupt rows that are named
_LONGEST = 2**16  # characters of a line
_CHUNK = 2**22  # bytes of a text of numbers that are read together
_PLAIN = b"0123456789+-.eE,;|\t \r\n"  # bytes of its rows
_STAMP = re.compile(r"(\d\d:\d\d:\d\d\.\d{3}) -> ")  # of the monitor of the Arduino IDE, before each line
_FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[+-]\d\d)")  # of an exponent
_SIGN = re.compile(r"((?:^|[;,\t|])[ \"]?[+-]) +(?=[.,]?\d)", re.MULTILINE)
_HEAD = 3000  # characters with the header, whose cells may have line breaks
_BROKEN = re.compile(r'(?<![^,;\t\n])"[^",;\t\d]{1,99}[\r\n]+[^",;\t\d]{1,99}"(?![^,;\t\r\n])')
_TYPOGRAPHY = str.maketrans({"\u2212": "-", "\u2013": "-", "\ufeff": None})
_LAST_DECIMALS = re.compile(r'(?:[.,](\d*))?"?\s*$')
KEYS = ("specimen", "source", "initial_length", "slack_force", "preprocessing", "repairs")


def decode(data: bytes, path: Path) -> str:
    r"""Text by its byte order mark, else UTF-8, else Windows-1252.

    Raises a `DatasetError` for binary content.

    >>> decode("Länge [mm]".encode("cp1252"), Path("rig.csv"))
    'Länge [mm]'
    """
    encoding = next((name for mark, name in _MARKS if data.startswith(mark)), "")
    data = data if encoding or len(data) % 2 == 0 else data.rstrip(b"\0")
    if not encoding and b"\0" in data:
        encoding = next(filter(partial(_is_text, data), ("utf-16-le", "utf-16-be")), "")
        if not encoding:
            raise refusal(path, "is a binary file", "give text in UTF-8, .xlsx, .h5, .mat or .tdms")
    try:
        return data.decode(encoding or "utf-8")
    except UnicodeDecodeError:
        return data.decode("cp1252", "replace")


def _is_text(data: bytes, encoding: str) -> bool:
    """Whether bytes are lines of printed characters in an encoding."""
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        return False
    return "\n" in text and all(map(str.isprintable, text[:_HEAD].split()))


def read_text(
    text: str, path: Path, mapping: Mapping[str, str], decimal: str, read: Callable[..., RawTable]
) -> RawTable:
    """Columns of a text: words, a header, perhaps rows of units, then one line per row; `read` is as `read_lines`."""
    Budget(path).spend(rows=max(text.count("\n"), text.count("\r")))
    text = _BROKEN.sub(lambda cell: " ".join(cell[0].split()), text[:_HEAD]) + text[_HEAD:]
    text = text.replace("\r\n", "\n").replace("\r", "\n").translate(_TYPOGRAPHY)
    lines = _SIGN.sub(r"\1", _FORTRAN.sub("e", text)).split("\n")
    stamps = [_STAMP.match(line) for line in lines]
    if any(stamps):
        lines = [line[stamp.end() :] if stamp else line for line, stamp in zip(lines, stamps, strict=True)]
        table = read(lines, path, mapping, decimal)
        times = [stamp[1] if stamp else "" for line in table.lines for stamp in stamps[line - 1 : line]]
        table.columns.append(RawColumn("time", times))
        return table
    if lines[0].startswith("LabVIEW Measurement"):
        lines = _of_labview(lines, path)
    return read(lines, path, mapping, decimal)


def read_numbers(path: Path, mapping: Mapping[str, str], decimal: str) -> RawTable | None:
    """Columns of a text whose rows have numbers alone, read in chunks, as of `read_text`; None for any other file.

    Raises a `DatasetError` if there are more numbers than may be read, or their decimal sign is not plain.
    """
    with path.open("rb") as file:
        chunk = file.read(_CHUNK)
        head = chunk[: chunk.rfind(b"\n", 0, 4 * _LONGEST) + 1]
        if b"\0" in chunk or not head:
            return None
        text = decode(head, path).replace("\r\n", "\n").translate(_TYPOGRAPHY)
        lines = text.split("\n")
        if "\r" in text or _BROKEN.search(text[:_HEAD]) or lines[0].startswith("LabVIEW Measurement"):
            return None
        layout = find_layout(lines, mapping)
        if layout is None or layout.separator == " ":
            return None
        table, separator, at = RawTable(place="line", decimal=decimal), layout.separator, 0
        _take_words(table, enumerate(lines[: max(layout.row, 0)], 1))
        names, units, first = _header(table, lines, layout)
        rows, count = head.split(b"\n", first)[-1], len(names)
        if not rows.strip() or rows.translate(None, _PLAIN):
            return None
        table.decimal = decimal or decimal_of(lines[first:], separator, path)
        file.seek(begin := len(head) - len(rows))
        blocks = iter(lambda: file.read(_CHUNK), b"")
        ends, marks = np.sum([(more.count(b"\n"), more.count(separator.encode())) for more in blocks], axis=0)
        Budget(path, MOST_PLAIN).spend(size=8 * (1 + ends) * count, columns=count)
        file.seek(max(file.tell() - _LONGEST, begin))
        tail = file.read()
        values = np.empty((count, 1 + ends - tail[len(tail.rstrip(b"\r\n")) :].count(b"\n")))
        file.seek(begin)
        options = {"dtype": np.float64, "quoting": csv.QUOTE_NONE, "na_filter": True}
        try:
            for block in _frame(file, separator, table.decimal, count, chunksize=_CHUNK // 32, **options):
                values[:, at : at + len(block)] = block.to_numpy().T
                at += len(block)
        except ValueError:
            return None
    if at < values.shape[1] or marks != at * (count - 1) or not np.isfinite(values).all():
        return None
    table.lines = np.arange(first + 1, first + 1 + at)
    for place, unit in enumerate(units):
        _add_column(table, names, place, values[place], unit)
    if not tail.endswith(b"\n"):
        _ask_of_cut(table, tail.decode().splitlines()[-50:])
    return table


def read_lines(
    lines: Sequence[str], path: Path, mapping: Mapping[str, str], decimal: str = "", settled: str = ""
) -> RawTable:
    """Columns of the table in the lines of a text or sheet.

    Parameters
    ----------
    lines
        Lines without their ends; an empty last one shows that the text was not cut off.
    mapping
        Headers of the recipe with their names, which are understood in any case.
    decimal, settled
        Decimal sign of the recipe, and that of the sheet's numbers.

    Raises
    ------
    DatasetError
        If there is no header, no row, or more of either than may be read.
    """
    budget, table = Budget(path), RawTable(place="line")
    budget.spend(rows=len(lines))
    if max(map(len, lines)) > _LONGEST:
        raise refusal(path, f"has a line of more than {_LONGEST} characters", "save rows")
    layout = find_layout(lines, mapping)
    if layout is None:
        raise DatasetError(str(path), [_no_header(lines)])
    separator = layout.separator
    _take_words(table, enumerate(lines[: max(layout.row, 0)], 1))
    names, units, first = _header(table, lines, layout)
    rows = _rows(table, lines, first, separator, names)
    if not rows:
        none = Problem("has a header, and no rows of numbers", line=layout.row + 1)
        raise DatasetError(str(path), [replace(asked.problem, remedy="") for asked in table.questions] or [none])
    budget.spend(rows=len(rows), columns=len(names), size=8 * len(rows) * len(names))
    table.decimal = decimal or settled
    if not table.decimal:
        table.decimal = decimal_of(rows, separator, path)
    for at, column in enumerate(_cells(rows, separator, table.decimal, len(names), path)):
        numbers, beside = _as_numbers(column, table.decimal, certain=bool(decimal))
        _add_column(table, names, at, numbers, units[at] or beside)
    if table.lines[-1] == len(lines):
        _ask_of_cut(table, rows[-50:])
    return table


def _add_column(table: RawTable, names: Sequence[str], at: int, cells: Floats | list[str], unit: str) -> None:
    """Add the column of a header to a table."""
    repeats = f" ({at + 1})" if names[at] in names[:at] else ""
    name = f"{names[at]}{repeats}" if names[at] else f"column {at + 1}"
    table.columns.append(RawColumn(name, cells, label=names[at], unit=unit))


def _ask_of_cut(table: RawTable, rows: Sequence[str]) -> None:
    """Question about the last number of a file, in the last of its rows."""
    if _is_cut(rows):
        text = "its last number has fewer digits than all others: was the file truncated?"
        table.questions.append(question(text, "corrupt", line=int(table.lines[-1])))


def _is_cut(rows: Sequence[str]) -> bool:
    """Whether the last number of the last row has fewer decimals than those of all others, which have equally many."""
    *others, last = (len(match[1] or "") for row in rows if (match := _LAST_DECIMALS.search(row)))
    return len(others) > 3 and len({*others}) == 1 and last < others[0]


def find_layout(lines: Sequence[str], mapping: Mapping[str, str]) -> Layout | None:
    """Row and separator with most headers that are understood; by position where the mapping has numbers.

    >>> find_layout(["Rig 3", "p [bar];F [N]", "2;150"], {})
    Layout(row=1, separator=';', names=['p [bar]', 'F [N]'])
    """
    by_position = bool(mapping) and all(key.isdigit() for key in mapping)
    best, most = None, 0.5
    for row, line in enumerate(lines[:_SEARCHED]):
        commented = line.lstrip().startswith(_COMMENT)
        for separator in SEPARATORS:
            cells = split_cells(line.lstrip("#%/! \t") if commented else line, separator)
            numbers = sum(NUMBER.fullmatch(cell) is not None for cell in cells)
            if by_position and numbers == len(cells) >= max(map(int, mapping)):
                return Layout(row - 1, separator, [str(at + 1) for at in range(len(cells))])
            if numbers or by_position or len(cells) < 2:
                continue
            if separator == " " and len(split_cells(lines[min(row + 1, len(lines) - 1)], separator)) < 2:
                continue  # blanks within names
            cells = _named_channels(cells, lines[:row], separator)
            if (score := _score(cells, mapping) - 0.25 * commented) > most:
                best, most = Layout(row, separator, cells), score
    return best


def _score(cells: Sequence[str], mapping: Mapping[str, str]) -> float:
    """Sum over the cells of a row of 1 for a header that is understood, and 1/2 for a name without a unit."""
    total, quantities = 0.0, set()
    for cell in cells[:200]:
        header = parse_header(cell)
        if cell in mapping:
            total += 1
        elif quantity := header.quantity or parse_header(header.name).quantity:
            total += 1 if header.quantity and header.unit and quantity not in quantities else 0.5
            quantities.add(quantity)
    return total if len(quantities) > 1 or total > 1 else 0.0


def _named_channels(cells: list[str], preamble: Sequence[str], separator: str) -> list[str]:
    """Header with the names that a block above the table gives to its channels (CH1, Force)."""
    if not any(re.fullmatch(r"CH ?\d+", cell) for cell in cells):
        return cells
    rows = [split_cells(line, separator) for line in preamble]
    named = {row[0]: row[1] for row in rows if len(row) > 2 and parse_header(row[1]).quantity}
    return [named.get(cell, cell) for cell in cells]


def _no_header(lines: Sequence[str]) -> Problem:
    shown = next((line.strip() for line in lines if line.strip()), "")
    if not shown:
        return Problem("is empty", remedy="give a file with a header and rows")
    text = f"has no header that is understood; it begins with {shown[:80]!r}"
    if remedy := matrix_remedy(lines):
        return Problem(f"{text}: a matrix?", remedy=remedy)
    remedy = (
        "name its columns by header or, without one, by position: columns={'HEADER': 'force_N', '2': 'pressure_bar'} "
        "(command line: --column 'HEADER=force_N' --column '2=pressure_bar')"
    )
    if not shown.isascii():
        remedy += "; save a text in another encoding than UTF-8 or Windows-1252 as UTF-8"
    if re.search(r"\b(m?V|volts?|counts?)\b", shown, re.IGNORECASE):
        remedy += ", of sensors with their line: --column 'HEADER=2.5*(x-0.4) pressure_bar'"
    return Problem(text, remedy=remedy)


def _take_words(table: RawTable, lines: Iterable[tuple[int, str]]) -> None:
    """Keep the words beside the table; keys that this program writes are comments."""
    for number, line in lines:
        bare = line.strip().lstrip("#%").strip()
        key, colon, value = bare.partition(":")
        if line.lstrip().startswith("#") and colon and key.strip() in KEYS:
            table.comments[key.strip()] = value.strip()
        elif bare:
            table.words.append((number, bare))


def _header(table: RawTable, lines: Sequence[str], layout: Layout) -> tuple[list[str], list[str], int]:
    """Names and units of the columns, and the first row of numbers; rows between that are no units are words."""
    names, units, first = layout.names, [""] * len(layout.names), layout.row + 1
    for first in range(layout.row + 1, min(layout.row + 6, len(lines))):
        cells = [cell.strip("[]() ") for cell in split_cells(lines[first], layout.separator)]
        numbers = [cell for cell in cells if BEGINS.match(cell)]
        if any(map(dimension_of, cells)) and {*numbers} <= {"1"} and len(cells) <= len(names):
            named = [cell if dimension_of(cell) or cell in ("-", "1") else "" for cell in cells]
            units = [*named, *units[len(named) :]]
        elif numbers:
            break
        else:
            _take_words(table, [(first + 1, lines[first])])
    else:
        first += 1
    if first < len(lines) and len(wide := split_cells(lines[first], layout.separator)) == len(names) + 1:
        if not wide[-1]:
            return [*names, ""], [*units, ""], first
        if layout.separator != "," or "." in lines[first]:  # decimal commas would look like row numbers
            return ["", *names], ["", *units], first
    return names, units, first


def _rows(table: RawTable, lines: Sequence[str], first: int, separator: str, names: Sequence[str]) -> list[str]:
    """Rows, with their line numbers in the table.

    Comments and lines without numbers are words; rows of another width than the header's are corrupt.
    """
    rows: list[str] = []
    table.lines = numbers = []
    for number, line in enumerate(lines[first:], first + 1):
        if not line.strip(f"{separator} \t"):
            continue
        quoted = '"' in line or separator == " "
        count = len(split_cells(line, separator)) if quoted else line.count(separator) + 1
        if line.lstrip().startswith(_COMMENT):
            _take_words(table, [(number, line)])
        elif count == len(names):
            if line[0].isdigit() or split_cells(line, separator) != names:
                rows.append(line)
                numbers.append(number)
        elif not any(map(BEGINS.match, split_cells(line, separator))):
            _take_words(table, [(number, line)])
        elif len(table.questions) < _LISTED:
            text = f"has {count} cell{'s' if count != 1 else ''}, the header {len(names)}"
            table.questions.append(question(text, "corrupt", line=number))
    return rows


def _cells(rows: Sequence[str], separator: str, decimal: str, count: int, path: Path) -> list[Floats | list[str]]:
    """Cells of each column: numbers where pandas reads all as such, else texts."""
    quoting = csv.QUOTE_MINIMAL if all(row.count('"') % 2 == 0 for row in rows) else csv.QUOTE_NONE
    try:
        read = _frame(io.StringIO("\n".join(rows)), separator, decimal, count, quoting=quoting)
    except ValueError as error:
        raise refusal(path, f"cannot be split into cells: {error}") from None
    if len(read) != len(rows):
        raise refusal(path, "has quotation marks across lines", "remove them")
    return [
        read[at].to_numpy(np.float64) if read[at].dtype.kind in "iuf" else [str(cell).strip() for cell in read[at]]
        for at in range(count)
    ]


def _frame(stream: BinaryIO | io.StringIO, separator: str, decimal: str, count: int, **options: object) -> Any:
    """Cells of rows by pandas: a frame or, with a size of chunks, several."""
    import pandas as pd

    return pd.read_csv(  # type: ignore[call-overload]
        stream,
        sep=r"\s+" if separator == " " else separator,
        header=None,
        index_col=False,
        names=range(count),
        decimal=decimal,
        skipinitialspace=True,
        low_memory=False,
        **{"na_filter": False, **options},
    )


def _as_numbers(cells: Floats | list[str], decimal: str, *, certain: bool) -> tuple[Floats | list[str], str]:
    """Cells as numbers where all are, and the unit that stands behind each of them."""
    if not isinstance(cells, list):
        return cells, ""
    matches = [WITH_UNIT.fullmatch(cell) for cell in cells]
    units = {match[2] if match else "" for match in matches}
    unit = units.pop() if len(units) == 1 else ""
    bare = [match[1] for match in matches if match] if dimension_of(unit) else cells
    numbers = to_numbers(bare, decimal, certain=certain)
    return bare if np.isnan(numbers).any() else numbers, unit if bare is not cells else ""


def _of_labview(lines: list[str], path: Path) -> list[str]:
    """Lines of a LabVIEW measurement of one segment as those of a table with a row of units.

    Its units stand in the second header as ``Y_Unit_Label``, and rows without a comment are one cell shorter. Raises a
    `DatasetError` if there are several segments.
    """
    ends = [row for row, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    if len(ends) != 2:
        remedy = "write one segment to a file, or give TDMS"
        raise refusal(path, f"has {max(len(ends) - 1, 0)} segments", remedy)
    before, header, rows = lines[: ends[1]], *lines[ends[1] + 1 : ends[1] + 2], lines[ends[1] + 2 :]
    separator = "," if any(line.startswith("Separator,") for line in before) else "\t"
    units = next((line for line in before if line.startswith("Y_Unit_Label")), "").split(separator)[1:]
    said = [line if line.startswith(("Notes", "Description", "Y_Dimension_Label")) else "" for line in before]
    rows = [f"{line}{separator * (header.count(separator) - line.count(separator))}" for line in rows]  # no comment
    return [*said, header, separator.join(["s", *units[: header.count(separator)]]), *rows]
