"""Numbers in the name of a file, such as the length at which a test was made."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mckibben.dataset.headers import parse_header
from mckibben.dataset.schema import WORDS
from mckibben.dataset.sheet import RawColumn, RawTable
from mckibben.errors import DatasetError, Problem, RangeError

_FIELD = re.compile(r"\{(\w+)\}")
_NUMBER = r"([-+]?\d+(?:[.,]\d+)?)"
_REMEDY = "write a pattern such as 'L{length_mm}mm' for Muscle_L190mm.csv"


def check_pattern(pattern: str) -> None:
    """Raise a `RangeError` unless a pattern is empty or names quantities with units in braces."""
    names = _FIELD.findall(pattern) if isinstance(pattern, str) else []
    headers = [parse_header(name) for name in names]
    if pattern and (not names or not all(one and one.unit and one.quantity not in WORDS for one in headers)):
        text = f"from_name (command line: --from-name) is {pattern!r:.60}, without a quantity and unit in braces"
        raise RangeError(text, field="from_name", value=pattern, remedy=_REMEDY)


def add_from_name(sheet: RawTable, path: Path, pattern: str) -> RawTable:
    """A table with a constant column for each number that a pattern finds in the name of its file."""
    if not pattern or not sheet.channels:
        return sheet
    names = _FIELD.findall(pattern)
    literal = _FIELD.split(pattern)[::2]
    text = _NUMBER.join(map(re.escape, literal))
    if not literal[0]:
        text = text.replace("[-+]?", "", 1)  # a hyphen before the first number separates it from a word
    found = {one.groups() for one in re.finditer(text, path.name)}
    if len(found) != 1:
        wrong = f"matches {pattern!r} in several places" if found else f"does not match {pattern!r}"
        raise DatasetError(str(path), [Problem(f"its name {wrong}", remedy=_REMEDY)])
    (numbers,) = found
    longest = max(sheet.channels, key=lambda one: len(one.cells))
    for name, number in zip(names, numbers, strict=True):
        cells = np.full(len(longest.cells), float(number.replace(",", ".")))
        sheet.channels.append(RawColumn(f"file name: {name}", cells, longest.lines, short=name))
    return sheet
