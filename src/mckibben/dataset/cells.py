"""Text cells to numbers: whole columns at once, cell by cell only to say what is wrong."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import Problem

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
