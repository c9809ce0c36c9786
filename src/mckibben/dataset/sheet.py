"""Raw table of a file: named columns of numbers or text with their line numbers."""

from __future__ import annotations

import contextlib
import functools
import io
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import DatasetError, Problem
from mckibben.units import NUMBER

COMMENTS = ("specimen", "source", "initial_length", "slack_force", "preprocessing", "repairs")
"""Keys of the comments that are read."""


@dataclass(frozen=True, slots=True)
class RowProblem(Problem):
    """Problem of a table with rows instead of lines."""

    def __str__(self) -> str:
        text = Problem.__str__(self)
        return text if self.line is None else f"row{text.removeprefix('line')}"


@dataclass(frozen=True, eq=False)
class RawColumn:
    """Raw column: full name (``group/channel``), cells, line numbers, short name and unit given outside the name.

    `notes` are warnings that matter only if the column is read; `missing` are lines that the file marks as missing;
    `scale` are factors of cells that are in another unit.
    """

    name: str
    cells: Sequence[str] | NDArray[np.float64]
    lines: Sequence[int]
    short: str = ""
    unit: str = ""
    notes: tuple[str, ...] = ()
    missing: frozenset[int] = frozenset()
    scale: NDArray[np.float64] | None = None

    @property
    def label(self) -> str:
        """Part of the name that is parsed as a header."""
        return self.short or self.name


@dataclass
class RawTable:
    """Raw columns of a file, and its problems."""

    channels: list[RawColumn] = field(default_factory=list)
    header_line: int | None = None
    comments: dict[str, tuple[int, str]] = field(default_factory=dict)
    delimiter: str = ";"
    has_header: bool = True
    corrupt: list[Problem] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    suspect: list[str] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    interval: float | None = None
    kind: type[Problem] = Problem

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return [channel.name for channel in self.channels]

    @property
    def unit(self) -> str:
        """Name of a line of this file."""
        return "line" if self.kind is Problem else "row"


_NOT_APPLIED = re.compile(
    r"scal|factor|gain|zero|bias|correct|offset|slope|intercept|conver|multipl|sensitiv|calib|resol|coeff|excit|(?<![a-z])(?:lsb|tare|cal(?![a-z]))",
    re.IGNORECASE,
)
NOT_APPLIED = re.compile(
    r"(?<![a-z])(?:gain\b|multipl(?:y|ied|ier)\b|divided? by|uncalibrat|not calibrat|(?:scale|calibration) factor"
    r"|offset|(?:not|un)[- ]?tared|tare\b|tara\b|subtract|lever|hebel|raw (?:counts|data|values)|raw\b.{0,40}\btimes"
    r"|(?:times|\*|(?<![0-9])(?<![0-9] )(?<!mm )[x×]) ?[0-9]|(?:per|/) ?(?:digit|count|bit|lsb|fib)"
    r"|(?:two|three|four|[2-9]) (?:muscles|muskeln|actuators)|(?:in|muscles) parallel)",
    re.I,
)
"""Words of a comment or description after which numbers may not be in the unit of their name."""
MENTIONED = re.compile(
    r"(?<![a-z])(?:forces?|loads?|pressures?|contractions?|lengths?|displacements?|units?|readings?|correct\w*|calibrat\w*"
    r"|sensitiv\w*|scal(?:e|ed|ing)|kr[aä]fte?|dr[uü]cke?|kontraktion|verkürzung|längen?|weg|einheiten?|forza|fuerza"
    r"|pression\w*|presi[oó]n|longueur|(?-i:[Fp](?=_| ?[=\[(]| in )))(?![a-z])",
    re.IGNORECASE,
)
"""Words of a line outside the table that may say something of its numbers."""


def not_applied(attributes: Mapping[str, object]) -> tuple[str, ...]:
    """Notes on attributes of a column that may scale its numbers, or say so."""
    found = [
        name
        for name, value in attributes.items()
        if (_NOT_APPLIED.search(name) and "date" not in name.lower())
        or (isinstance(value, str) and NOT_APPLIED.search(value[:_LONGEST_TEXT]))
    ]
    return tuple(f"has the attribute {name!r}, which is not applied" for name in found)


