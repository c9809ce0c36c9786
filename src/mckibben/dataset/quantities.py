"""Conversion of the columns of a file to SI units, with all problems found."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mckibben.component.calls import user_level
from mckibben.dataset.columns import find_columns
from mckibben.dataset.headers import (
    ACCEPTED,
    LONGEST_NAME,
    name_and_unit,
    parse_header,
    with_units_beside,
    without_units,
)
from mckibben.dataset.plausibility import exchanged, implied_diameter, missing_marks
from mckibben.dataset.schema import VACUUM, WORDS, format_range, unquote, written_by_us
from mckibben.dataset.sheet import RawTable, decimal_sign, read_numbers
from mckibben.dataset.summaries import (
    MOST_POINTS,
    drifting_temperatures,
    integer_rows,
    invalid_rows,
    is_status,
    labelled_summaries,
    several_specimens,
    summaries,
)
from mckibben.errors import DatasetError, McKibbenWarning, Problem, UnitError, printable
from mckibben.units import factor, mm, quantity

OnCorrupt = Literal["raise", "report"]
"""Treatment of corrupt rows: raise an error, or leave them out and report each."""

Decimal = Literal["", ".", ","]
"""Decimal sign of texts; empty if the file determines it."""

Displacement = Literal["", "shortening", "lengthening"]
"""Direction of positive displacements; empty if unknown."""

_LENGTH_REMEDY = "give initial_length (command line: --initial-length '180 mm')"
_SIGN_REMEDY = (
    "give displacement='shortening' (command line: --displacement shortening) or displacement='lengthening' "
    "(command line: --displacement lengthening), the direction in which it is positive, and zero_length (command line: "
    "--zero-length), the length at 0, if it is not the initial length"
)
_ZERO_REMEDY = (
    "check its unit, initial_length, displacement and zero_length (options --initial-length, --displacement, "
    "--zero-length)"
)
_NO_DISPLACEMENT = (
    "displacement and zero_length (options --displacement, --zero-length) have no effect: no column is read as a "
    "displacement"
)
LEAVE_OUT = ", or leave such rows out by on_corrupt='report' (command line: --skip-corrupt)"
_SLACK_REMEDY = "give a force of 0 N or more (command line: --slack-force '1 N')"
_LENGTH_ROUNDING = 0.5e-3, 0.002  # m and fraction of the initial length: precision of a ruler and of a printed table
_LONGEST = 20.0  # m
_MEASURED = frozenset(("pressure", "force", "contraction", "length", "displacement"))
_LISTED = 10_000  # problems of an error
_WARNED = 5  # omitted rows listed in a warning
_COMPARED = 500  # rows of columns that may be exchanged
_ROWS = 3  # of impossible lengths that are listed

_MEANINGS: Mapping[str, Mapping[str, str]] = {
    "direction": {
        **dict.fromkeys(("loading", "load", "stretching", "lengthening"), "loading"),
        **dict.fromkeys(("dehnen", "dehnung", "strecken", "verlängern", "belasten", "belastung"), "loading"),
        **dict.fromkeys(("unloading", "unload", "shortening"), "unloading"),
        **dict.fromkeys(("verkürzen", "verkürzung", "entlasten", "entlastung"), "unloading"),
        "unknown": "",
    },
    "phase": {
        **dict.fromkeys(("filling", "inflating", "inflation"), "filling"),
        **dict.fromkeys(("venting", "deflating", "deflation"), "venting"),
        "unknown": "",
    },
}
_WORD_REMEDY = {
    "direction": "write loading (being stretched), unloading (shortening) or unknown, or leave the column out",
    "phase": "write filling, venting or unknown, or leave the column out",
}
_MEANING_REMEDY = "; or give its meaning, {0} or {1}: columns={{{text!r}: ...}} (command line: --column '{text}=...')"


def impossible_settings(initial_length: float | None, slack_force: float | None) -> list[Problem]:
    """Problems of an initial length in another unit than m, and of a negative slack force."""
    found = []
    if initial_length is not None and _LONGEST < initial_length < np.inf:
        text = f"{initial_length:g} m is longer than any muscle"
        found.append(Problem(text, field="initial_length", remedy=f"{_LENGTH_REMEDY}, in Python in m: 0.18"))
    if slack_force is not None and slack_force < 0:
        found.append(Problem(f"{slack_force:g} N is negative", field="slack_force", remedy=_SLACK_REMEDY))
    return found


class ColumnConverter:
    """Converts the cells of a file to SI columns; collects `problems`, `corrupt` rows and `suspect` values.

    `missing` are rows with values that the file itself marks as missing or invalid, and summaries of others: they are
    always left out.
    """

    def __init__(
        self,
        sheet: RawTable,
        mapping: Mapping[str, str],
        initial_length: float | None,
        needed: Sequence[str],
        decimal: str = "",
        *,
        displacement: str = "",
        zero_length: float | None = None,
        unread: Collection[str] = (),
    ) -> None:
        self.sheet = sheet
        self.displacement, self.zero_length = displacement, zero_length
        sheet.channels, several = with_units_beside(
            [without_units(channel, mapping.get(channel.name, "")) for channel in sheet.channels]
        )
        self.missing: list[Problem] = []
        self.mapping = mapping
        mapping = {header: name for header, name in mapping.items() if all(name not in one for one in WORDS.values())}
        self.initial_length = initial_length
        self.force_sign = 1
        layout = find_columns(sheet, mapping, needed, unread)
        self.places = layout.places
        self.ignored = layout.ignored
        self.problems = layout.problems + sheet.problems
        self.corrupt = list(sheet.corrupt)
        self.suspect = sheet.suspect + layout.suspect + several
        read = [sheet.channels[index] for index, _ in self.places.values()]
        if len({len(channel.cells) for channel in read}) > 1:  # then there are no rows
            self.places, read = {}, []
        self.lines: Sequence[int] = read[0].lines if read else []
        numeric = [sheet.channels[index] for index, column in self.places.values() if column.quantity not in WORDS]
        self.suspect += [f"{channel.name}: {note}" for channel in numeric for note in channel.notes]
        others = [channel for channel in sheet.channels if all(channel is not one for one in read)]
        self.suspect += [
            f"{sheet.channels[index].name!r} is read as {name}, and has the name of a column of states"
            for name, (index, column) in self.places.items()
            if column.unit and is_status(sheet.channels[index].label)
        ]
        not_read = [one for one in others if len(one.cells) == len(self.lines)]
        invalid, states = invalid_rows(not_read, sheet.unit)
        self.suspect += [*states, *several_specimens(not_read), *drifting_temperatures(not_read)]
        self.summaries = labelled_summaries(numeric)
        self.missing += [sheet.kind(mark, line=line) for line, mark in (invalid | self.summaries).items()]
        # with a unit: dates determine no decimal sign
        measured = [one for one in others if one.unit or name_and_unit(one.label[:LONGEST_NAME])[1] is not None]
        self.decimal, question = decimal_sign(numeric, measured, sheet.delimiter, decimal)
        if question is not None:
            self.problems.append(sheet.kind(question.message, question.line, question.field, question.remedy))
        elif (alone := decimal_sign(numeric, (), sheet.delimiter, decimal)[1]) is not None:
            both = alone.message.partition(";")[0]
            self.suspect.append(f"{alone.field}: {both}, and only a column that is not read decides; {alone.remedy}")

    @property
    def units(self) -> dict[str, str]:
        """Unit of each quantity that has one."""
        return {name: column.unit for name, (_, column) in self.places.items() if column.unit}

    def line_numbers(self) -> NDArray[np.int64]:
        """Line number of each row."""
        lines = self.lines
        return np.arange(lines.start, lines.stop) if isinstance(lines, range) else np.asarray(lines, np.int64)

    def attributes(self, path: Path, specimen: str, slack_force: float | None) -> dict[str, Any]:
        """Attributes from the comments; arguments take precedence."""
        comments = self.sheet.comments
        found: dict[str, float] = {}
        for key, unit in (("initial_length", "m"), ("slack_force", "N")):
            line, text = comments.get(key, (0, ""))
            try:
                found |= {key: quantity(text, unit)} if text else {}
            except UnitError as error:
                self._problem(str(error), line, key)
        given, stated = self.initial_length, found.get("initial_length")
        self.initial_length = stated if given is None else given
        if given is not None and stated is not None and abs(given - stated) > _LENGTH_ROUNDING[0]:
            text = f"initial_length: {given / mm:.5g} mm is given, but the file states {stated / mm:.5g} mm"
            self.suspect.append(f"{text}, which is not used")
        self.problems += impossible_settings(given, slack_force)
        return {
            "specimen": specimen or unquote(comments.get("specimen", (0, ""))[1]),
            "source": unquote(comments["source"][1]) if "source" in comments else path.name,
            "slack_force": found.get("slack_force", 0.0) if slack_force is None else slack_force,
        }

    def columns(self, force_sign: int, largest_force: float | None = None) -> dict[str, np.ndarray]:
        """Columns in SI units, lengths converted to contractions, and categorical columns."""
        data = {name: self._numbers(name) for name in self.places if name not in WORDS}
        self.measured = {name: data[name] for name in ("length", "displacement") if name in data}
        moved = data.pop("displacement", None)
        if moved is None and (self.displacement or self.zero_length is not None):
            self.suspect.append(_NO_DISPLACEMENT)
        if moved is not None and (length := self._length(moved)) is not None:
            self._compare_lengths(length, data.setdefault("length", length))
        if "force" in data:
            data["force"] *= force_sign
            self.force_sign = force_sign
            for row in np.flatnonzero(data["force"] >= (np.inf if largest_force is None else largest_force)).tolist():
                text = f"{data['force'][row]:.4g} N is at the end of the sensor's range"
                self.missing.append(self.sheet.kind(text, line=self.lines[row], field="force"))
        if (length := data.pop("length", None)) is not None:
            if "contraction" in data:
                self._compare(data["contraction"], length)
            else:
                data["contraction"] = self._contraction(length)
        return data | {name: self._words(name) for name in self.places if name in WORDS}

    def settle(
        self, path: Path, data: dict[str, np.ndarray], on_corrupt: OnCorrupt
    ) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """Valid rows, and attributes that list the corrupt ones; raises a `DatasetError` with all problems."""
        self.corrupt = [one for one in self.corrupt if one.line not in self.summaries]
        self._leave_out_summaries(data)
        self._exchanged(data)
        omitted = self.corrupt + self.missing
        bad = {problem.line for problem in omitted}
        lines = self.line_numbers()
        kept = ~np.isin(lines, [line for line in bad if line is not None])
        rows = len(lines) + len(bad - {None, *lines.tolist()}) if bad else len(lines)
        left_out = rows - int(kept.sum())
        refused = self.corrupt and on_corrupt == "raise"
        if omitted and not refused and not self.problems and 2 * left_out > rows:
            text = f"{left_out} of {rows} rows are not numeric: more than half cannot be left out"
            self.problems.append(Problem(text))
        if self.problems or refused:
            remedy = "" if 2 * left_out > rows else f"correct it{LEAVE_OUT}"  # more than half are a misread file
            corrupt = [replace(one, remedy=one.remedy or remedy) for one in self.corrupt]
            found = self._sorted(self.problems + corrupt)
            more = [Problem(f"and {len(found) - _LISTED} more problems")] if len(found) > _LISTED else []
            raise DatasetError(str(path), found[:_LISTED] + more)
        for text in self.suspect:
            warnings.warn(f"{path}: {text}", McKibbenWarning, stacklevel=user_level())
        attrs = {"ignored_columns": printable(", ".join(self.ignored))} if self.ignored else {}
        ours = written_by_us(self.sheet.names, self.sheet.comments)
        if not ours:
            attrs["columns_read"] = self._columns_read(data, kept)
        for name in ("preprocessing", "repairs") if ours else ():  # of the file from which this one was made
            if (text := self.sheet.comments.get(name, (0, "none"))[1]) != "none":
                attrs[name] = unquote(text)
        if omitted:
            found = self._sorted(omitted)
            attrs["repairs"] = "\n".join([*filter(None, [attrs.get("repairs")]), *map(str, found)])
            first = "; ".join(map(str, found[:_WARNED]))
            more = f" ... and {len(found) - _WARNED} more, all in the attribute repairs" if len(found) > _WARNED else ""
            text = f"{path}: {left_out} of {rows} rows are left out: {first}{more}"
            warnings.warn(text, McKibbenWarning, stacklevel=user_level())
            data, self.lines = {name: values[kept] for name, values in data.items()}, lines[kept].tolist()
        return data, attrs

    def _leave_out_summaries(self, data: Mapping[str, np.ndarray]) -> None:
        """Count rows that are a statistic of others as missing, or report them in a file that was written by us."""
        lines = self.line_numbers()
        bad = [problem.line for problem in self.corrupt + self.missing if problem.line is not None]
        kept = ~np.isin(lines, bad)
        values = {**data, **self.measured}
        read = {name: column.unit for name, (_, column) in self.places.items() if name in _MEASURED and name in values}
        if self.problems or not read or kept.sum() > MOST_POINTS:
            return
        columns = {name: (values[name][kept], factor(unit)) for name, unit in read.items()}
        integers = "contains only integers, unlike the others: "
        found = [
            (row, certain, integers + ("numbers of channels, or full scales" if certain else "is it a measurement?"))
            for row, certain in integer_rows(columns)
        ]
        found += [(row, True, f"is {what}: a summary is not a measurement") for row, what in summaries(columns).items()]
        ours = written_by_us(self.sheet.names, self.sheet.comments)
        for row, certain, what in found:
            line = int(lines[kept][row])
            if certain and not ours:
                self.missing.append(self.sheet.kind(what, line=line))
            else:
                self.suspect.append(f"{self.sheet.unit} {line} {what}")

    def _exchanged(self, data: Mapping[str, np.ndarray]) -> None:
        """Ask, in place of all other problems, if impossible columns are those of a muscle in another order only."""
        third, initial = next(iter([*self.measured, "contraction"])), self.initial_length or 0.0
        names = "pressure", third, "force"
        if not {*names} <= {*data, *self.measured} or not (initial or third == "contraction"):
            return
        moved = third == "displacement"
        if moved and not (self.displacement and self.zero_length):
            return
        zero, side = (self.zero_length or 0.0) * moved, -1 if moved and self.displacement == "shortening" else 1
        units = [self.places[name][1].unit for name in names]
        values = data["pressure"], {**data, **self.measured}[third], self.force_sign * data["force"]
        every = max(1, len(self.lines) // _COMPARED)
        numbers = [one[::every] / factor(unit) for one, unit in zip(values, units, strict=True)]

        def conversion(name: str, unit: str) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
            scale = factor(unit) * (self.force_sign if name == "force" else 1)
            return lambda x: 1 - (zero + side * x * scale) / initial if name in self.measured else x * scale

        to_si = [
            [conversion(name, unit) for unit in dict.fromkeys((own, *ACCEPTED[name]))]
            for name, own in zip(names, units, strict=True)
        ]
        if (order := exchanged(numbers, to_si)) is None:
            return
        apart = [(self._field(names[at]), place) for place, at in enumerate(order) if at != place]
        meant = {column: f"{names[place]}_{units[place]}" for column, place in apart}
        looks = ", ".join(f"{column!r} looks like a {names[place]}" for column, place in apart)
        options = " ".join(f"--column '{column}={name}'" for column, name in meant.items())
        text = f"columns may be exchanged: by their numbers, {looks}"
        remedy = f"correct the header, or give columns={meant} (command line: {options})"
        self.problems = [self.sheet.kind(text, line=self.sheet.header_line, remedy=remedy)]

    def _columns_read(self, data: Mapping[str, np.ndarray], kept: NDArray[np.bool_]) -> str:
        """Table of the columns read: quantity, unit, its origin, range in this unit, remark; rows, implied diameter."""
        rows = [("column", "quantity", "unit", "unit from", "range", "")]
        shown_rows = slice(None) if kept.all() else kept  # a slice copies nothing
        for name, (index, column) in self.places.items():
            channel = self.sheet.channels[index]
            values = data.get(name, self.measured.get(name))
            shown = remark = ""
            if values is not None and name not in WORDS:
                shown = format_range(values[shown_rows] / (factor(column.unit) if column.unit else 1.0))
            if name == "force" and self.force_sign < 0:
                remark = "sign reversed"
            if name in self.measured and self.initial_length:
                remark = f"initial length {self.initial_length / mm:.5g} mm"
            if name == "displacement" and self.zero_length:
                remark += f", {self.displacement} is positive, 0 at {self.zero_length / mm:.5g} mm"
            origin = "columns" if channel.name in self.mapping else "header"
            if origin == "header" and parse_header(channel.label) is None:
                origin = "file"
            rows.append((printable(channel.name), name, column.unit, origin if column.unit else "", shown, remark))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        last = f"{int(kept.sum())} rows"
        with np.errstate(over="ignore"):
            diameter = (
                implied_diameter(*(data[key][shown_rows] for key in ("pressure", "force"))) if kept.any() else None
            )
        if diameter is not None and np.isfinite(diameter):
            last += f"; the largest force is that of a muscle of about {diameter / mm:.2g} mm diameter"
        return printable("\n".join([*lines, last]))

    def _sorted(self, problems: list[Problem]) -> list[Problem]:
        """Problems in the order of lines and columns."""
        places = {name: place for place, name in enumerate(self.sheet.names)}
        return sorted(problems, key=lambda problem: (problem.line or 0, places.get(problem.field, len(places))))

    def _problem(self, message: str, line: int | None, name: str, remedy: str = "") -> None:
        """Add a problem of a quantity's column or of an attribute."""
        self.problems.append(self.sheet.kind(message, line=line, field=self._field(name), remedy=remedy))

    def _field(self, name: str) -> str:
        return self.sheet.channels[self.places[name][0]].name if name in self.places else name

    def _words(self, name: str) -> NDArray[np.str_]:
        """Directions or phases."""
        cells = [str(cell) for cell in self.sheet.channels[self.places[name][0]].cells]
        given = {text.lower(): word for text, word in self.mapping.items() if word in WORDS[name]}
        meaning = {text: {**_MEANINGS[name], **given}.get(text.strip().lower()) for text in set(cells)}
        rows = [one for one in zip(self.lines, cells, strict=True) if one[0] not in self.summaries]
        first = {text: line for line, text in reversed(rows)}
        for line, text in rows:
            if meaning[text] is None:
                short = text.strip()[:40]
                remedy = _WORD_REMEDY[name] + (_MEANING_REMEDY.format(*WORDS[name], text=short) if short else "")
                message = f"{repr(short) if short else 'an empty cell'} is not a {name}"
                problem = self.sheet.kind(message, line=line, field=self._field(name), remedy=remedy)
                (self.corrupt if line == first[text] else self.missing).append(problem)  # one mistake per word
        return np.array([meaning[text] or "" for text in cells], dtype="<U9")

    def _numbers(self, name: str) -> NDArray[np.float64]:
        index, column = self.places[name]
        channel = self.sheet.channels[index]
        self.sheet.channels[index] = replace(channel, cells=())  # of a large file
        header = channel.name
        values, problems = read_numbers(
            channel.cells,
            self.lines,
            field=header,
            decimal=self.decimal,
            may_be_empty=name == "set_pressure",
            kind=self.sheet.kind,
        )
        for problem in problems:
            if problem.line is None:
                self.problems.append(problem)
            elif problem.line in channel.missing:
                self.missing.append(replace(problem, message="is marked as missing by the file"))
            else:
                self.corrupt.append(problem)
        values = values if channel.scale is None else values * channel.scale
        self._report_marks(channel.name, values)
        with np.errstate(over="ignore"):
            si = values * factor(column.unit) if column.unit else values
        unit = f" {column.unit}" if column.unit else ""
        self._refuse(name, values, np.isinf(si), f"{{:g}}{unit} is too large")
        if column.quantity.endswith("pressure"):
            vacuum = f"a vacuum ({VACUUM / factor(column.unit):.5g}{unit}, gauge)"
            self._refuse(name, values, si < VACUUM, f"{{:g}}{unit} is below {vacuum}")
            if column.unit == "Pa" and 0 < np.nanmax(np.abs(si), initial=0.0) <= 100:
                self.suspect.append(f"{header} never exceeds 100 Pa; if these are bar, name it {name}_bar")
        elif name == "contraction" and column.unit == "ratio":
            remedy = "this looks like percent: name the column contraction_percent"
            self._refuse(name, values, np.abs(si) >= 1, "{:g} is not between -1 and 1", remedy)
        elif name == "contraction":
            sign = {"percent": " %"}.get(column.unit, unit)
            self._refuse(name, values, np.abs(si) >= 1, f"{{:g}}{sign} is not between -100 and 100 %")
            if np.nanmax(np.abs(values), initial=0.0) <= 0.5 and len(np.unique(values)) > 3:
                meant = "if these are ratios, name it contraction_ratio"
                self.suspect.append(f"{header} never exceeds 0.5 %; {meant}")
        elif name == "length":
            self._refuse(name, values, si <= 0, f"{{:g}}{unit} is not above 0")
        elif name == "repeat":
            # beyond 2**53 a float cannot distinguish consecutive integers
            wrong = (si < 0) | (si != np.round(si)) | (si > 2**53)
            self._refuse(name, values, wrong & ~np.isnan(si), "{:g} is not an integer from 0 up")
        return si

    def _report_marks(self, header: str, values: NDArray[np.float64]) -> None:
        """Rows with a number such as -9999 that marks a missing value: corrupt if far from the others, else suspect."""
        marks, isolated = missing_marks(values)
        if isolated:
            self.corrupt += [
                self.sheet.kind(f"{values[row]:g} marks a missing value", line=self.lines[int(row)], field=header)
                for row in np.flatnonzero(marks)
            ]
        elif marks.any():
            count, first = int(marks.sum()), int(np.argmax(marks))
            times = f" in {count} rows" if count > 1 else ""
            text = f"{values[first]:g}{times}, first {self.sheet.unit} {self.lines[first]}, may mark a missing value"
            self.suspect.append(f"{header}: {text}")

    def _refuse(
        self, name: str, values: NDArray[np.float64], bad: NDArray[np.bool_], message: str, remedy: str = ""
    ) -> None:
        for row in np.flatnonzero(bad):
            self._problem(message.format(values[row]), self.lines[int(row)], name, remedy)

    def _compare_lengths(self, moved: NDArray[np.float64], length: NDArray[np.float64]) -> None:
        """Check lengths from displacements against a column of lengths."""
        apart = np.abs(moved - length)
        for row in np.flatnonzero(apart > np.maximum(_LENGTH_ROUNDING[0], _LENGTH_ROUNDING[1] * np.abs(length)))[:1]:
            text = f"gives the length {moved[row] / mm:.5g} mm, the column of lengths {length[row] / mm:.5g} mm"
            self._problem(text, self.lines[int(row)], "displacement", f"assign one of the two, or {_ZERO_REMEDY}")

    def _length(self, displacement: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Length at displacements [m]; None if the length at 0 is unknown."""
        direction = self.displacement or ("shortening" if self.places["displacement"][1].shortening else "")
        if not direction:
            self._problem("may be positive for a shorter or for a longer muscle", None, "displacement", _SIGN_REMEDY)
        self.zero_length = self.initial_length if self.zero_length is None else self.zero_length
        if self.zero_length is None:
            self._problem("is needed for displacements", None, "initial_length", _LENGTH_REMEDY)
            return None
        self.displacement = direction
        return self.zero_length + displacement * (1 if direction == "lengthening" else -1)

    def _contraction(self, length: NDArray[np.float64]) -> NDArray[np.float64]:
        initial = self.initial_length
        if initial is None or not (np.isfinite(initial) and initial > 0):
            what = "is needed for lengths" if initial is None else f"{initial:g} m is not a positive length"
            self._problem(what, None, "initial_length", _LENGTH_REMEDY)
            return length
        with np.errstate(over="ignore"):
            contraction = 1 - length / initial
        rows = np.flatnonzero((np.abs(contraction) >= 1) & ((length > 0) | ("displacement" in self.measured)))
        for row in rows if rows.size <= _ROWS else rows[:1]:  # more are one mistake of a unit or a setting
            times = f"{length[row]:g} m is {length[row] / initial:.3g} times the initial length, {initial:g} m"
            if rows.size > _ROWS:
                times += f"; the lengths of {rows.size - 1} more rows are impossible too"
            name = "displacement" if "displacement" in self.measured else "length"
            remedy = _ZERO_REMEDY if name == "displacement" else "check its unit and initial_length"
            self._problem(times, self.lines[int(row)], name, remedy)
        return contraction

    def _compare(self, contraction: NDArray[np.float64], length: NDArray[np.float64]) -> None:
        """Check contractions against lengths; infer the initial length if it is not given."""
        usable = np.isfinite(contraction) & np.isfinite(length) & (np.abs(contraction) < 1) & (length > 0)
        if not usable.any():
            return
        agreed = round(float(np.median(length[usable] / (1 - contraction[usable]))), 9)
        rounding, relative = _LENGTH_ROUNDING
        tolerance = max(rounding, relative * agreed)
        if self.initial_length is None:
            self.initial_length = agreed
        elif not abs(self.initial_length - agreed) <= tolerance:
            text = f"{self.initial_length:g} m is given, but lengths and contractions agree on {agreed:g} m"
            self._problem(text, None, "initial_length")
        expected = agreed * (1 - contraction)
        for row in np.flatnonzero(usable & (np.abs(length - expected) > tolerance)):
            given = f"{length[row]:g} m contradicts contraction {contraction[row]:g}"
            text = f"{given} of {agreed:g} m, which implies {expected[row]:.4g} m"
            self._problem(text, self.lines[int(row)], "length")
