"""A table as it was understood: what each column is, where that is from, and the questions that remain."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mckibben.dataset.clock import seconds_of
from mckibben.dataset.raw import Floats, RawColumn, RawTable
from mckibben.dataset.text import NUMBER, to_numbers
from mckibben.dataset.vocabulary import (
    QUANTITIES,
    Header,
    canonical_unit,
    dimension_of,
    is_harmless,
    parse_header,
    si_factor,
)
from mckibben.dataset.words import doubtful_words
from mckibben.errors import DatasetError, Problem, UnitError, closest, printable
from mckibben.units import quantity, show

if TYPE_CHECKING:
    from mckibben.dataset.recipe import Recipe

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
_COLUMN_REMEDY = "name it: columns={{{0!r}: '{1}'}} (command line: --column '{0}={1}')"
_NEEDLESS = "if it is not needed: columns={{{0!r}: 'ignore'}} (command line: --column '{0}=ignore')"
_AMBIENT = "give the ambient pressure: ambient=101300.0 (command line: --ambient '101.3 kPa')"
_LENGTH_REMEDY = "give initial_length (command line: --initial-length '180 mm')"
_SIGN_REMEDY = (
    "name the direction in which it grows: columns={{{0!r}: 'shortening_{1}'}} (command line: --column '{0}=shortening_{1}', "
    "or lengthening_{1}); and in a recipe zero_length, the length at 0, if it is not the initial length"
)
_WORDS: Mapping[str, Mapping[str, str]] = {
    "direction": {
        **dict.fromkeys(("loading", "stretching", "belasten", "belastung", "dehnen"), "loading"),
        **dict.fromkeys(("unloading", "shortening", "entlasten", "entlastung", "verkürzen"), "unloading"),
        **dict.fromkeys(("unknown", "unbekannt"), ""),
    },
    "phase": {
        **dict.fromkeys(("filling", "inflating", "befüllen"), "filling"),
        **dict.fromkeys(("venting", "deflating", "entlüften"), "venting"),
        **dict.fromkeys(("unknown", "unbekannt"), ""),
    },
}
_MARKS = np.array([9999.0, 99999.0, 999999.0, 999.9, 999.99, 999.0, 9999.9, 32767.0, 32768.0, 65535.0, 1e29])
_ENDS = (127.0, 255.0, 511.0, 1023.0, 2047.0, 4095.0, 8191.0, 16383.0)
_ROUNDING = 0.5e-3, 0.002  # m and relative: precision of lengths
_LONGEST = 20.0  # m
_ELECTRICAL = frozenset(("v", "mv", "a", "ma", "mv/v", "counts", "digits", "raw", "lsb", "adc"))
_MOTIONS = ("length", "shortening", "lengthening", "displacement")


class Question(NamedTuple):
    """What is not plain, with its remedy; `topic`, if any, is the word of `accept` that answers it."""

    problem: Problem
    topic: str = ""


def question(topic: str, text: str, *, line: int | None = None, field: str = "", remedy: str = "") -> Question:
    """A question that `accept` answers too."""
    accepted = f"accept=[{topic!r}] (command line: --accept {topic}) if {TOPICS[topic]}"
    return Question(
        Problem(text, line=line, field=field, remedy=f"{remedy}, or {accepted}" if remedy else accepted), topic
    )


@dataclass(frozen=True, eq=False)
class Column:
    """Column as it was understood.

    Attributes
    ----------
    header
        Name in the file.
    quantity, unit
        Of `vocabulary.QUANTITIES`.
    values
        Shape (rows,): SI units, or words.
    sign
        -1 if the numbers of the file have the other sign.
    reference
        "gauge", or what was subtracted from absolute pressures; empty for other quantities.
    source
        Where quantity and unit are from: "header", "file" (a row of units or a property) or "columns" (the recipe).
    """

    header: str
    quantity: str
    unit: str
    values: np.ndarray
    sign: int = 1
    reference: str = ""
    source: str = "header"


@dataclass(eq=False)
class Table:
    """What was understood of a file.

    Attributes
    ----------
    columns
        By quantity: pressure, force, contraction (converted from lengths) and, where the file has them, direction,
        phase, repeat, time and set_pressure.
    ignored
        Headers of the columns that are not read.
    lines
        Line of each row, or its number in a file of rows (`place`).
    questions
        What is not plain, with the option that answers it.
    """

    path: Path
    columns: dict[str, Column] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)
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

    def __str__(self) -> str:
        return describe(self)

    def __repr__(self) -> str:
        return f"<Table of {self.path.name}: {', '.join(self.columns)}; {len(self.questions)} questions>"

    def _repr_html_(self) -> str:
        asked = "\n".join(str(question.problem) for question in self.questions)
        return f"<pre>{escape(describe(self))}\n{escape(asked)}</pre>"

    def ask(self, accept: Sequence[str]) -> None:
        """Raise a `DatasetError` with all questions that are not answered by a topic of `accept`."""
        open_questions = [
            question.problem for question in self.questions if question.topic not in accept or not question.topic
        ]
        if open_questions:
            raise DatasetError(str(self.path), sorted(open_questions, key=lambda problem: problem.line or 0))


def describe(table: Table) -> str:
    """Rows of text: column, quantity, unit, its origin, range and remarks of each column; last the number of rows."""
    rows = [("column", "quantity", "unit", "unit from", "range", "")]
    for column in table.columns.values():
        shown = ""
        if column.values.dtype.kind == "f" and np.isfinite(column.values).any():
            scale = si_factor(Header(column.quantity, column.unit))
            low, high = (f"{bound(column.values) / scale:.4g}" for bound in (np.nanmin, np.nanmax))
            shown = low if low == high else f"{low}..{high}"
        remarks = [column.reference] if column.reference != "gauge" else []
        remarks += ["sign reversed"] if column.sign < 0 else []
        if column.quantity in _MOTIONS and table.initial_length:
            remarks.append(f"initial length {show(table.initial_length, 'mm', 5)}")
        origin = column.source if column.unit else ""
        rows.append(
            (printable(column.header), column.quantity, column.unit, origin, shown, ", ".join(filter(None, remarks)))
        )
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    return "\n".join([*lines, f"{len(table.lines)} rows"])


def understand(path: Path, raw: RawTable, recipe: Recipe, needed: Sequence[str]) -> Table:
    """Map the columns of a file to quantities in SI units; what is not plain becomes a question of the table.

    Parameters
    ----------
    recipe
        Answers: columns, lengths, signs, ambient pressure, decimal sign.
    needed
        Quantities without which nothing can be read.
    """
    return _Reader(path, raw, recipe).read(needed)


class _Reader:
    """Steps of `understand`."""

    def __init__(self, path: Path, raw: RawTable, recipe: Recipe) -> None:
        self.raw, self.recipe = raw, recipe
        self.mapping = {str(key).strip(): name for key, name in (recipe.columns or {}).items()}
        self.table = Table(path, place=raw.place, lines=np.asarray(raw.lines, np.int64), interval=raw.interval)
        self.asked = self.table.questions
        self.bad = np.zeros(len(raw.lines), bool)
        self.asked_about: set[str] = set()

    def read(self, needed: Sequence[str]) -> Table:
        table, raw = self.table, self.raw
        self._attributes()
        chosen = self._choose(self._headers())
        self._check_mapping()
        self.asked += [Question(problem, "layout" if problem.field == "layout" else "") for problem in raw.problems]
        if raw.ambiguous and not self.recipe.decimal:
            text = f"{raw.ambiguous!r} may be a decimal or a thousand" if raw.ambiguous[0].isdigit() else raw.ambiguous
            self.ask(text, remedy="give the decimal sign: decimal=',' or decimal='.' (command line: --decimal)")
        for column, header, sign, source in chosen:
            self._convert(column, header, sign, source)
        for problem in raw.corrupt:
            self.asked.append(question("corrupt", problem.message, line=problem.line))
            table.repairs.append(str(problem))
        self._lengths()
        if missing := [name for name in needed if name not in table.columns and name not in self.asked_about]:
            names = ", ".join(column.name for column in raw.columns[:20])
            kinds = " and ".join(missing)
            remedy = "name them: " + " ".join(
                f"--column 'HEADER={name}_{QUANTITIES[name][0]}'" for name in missing if QUANTITIES[name]
            )
            self.ask(f"no column for {kinds}; its columns are {names}", remedy=f"{remedy} (in Python columns={{...}})")
        units = {column.unit for column in table.columns.values()}
        for line, text in doubtful_words(raw.words, units):
            self.asked.append(
                question(
                    "words",
                    f"beside the table stands {text[:200]!r}",
                    line=line,
                    remedy="apply it to the numbers in the file",
                )
            )
        self._leave_out()
        return table

    def ask(self, text: str, *, field: str = "", line: int | None = None, remedy: str = "") -> None:
        self.asked.append(Question(Problem(text, field=field, line=line, remedy=remedy)))

    def _attributes(self) -> None:
        """Specimen, source, initial length and slack force, of the recipe or of the file."""
        said, recipe, table = self.raw.comments, self.recipe, self.table
        numbers: dict[str, float | None] = {}
        for key, unit in (("initial_length", "m"), ("slack_force", "N")):
            stated = None
            try:
                stated = quantity(said[key], unit) if said.get(key) else None
            except UnitError as error:
                self.ask(error.message, field=key, remedy=error.remedy)
            given = getattr(recipe, key)
            numbers[key] = stated if given is None else given
            if key == "initial_length" and None not in (given, stated) and abs(given - stated) > _ROUNDING[0]:
                text = f"{show(given, 'mm', 5)} is given, but the file states {show(stated, 'mm', 5)}"
                self.asked.append(question("words", text, field=key))
        table.initial_length, table.slack_force = numbers["initial_length"], numbers["slack_force"]
        from mckibben.dataset.schema import unquote

        table.preprocessing = unquote(said.get("preprocessing", "none"))
        table.repairs += unquote(said.get("repairs", "")).splitlines()
        table.specimen = recipe.specimen or unquote(said.get("specimen", ""))
        table.source = unquote(said["source"]) if "source" in said else table.path.name

    def _headers(self) -> list[tuple[RawColumn, Header, int, str]]:
        """Columns that are understood, with sign and origin; questions about the others."""
        understood = []
        self._units_beside()
        for column in self.raw.columns:
            label = column.label or column.name
            name = self.mapping.get(column.name, self.mapping.get(label, ""))
            if name.lower() in ("ignore", "ignored"):
                self.table.ignored.append(column.name)
                continue
            sign = -1 if name.startswith("-") else 1
            header = parse_header(name.lstrip("-")) if name else parse_header(label, column.unit)
            if re.fullmatch(r"column \d+", column.name) and not isinstance(column.cells, np.ndarray):
                header = Header("time", "") if seconds_of(header, column.cells) is not None else header
            if name and (not header.quantity or not (header.unit or not QUANTITIES[header.quantity])):
                remedy = f"name quantity and unit, such as {closest(name, [f'{q}_{u[0]}' for q, u in QUANTITIES.items() if u]) or 'force_N'}"
                self.ask(f"{name!r} is not a quantity with a unit", field=column.name, remedy=remedy)
            elif header.quantity:
                self._compare_units(column, label, header, bool(name))
                source = "columns" if name else "file" if column.unit and not parse_header(label).unit else "header"
                understood.append((column, header, sign, source))
            else:
                self._unread(column, label)
        return understood

    def _compare_units(self, column: RawColumn, label: str, header: Header, named: bool) -> None:
        """Ask about a unit of the recipe that is not the one in the file."""
        stated = column.unit or (match[1] if (match := re.search(r"[\[(]([^\[\]()]+)[\])]\s*$", label)) else "")
        dimension = dimension_of(stated)
        if (
            named
            and stated
            and header.unit
            and canonical_unit(stated, header.quantity) != header.unit
            and (dimension or stated.lower() in _ELECTRICAL)
        ):
            text = f"is in {stated!r} by the file, and in {header.unit!r} by columns"
            self.asked.append(question("columns", text, field=column.name, remedy="name the unit of the file"))

    def _units_beside(self) -> None:
        """Take the unit of a column from a column of units behind it."""
        columns = self.raw.columns
        for at, column in enumerate(columns[1:], 1):
            if "unit" not in column.name.lower() and "einheit" not in column.name.lower():
                continue
            units = {str(cell) for cell in column.cells}
            before = columns[at - 1]
            header = parse_header(before.label or before.name, before.unit)
            unit = units.pop() if len(units) == 1 else ""
            if header.quantity and (known := canonical_unit(unit, header.quantity)) and header.unit in ("", known):
                columns[at - 1] = RawColumn(before.name, before.cells, before.label, before.unit or unit)
                columns[at] = RawColumn("unit", (), "index")

    def _unread(self, column: RawColumn, label: str) -> None:
        """Ask about a column that is not understood, unless its name or its content says that it is not needed."""
        self.table.ignored.append(column.name)
        unit = column.unit or (label.rpartition("[")[2] or label.rpartition("(")[2]).rstrip("])")
        dimension = dimension_of(unit) if unit != label else dimension_of(label.rpartition("_")[2])
        numeric = isinstance(column.cells, np.ndarray)
        texts = set() if numeric else {str(cell).strip() for cell in column.cells}
        named = any(
            word in label.lower()
            for word in ("force", "kraft", "press", "druck", "length", "länge", "contract", "kontrak")
        )
        numbers = 0 if numeric else sum(bool(NUMBER.fullmatch(text)) for text in texts)
        named_otherwise = numeric and bool(unit) and unit != label and not dimension
        if (
            dimension in ("pressure", "force", "contraction", "length")
            or (named and not named_otherwise)
            or 0 < numbers < len(texts - {""})
        ):
            pass
        elif numeric and re.fullmatch(r"column \d+", column.name):
            if np.array_equal(np.diff(column.cells), np.ones(len(column.cells) - 1)):
                return
        elif (
            named_otherwise
            or is_harmless(label)
            or not texts - {""} | ({"x"} if numeric else set())
            or (not numeric and len(texts) == 1 and not any(map(str.isdigit, texts)))
        ):
            return
        remedy = _NEEDLESS.format(column.name)
        meant = {
            "pressure": "pressure_bar",
            "force": "force_N",
            "length": "length_mm",
            "contraction": "contraction_percent",
        }.get(dimension)
        if meant and dimension != "contraction":
            meant = f"{dimension}_{unit}"
        if meant:
            remedy = f"{_COLUMN_REMEDY.format(column.name, meant)}; {remedy}"
        self.asked.append(question("columns", "is not understood", field=column.name, remedy=remedy))

    def _choose(
        self, understood: Sequence[tuple[RawColumn, Header, int, str]]
    ) -> list[tuple[RawColumn, Header, int, str]]:
        """One column for each quantity: the one that the recipe names, or the only one."""
        chosen: dict[str, tuple[RawColumn, Header, int, str]] = {}
        for entry in understood:
            column, header, _, source = entry
            other = chosen.get(header.quantity)
            if other is None:
                chosen[header.quantity] = entry
            elif (source == "columns") != (other[3] == "columns"):
                chosen[header.quantity] = entry if source == "columns" else other
                self.table.ignored.append((other[0] if source == "columns" else column).name)
            elif header.quantity == "time":
                best = entry if header.unit and not other[1].unit else other
                chosen["time"] = best
                self.table.ignored.append((other if best is entry else entry)[0].name)
            elif self._agree(column, header, other):
                units = QUANTITIES[header.quantity]
                best = min(other, entry, key=lambda choice: units.index(choice[1].unit))
                chosen[header.quantity] = best
                self.table.ignored.append((other if best is entry else entry)[0].name)
            else:
                self.asked_about.add(header.quantity)
                text = f"and {other[0].name!r} are both a {header.quantity.replace('_', ' ')}"
                remedy = f"name the one that is meant: {_COLUMN_REMEDY.format(column.name, f'{header.quantity}_{header.unit}')}"
                self.ask(text, field=column.name, remedy=remedy)
        return list(chosen.values())

    @staticmethod
    def _agree(column: RawColumn, header: Header, other: tuple[RawColumn, Header, int, str]) -> bool:
        """Whether two columns have the same values, perhaps in different units."""
        first, second = column.cells, other[0].cells
        if (
            not (isinstance(first, np.ndarray) and isinstance(second, np.ndarray))
            or header.absolute != other[1].absolute
        ):
            return False
        scales = si_factor(header), si_factor(other[1])
        return bool(
            np.allclose(first * scales[0], second * scales[1], rtol=2e-3, atol=1e-3 * np.abs(second).max() * scales[1])
        )

    def _check_mapping(self) -> None:
        """Questions about headers of the recipe that the file does not have."""
        names = {column.name for column in self.raw.columns} | {column.label for column in self.raw.columns}
        for key, name in self.mapping.items():
            if key not in names and name not in ("loading", "unloading", "filling", "venting"):
                known = [column.name for column in self.raw.columns]
                close = closest(key, known)
                remedy = f"did you mean {close!r}?" if close else f"the file has {', '.join(known[:20])}"
                self.ask(f"there is no column {key!r}", remedy=remedy)

    def _convert(self, column: RawColumn, header: Header, sign: int, source: str) -> None:
        """Add a column in SI units, or a question."""
        name = header.quantity
        if name in _WORDS:
            values = self._meaning(name, column)
        elif name == "time":
            clock = seconds_of(header, column.cells)
            if clock is None:
                self._unread_clock(column, header)
                return
            values = clock
        elif QUANTITIES[name] and not header.unit:
            unit = QUANTITIES[name][0]
            self.asked_about |= {"contraction"} if name in _MOTIONS else {name}
            if name == "displacement":
                name = "shortening"
            self.ask(
                "has no unit that is understood",
                field=column.name,
                remedy=_COLUMN_REMEDY.format(column.name, f"{name}_{unit}"),
            )
            self.table.ignored.append(column.name)
            return
        else:
            values = self._numbers(column, name) * si_factor(header)
        if name == "displacement" and not self.recipe.displacement:
            self.asked_about.add("contraction")
            self.ask(
                "may grow with shortening or with lengthening",
                field=column.name,
                remedy=_SIGN_REMEDY.format(column.name, header.unit),
            )
            return
        if name == "force":
            sign *= self.recipe.force_sign or 1
        reference = "gauge" if name.endswith("pressure") else ""
        if header.absolute:
            if self.recipe.ambient is None:
                self.asked_about.add(name)
                self.ask("is an absolute pressure", field=column.name, remedy=_AMBIENT)
                return
            values, reference = values - self.recipe.ambient, f"absolute, less {show(self.recipe.ambient, 'kPa')}"
        self.table.columns[name] = Column(
            column.name, name, header.unit, values if sign > 0 else -values, sign, reference, source
        )

    def _unread_clock(self, column: RawColumn, header: Header) -> None:
        self.table.ignored.append(column.name)
        self.table.clock = column.name

    def _numbers(self, column: RawColumn, name: str) -> Floats:
        """Numbers of a column; cells that are none are corrupt."""
        header, cells = column.name, column.cells
        values = (
            cells.copy()
            if isinstance(cells, np.ndarray)
            else to_numbers(cells, self.raw.decimal, certain=bool(self.recipe.decimal))
        )
        wrong = ~np.isfinite(values)
        if name == "set_pressure":
            wrong &= (
                np.array([bool(str(cell).strip()) for cell in cells]) if not isinstance(cells, np.ndarray) else False
            )
        for row in np.flatnonzero(wrong):
            text = f"{str(cells[row])[:40]!r} is not a number"
            self._corrupt(int(row), header, text)
        self.bad |= wrong
        usual = values[~wrong]
        size = np.abs(values)
        if name == "force" and len(usual) and usual.max() in _ENDS and np.count_nonzero(usual == usual.max()) > 1:
            text = f"the largest value, {usual.max():g}, is the end of a converter's range"
            self.asked.append(
                question(
                    "saturation",
                    text,
                    field=header,
                    remedy=f"leave these rows out: in a recipe largest_force: {usual.max():g} N",
                )
            )
        marks = (
            np.isclose(size[:, None], _MARKS[:-1], rtol=1e-12).any(axis=1)
            if size.max(initial=0) > 990
            else np.zeros(len(size), bool)
        ) | (size >= 1e29)
        marks |= (values <= -999) & (np.modf(values)[0] == 0) & (usual.max(initial=0) > 0) & (np.isin(size, _MARKS))
        if marks.any() and 2 * np.count_nonzero(marks) < len(values):
            others = values[~marks & ~wrong]
            if len(others) and (
                values[marks].max() > 2 * np.abs(others).max()
                or values[marks].min() < 0 <= others.min()
                or not _between(values, marks)
            ):
                row = int(np.argmax(marks))
                text = f"{values[row]:g} may mark a missing value"
                self.asked.append(
                    question(
                        "rows",
                        text,
                        line=int(self.table.lines[row]),
                        field=header,
                        remedy="leave these rows out of the file",
                    )
                )
        return values

    def _corrupt(self, row: int, header: str, text: str) -> None:
        line = int(self.table.lines[row])
        self.asked.append(question("corrupt", text, line=line, field=header, remedy="correct it"))
        self.table.repairs.append(f"{self.table.place} {line}, {header}: {text}")

    def _meaning(self, name: str, column: RawColumn) -> np.ndarray:
        """Directions or phases by their words."""
        said = {**_WORDS[name], **{key.lower(): word for key, word in self.mapping.items() if word in _WORDS[name]}}
        cells = [str(cell).strip().lower() for cell in column.cells]
        first, second = list(dict.fromkeys(filter(None, _WORDS[name].values())))
        for cell in dict.fromkeys(cells):
            if cell not in said:
                shown = str(column.cells[cells.index(cell)])[:40]
                remedy = f"give its meaning: columns={{{shown!r}: {first!r}}} (command line: --column '{shown}={first}', or {second})"
                self.ask(
                    f"{shown!r} is not a {name}",
                    field=column.name,
                    line=int(self.table.lines[cells.index(cell)]),
                    remedy=remedy,
                )
        return np.array([said.get(cell, "") for cell in cells], "<U9")

    def _lengths(self) -> None:
        """Contractions from lengths or displacements; a question where both are given and differ."""
        table, recipe = self.table, self.recipe
        motions = [name for name in _MOTIONS if name in table.columns]
        if recipe.initial_length and recipe.initial_length > _LONGEST:
            self.ask(
                f"{recipe.initial_length:g} m is longer than any muscle",
                field="initial_length",
                remedy=f"{_LENGTH_REMEDY}, in Python in m",
            )
        if not motions:
            return
        initial = table.initial_length
        lengths = {}
        for name in motions:
            column = table.columns[name]
            way = {"displacement": recipe.displacement}.get(name, name)
            zero = recipe.zero_length if recipe.zero_length is not None else initial
            if name == "length":
                lengths[name] = column.values
            elif zero is not None:
                lengths[name] = zero + (column.values if way == "lengthening" else -column.values)
        if "contraction" in table.columns:
            self._compare(lengths)
            return
        if initial is None:
            self.asked_about.add("contraction")
            self.ask("is needed for lengths and displacements", field="initial_length", remedy=_LENGTH_REMEDY)
            return
        first, *others = lengths.values()
        if others and not np.allclose(first, others[0], atol=_ROUNDING[0]):
            self.ask(
                f"and {motions[1]!r} give different lengths", field=motions[0], remedy="ignore one of the two columns"
            )
        if np.nanmin(first, initial=np.inf) <= 0 or np.nanmax(first, initial=0) > 2 * initial:
            text = f"lengths of {show(float(np.nanmin(first)), 'mm', 4)} to {show(float(np.nanmax(first)), 'mm', 4)} do not fit the initial length, {show(initial, 'mm', 5)}"
            self.ask(
                text, field=motions[0], remedy="check its unit and initial_length (command line: --initial-length)"
            )
        column = table.columns[motions[0]]
        values = 1 - first / initial
        table.columns["contraction"] = Column(column.header, "contraction", "", values, source=column.source)

    def _compare(self, lengths: Mapping[str, Floats]) -> None:
        """Compare contractions with lengths, which give the initial length."""
        contraction = self.table.columns["contraction"].values
        for name, length in lengths.items():
            with np.errstate(divide="ignore", invalid="ignore"):
                implied = length / (1 - contraction)
            agreed = float(np.nanmedian(implied))
            if self.table.initial_length is None and name == "length":
                self.table.initial_length = round(agreed, 9)
            expected = (self.table.initial_length or agreed) * (1 - contraction)
            off = np.abs(length - expected) > max(_ROUNDING[0], _ROUNDING[1] * agreed)
            if off.any():
                row = int(np.argmax(off))
                text = f"{show(float(length[row]), 'mm', 5)} contradicts the contraction, {contraction[row]:.4g}"
                remedy = f"ignore one of the two: {_NEEDLESS.format(self.table.columns[name].header)}"
                self.ask(text, field=name, line=int(self.table.lines[row]), remedy=remedy)

    def _leave_out(self) -> None:
        """Leave out corrupt rows, if that is accepted, and rows of a saturated sensor."""
        table = self.table
        bad = self.bad.copy() if "corrupt" in self.recipe.accept else np.zeros(len(self.bad), bool)
        if self.recipe.largest_force is not None and "force" in table.columns:
            full = table.columns["force"].values >= self.recipe.largest_force
            table.repairs += [
                f"{table.place} {line}: force at the end of the sensor's range" for line in table.lines[full]
            ]
            bad |= full
        if 2 * np.count_nonzero(bad) > len(bad):
            self.ask(
                f"{np.count_nonzero(bad)} of {len(bad)} rows would be left out", remedy="check columns and decimal sign"
            )
        elif bad.any():
            table.lines = table.lines[~bad]
            table.columns = {
                name: Column(
                    column.header, name, column.unit, column.values[~bad], column.sign, column.reference, column.source
                )
                for name, column in table.columns.items()
            }


def _between(values: Floats, marks: np.ndarray) -> bool:
    """Whether each marked value is close to one of its neighbours, as a measurement is."""
    rows = np.flatnonzero(marks)
    before, after = values[np.clip(rows - 1, 0, None)], values[np.clip(rows + 1, None, len(values) - 1)]
    near = np.minimum(np.abs(before - values[rows]), np.abs(after - values[rows])) <= 0.25 * np.abs(values[rows])
    return bool(near.all())
