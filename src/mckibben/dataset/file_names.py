"""Numbers in the name of a file or of one of its parts, such as the length at which a test was made."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mckibben.dataset.raw import RawColumn, RawTable
from mckibben.dataset.table import refusal
from mckibben.dataset.vocabulary import canonical_unit, dimension_of, parse_header
from mckibben.errors import DatasetError, Problem

_FIELD = re.compile(r"\{(\w+)\}")
_NUMBER = r"([-+]?\d+(?:[.,]\d+)?)"
_NUMBER_WITH_UNIT = re.compile(rf"(\D*?){_NUMBER}(\s*)([a-zA-Z]+)(\D*)")


class SeveralPartsError(DatasetError):
    """Question of which of several parts of a file, such as sheets, with their `names`, are to be read."""

    names: tuple[str, ...] = ()


def several(path: Path, what: str, names: Sequence[str]) -> SeveralPartsError:
    """Question of which of several parts of a file are to be read, and of the numbers in their names.

    >>> "'from_name={force_kgf}kg'" in several(Path("rig.xlsx"), "sheets", ["5kg", "10kg"]).problems[0].remedy
    True
    """
    pattern, parts = _pattern_of(names) or "{force_kgf}kg", ", ".join(names[:2])
    remedy = (
        f"choose one, or more: --read 'part=[{parts}]' (in Python part={[*names[:2]]!r}); for numbers in their names, "
        f"give --read 'from_name={pattern}' (in Python from_name={pattern!r})"
    )
    text = f"has several {what} of measurements: {', '.join(names[:20])}"
    error = SeveralPartsError(str(path), [Problem(text, remedy=remedy)])
    error.names = tuple(names)
    return error


def _pattern_of(names: Sequence[str]) -> str:
    """Pattern of names that differ in a number with its unit; empty if they do not.

    >>> _pattern_of(["Last 5 kg", "Last 10 kg"]), _pattern_of(["Test", "Retest"])
    ('Last {force_kgf} kg', '')
    """
    matches = [_NUMBER_WITH_UNIT.fullmatch(name) for name in names]
    literals = {match.group(1, 3, 4, 5) if match else ("",) * 4 for match in matches}
    before, blanks, unit, after = literals.pop() if len(literals) == 1 else ("",) * 4
    name = f"{quantity}_{canonical_unit(unit, quantity)}" if (quantity := dimension_of(unit)) else ""
    return f"{before}{{{name}}}{blanks}{unit}{after}" if name else ""


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


def numbers_in(name: str, pattern: str) -> set[tuple[str, ...]]:
    """Numbers that a pattern finds in a name, each time that it matches.

    >>> numbers_in("Muscle_L190mm.csv", "L{length_mm}mm")
    {('190',)}
    """
    literal = _FIELD.split(pattern)[::2]
    text = _NUMBER.join(map(re.escape, literal))
    if not literal[0]:
        text = text.replace("[-+]?", "", 1)  # a hyphen before the first number separates it from a word
    return {match.groups() for match in re.finditer(text, name)}


def add_from_name(table: RawTable, path: Path, pattern: str) -> None:
    """Add a constant column for each number that a pattern finds in the name of a file, or of its part.

    Raises a `DatasetError` if the pattern matches nowhere in the name, or with different numbers.

    >>> table = RawTable(lines=range(3))
    >>> add_from_name(table, Path("Muscle_L190mm.csv"), "L{length_mm}mm")
    >>> table.columns[0].label, table.columns[0].cells.tolist()
    ('length_mm', [190.0, 190.0, 190.0])
    """
    if len(matches := numbers_in(path.name, pattern)) != 1:
        wrong = f"matches {pattern!r} in several places" if matches else f"does not match {pattern!r}"
        raise refusal(path, f"its name {wrong}", "correct from_name in the recipe")
    (numbers,) = matches
    literal = _FIELD.split(pattern)[-1]
    if problem := pattern_problem(pattern + path.name.rpartition(f"{numbers[-1]}{literal}")[2]):
        raise refusal(path, f"its name: {problem}", "correct from_name in the recipe")
    for name, number in zip(_FIELD.findall(pattern), numbers, strict=True):
        cells = np.full(len(table.lines), float(number.replace(",", ".")))
        table.columns.append(RawColumn(f"file name: {name}", cells, label=name))
