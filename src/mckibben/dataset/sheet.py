"""What every file of measurements becomes first: named columns of numbers or text that know their lines."""

from __future__ import annotations

from collections.abc import Sequence
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
class Channel:
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
class Sheet:
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

    channels: list[Channel] = field(default_factory=list)
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
