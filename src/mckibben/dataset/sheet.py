"""Named columns of numbers or text with their line numbers: the common form of every file that is read."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import Problem


@dataclass(frozen=True, slots=True)
class RowProblem(Problem):
    """One thing that is wrong in a table that has rows instead of lines.

    >>> print(RowProblem("is not finite", line=7, field="rig/force"))
    row 7, rig/force: is not finite
    """

    def __str__(self) -> str:
        text = Problem.__str__(self)
        return text if self.line is None else f"row{text.removeprefix('line')}"


@dataclass(frozen=True, eq=False)
class RawColumn:
    """One column of a file.

    Attributes
    ----------
    name
        As the user has to write it: a header, ``group/channel`` or ``struct.field``.
    cells
        Texts, or float64 where the file has numbers; shape (rows,).
    lines
        The number of the line or row of each cell.
    short
        The part of the name that may say what the column is.
    unit
        What the file says of its unit elsewhere than in the name; empty where it does not.
    """

    name: str
    cells: Sequence[str] | NDArray[np.float64]
    lines: Sequence[int]
    short: str = ""
    unit: str = ""

    @property
    def label(self) -> str:
        """The part of the name that may say what the column is."""
        return self.short or self.name


@dataclass
class RawTable:
    """The columns of a file.

    Attributes
    ----------
    channels
        In the order of the file.
    header_line
        The number of the line with their names, where there is one.
    comments
        From the leading ``# key: value`` lines: the number of the line and the value, by key.
    delimiter
        Of a text; the decimal sign hangs on it.
    corrupt
        Rows that are no rows: with too few cells, or cut off. They are in no channel.
    problems
        What makes the file unreadable, or unreadable after a line.
    suspicions
        What is legal and probably not meant.
    ignored
        Things in the file that are no columns, by name.
    interval
        From one row to the next [s], where the file says so, and not in a column.
    kind
        `Problem` of lines or `RowProblem`.
    """

    channels: list[RawColumn] = field(default_factory=list)
    header_line: int | None = None
    comments: dict[str, tuple[int, str]] = field(default_factory=dict)
    delimiter: str = ";"
    corrupt: list[Problem] = field(default_factory=list)
    problems: list[Problem] = field(default_factory=list)
    suspicions: list[str] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)
    interval: float | None = None
    kind: type[Problem] = Problem

    @property
    def names(self) -> list[str]:
        """The names of the columns."""
        return [channel.name for channel in self.channels]

    @property
    def unit(self) -> str:
        """What a line of this file is called."""
        return "line" if self.kind is Problem else "row"


def settled(cells: Sequence[object]) -> list[str] | NDArray[np.float64]:
    """The cells of a column as numbers, if all are, or as texts; nothing is an empty text.

    >>> settled([1, 2.5]), settled([1, None, "a"])
    (array([1. , 2.5]), ['1', '', 'a'])
    """
    if all(isinstance(cell, (int, float, np.integer, np.floating)) and not isinstance(cell, bool) for cell in cells):
        try:
            return np.array(cells, dtype=np.float64)
        except OverflowError:  # an integer that no float can hold
            pass
    return ["" if cell is None else str(cell) for cell in cells]


_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_THOUSANDS = re.compile(r"[+-]?[0-9]{1,3}(?:([.,'’\s])[0-9]{3})(?:\1[0-9]{3})*(?:[.,][0-9]*)?")
_DIGITS = frozenset("0123456789+-eE \n")
_NAMES = {".": "point", ",": "comma"}


@dataclass(frozen=True)
class DecimalSign:
    """The decimal sign of a file, and the line that settled it (None where the delimiter did)."""

    sign: str
    line: int | None = None


def decimal_sign(
    columns: Iterable[Sequence[str] | NDArray[np.float64]], lines: Sequence[int], delimiter: str
) -> DecimalSign:
    """The sign that the first number with one has; in a comma-separated file it is always the point.

    Columns that are numbers already say nothing.
    """
    columns = [column for column in columns if not isinstance(column, np.ndarray)]
    if delimiter == "," or not columns:
        return DecimalSign(".")
    for line, row in zip(lines, zip(*columns, strict=True), strict=False):
        for cell in row:
            if (last := max(cell.rfind("."), cell.rfind(","))) >= 0 and set(cell) <= _DIGITS | {".", ","}:
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
    r"""Convert one column.

    Parameters
    ----------
    cells, lines
        The texts, or numbers; and the number of the line of each.
    field
        The name of the column, for the problems.
    decimal
        The decimal sign of the file; the other one is a problem.
    may_be_empty
        An empty cell is NaN instead of a problem, and NaN an empty cell.
    kind
        Of the problems: `RowProblem` where a line is a row.

    Returns
    -------
    values
        Float64, NaN where there is no number.
    problems
        One for each cell that is no finite number.

    Examples
    --------
    >>> values, problems = read_numbers(["1,5", "", "2.5"], [2, 3, 4], field="force_N",
    ...                                 decimal=DecimalSign(",", 2))
    >>> values
    array([1.5, nan, nan])
    >>> print(*problems, sep="\n")
    line 3, force_N: the cell is empty
    line 4, force_N: '2.5' has a decimal point, but line 2 a decimal comma; use one of them in the whole file
    """
    if isinstance(cells, np.ndarray):
        wrong = ~np.isfinite(cells) & ~(np.isnan(cells) & may_be_empty)
        found = [
            kind(f"{cells[at]:g} is not a finite number", line=lines[int(at)], field=field)
            for at in np.flatnonzero(wrong)
        ]
        return np.where(np.isfinite(cells), cells, np.nan), found
    joined = "\n".join(cells)
    if set(joined) <= _DIGITS | {decimal.sign}:  # so float() can take nothing that we would not
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
        text = cell.strip()
        if not text and may_be_empty:
            continue
        message, remedy = _wrong(text, decimal, "line" if kind is Problem else "row")
        if message:
            problems.append(kind(message, line=line, field=field, remedy=remedy))
        else:
            values[index] = float(text.replace(",", "."))
    return values, problems


def _wrong(text: str, decimal: DecimalSign, place: str) -> tuple[str, str]:
    """What is wrong with a cell and what to do about it; two empty texts where nothing is."""
    shown = repr(text if len(text) <= 40 else f"{text[:37]}...")
    other = "," if decimal.sign == "." else "."
    if not text:
        return "the cell is empty", ""
    if _NUMBER.fullmatch(text.replace(decimal.sign, ".")) and other not in text:
        return ("", "") if np.isfinite(float(text.replace(",", "."))) else (f"{shown} is not a finite number", "")
    if text.count(other) == 1 and decimal.sign not in text and _NUMBER.fullmatch(text.replace(other, ".")):
        if decimal.line is None:
            return f"{shown} has a decimal {_NAMES[other]}", f"use a decimal {_NAMES[decimal.sign]}"
        has = f"{shown} has a decimal {_NAMES[other]}, but {place} {decimal.line} a decimal {_NAMES[decimal.sign]}"
        return has, "use one of them in the whole file"
    if _THOUSANDS.fullmatch(text):
        return f"{shown} has a thousands separator", "write the number without it"
    if text.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"{shown} is not a finite number", ""
    return f"{shown} is not a number", ""
