"""Understanding of a raw table: its columns as quantities in SI units, or questions."""

from __future__ import annotations

import re
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mckibben.dataset.at_joint import JointPaths, add_muscle, implausible_torque, needed_at_joint
from mckibben.dataset.cells import NUMBER, missing_marks, to_numbers
from mckibben.dataset.clock import continuous, seconds_of
from mckibben.dataset.raw import Floats, RawColumn, RawTable
from mckibben.dataset.schema import WORDS, unquote
from mckibben.dataset.segmentation import usual_interval
from mckibben.dataset.table import MOTIONS, Column, Question, Table, question
from mckibben.dataset.vocabulary import (
    ABSOLUTE,
    OF_MUSCLES,
    QUANTITIES,
    VOCABULARY,
    Header,
    dimension_of,
    is_harmless,
    parse_header,
    parse_line,
    parse_named,
    si_factor,
)
from mckibben.dataset.words import doubtful_words, other_units
from mckibben.errors import Problem, UnitError, closest
from mckibben.units import quantity, show

if TYPE_CHECKING:
    from mckibben.dataset.recipe import Recipe

_COLUMN_REMEDY = "name it: columns={{{0!r}: '{1}'}} (command line: --column '{0}={1}')"
_NEEDLESS = "if it is not needed: columns={{{0!r}: 'ignore'}} (command line: --column '{0}=ignore')"
_AMBIENT = "give the ambient pressure: ambient=101300.0 (command line: --read 'ambient=101.3 kPa')"
_LENGTH_REMEDY = "give initial_length (command line: --initial-length '180 mm')"
_SIGN_REMEDY = (
    "name the direction in which it grows, WAY being shortening or lengthening: columns={{{0!r}: 'WAY_{1}'}} "
    "(command line: --column '{0}=WAY_{1}'); zero_length of a recipe is the length at 0, if not the initial one"
)
_ELSEWHERE = (
    " (in Python columns={...}); per file: --read 'from_name={pressure_bar}bar', --read 'loads=2 kg, 5 kg'; in that "
    "of a second device: --read clocks=estimated"
)
_AT_JOINT = (
    "of torques at angles, give the geometry of the joint: --read joint=FILE (in Python joint=FILE), of forces at a "
    "lever also --read 'lever=250 mm'; else "
)
_AT_LEVER = "of forces at a lever of the joint, give its arm: --read 'lever=250 mm' (in Python lever=0.25); else "
_ROUNDING = 0.5e-3  # m: precision of lengths
_LISTED = 1000  # corrupt cells of a column that are named
_WORDS_LISTED = 20  # unknown words of a column that are named
_LONGEST = 20.0  # m
_MASS = re.compile(r"weight|mass|gewicht|last\b|poids|重量|质量|質量|砝码|おもり", re.IGNORECASE)
_OF_JOINTS = ("angle", "torque", *(name for pair in OF_MUSCLES for name in pair))
_NEEDLESS_UNITS = ("time", "angle", "torque")
_KINDS = {
    "length": ", where KIND is length, shortening or lengthening",
    "contraction": ", where KIND is contraction or lengthening",
}
_WITH_UNIT = re.compile(r"(.+?)\s*[\[(]([^\[\]()]+)[\])]\s*")
_UNNAMED = re.compile(r"column \d+")
_LENGTH = re.compile(r"(?<![\d.,])(\d+(?:\.\d+)?) ?(mm|cm|m)\b(?!\w|[/^])")


def understand(
    path: Path,
    raw: RawTable,
    recipe: Recipe,
    needed: Sequence[str],
    geometry: JointPaths | None = None,
    named: Sequence[str] = (),
) -> Table:
    """Map the columns of a file to quantities in SI units; what is not plain becomes a question of the table.

    Parameters
    ----------
    recipe
        Answers: columns, lengths, signs, ambient pressure, decimal sign.
    needed
        Quantities without which nothing can be read.
    geometry
        Of the joint at which torques were measured: those of one muscle are read as its force and length.
    named
        Quantities of named joints and muscles, such as ``angle.hip``.
    """
    return _Reader(path, raw, recipe, named).read(needed, geometry)


class _Entry(NamedTuple):
    """Column of a file, what its header means, the line of its sensor, and where this is from."""

    column: RawColumn
    header: Header
    source: str
    gain: float = 1.0
    offset: float = 0.0

    def without_sensor(self) -> _Entry:
        """The entry where no column is a force: a weight that hangs is, or a load that the recipe names."""
        named = self.source == "columns" or _MASS.search(self.column.name)
        hung = named and self.header.quantity == "set_force"
        return self._replace(header=self.header._replace(quantity="force")) if hung else self


