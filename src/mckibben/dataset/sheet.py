"""Raw table of a file: named columns of numbers or text with their line numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import DatasetError, Problem
from mckibben.units import NUMBER


@dataclass(frozen=True, slots=True)
class RowProblem(Problem):
    """Problem of a table with rows instead of lines."""

    def __str__(self) -> str:
        text = Problem.__str__(self)
        return text if self.line is None else f"row{text.removeprefix('line')}"


@dataclass(frozen=True, eq=False)
class RawColumn:
    """Raw column: full name (``group/channel``), cells, line numbers, short name and unit given outside the name."""

    name: str
    cells: Sequence[str] | NDArray[np.float64]
    lines: Sequence[int]
    short: str = ""
    unit: str = ""

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


def unreadable(path: Path, what: str, error: Exception, remedy: str = "save it again") -> DatasetError:
    """Error for a file that a library cannot read."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return DatasetError(str(path), [Problem(f"cannot be read as {what}: {text.splitlines()[0]}", remedy=remedy)])


def as_column(cells: Sequence[object]) -> list[str] | NDArray[np.float64]:
    """Cells of a column as numbers if all are numeric, else as texts; an empty cell is an empty text."""
    if all(isinstance(cell, (int, float, np.integer, np.floating)) and not isinstance(cell, bool) for cell in cells):
        try:
            return np.array(cells, dtype=np.float64)
        except OverflowError:  # an integer too large for a float
            pass
    return ["" if cell is None else str(cell) for cell in cells]


_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:([.,'’\s])[0-9]{3})(?:\1[0-9]{3})*(?:[.,][0-9]*)?")
_DIGITS = frozenset("0123456789+-eE \n")
_NAMES = {".": "point", ",": "comma"}


@dataclass(frozen=True)
class DecimalSign:
    """Decimal sign of a file, and the line where it was found (None if it follows from the delimiter)."""

    sign: str
    line: int | None = None


def decimal_sign(
    columns: Iterable[Sequence[str] | NDArray[np.float64]], lines: Sequence[int], delimiter: str
) -> DecimalSign:
    """Decimal sign of the first number that has one; always a point in a comma-separated file."""
    columns = [column for column in columns if not isinstance(column, np.ndarray)]
    if delimiter == "," or not columns:
        return DecimalSign(".")
    for line, row in zip(lines, zip(*columns, strict=True), strict=False):
        for cell in row:
            last = max(cell.rfind("."), cell.rfind(","))
            if last >= 0 and cell.count(cell[last]) == 1 and set(cell) <= _DIGITS | {".", ","}:
                return DecimalSign(cell[last], line)
    return DecimalSign(".")


def read_numbers(
    cells: Sequence[str] | NDArray[np.float64],
    lines: Sequence[int],
    *,
    field: str,
    decimal: DecimalSign,
    may_be_empty: bool = False,
    kind: type[Problem] = Problem,
) -> tuple[NDArray[np.float64], list[Problem]]:
    """Values of a column (NaN where there is no number), and a problem for each cell that is not a finite number."""
    if isinstance(cells, np.ndarray):
        wrong = ~np.isfinite(cells) & ~(np.isnan(cells) & may_be_empty)
        found = [
            kind(f"{cells[at]:g} is not a finite number", line=lines[int(at)], field=field)
            for at in np.flatnonzero(wrong)
        ]
        return np.where(np.isfinite(cells), cells, np.nan), found
    joined = "\n".join(cells)
    if set(joined) <= _DIGITS | {decimal.sign}:  # so float() accepts nothing that we would refuse
        try:
            values = np.fromiter(map(float, joined.replace(",", ".").split("\n")), np.float64)
        except ValueError:
            pass
        else:
            if len(values) == len(cells) and np.isfinite(values).all():
                return values, []
    values = np.full(len(cells), np.nan)
    problems: list[Problem] = []
    for index, (cell, line) in enumerate(zip(cells, lines, strict=True)):
        text = _without_thousands(cell.strip(), decimal.sign)
        if not text and may_be_empty:
            continue
        message, remedy = _wrong(text, decimal, "line" if kind is Problem else "row")
        if message:
            problems.append(kind(message, line=line, field=field, remedy=remedy))
        else:
            values[index] = float(text.replace(",", "."))
    return values, problems


def _without_thousands(text: str, decimal: str) -> str:
    """Return the number without thousands separators, unless one of them could be a decimal sign."""
    match = _THOUSANDS.fullmatch(text)
    if match is None or match[1] == decimal or (match[1] in ".," and text.count(match[1]) == 1 and decimal not in text):
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
        return has, "use one decimal sign in the whole file"
    if _THOUSANDS.fullmatch(text):
        return f"{shown} may contain a thousands separator", "write the number without it"
    if text.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{shown} is not a finite number", ""
    return f"{shown} is not a number", ""
