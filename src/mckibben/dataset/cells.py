"""Cells of lines of text, and the numbers in them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.dataset.raw import Floats
from mckibben.dataset.table import refusal
from mckibben.dataset.vocabulary import dimension_of

SEPARATORS = ("\t", ";", ",", "|", " ")
NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?")
BEGINS = re.compile(r"[+-]?[.,]?\d")
WITH_UNIT = re.compile(r"([+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*([^\d\s.,;:-][^\s]*)")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:([.,'’\s])\d{3})(?:\1\d{3})*(?:[.,]\d+)?")
_SPACED = re.compile(r'"[^"]*"|[^\s\[(]+(?:[ \t]*[\[(][^\])]{0,99}[\])])?|\S+')
_MARKS = 999.9, 999.99, 9999.0, 9999.9, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0  # of missing values
_SAMPLED = 5000  # rows that may determine the decimal sign
_DECIMAL_REMEDY = "give the decimal sign, a point or a comma: decimal='.' (command line: --read decimal=. or decimal=,)"


class Layout(NamedTuple):
    """Row of the header (from 0), separator of its cells, and the cells."""

    row: int
    separator: str
    names: list[str]


def split_cells(line: str, separator: str) -> list[str]:
    """Cells of a line, without blanks around them and quotation marks."""
    if separator == " ":
        return [cell.strip('"') for cell in _SPACED.findall(line)]
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    return [cell.strip() for cell in line.split(separator)]


def decimal_of(rows: Sequence[str], separator: str, path: Path) -> str:
    """Decimal sign of rows; raises a `DatasetError` if it is not plain, as nothing else can be read."""
    sample = rows[:: 1 + len(rows) // _SAMPLED]
    decimal, unclear = decimal_sign([cell for line in sample for cell in split_cells(line, separator)], separator)
    if unclear:
        raise refusal(path, unclear, _DECIMAL_REMEDY)
    return decimal


def to_numbers(cells: Floats | Sequence[str], decimal: str, *, certain: bool = False) -> Floats:
    """Numbers of texts, NaN where a cell is none; numbers remain what they are.

    Groups of thousands are read where their sign cannot be the decimal one: `certain`, or another cell has both.

    >>> to_numbers(["1.234,5", "2.000", "3 000", "x"], ",").tolist()
    [1234.5, 2000.0, 3000.0, nan]
    """
    if isinstance(cells, np.ndarray):
        return cells
    import pandas as pd

    other = {".": ",", ",": "."}[decimal]
    texts = pd.Series([*cells], dtype=object)
    plain = texts.str.fullmatch(rf"[+-]?(?:\d+[{decimal}]?\d*|[{decimal}]\d+)(?:[eE][+-]?\d+)?")
    grouped = texts.str.fullmatch(rf"[+-]?\d{{1,3}}(?:[{other}'’\s]\d{{3}})+(?:[{decimal}]\d+)?")
    if not (certain or (grouped & texts.str.contains(decimal, regex=False)).any()):
        grouped &= ~texts.str.contains(other, regex=False)
    bare = texts.where(plain | grouped, "").str.replace(rf"[{other}'’\s]", "", regex=True)
    return pd.to_numeric(bare.str.replace(decimal, "."), errors="coerce").to_numpy(np.float64)


def decimal_sign(cells: Iterable[str], separator: str) -> tuple[str, str]:
    """Decimal sign of the numbers of a text, and what is not plain: a number of either sign, if no other settles it.

    >>> decimal_sign(["1,234", "0,5"], ";"), decimal_sign(["1,234", "2"], ";")
    ((',', ''), ('.', "'1,234' may be a decimal or a thousand"))
    """
    settled, ambiguous = set(), ""
    for cell in cells:
        if match := WITH_UNIT.fullmatch(cell) if dimension_of(cell.split()[-1] if " " in cell else "") else None:
            cell = match[1]
        if ("." in cell or "," in cell) and (NUMBER.fullmatch(cell) or _GROUPED.fullmatch(cell)):
            sign = _sign_of(cell)
            settled |= {sign} - {""}
            ambiguous = ambiguous or ("" if sign else cell)
    sign = next(iter(settled)) if len(settled) == 1 else "." if separator == "," and not settled else ""
    if ambiguous and (not sign or sign not in ambiguous):
        return sign or ".", f"{ambiguous!r} may be a decimal or a thousand"
    return sign or ".", "has numbers with decimal points and with commas" if len(settled) > 1 else ""


def _sign_of(cell: str) -> str:
    """Decimal sign of a number; empty for one such as 1.234, in which it may separate thousands.

    >>> [_sign_of(cell) for cell in ("0.5", "1,234.5", "1.234.567", "1.234")]
    ['.', '.', ',', '']
    """
    signs = re.findall("[.,]", cell)
    if len(signs) > 1:
        return signs[-1] if signs[0] != signs[-1] else ",."[signs[0] == ","]
    return "" if re.fullmatch(r"[+-]?[1-9]\d{0,2}[.,]\d{3}", cell) else signs[0]


def missing_marks(values: Floats, *, chance: float = 1e-3, near: float = 0.01) -> NDArray[np.bool_]:
    """Mask of the values that may mark missing ones.

    They are more frequent than the values within 1 % of them, each multiple of the resolution as likely as another one
    (Poisson). A single one between its neighbours is a value.

    >>> [int(missing_marks(np.array(forces)).sum()) for forces in ([12.0, 9999.0, 8.0], [9990.5, 9999.0, 10002.0])]
    [1, 0]
    >>> int(missing_marks(np.round(np.linspace(900, 1100, 100_000), 2)).sum())
    0
    """
    from scipy.special import pdtrc

    marks = np.zeros(len(values), bool)
    for mark in np.intersect1d(np.abs(values), _MARKS):
        rows = np.abs(values) == mark
        count = int(np.count_nonzero(rows))
        others = np.sort(values[(np.abs(np.abs(values) - mark) < near * mark) & ~rows])
        steps = np.diff(others)
        finest = min(steps[steps > 1e-9 * mark], default=1.0)
        often = pdtrc(count - 1, len(others) * min(finest, 1.0) / (2 * near * mark)) < chance
        inside = (values - np.roll(values, 1)) * (np.roll(values, -1) - values) > 0
        if often and (count > 1 or not inside[rows].any()):
            marks |= rows
    return marks