class _Reader:
    """Steps of `understand`."""

    def __init__(self, path: Path, raw: RawTable, recipe: Recipe, named: Sequence[str]) -> None:
        self.raw, self.recipe, self.named = raw, recipe, named
        self.mapping = {str(key).strip(): name for key, name in (recipe.columns or {}).items()}
        lines = np.asarray(raw.lines, np.int64)
        self.table = Table(path, place=raw.place, lines=lines, interval=raw.interval, questions=raw.questions)
        self.table.head = {column.name: copy(column.cells[:4]) for column in raw.columns}
        self.table.units = {column.name: column.unit for column in raw.columns}
        self.asked = self.table.questions
        self.bad = np.zeros(len(raw.lines), bool)
        self.asked_about: set[str] = set()

    def read(self, needed: Sequence[str], geometry: JointPaths | None) -> Table:
        table, raw = self.table, self.raw
        self._attributes()
        chosen = self._choose(self._headers())
        self._check_mapping()
        for entry in chosen:
            self._convert(entry)
        if self.recipe.joint is not None and "time" not in needed:
            needed = self._at_joint(needed, geometry)
        self._lengths()
        if missing := [name for name in needed if name not in table.columns and name not in self.asked_about]:
            names = ", ".join(column.name for column in raw.columns[:20])
            kinds = " and ".join(missing)
            meant = " ".join(self._meant(name) for name in missing if QUANTITIES[name])
            at_joint = any(column.header().quantity in _OF_JOINTS for column in raw.columns)
            of_joint = _AT_JOINT if at_joint and not self.recipe.joint else ""
            of_joint = _AT_LEVER if "torque" in missing and "force" in table.columns else of_joint
            named = f"{of_joint}name them: {meant}{_ELSEWHERE}"
            self.ask(f"no column for {kinds}; its columns are {names}", remedy=named)
        self._ask_about_words(chosen)
        table.repairs += [str(replace(asked.problem, remedy="")) for asked in self.asked if asked.topic == "corrupt"]
        self._leave_out()
        return table

    def _ask_about_words(self, chosen: Sequence[_Entry]) -> None:
        """Questions about words that may change numbers, and about an ambient pressure that nothing needs."""
        answered, columns = self.recipe.ambient is not None, self.table.columns
        initial, units = self.table.initial_length or np.nan, {column.unit for column in columns.values()}
        words = [(line, ABSOLUTE.sub("", text) if answered else text) for line, text in self.raw.words]
        words = [(line, _LENGTH.sub(lambda match: _unless(match, initial), text)) for line, text in words]
        for line, text in doubtful_words(words, units):
            length, foreign = _LENGTH.search(text), dict(other_units(text, units))
            kind = next((name for name in foreign if name in columns), "force")
            header, unit = "HEADER", "N"
            if column := columns.get(kind):
                header, unit = column.header, column.unit
            remedy = f"apply it by --column '{header}=1*x-12.5 {kind}_{unit}'"
            if ABSOLUTE.search(text):
                remedy = _AMBIENT
            elif kind in foreign:
                remedy = f"if it is the unit: --column '{header}={kind}_{foreign[kind]}'"
            elif length and "length" in foreign:
                remedy = f"if it is the initial length: --initial-length '{length[0]}'"
            self.ask(f"beside the table stands {text[:200]!r}", "words", line=line, remedy=remedy)
        if answered and not any(self._is_absolute(entry.header) for entry in chosen):
            remedy = "name an absolute one: --column 'HEADER=pressure_bar_abs', or leave ambient out"
            self.ask("no pressure is absolute", field="ambient", remedy=remedy)

    def _at_joint(self, needed: Sequence[str], geometry: JointPaths | None) -> Sequence[str]:
        """Quantities that a test on a joint needs, with questions; adds those of the only muscle."""
        columns, lever = self.table.columns, self.recipe.lever
        if (torque := columns.get("torque")) and (lever is not None or "force" in columns):
            ways = (torque if lever is not None else columns["force"]).header
            remedy = f"leave lever out, or {_NEEDLESS}" if lever is not None else _NEEDLESS
            text = f"is a torque beside a {'force' if lever is None else 'lever'}"
            self.ask(text, field=torque.header, remedy=remedy.format(ways))
        at_joint = needed_at_joint(columns, lever)
        if "torque" not in needed:
            if {*at_joint} <= {*columns}:
                self.asked += add_muscle(columns, geometry)
            return at_joint
        if geometry is not None and {*needed} <= {*columns}:
            arms = geometry.paths_and_arms(columns["angle"].values)[1]
            self.asked += implausible_torque(columns, np.asarray(arms))
        return needed

    def _meant(self, quantity: str) -> str:
        """Option that names a column of a quantity: the one whose header has its unit, or its name, if any."""
        for column in self.raw.columns:
            if column.name not in self.table.ignored:
                continue
            unit = column.header().unit
            if dimension_of(unit) == quantity and quantity not in _KINDS:
                return f"--column '{column.name}={quantity}_{unit}'"
            match = _WITH_UNIT.fullmatch(column.title)
            if match and parse_header(match[1]).quantity == quantity:
                unit = closest(match[2], QUANTITIES[quantity])
                line = "" if unit else "GAIN*x+OFFSET "  # of a sensor in volts or counts
                return f"--column '{column.name}={line}{quantity}_{unit or QUANTITIES[quantity][0]}'"
        return f"--column 'HEADER={quantity}_{QUANTITIES[quantity][0]}'"

    def ask(self, text: str, topic: str = "", *, field: str = "", line: int | None = None, remedy: str = "") -> None:
        self.asked.append(question(text, topic, line=line, field=field, remedy=remedy))

    def _attributes(self) -> None:
        """Specimen, source, initial length and slack force, of the recipe or of the file."""
        said, recipe, table = self.raw.comments, self.recipe, self.table
        for key, unit in (("initial_length", "m"), ("slack_force", "N")):
            stated, chosen = None, getattr(recipe, key)
            try:
                stated = quantity(said[key], unit) if said.get(key) else None
            except UnitError as error:
                self.ask(error.message, field=key, remedy=error.remedy)
            if key == "initial_length" and chosen and stated and abs(chosen - stated) > _ROUNDING:
                text = f"{show(chosen, 'mm', 5)} is given, but the file states {show(stated, 'mm', 5)}"
                self.ask(text, "words", field=key)
            setattr(table, key, stated if chosen is None else chosen)
        table.joined = said.get("clocks", "")
        table.preprocessing = unquote(said.get("preprocessing", "none"))
        table.repairs += unquote(said.get("repairs", "")).splitlines()
        table.specimen = recipe.specimen or unquote(said.get("specimen", ""))
        table.source = unquote(said["source"]) if "source" in said else table.path.name

    def _headers(self) -> list[_Entry]:
        """Columns that are understood, with sign and origin; questions about the others."""
        understood = []
        for column in self.raw.columns:
            name = column.name_in(self.mapping)
            if name == "ignore":
                self.table.ignored.append(column.name)
                continue
            gain, offset, name = parse_line(name)
            stated = (name, "") if name else (column.title, column.unit)
            header = parse_named(*stated, self.named) or (parse_header(name) if name else self._header_of(column))
            if name and (not header.quantity or not (header.unit or not QUANTITIES[header.quantity])):
                known = [f"{quantity}_{units[0]}" for quantity, units in QUANTITIES.items() if units]
                remedy = f"name quantity and unit, such as {closest(name, known) or 'force_N'}"
                self.ask(f"{name!r} is not a quantity with a unit", field=column.name, remedy=remedy)
            elif header.quantity:
                source = (
                    "columns" if name else "file" if column.unit and not parse_header(column.title).unit else "header"
                )
                understood.append(_Entry(column, header, source, gain, offset))
                self._ask_of_contradiction(understood[-1])
            else:
                self._unread(column, header.unit)
        sensed = any(entry.header.quantity == "force" for entry in understood)
        return understood if sensed else [entry.without_sensor() for entry in understood]

    def _ask_of_contradiction(self, entry: _Entry) -> None:
        """Ask about a column that the recipe names otherwise than its header says, without the line of a sensor."""
        if entry.source != "columns" or abs(entry.gain) != 1 or entry.offset:
            return
        column, named = entry.column, entry.header
        said = column.header()
        unlike = said.unit != named.unit and dimension_of(said.unit) and dimension_of(named.unit)
        if unlike or (said.absolute and not named.absolute and "pressure" in named.quantity):
            text = f"is named {named.quantity}_{named.unit}, which contradicts its header"
            self.ask(text, "words", field=column.name, remedy="correct either")

    def _header_of(self, column: RawColumn) -> Header:
        """Meaning of a column that the recipe does not name; those of a joint are read in its tests alone."""
        header = column.header()
        if _UNNAMED.fullmatch(column.name) and not isinstance(column.cells, np.ndarray):
            return Header("time", "") if seconds_of(header, column.cells) is not None else header
        return header if self.recipe.joint is not None or header.quantity not in _OF_JOINTS else Header("", header.unit)

    def _unread(self, column: RawColumn, unit: str) -> None:
        """Ask about a column that is not understood, unless its name or its content says that it is not needed."""
        self.table.ignored.append(column.name)
        if _UNNAMED.fullmatch(column.name) and not isinstance(column.cells, np.ndarray):
            self.raw.words += [(line, cell) for line, cell in zip(self.raw.lines, column.cells, strict=True) if cell]
            return
        remedy, dimension = _NEEDLESS.format(column.name), dimension_of(unit)
        if dimension in ("", *_NEEDLESS_UNITS):
            if _is_needless(column, other_unit=bool(unit)):
                return
        else:
            kinds = _KINDS.get(dimension, "")
            meant = f"{'KIND' if kinds else dimension}_{unit}"
            remedy = f"{_COLUMN_REMEDY.format(column.name, meant)}{kinds}; {remedy}"
        self.ask("is not understood", "columns", field=column.name, remedy=remedy)

    def _choose(self, understood: Sequence[_Entry]) -> list[_Entry]:
        """One column for each quantity, lengths and displacements together: the one of the recipe, or the only one."""
        chosen: dict[str, _Entry] = {}
        for entry in sorted(understood, key=lambda entry: (entry.source != "columns", not entry.header.unit)):
            kind = "length" if entry.header.quantity in MOTIONS else entry.header.quantity
            other = chosen.setdefault(kind, entry)
            if other is entry:
                continue
            self.table.ignored.append(entry.column.name)
            if kind == "time" and self._disagree(other, entry):
                text = f"is another clock than {other.column.name!r}"
                remedy = f"if each is that of the columns after it: --read clocks=paired; {_NEEDLESS}"
                self.ask(text, field=entry.column.name, remedy=remedy.format(entry.column.name))
            if kind != "time" and (other.source == "columns") == (entry.source == "columns"):
                self.asked_about.add(kind)
                meant = _COLUMN_REMEDY.format(entry.column.name, f"{entry.header.quantity}_{entry.header.unit}")
                text = f"and {other.column.name!r} are both a {kind.replace('_', ' ')}"
                self.ask(text, field=entry.column.name, remedy=f"of the two, {meant}")
        return sorted(chosen.values(), key=understood.index)

    def _disagree(self, first: _Entry, second: _Entry) -> bool:
        """Whether two clocks differ by more than two of their steps and a drift of 0.1 %, or one ends early.

        Of elapsed times in front of signals each, the offset counts, too.
        """
        if any(not isinstance(entry.column.cells, np.ndarray) and entry.header.unit for entry in (first, second)):
            return True
        time, other = (seconds_of(entry.header, entry.column.cells) for entry in (first, second))
        if time is None or other is None or not len(time):
            return False
        place = [self.raw.columns.index(entry.column) for entry in (first, second)]
        apart = other - time
        if abs(place[0] - place[1]) == 1 or not (first.header.unit and second.header.unit):
            apart = apart - apart[0]
        steps = max(usual_interval(np.diff(part))[0] for part in (time, other))
        return bool(np.abs(apart).max() > 2 * steps + 1e-3 * np.ptp(time))

    def _check_mapping(self) -> None:
        """Questions about headers of the recipe that the file does not have."""
        names = {column.name for column in self.raw.columns} | {column.label for column in self.raw.columns}
        for key, name in self.mapping.items():
            if key not in names and name not in VOCABULARY["synonyms"]:
                known = [column.name for column in self.raw.columns]
                close = closest(key, known)
                remedy = f"did you mean {close!r}?" if close else f"the file has {', '.join(known[:20])}"
                self.ask(f"there is no column {key!r}", remedy=remedy)

    def _convert(self, entry: _Entry) -> None:
        """Add a column in SI units, or a question."""
        column, header, source, gain, offset = entry
        name, remarks = header.quantity, list[str]()
        if name == "time":
            clock = seconds_of(header, column.cells)
            if clock is None:
                self.table.ignored.append(column.name)
                self.table.clock = column.name
                return
            values, remarks = continuous(clock)
        elif name in WORDS:
            values = self._meaning(name, column)
        elif problem := self._not_convertible(column, header):
            self.asked_about |= {"contraction"} if name in MOTIONS else {name}
            self.asked.append(Question(problem))
            return
        else:
            values = gain * self._numbers(column, name)
            values += offset  # in place, as there may be ten million
            values *= si_factor(header)
        remarks += [] if offset == 0 and abs(gain) == 1 else [f"{gain:g} x {offset:+g}"]
        remarks += ["sign reversed"] * (gain < 0)
        if self._is_absolute(header) and self.recipe.ambient is not None:
            values = values - self.recipe.ambient
            remarks.append(f"absolute, less {show(self.recipe.ambient, 'kPa')}")
        remarks += ["masses times g"] * bool(header.unit in ("kgf", "gf") and _MASS.search(column.name))
        self.table.columns[name] = Column(column.name, name, header.unit, values, source, tuple(remarks))

    def _is_absolute(self, header: Header) -> bool:
        """Whether a pressure is absolute, by its header or, if the ambient pressure is known, by words of the file."""
        said = self.recipe.ambient is not None and any(ABSOLUTE.search(text) for _, text in self.raw.words)
        return header.absolute or (said and "pressure" in header.quantity)

    def _not_convertible(self, column: RawColumn, header: Header) -> Problem | None:
        """Why the numbers of a column have no plain unit, sign or reference."""
        name = header.quantity
        if QUANTITIES[name] and not header.unit:
            self.table.ignored.append(column.name)
            meant = f"{'shortening' if name == 'displacement' else name}_UNIT"
            remedy = f"{_COLUMN_REMEDY.format(column.name, meant)}, where UNIT is one of {', '.join(QUANTITIES[name])}"
            return Problem("has no unit that is understood", field=column.name, remedy=remedy)
        if name == "displacement" and not self.recipe.displacement:
            remedy = _SIGN_REMEDY.format(column.name, header.unit)
            return Problem("may grow with shortening or with lengthening", field=column.name, remedy=remedy)
        if self._is_absolute(header) and self.recipe.ambient is None:
            return Problem("is an absolute pressure", field=column.name, remedy=_AMBIENT)
        return None

    def _numbers(self, column: RawColumn, name: str) -> Floats:
        """Numbers of a column; cells that are none are corrupt."""
        cells = column.cells
        values = to_numbers(cells, self.raw.decimal, certain=bool(self.recipe.decimal))
        wrong = ~np.isfinite(values)
        if name in ("set_pressure", "set_force") and not isinstance(cells, np.ndarray):
            wrong &= [bool(cell.strip()) for cell in cells]
        for row in np.flatnonzero(wrong)[:_LISTED].tolist():
            text, line = f"{str(cells[row])[:40]!r} is not a number", int(self.table.lines[row])
            self.ask(text, "corrupt", line=line, field=column.name, remedy="correct it")
        self.bad |= wrong
        marks = missing_marks(values)
        if 0 < np.count_nonzero(marks) < len(values) / 2:
            row = int(np.argmax(marks))
            text, line = f"{values[row]:g} may mark a missing value", int(self.table.lines[row])
            self.ask(text, "rows", line=line, field=column.name, remedy="leave these rows out of the file")
        return values

    def _meaning(self, name: str, column: RawColumn) -> np.ndarray:
        """Directions or phases by their words."""
        said = dict.fromkeys(("", "unknown", "unbekannt"), "")
        said |= {synonym: word for word in WORDS[name] for synonym in (word, *VOCABULARY["synonyms"][word].split())}
        said |= {key.lower(): word for key, word in self.mapping.items() if word in WORDS[name]}
        cells = [str(cell).strip().lower() for cell in column.cells]
        for cell in [cell for cell in dict.fromkeys(cells) if cell not in said][:_WORDS_LISTED]:
            at = cells.index(cell)
            shown = str(column.cells[at])[:40]
            meant = (_COLUMN_REMEDY.format(shown, word).removeprefix("name it: ") for word in WORDS[name])
            remedy = f"give its meaning: {' or '.join(meant)}"
            self.ask(f"{shown!r} is not a {name}", field=column.name, line=int(self.table.lines[at]), remedy=remedy)
        return np.array([said.get(cell, "") for cell in cells], "<U9")

    def _lengths(self) -> None:
        """Add the contraction that follows from a length or displacement."""
        table, recipe, initial = self.table, self.recipe, self.table.initial_length
        if recipe.initial_length and recipe.initial_length > _LONGEST:
            text = f"{recipe.initial_length:g} m is longer than any muscle"
            self.ask(text, field="initial_length", remedy=f"{_LENGTH_REMEDY}, in Python in m")
        if recipe.contraction is not None and "contraction" not in table.columns:
            values = np.full(len(table.lines), recipe.contraction)
            table.columns["contraction"] = Column("contraction", "contraction", "", values, source="recipe")
            return
        column = next((table.columns[name] for name in MOTIONS if name in table.columns), None)
        if column is None:
            return
        if "contraction" in table.columns:
            self._compare(column)
            return
        if column.unit in QUANTITIES["contraction"]:
            values = 1 - column.values if column.quantity == "relative_length" else -column.values
            table.columns["contraction"] = replace(column, values=values)
            return
        if initial is None:
            self.asked_about.add("contraction")
            self.ask("is needed for lengths and displacements", field="initial_length", remedy=_LENGTH_REMEDY)
            return
        length, way = column.values, recipe.displacement if column.quantity == "displacement" else column.quantity
        if way != "length":
            zero = recipe.zero_length if recipe.zero_length is not None else initial
            length = zero + (length if way == "lengthening" else -length)
        shortest, longest = float(np.nanmin(length, initial=np.inf)), float(np.nanmax(length, initial=0.0))
        if shortest <= 0 or longest > 2 * initial:
            span = f"{show(shortest, 'mm', 4)} to {show(longest, 'mm', 4)}"
            text = f"lengths of {span} do not fit the initial length, {show(initial, 'mm', 5)}"
            turned = f"the angle: --column '{column.header}=angle_UNIT', the geometry"
            unit = turned if "angle" in table.columns else "it"
            remedy = f"check the unit of {unit} and initial_length (command line: --initial-length)"
            self.ask(text, field=column.quantity, remedy=remedy)
        table.columns["contraction"] = replace(column, values=1 - length / initial)

    def _compare(self, column: Column) -> None:
        """Ask about a length that is not the initial one, less the contraction of another column."""
        if column.quantity == "length":
            shape = 1 - self.table.columns["contraction"].values
            implied = float(np.nanmedian(column.values / shape))
            self.table.initial_length = self.table.initial_length or round(implied, 9)
            if np.any(np.abs(column.values - self.table.initial_length * shape) > _ROUNDING):
                self.ask("contradicts the contraction", field=column.header, remedy=_NEEDLESS.format(column.header))

    def _leave_out(self) -> None:
        """Leave out corrupt rows, if that is accepted, and rows of a saturated sensor."""
        table = self.table
        bad = self.bad.copy() if "corrupt" in self.recipe.accept else np.zeros(len(self.bad), bool)
        if self.recipe.largest_force is not None and "force" in table.columns:
            full = table.columns["force"].values >= self.recipe.largest_force
            reason = "force at the end of the sensor's range"
            table.repairs += [f"{table.place} {line}: {reason}" for line in table.lines[full]]
            bad |= full
        if 2 * np.count_nonzero(bad) > len(bad):
            text = f"{np.count_nonzero(bad)} of {len(bad)} rows would be left out"
            self.ask(text, remedy="check columns and decimal sign")
        elif bad.any():
            table.lines, columns = table.lines[~bad], table.columns.items()
            table.columns = {name: replace(column, values=column.values[~bad]) for name, column in columns}


def _unless(match: re.Match[str], initial: float) -> str:
    """Length in a text; empty if it is the initial one."""
    return "" if abs(quantity(match[0], "m") - initial) < _ROUNDING else match[0]


def _is_needless(column: RawColumn, *, other_unit: bool) -> bool:
    """Whether the name or the content of a column says that it is no pressure, force, length or mark of rows."""
    cells = column.cells
    if isinstance(cells, np.ndarray):
        if _UNNAMED.fullmatch(column.name):
            return bool(np.all(np.diff(cells) == 1))
        return other_unit or is_harmless(column.title)
    texts = {str(cell).strip() for cell in cells} - {""}
    numbers = sum(bool(NUMBER.fullmatch(text)) for text in texts)
    if 0 < numbers < len(texts):
        return False
    constant = len(texts) == 1 and not any(dimension_of(text) or set("0123456789") & {*text} for text in texts)
    return not texts or constant or is_harmless(column.title)
