"""Understanding of a raw table: its columns as quantities in SI units, or questions."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mckibben.dataset.clock import seconds_of
from mckibben.dataset.raw import Floats, RawColumn, RawTable
from mckibben.dataset.schema import unquote
from mckibben.dataset.table import MOTIONS, Column, Question, Table, question
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
from mckibben.errors import Problem, UnitError, closest
from mckibben.units import quantity, show

if TYPE_CHECKING:
    from mckibben.dataset.recipe import Recipe

_COLUMN_REMEDY = "name it: columns={{{0!r}: '{1}'}} (command line: --column '{0}={1}')"
_NEEDLESS = "if it is not needed: columns={{{0!r}: 'ignore'}} (command line: --column '{0}=ignore')"
_AMBIENT = "give the ambient pressure: ambient=101300.0 (command line: --read 'ambient=101.3 kPa')"
_LENGTH_REMEDY = "give initial_length (command line: --initial-length '180 mm')"
_SIGN_REMEDY = (
    "name the direction in which it grows, shortening or lengthening: columns={{{0!r}: 'shortening_{1}'}} "
    "(command line: --column '{0}=shortening_{1}'); zero_length of a recipe is the length at 0, if not the initial one"
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
_LISTED = 1000  # corrupt cells of a column that are named
_LONGEST = 20.0  # m
_WITH_UNIT = re.compile(r"(.+?)\s*[\[(]([^\[\]()]+)[\])]\s*")
_UNNAMED = re.compile(r"column \d+")
_MEASURED = re.compile("force|kraft|press|druck|length|länge|contract|kontrak", re.IGNORECASE)
_ELECTRICAL = frozenset(("v", "mv", "a", "ma", "mv/v", "counts", "digits", "raw", "lsb", "adc"))


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


class _Entry(NamedTuple):
    """Column of a file, what its header means, its sign, and where this is from."""

    column: RawColumn
    header: Header
    sign: int
    source: str


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
            remedy = "give the decimal sign: decimal=',' or decimal='.' (command line: --read decimal=. or decimal=,)"
            self.ask(text, remedy=remedy)
        for entry in chosen:
            self._convert(entry)
        for problem in raw.corrupt:
            self.asked.append(question("corrupt", problem.message, line=problem.line))
            table.repairs.append(str(problem))
        self._lengths()
        if missing := [name for name in needed if name not in table.columns and name not in self.asked_about]:
            names = ", ".join(column.name for column in raw.columns[:20])
            kinds = " and ".join(missing)
            remedy = "name them: " + " ".join(self._meant(name) for name in missing if QUANTITIES[name])
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

    def _meant(self, quantity: str) -> str:
        """Option that names a column of a quantity: the one whose header has its name and an unknown unit, if any."""
        for column in self.raw.columns:
            match = _WITH_UNIT.fullmatch(column.label or column.name)
            if match and column.name in self.table.ignored and parse_header(match[1]).quantity == quantity:
                unit = closest(match[2], QUANTITIES[quantity]) or QUANTITIES[quantity][0]
                return f"--column '{column.name}={quantity}_{unit}'"
        return f"--column 'HEADER={quantity}_{QUANTITIES[quantity][0]}'"

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
            apart = given is not None and stated is not None and abs(given - stated) > _ROUNDING[0]
            if key == "initial_length" and given and stated and apart:
                text = f"{show(given, 'mm', 5)} is given, but the file states {show(stated, 'mm', 5)}"
                self.asked.append(question("words", text, field=key))
        table.initial_length, table.slack_force = numbers["initial_length"], numbers["slack_force"]
        table.preprocessing = unquote(said.get("preprocessing", "none"))
        table.repairs += unquote(said.get("repairs", "")).splitlines()
        table.specimen = recipe.specimen or unquote(said.get("specimen", ""))
        table.source = unquote(said["source"]) if "source" in said else table.path.name

    def _headers(self) -> list[_Entry]:
        """Columns that are understood, with sign and origin; questions about the others."""
        understood = []
        self._units_beside()
        for column in self.raw.columns:
            label = column.label or column.name
            name = self.mapping.get(column.name, self.mapping.get(label, ""))
            if name.lower() in ("ignore", "ignored"):
                self.table.ignored.append(column.name)
                continue
            header = parse_header(name.lstrip("-")) if name else parse_header(label, column.unit)
            if _UNNAMED.fullmatch(column.name) and not isinstance(column.cells, np.ndarray):
                header = Header("time", "") if seconds_of(header, column.cells) is not None else header
            if name and (not header.quantity or not (header.unit or not QUANTITIES[header.quantity])):
                known = [f"{quantity}_{units[0]}" for quantity, units in QUANTITIES.items() if units]
                remedy = f"name quantity and unit, such as {closest(name, known) or 'force_N'}"
                self.ask(f"{name!r} is not a quantity with a unit", field=column.name, remedy=remedy)
            elif header.quantity:
                self._compare_units(column, label, header, bool(name))
                source = "columns" if name else "file" if column.unit and not parse_header(label).unit else "header"
                understood.append(_Entry(column, header, -1 if name.startswith("-") else 1, source))
            else:
                self._unread(column, label)
        return understood

    def _compare_units(self, column: RawColumn, label: str, header: Header, named: bool) -> None:
        """Ask about a unit of the recipe that is not the one in the file."""
        match = re.search(r"[\[(]([^\[\]()]+)[\])]\s*$", label)
        stated = column.unit or (match[1] if match else "")
        is_unit = dimension_of(stated) or stated.lower() in _ELECTRICAL
        if named and is_unit and header.unit and canonical_unit(stated, header.quantity) != header.unit:
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
        unit = unit if unit != label else label.rpartition("_")[2] if dimension_of(label.rpartition("_")[2]) else ""
        dimension = dimension_of(unit)
        if dimension in ("", "time") and _is_needless(column, label, other_unit=bool(unit)):
            return
        remedy = _NEEDLESS.format(column.name)
        if dimension and dimension != "time":
            meant = f"{dimension}_{canonical_unit(unit, dimension) or QUANTITIES[dimension][0]}"
            remedy = f"{_COLUMN_REMEDY.format(column.name, meant)}; {remedy}"
        self.asked.append(question("columns", "is not understood", field=column.name, remedy=remedy))

    def _choose(self, understood: Sequence[_Entry]) -> list[_Entry]:
        """One column for each quantity: the one that the recipe names, or the only one."""
        chosen: dict[str, _Entry] = {}
        for entry in understood:
            name = entry.header.quantity
            other = chosen.setdefault(name, entry)
            if other is entry:
                continue
            named = [candidate for candidate in (other, entry) if candidate.source == "columns"]
            if len(named) == 1:
                best = named[0]
            elif name == "time":
                best = entry if entry.header.unit and not other.header.unit else other
            elif _agree(entry, other):
                best = min(other, entry, key=lambda candidate: QUANTITIES[name].index(candidate.header.unit))
            else:
                self.asked_about.add(name)
                meant = _COLUMN_REMEDY.format(entry.column.name, f"{name}_{entry.header.unit}")
                text = f"and {other.column.name!r} are both a {name.replace('_', ' ')}"
                self.ask(text, field=entry.column.name, remedy=f"name the one that is meant: {meant}")
                continue
            chosen[name] = best
            self.table.ignored.append((other if best is entry else entry).column.name)
        return list(chosen.values())

    def _check_mapping(self) -> None:
        """Questions about headers of the recipe that the file does not have."""
        names = {column.name for column in self.raw.columns} | {column.label for column in self.raw.columns}
        for key, name in self.mapping.items():
            if key not in names and name not in ("loading", "unloading", "filling", "venting"):
                known = [column.name for column in self.raw.columns]
                close = closest(key, known)
                remedy = f"did you mean {close!r}?" if close else f"the file has {', '.join(known[:20])}"
                self.ask(f"there is no column {key!r}", remedy=remedy)

    def _convert(self, entry: _Entry) -> None:
        """Add a column in SI units, or a question."""
        column, header, sign, source = entry
        name = header.quantity
        if name == "time":
            clock = seconds_of(header, column.cells)
            if clock is None:
                self.table.ignored.append(column.name)
                self.table.clock = column.name
                return
            values = clock
        elif name in _WORDS:
            values = self._meaning(name, column)
        elif problem := self._not_convertible(column, header):
            self.asked_about |= {"contraction"} if name in MOTIONS else {name}
            self.asked.append(Question(problem))
            return
        else:
            values = self._numbers(column, name) * si_factor(header)
        if name == "force":
            sign *= self.recipe.force_sign or 1
        reference = "gauge" if name.endswith("pressure") else ""
        if header.absolute and self.recipe.ambient is not None:
            values, reference = values - self.recipe.ambient, f"absolute, less {show(self.recipe.ambient, 'kPa')}"
        values = values if sign > 0 else -values
        self.table.columns[name] = Column(column.name, name, header.unit, values, sign, reference, source)

    def _not_convertible(self, column: RawColumn, header: Header) -> Problem | None:
        """Why the numbers of a column have no plain unit, sign or reference."""
        name = header.quantity
        if QUANTITIES[name] and not header.unit:
            self.table.ignored.append(column.name)
            meant = f"{'shortening' if name == 'displacement' else name}_{QUANTITIES[name][0]}"
            remedy = _COLUMN_REMEDY.format(column.name, meant)
            return Problem("has no unit that is understood", field=column.name, remedy=remedy)
        if name == "displacement" and not self.recipe.displacement:
            remedy = _SIGN_REMEDY.format(column.name, header.unit)
            return Problem("may grow with shortening or with lengthening", field=column.name, remedy=remedy)
        if header.absolute and self.recipe.ambient is None:
            return Problem("is an absolute pressure", field=column.name, remedy=_AMBIENT)
        return None

    def _numbers(self, column: RawColumn, name: str) -> Floats:
        """Numbers of a column; cells that are none are corrupt."""
        cells = column.cells
        if isinstance(cells, np.ndarray):
            values, filled = cells.copy(), np.ones(len(cells), bool)
        else:
            values = to_numbers(cells, self.raw.decimal, certain=bool(self.recipe.decimal))
            filled = np.array([bool(cell.strip()) for cell in cells])
        wrong = ~np.isfinite(values)
        if name == "set_pressure":
            wrong &= filled
        for row in np.flatnonzero(wrong)[:_LISTED].tolist():
            text, line = f"{str(cells[row])[:40]!r} is not a number", int(self.table.lines[row])
            self.asked.append(question("corrupt", text, line=line, field=column.name, remedy="correct it"))
            self.table.repairs.append(f"{self.table.place} {line}, {column.name}: {text}")
        self.bad |= wrong
        if (row := missing_mark(values)) is not None:
            text, line = f"{values[row]:g} may mark a missing value", int(self.table.lines[row])
            remedy = "leave these rows out of the file"
            self.asked.append(question("rows", text, line=line, field=column.name, remedy=remedy))
        highest = float(np.max(values[~wrong], initial=0.0))
        if name == "force" and highest in _ENDS and np.count_nonzero(values == highest) > 1:
            text = f"the largest value, {highest:g}, is the end of a converter's range"
            remedy = f"leave these rows out: in a recipe largest_force: {highest:g} N"
            self.asked.append(question("saturation", text, field=column.name, remedy=remedy))
        return values

    def _meaning(self, name: str, column: RawColumn) -> np.ndarray:
        """Directions or phases by their words."""
        said = {**_WORDS[name], **{key.lower(): word for key, word in self.mapping.items() if word in _WORDS[name]}}
        cells = [str(cell).strip().lower() for cell in column.cells]
        first, second = list(dict.fromkeys(filter(None, _WORDS[name].values())))
        for cell in [cell for cell in dict.fromkeys(cells) if cell not in said]:
            at = cells.index(cell)
            shown = str(column.cells[at])[:40]
            meant = f"columns={{{shown!r}: {first!r}}} (command line: --column '{shown}={first}')"
            remedy = f"give its meaning, {first} or {second}: {meant}"
            line = int(self.table.lines[at])
            self.ask(f"{shown!r} is not a {name}", field=column.name, line=line, remedy=remedy)
        return np.array([said.get(cell, "") for cell in cells], "<U9")

    def _lengths(self) -> None:
        """Contractions from lengths or displacements; a question where both are given and differ."""
        table, recipe, initial = self.table, self.recipe, self.table.initial_length
        if recipe.initial_length and recipe.initial_length > _LONGEST:
            text = f"{recipe.initial_length:g} m is longer than any muscle"
            self.ask(text, field="initial_length", remedy=f"{_LENGTH_REMEDY}, in Python in m")
        zero = recipe.zero_length if recipe.zero_length is not None else initial
        lengths: dict[str, Floats] = {}
        for name in [name for name in MOTIONS if name in table.columns]:
            values = table.columns[name].values
            way = (recipe.displacement or "") if name == "displacement" else name
            if name == "length":
                lengths[name] = values
            elif zero is not None:
                lengths[name] = zero + (values if way == "lengthening" else -values)
        if "contraction" in table.columns:
            self._compare(lengths)
        elif initial is None and any(name in table.columns for name in MOTIONS):
            self.asked_about.add("contraction")
            self.ask("is needed for lengths and displacements", field="initial_length", remedy=_LENGTH_REMEDY)
        elif initial is not None and lengths:
            self._contract(lengths, initial)

    def _contract(self, lengths: Mapping[str, Floats], initial: float) -> None:
        """Add the contraction of lengths."""
        name, length = next(iter(lengths.items()))
        if any(not np.allclose(length, other, atol=_ROUNDING[0], equal_nan=True) for other in lengths.values()):
            self.ask("differs from the lengths of another column", field=name, remedy="ignore one of the two columns")
        shortest, longest = float(np.nanmin(length, initial=np.inf)), float(np.nanmax(length, initial=0.0))
        if shortest <= 0 or longest > 2 * initial:
            span = f"{show(shortest, 'mm', 4)} to {show(longest, 'mm', 4)}"
            text = f"lengths of {span} do not fit the initial length, {show(initial, 'mm', 5)}"
            self.ask(text, field=name, remedy="check its unit and initial_length (command line: --initial-length)")
        column = self.table.columns[name]
        contraction = Column(column.header, "contraction", "", 1 - length / initial, source=column.source)
        self.table.columns["contraction"] = contraction

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


def _is_needless(column: RawColumn, label: str, *, other_unit: bool) -> bool:
    """Whether the name or the content of a column says that it is no pressure, force, length or mark of rows."""
    cells = column.cells
    if isinstance(cells, np.ndarray):
        if _UNNAMED.fullmatch(column.name):
            return bool(np.all(np.diff(cells) == 1))
        return other_unit or (is_harmless(label) and not _MEASURED.search(label))
    texts = {str(cell).strip() for cell in cells} - {""}
    numbers = sum(bool(NUMBER.fullmatch(text)) for text in texts)
    if 0 < numbers < len(texts) or (_MEASURED.search(label) and texts):
        return False
    return is_harmless(label) or not texts or (len(texts) == 1 and not any(map(str.isdigit, texts)))


def _agree(entry: _Entry, other: _Entry) -> bool:
    """Whether two columns have the same values, perhaps in different units."""
    first, second = entry.column.cells, other.column.cells
    if not (isinstance(first, np.ndarray) and isinstance(second, np.ndarray)):
        return False
    first, second = first * si_factor(entry.header), second * si_factor(other.header)
    alike = np.allclose(first, second, rtol=2e-3, atol=1e-3 * float(np.abs(second).max(initial=0.0)))
    return alike and entry.header.absolute == other.header.absolute


def missing_mark(values: Floats) -> int | None:
    """First row of a number such as -9999 that marks missing values, far from the others or from its neighbours."""
    size = np.abs(values)
    if not size.max(initial=0.0) > 990:
        return None
    marks = np.isin(size, _MARKS) | (size >= 1e29)
    others = values[~marks & np.isfinite(values)]
    if not (marks.any() and 2 * np.count_nonzero(marks) < len(values) and len(others)):
        return None
    rows = np.flatnonzero(marks)
    beside = values[np.clip(rows - 1, 0, None)], values[np.clip(rows + 1, None, len(values) - 1)]
    apart = np.min([np.abs(neighbour - values[rows]) for neighbour in beside], axis=0) > 0.02 * size[rows]
    far = values[rows].max() > 2 * np.abs(others).max() or values[rows].min() < 0 <= others.min()
    return int(rows[0]) if far or apart.any() else None
