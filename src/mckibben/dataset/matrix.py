"""Matrices: tables with a row per pressure and a column per contraction, say, whose cells are forces."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mckibben.dataset.cells import BEGINS, NUMBER, SEPARATORS, Layout, decimal_of, split_cells, to_numbers
from mckibben.dataset.raw import Budget, RawColumn, RawTable
from mckibben.dataset.table import question, refusal
from mckibben.dataset.vocabulary import dimension_of, parse_header, parse_line

MATRIX = ("rows", "columns", "cells")
"""Columns of a matrix with one row per cell: the numbers before its rows and above its columns, and those of cells."""

_SEARCHED = 300  # lines in which the labels of the columns are looked for
_IN_LABEL = re.compile(r"(?:(?<![\w\])])[+-])?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?")
_UNIT = re.compile(r"#\s*([^\s\[\](),;]+)")
_USUAL = {"pressure": "pressure_bar", "contraction": "contraction_percent", "force": "force_N"}


def find_matrix(lines: Sequence[str], mapping: Mapping[str, str] | None = None) -> Layout | None:
    r"""Row with one number in each cell behind the first column, above a row of numbers; the mapping is not needed.

    A row that is one cell shorter lacks the corner.

    >>> find_matrix(["Rig 3", "p[bar]\\eps[%];0;5", "2;1286;866"])
    Layout(row=1, separator=';', names=['p[bar]\\eps[%]', '0', '5'])
    """
    several = False
    for row, line in enumerate(lines[:_SEARCHED]):
        below = next((more for more in lines[row + 1 : row + 4] if any(map(str.isdigit, more))), "")
        for separator in SEPARATORS:
            names, cells = split_cells(line, separator), split_cells(below, separator)
            several |= separator != " " and sum(NUMBER.fullmatch(name) is not None for name in names) > 1
            names = ["", *names] if len(names) == len(cells) - 1 else names
            first, *numbers = [at for at, cell in enumerate(cells) if any(map(str.isdigit, cell))] or [0]
            labels = {at for at, cell in enumerate(names) if at > first and split_label(cell)}
            matching = len(names) == len(cells) and numbers and {*numbers} <= labels
            if matching and len(labels) > 1 and not NUMBER.fullmatch(names[first]):
                return Layout(row, separator, names)
        if several:  # numbers that are no labels
            return None
    return None


def split_label(cell: str) -> tuple[str, str] | None:
    """The only number of a cell, and the text around it; None if there is none or more.

    >>> split_label("F at 2.5 bar"), split_label("CH1 2 bar")
    (('2.5', 'F at # bar'), None)
    """
    numbers = _IN_LABEL.findall(cell)
    return (numbers[0], _IN_LABEL.sub("#", cell)) if len(numbers) == 1 else None


def matrix_remedy(lines: Sequence[str]) -> str:
    r"""Option that reads lines as a matrix, with the units that its corner and labels state; empty if they are none.

    >>> matrix_remedy(["p[MPa]\\h[%];0;5", "0.2;1286;866"])[-57:]
    "--read 'matrix=pressure_MPa,contraction_percent,force_N')"
    """
    layout = find_matrix(lines)
    labels = [label for name in layout.names[1:] if (label := split_label(name))] if layout else []
    if layout is None or not labels or split_label(layout.names[0]):
        return ""
    around = labels[-1][1]
    below = [split_cells(line, layout.separator) for line in lines[layout.row + 1 :]]
    first = next(filter(None, map(split_label, chain.from_iterable(below))), ("", ""))
    down, across = _labelled(first[1]), _labelled(around)
    corner = [_stated(text) for text in re.split(r"[\\;|]|\s/\s|\bvs\b", layout.names[0])]
    others = iter([name for name in corner if name and name not in (down, across)])
    names = [down or next(others, ""), across or next(others, ""), _stated(_UNIT.sub("", around)) or next(others, "")]
    taken = {dimension_of(name.rpartition("_")[2]) for name in names}
    usual = iter([name for dimension, name in _USUAL.items() if dimension not in taken])
    meant = ",".join(name or next(usual) for name in names)
    return f"say what rows, columns and cells are: matrix={meant!r} (command line: --read 'matrix={meant}')"


def _labelled(text: str) -> str:
    """Quantity and unit of labels with # in place of their number; empty if they have no unit."""
    unit = _UNIT.search(text)
    return _stated(f"x [{unit[1]}]") if unit else ""