def unreadable(path: Path, what: str, error: Exception, remedy: str = "save it again") -> DatasetError:
    """Error for a file that a library cannot read."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return DatasetError(str(path), [Problem(f"cannot be read as {what}: {text.splitlines()[0]}", remedy=remedy)])


class NumberText(str):
    """Text of a cell that is a number in the file: it says nothing about the decimal sign of other cells."""

    __slots__ = ()


def as_column(cells: Sequence[object]) -> list[str] | NDArray[np.float64]:
    """Cells of a column as numbers if all are numeric, else as texts; an empty cell is an empty text.

    Texts are shortened: a file of a few MB may refer to a long one in each of a million cells.
    """
    if all(map(_is_number, cells)):
        try:
            return np.array(cells, dtype=np.float64)
        except OverflowError:  # an integer too large for a float
            pass

    @functools.cache
    def shortened(text: str) -> str:  # with dots, so that it is not a number
        return f"{text[:_LONGEST_TEXT]}..."

    def as_text(cell: object) -> str:
        if cell is None or _is_number(cell):
            return "" if cell is None else NumberText(cell)
        text = str(cell)
        return text if len(text) <= _LONGEST_TEXT else shortened(text)

    return list(map(as_text, cells))


def _is_number(cell: object) -> bool:
    return isinstance(cell, (int, float, np.integer, np.floating)) and not isinstance(cell, bool)


def at_type_limit(values: np.ndarray) -> tuple[str, ...]:
    """Note on integers at the limit of their type, where a converter saturates."""
    if values.dtype.kind not in "iu" or not values.size:
        return ()
    limits = np.iinfo(values.dtype)
    ends = [limits.max] if values.dtype.kind == "u" else [limits.min, limits.max]
    count = int(np.isin(values, ends).sum())
    return (f"{count} of {values.size} values are at the limit of {values.dtype}: saturated?",) if count else ()


_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:([.,'’\s])[0-9]{3})(?:\1[0-9]{3})*(?:([.,])[0-9]*)?")
_ONE_SIGN = re.compile(r"[+-]?([0-9]*)([.,])([0-9]*)([eEdD][+-]?[0-9]+)?")
_FORTRAN = re.compile(r"(?<=[0-9.,])[dD](?=[+-]?[0-9])")
_SIGN = re.compile(r"^([+-])\s+(?=[0-9])")  # + 1.5, as some loggers write
_UNCERTAIN = re.compile(r"(?<=[0-9.,])\s*(?:±|\+/-|\+-)\s*[0-9.,]+$")  # of 12.3 ± 0.5
_LONGEST_TEXT = 200  # characters of a cell of a workbook or another binary file
_FEW = 10_000  # cells of a column whose problems are all listed
_UNDECIDED = "?"
_DIGITS = frozenset("0123456789+-eE \n")
_NAMES = {".": "point", ",": "comma"}
_ONE_DECIMAL_SIGN = "use one decimal sign in the whole file"


@dataclass(frozen=True)
class DecimalSign:
    """Decimal sign of a file, the line that determines it (None if none does), and True if it was given."""

    sign: str
    line: int | None = None
    given: bool = False


def _number_alone(text: str) -> str:
    """Text of a number without the blank after its sign and without its uncertainty."""
    text = _SIGN.sub(r"\1", text) if text[:1] in "+-" else text
    return _UNCERTAIN.sub("", text) if "±" in text or "+/-" in text or "+-" in text else text


def evidence(cell: str) -> str:
    """Decimal sign that a cell determines; "?" for 1.234 and 1,234, empty if it has none."""
    if isinstance(cell, NumberText):
        return ""
    text = _number_alone(cell.strip())
    if match := _ONE_SIGN.fullmatch(text):
        whole, sign, rest, exponent = match.groups()
        grouped = len(rest) == 3 and not exponent and 0 < len(whole) <= 3 and whole[0] != "0"
        return _UNDECIDED if grouped else sign if whole or rest else ""
    if (match := _THOUSANDS.fullmatch(text)) and match[1] != match[2]:
        return {".": ",", ",": "."}.get(match[1], match[2] or "")
    return ""


def decimal_sign(
    columns: Sequence[RawColumn], others: Sequence[RawColumn], delimiter: str, given: str
) -> tuple[DecimalSign, Problem | None]:
    """Decimal sign of a file from the columns read, else from other numeric columns; and the question if none decides.

    Between commas, 1.234 has a decimal point.
    """
    if given:
        return _given_sign(columns, given)
    open_question: tuple[RawColumn, int, str] | None = None
    found: DecimalSign | None = None
    for column in columns:
        if isinstance(column.cells, np.ndarray):
            continue
        for line, cell in zip(column.lines, column.cells, strict=True):
            if found is not None and found.line is not None and line >= found.line:
                break
            sign = evidence(cell) if "." in cell or "," in cell else ""
            if sign == _UNDECIDED and delimiter == "," and "." in cell:
                sign = "."
            if sign == _UNDECIDED:
                open_question = open_question or (column, line, cell.strip())
            elif sign:
                found = DecimalSign(sign, line)
                break
    if found is None:
        found = next(filter(None, map(_sign_of_numbers, others)), None)
    if found is not None or open_question is None:
        return found or DecimalSign("."), None
    column, line, text = open_question
    sign = "," if "," in text else "."
    other = "." if sign == "," else ","
    remedy = (
        f"for {text.replace(sign, '.')} give decimal={sign!r} (command line: --decimal '{sign}'), "
        f"for {text.replace(sign, '')} give decimal={other!r} (command line: --decimal '{other}')"
    )
    message = f"{text!r} is {text.replace(sign, '')} or {text.replace(sign, '.')}; no cell of the file decides"
    return DecimalSign(sign), Problem(message, line=line, field=column.name, remedy=remedy)


def _given_sign(columns: Sequence[RawColumn], given: str) -> tuple[DecimalSign, Problem | None]:
    """The given decimal sign; the other one, with a problem, where most cells that determine theirs have it."""
    other = "," if given == "." else "."
    texts = [
        (line, column.name, cell.strip())
        for column in columns
        if not isinstance(column.cells, np.ndarray)
        for line, cell in zip(column.lines, column.cells, strict=True)
        if evidence(cell) in (".", ",")
    ]
    wrong = [one for one in texts if evidence(one[2]) == other]
    if 2 * len(wrong) <= len(texts):
        return DecimalSign(given, given=True), None
    line, name, cell = min(wrong)
    text = f"decimal is {given!r}, but {len(wrong)} numbers have a decimal {_NAMES[other]}, first {cell!r}"
    choice = f"leave decimal out, or give decimal={other!r} (command line: --decimal '{other}')"
    remedy = choice if len(wrong) == len(texts) else _ONE_DECIMAL_SIGN
    return DecimalSign(other, given=True), Problem(text, line=line, field=name, remedy=remedy)


def _sign_of_numbers(column: RawColumn) -> DecimalSign | None:
    """Decimal sign of an unread column, if all its cells are numbers."""
    if isinstance(column.cells, np.ndarray):
        return None
    filled = [(line, cell) for line, cell in zip(column.lines, column.cells, strict=True) if cell.strip()]
    signs = [(line, evidence(cell)) for line, cell in filled]
    if any(not sign and not NUMBER.fullmatch(cell.strip()) for (_, sign), (_, cell) in zip(signs, filled, strict=True)):
        return None
    return next((DecimalSign(sign, line) for line, sign in signs if sign in (".", ",")), None)


def read_numbers(
    cells: Sequence[str] | NDArray[np.float64],
    lines: Sequence[int],
    *,
    field: str,
    decimal: DecimalSign,
    may_be_empty: bool = False,
    kind: type[Problem] = Problem,
) -> tuple[NDArray[np.float64], list[Problem]]:
    """Values of a column (NaN where there is no number), and a problem for each cell that is not a finite number.

    Of a long column most of whose cells are not numbers, the first problems are listed, and one without a line.
    """
    if isinstance(cells, np.ndarray):
        if np.isfinite(cells).all():
            return cells, []
        refused = ~np.isfinite(cells) & ~(np.isnan(cells) & may_be_empty)
        found = [
            kind(f"{cells[at]:g} is not a finite number", line=lines[int(at)], field=field)
            for at in np.flatnonzero(refused)
        ]
        return np.where(np.isfinite(cells), cells, np.nan), found
    joined = "\n".join(cells)
    plain = _DIGITS | {decimal.sign}  # so float() accepts nothing that we would refuse
    if set(joined) <= plain:
        try:
            values = np.fromiter(map(float, joined.replace(",", ".").split("\n")), np.float64)
        except ValueError:
            pass
        else:
            if len(values) == len(cells) and np.isfinite(values).all():
                return values, []
    values = np.full(len(cells), np.nan)
    wrong: list[int] = []
    place = "line" if kind is Problem else "row"
    settled = decimal.given or (decimal.line is not None and not _only_groups(cells))

    def trimmed(cell: str) -> str:
        text = _FORTRAN.sub("e", cell.strip().replace("\u2212", "-"))  # the exponent of 1.5D+02
        return _without_thousands(_number_alone(text), decimal.sign, settled=settled)

    for index, cell in enumerate(cells):
        if not cell:
            if not may_be_empty:
                wrong.append(index)
            continue
        if isinstance(cell, NumberText) and np.isfinite(float(cell)):
            values[index] = float(cell)
            continue
        if plain.issuperset(cell):
            with contextlib.suppress(ValueError):
                if math.isfinite(value := float(cell.replace(",", "."))):
                    values[index] = value
                    continue
        text = trimmed(cell)
        if not text and may_be_empty:
            continue
        if _wrong(text, decimal, place)[0]:
            wrong.append(index)
            if 2 * len(wrong) > len(cells) > _FEW:
                break
        else:
            values[index] = float(text.replace(",", "."))
    too_many = 2 * len(wrong) > len(cells) > _FEW
    problems: list[Problem] = []
    for index in wrong[:_FEW] if too_many else wrong:
        message, remedy = _wrong(trimmed(cells[index]), decimal, place)
        problems.append(kind(message, line=lines[index], field=field, remedy=remedy))
    if too_many:
        problems.append(Problem("more than half of its cells are not numbers: too many to leave out", field=field))
    return values, problems


def _only_groups(cells: Sequence[str]) -> bool:
    """True if all cells have the form 1,234: then nothing but other columns says that these are thousands."""
    filled = [cell for cell in cells if cell.strip()]
    return all(evidence(cell) == _UNDECIDED for cell in filled)


def _without_thousands(text: str, decimal: str, *, settled: bool) -> str:
    """Return the number without thousands separators, unless one of them could be a decimal sign."""
    match = _THOUSANDS.fullmatch(text)
    if match is None or match[1] == decimal or match[1] == match[2]:
        return text
    if not settled and match[1] in ".," and text.count(match[1]) == 1 and decimal not in text:
        return text
    return text.replace(match[1], "")


def _wrong(text: str, decimal: DecimalSign, place: str) -> tuple[str, str]:
    """Problem of a cell and its remedy; empty texts if there is none."""
    shown = repr(text if len(text) <= 40 else f"{text[:37]}...")
    other = "," if decimal.sign == "." else "."
    if not text:
        return "the cell is empty", ""
    if NUMBER.fullmatch(text.replace(decimal.sign, ".")) and other not in text:
        return ("", "") if np.isfinite(float(text.replace(",", "."))) else (f"{shown} is not a finite number", "")
    if text.count(other) == 1 and decimal.sign not in text and NUMBER.fullmatch(text.replace(other, ".")):
        if decimal.line is None:
            return f"{shown} has a decimal {_NAMES[other]}", f"use a decimal {_NAMES[decimal.sign]}"
        has = f"{shown} has a decimal {_NAMES[other]}, but {place} {decimal.line} a decimal {_NAMES[decimal.sign]}"
        return has, _ONE_DECIMAL_SIGN
    if _THOUSANDS.fullmatch(text):
        return f"{shown} may contain a thousands separator", "write the number without it"
    if text.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{shown} is not a finite number", ""
    return f"{shown} is not a number", ""


_LARGE = 2**20  # bytes of numbers, from which pandas reads them


def numeric_bytes(delimiter: str, sign: str) -> bytes:
    """Bytes of a text of numbers with a delimiter and a decimal sign."""
    return ("0123456789+-eE\r\n" + sign + (" \t" if delimiter == " " else delimiter)).encode()


def count_rows(raw: bytes) -> int:
    """Number of lines of a text."""
    return raw.count(b"\n") + (not raw.endswith(b"\n"))


def parse_numbers(raw: bytes, delimiter: str, sign: str, columns: int) -> NDArray[np.float64]:
    """Numbers of a text, shape (rows, columns); `ValueError` if a cell has no finite one, or rows differ in length."""
    if b"\r" in raw:
        raw = raw.replace(b"\r\n", b"\n")
    if b"\r" in raw or not raw.strip():
        raise ValueError("a carriage return within a line, or no row")
    rows = count_rows(raw)
    numbers = _parsed_numbers(raw.replace(b",", b".") if sign == "," else raw, delimiter, rows, columns)
    if numbers.shape != (rows, columns) or not np.isfinite(numbers).all():
        raise ValueError("an empty line, or a number that is not finite")
    return numbers


def _parsed_numbers(raw: bytes, delimiter: str, rows: int, columns: int) -> NDArray[np.float64]:
    """Numbers of a text with decimal points, by NumPy or pandas."""
    if len(raw) < _LARGE or delimiter == " ":
        return np.loadtxt(io.TextIOWrapper(io.BytesIO(raw)), delimiter=None if delimiter == " " else delimiter, ndmin=2)
    import pandas as pd  # three times as fast, but takes 0.3 s to import

    if raw.count(delimiter.encode()) != rows * (columns - 1):
        raise ValueError("rows of unequal length")
    major, minor = map(int, pd.__version__.split(".")[:2])
    exact: Any = {} if (major, minor) >= (3, 1) else {"float_precision": "round_trip"}  # the default from then on
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            table = pd.read_csv(
                io.BytesIO(raw),
                sep=delimiter,
                header=None,
                names=[*map(str, range(columns))],
                index_col=False,
                dtype=np.float64,
                na_filter=False,
                **exact,
            )
        except pd.errors.ParserWarning as warning:
            raise ValueError("rows of unequal length") from warning
    return table.to_numpy()
