"""A table as it was understood: what each column is, where that is from, and the questions that remain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mckibben.dataset.vocabulary import Header, si_factor
from mckibben.errors import DatasetError, Problem, printable
from mckibben.units import show

TOPICS: Mapping[str, str] = {
    "words": "words beside the table do not change its numbers",
    "layout": "hidden, merged, noted or coloured cells, and channels that begin at different times, are plain rows",
    "columns": "columns that are not understood are not needed",
    "corrupt": "rows without numbers are left out",
    "rows": "rows that look like summaries, copies or marks of missing values are measurements",
    "sign": "negative forces are slack",
    "range": "unusual pressures, contractions and forces are right",
    "saturation": "the largest value repeats, and no sensor is saturated",
    "gauge": "pressures are gauge pressures",
    "zero": "the load cell has no offset",
    "order": "points that contradict each other are right",
}
"""Questions that `accept` answers, each with what is then taken for true."""
MOTIONS = ("length", "shortening", "lengthening", "displacement", "relative_length")
"""Quantities from which a contraction follows."""


class Question(NamedTuple):
    """What is not plain, with its remedy; `topic`, if any, is the word of `accept` that answers it."""

    problem: Problem
    topic: str = ""


def question(text: str, topic: str = "", *, line: int | None = None, field: str = "", remedy: str = "") -> Question:
    """A question that is answered by its remedy, and by `accept` if it has a topic of `TOPICS`.

    >>> question("a sensor at its end?", "saturation", line=7, remedy="leave it out").problem.line
    7
    """
    if topic:
        accepted = f"accept=[{topic!r}] (command line: --read accept={topic}) if {TOPICS[topic]}"
        remedy = f"{remedy}, or {accepted}" if remedy else accepted
    return Question(Problem(text, line=line, field=field, remedy=remedy), topic)


def refusal(path: Path, text: str, remedy: str = "", field: str = "") -> DatasetError:
    """Error of a file with one problem."""
    return DatasetError(str(path), [Problem(text, field=field, remedy=remedy)])


def open_problems(questions: Sequence[Question], accept: Sequence[str]) -> list[Problem]:
    """Problems of the questions that no topic of `accept` answers."""
    return [asked.problem for asked in questions if not asked.topic or asked.topic not in accept]


@dataclass(frozen=True, eq=False)
class Column:
    """Column as it was understood.

    Attributes
    ----------
    header
        Name in the file.
    quantity, unit
        Of `vocabulary.QUANTITIES`; of a contraction that follows from a length, those of the length.
    values
        Shape (rows,): SI units, or words.
    source
        Where quantity and unit are from: "header", "file" (a row of units or a property) or "columns" (the recipe).
    remarks
        What was done to the numbers of the file: a line of the sensor, an ambient pressure that was subtracted.
    """

    header: str
    quantity: str
    unit: str
    values: np.ndarray
    source: str = "header"
    remarks: tuple[str, ...] = ()


@dataclass(eq=False)
class Table:
    """What was understood of a file.

    Attributes
    ----------
    path
        File.
    columns
        By quantity: pressure, force, contraction (converted from lengths) and, where the file has them, direction,
        phase, repeat, time and set_pressure.
    ignored
        Headers of the columns that are not read.
    head, units
        First cells of every column of the file, by its header, numbers or texts; and the unit that stands elsewhere.
    lines
        Shape (rows,): line of each row, or its number in a file of rows (`place`).
    questions
        What is not plain, with the option that answers it.
    repairs
        Rows that are left out, with the reasons.
    preprocessing
        Estimates in a file that this program wrote, "none" in any other.
    specimen, source
        Name of the muscle, and of the file or its source.
    initial_length, slack_force
        Length of the deflated muscle [m], and force up to which it counts as slack [N], if they are known.
    interval
        Sampling interval [s] that the file states.
    clock, joined
        Header of a clock that is not understood, and how the clock of another file was joined, as text.
    """

    path: Path
    columns: dict[str, Column] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)
    head: dict[str, Sequence[str] | np.ndarray] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    lines: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    place: str = "line"
    questions: list[Question] = field(default_factory=list)
    repairs: list[str] = field(default_factory=list)
    preprocessing: str = ""
    specimen: str = ""
    source: str = ""
    initial_length: float | None = None
    slack_force: float | None = None
    interval: float | None = None
    clock: str = ""
    joined: str = ""

    def __str__(self) -> str:
        """The `rows` as text under their heading; last the number of rows."""
        rows = [("column", "quantity", "unit", "unit from", "range", ""), *self.rows()]
        widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return "\n".join([*lines, f"{len(self.lines)} rows"])

    def __repr__(self) -> str:
        return f"<Table of {self.path.name}: {', '.join(self.columns)}; {len(self.questions)} questions>"

    def _repr_html_(self) -> str:
        asked = "\n".join(str(question.problem) for question in self.questions)
        return f"<pre>{escape(f'{self}')}\n{escape(asked)}</pre>"

    def rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """Header, quantity, unit, origin of the unit, range [unit] and remarks of each column, as text."""
        rows = []
        for quantity, column in self.columns.items():
            if quantity == "contraction" and any(row[0] == printable(column.header) for row in rows):
                continue  # it follows from this column
            shown = ""
            if column.values.dtype.kind == "f" and np.isfinite(column.values).any():
                scale = si_factor(Header(column.quantity, column.unit))
                low, high = (f"{bound(column.values) / scale:.4g}" for bound in (np.nanmin, np.nanmax))
                shown = low if low == high else f"{low}..{high}"
            known = self.initial_length if column.quantity in MOTIONS else None
            length = f"initial length {show(known, 'mm', 5)}" if known else ""
            origin, text = column.source if column.unit else "", ", ".join(filter(None, (*column.remarks, length)))
            rows.append((printable(column.header), column.quantity, column.unit, origin, shown, text))
        return rows

    def ask(self, accept: Sequence[str]) -> None:
        """Raise a `DatasetError` with all questions that are not answered by a topic of `accept`."""
        if problems := open_problems(self.questions, accept):
            raise DatasetError(str(self.path), sorted(problems, key=lambda problem: problem.line or 0))