def _stated(text: str) -> str:
    """Quantity and unit of a text; empty if it has no unit."""
    header = parse_header(text)
    dimension = dimension_of(header.unit)
    usual = {"length": "displacement", "time": ""}.get(dimension, dimension)
    return f"{header.quantity or usual}_{header.unit}" if usual else ""


def read_matrix(
    lines: Sequence[str], path: Path, mapping: Mapping[str, str], decimal: str = "", settled: str = ""
) -> RawTable:
    """Columns `MATRIX` of the matrix in the lines of a text or sheet, as `read_lines` has those of a table.

    Empty cells are no points. Rows without a label, or with a number outside the labelled columns, are questions, as
    are labels that differ in more than a number. Raises a `DatasetError` if there is no matrix.
    """
    budget, table = Budget(path), RawTable(place="line")
    budget.spend(rows=len(lines))
    layout = find_matrix(lines) or Layout(len(lines), "\t", [])
    points = list(_points(table, lines, layout))
    if not points:
        remedy = "give a row of numbers above the columns, and a number before each row"
        raise refusal(path, "has no matrix", remedy, "matrix")
    across, down = (parse_header(parse_line(mapping[name])[2]).quantity for name in ("columns", "rows"))
    if "force" in across or ("pressure" in across and "force" not in down):  # what a test holds
        points.sort(key=lambda point: point.column)
    budget.spend(rows=len(points), size=24 * len(points))
    table.lines = [point.line for point in points]
    table.decimal = decimal or settled or decimal_of(lines[layout.row :], layout.separator, path)
    for name in MATRIX[:2]:
        numbers, texts = zip(*(split_label(getattr(point, name)) or ("", "") for point in points), strict=True)
        if len(around := list(dict.fromkeys(texts))) > 1:
            text = f"differ by more than a number: {around[0]!r} and {around[1]!r}, # being it"
            table.questions.append(question(text, field=name, remedy="give numbers in one unit"))
        unit = _UNIT.search(around[0])
        sign = decimal_of(["\t".join(numbers)], "\t", path) if settled else table.decimal  # texts of a sheet
        stated = unit[1] if unit and dimension_of(unit[1]) else ""
        table.columns.append(RawColumn(name, to_numbers(numbers, sign, certain=True), unit=stated))
    cells = [point.cells for point in points]
    values = to_numbers(cells, table.decimal, certain=bool(decimal))
    table.columns.append(RawColumn("cells", cells if np.isnan(values).any() else values))
    return table


class _Point(NamedTuple):
    """Line, label of the row, number and label of the column, and text of a cell."""

    line: int
    rows: str
    column: int
    columns: str
    cells: str


def _points(table: RawTable, lines: Sequence[str], layout: Layout) -> Iterator[_Point]:
    """Points of a matrix; lines without numbers are words of the table, and rows that do not fit are questions."""
    labelled = {at for at, name in enumerate(layout.names) if split_label(name)}
    table.words = [(number, " ".join(line.split())) for number, line in enumerate(lines[: layout.row + 1], 1)]
    first = len(layout.names)
    for number, line in enumerate(lines[layout.row + 1 :], layout.row + 2):
        cells = split_cells(line, layout.separator)
        if not any(map(BEGINS.match, cells)):
            table.words.append((number, " ".join(line.split())))
            continue
        numbers = {at for at, cell in enumerate(cells) if any(map(str.isdigit, cell))}
        first = min(first, *numbers)
        if len(cells) == len(layout.names) and split_label(cells[first]) and numbers - {first} <= labelled:
            columns = [at for at in sorted(labelled) if at > first and cells[at]]
            yield from (_Point(number, cells[first], at, layout.names[at], cells[at]) for at in columns)
        else:
            text = "has no number before it, or one without a number above it: does another matrix begin?"
            table.questions.append(question(text, line=number, remedy="save each matrix by itself"))
