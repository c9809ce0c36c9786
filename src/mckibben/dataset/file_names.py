"""Numbers in the name of a file, such as the length at which a test was made."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from mckibben.dataset.raw import RawColumn, RawTable
from mckibben.dataset.vocabulary import canonical_unit, parse_header
from mckibben.errors import DatasetError, Problem

_FIELD = re.compile(r"\{(\w+)\}")
_NUMBER = r"([-+]?\d+(?:[.,]\d+)?)"


def pattern_problem(pattern: str) -> str:
    """Why a pattern has no quantity with a unit in braces, or one that contradicts its name; empty if it is right.

    >>> pattern_problem("L{length_mm}mm"), pattern_problem("L{length}")
    ('', "'L{length}' has no quantity and unit in braces")
    >>> pattern_problem("hang_{force_N}kg")
    "'hang_{force_N}kg' reads N, and kg follows"
    """
    headers = [parse_header(name) for name in _FIELD.findall(pattern)]
    if not headers or not all(header.quantity and header.unit for header in headers):
        return f"{pattern!r:.60} has no quantity and unit in braces"
    for header, follows in zip(headers, _FIELD.split(pattern)[2::2], strict=True):
        unit = re.match(r" ?([a-zA-Z]+)(?![a-zA-Z0-9])", follows)
        if unit and canonical_unit(unit[1], header.quantity) not in ("", header.unit):
            return f"{pattern!r:.60} reads {header.unit}, and {unit[1]} follows"
    return ""


def add_from_name(table: RawTable, path: Path, pattern: str) -> None:
    """Add a constant column for each number that a pattern finds in the name of a file.

    Raises a `DatasetError` if the pattern matches nowhere in the name, or with different numbers.

    >>> table = RawTable(lines=range(3))
    >>> add_from_name(table, Path("Muscle_L190mm.csv"), "L{length_mm}mm")
    >>> table.columns[0].label, table.columns[0].cells.tolist()
    ('length_mm', [190.0, 190.0, 190.0])
    """
    literal = _FIELD.split(pattern)[::2]
    text = _NUMBER.join(map(re.escape, literal))
    if not literal[0]:
        text = text.replace("[-+]?", "", 1)  # a hyphen before the first number separates it from a word
    matches = {match.groups() for match in re.finditer(text, path.name)}
    if len(matches) != 1:
        wrong = f"matches {pattern!r} in several places" if matches else f"does not match {pattern!r}"
        raise DatasetError(str(path), [Problem(f"its name {wrong}", remedy="correct from_name in the recipe")])
    (numbers,) = matches
    for name, number in zip(_FIELD.findall(pattern), numbers, strict=True):
        cells = np.full(len(table.lines), float(number.replace(",", ".")))
        table.columns.append(RawColumn(f"file name: {name}", cells, label=name))
