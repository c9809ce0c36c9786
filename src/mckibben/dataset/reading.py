"""Readers of measurement files that report all errors of a file at once."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from mckibben.component.calls import checked_call, user_level
from mckibben.component.checks import check_number
from mckibben.dataset.arrangement import one_row_per_point
from mckibben.dataset.consistency import check_dataset
from mckibben.dataset.file_names import add_from_name, check_pattern
from mckibben.dataset.formats import read_table
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.plausibility import check_pressures
from mckibben.dataset.preprocessing import preprocess, with_notes, without_offset
from mckibben.dataset.quantities import ColumnConverter, Decimal, Displacement, OnCorrupt, impossible_settings
from mckibben.dataset.recording import Recording
from mckibben.dataset.schema import OF_FILE, FileLines, written_by_us
from mckibben.dataset.sheet import RawTable
from mckibben.errors import DatasetError, McKibbenWarning, Problem, RangeError, described
from mckibben.units import mm

if TYPE_CHECKING:
    import xarray as xr

_NEEDED = ("pressure", "contraction", "force")

FilePaths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""One file, or several files of one test in their order."""


@checked_call
def read_dataset(
    path: FilePaths,
    *,
    columns: Mapping[str, str] | None = None,
    initial_length: float | None = None,
    displacement: Displacement = "",
    zero_length: float | None = None,
    specimen: str = "",
    slack_force: float | None = None,
    largest_force: float | None = None,
    force_sign: int = 1,
    on_corrupt: OnCorrupt = "raise",
    decimal: Decimal = "",
    from_name: str = "",
) -> IsobaricDataset:
    """Read the points of isobaric tests from a file, or from several files of one test.

    A file named ``*.nc`` is NetCDF. Others are recognised by their first bytes: Excel (.xlsx), MATLAB (.mat), TDMS,
    HDF5, and text with a header and one row per point, delimited by comma, semicolon, tab or white space. Leading lines
    of a text may be comments; ``# key: value`` is read for `specimen`, `source`, `initial_length` and `slack_force`
    (both with a unit). Decimal commas are read unless the delimiter is a comma.

    Required are ``pressure_*`` (bar, kPa, MPa, Pa, mbar or psi; gauge), ``force_*`` (N or kN) and ``contraction_*``
    (percent or ratio), ``length_*`` (mm, m or cm) or ``displacement_*`` (the same). Read where present: ``direction``
    (loading, unloading or a synonym; 1 and -1 are refused, as their meaning differs), ``phase``, ``repeat``, ``time_*``
    (s, ms or min) and ``set_pressure_*``, which may have empty cells. ``Pressure [bar]``, ``p / kPa`` etc. are
    equivalent, as are units in a row under the header or in the properties of a channel. Other columns are listed in
    the attribute ``ignored_columns``.

    If the file does not give them, pressure levels are estimated from gaps between the pressures, directions and
    repeats from reversals of the contraction in row order, and the force of the slack muscle from its noise; the
    attribute ``preprocessing`` lists the estimates.

    Parameters
    ----------
    path
        File, or a list of files in the order of the test. Their rows are joined before pressure levels, directions and
        offset are estimated; no stroke extends across two files, and repeats are numbered on.
    columns
        Header of the file to one of the names above: ``{"Druck [bar]": "pressure_bar"}``. In files with
        groups or structs: ``group/channel``, ``struct.field``, ``matrix(:,2)``, ``sheet/header``.
    initial_length
        Length of the deflated muscle [m]: required if the file has lengths but no contractions, inferred if it has
        both.
    displacement, zero_length
        Direction of positive displacements, "shortening" or "lengthening", required if the file has displacements in
        place of lengths; and the length [m] at displacement 0, by default `initial_length`.
    specimen, slack_force
        Type of the muscle, and force [N] up to which it counts as slack. Default: from the file, or from the noise of
        the slack muscle, whose mean force is subtracted.
    largest_force
        Force [N] from which on rows are left out, as the sensor is saturated there.
    force_sign
        -1 for a load cell that reads a pull as negative.
    on_corrupt
        "raise": a truncated row, or a cell without a number, is an error. "report": such rows are left out with a
        warning, and the attribute ``repairs`` lists them.
    decimal
        Decimal sign of texts, "." or ",". Default: of the first number that determines it; if there is none, a number
        such as 1.234 is an error, which gives both readings.
    from_name
        Pattern of the files' names, with a name above in braces for each number: ``"L{length_mm}mm"`` reads a length of
        190 mm from ``Muscle_L190mm.csv``, for all rows of that file.

    Raises
    ------
    DatasetError
        With every problem of the file, its line and column; also if more than half of the rows are corrupt, or the
        points are impossible for a muscle: negative forces, or a wrong unit or initial length.
    RangeError
        If an argument is not a number in SI units, or none of the words and signs above.

    Warns
    -----
    McKibbenWarning
        If forces, pressures or contractions are unusual for a muscle or contradict each other, or rows are left out.
    """
    asked = _Options.checked(**locals())
    read = [_read_points(one, asked) for one in _paths(path)]
    parts, ours, slack_known = zip(*read, strict=True)
    dataset, source = _joined(parts, path, slack_known)
    if all(ours):
        if len(parts) > 1 and slack_force is None and not dataset.table.attrs["slack_force"]:
            table, notes = without_offset(dataset.table)  # one length may not show it
            dataset = replace(dataset, table=with_notes(table, notes))
        return check_dataset(dataset, source, only_warn=True)
    files, measured = np.repeat(np.arange(len(parts)), list(map(len, parts))), dataset.force
    del read, parts  # as large as the result
    dataset = replace(dataset, table=preprocess(dataset.table, slack_known=all(slack_known), files=files))
    return check_dataset(dataset, source, measured=measured)


Kind = TypeVar("Kind", IsobaricDataset, Recording)


@dataclass(frozen=True, kw_only=True)
class _Options:
    """Arguments of both readers."""

    columns: dict[str, str]
    initial_length: float | None
    displacement: str
    zero_length: float | None
    specimen: str
    slack_force: float | None
    largest_force: float | None
    force_sign: int
    on_corrupt: OnCorrupt
    decimal: str
    from_name: str
    contraction: float | None = None
    sample_rate: float | None = None

    @classmethod
    def checked(cls, path: FilePaths, columns: Mapping[str, str] | None, **given: Any) -> Self:
        """The arguments of a reader; raises a `RangeError` for impossible ones."""
        asked = cls(columns=_mapping(columns), **given)
        numbers = ("initial_length", "zero_length", "slack_force", "largest_force", "contraction", "sample_rate")
        words = asked.force_sign, asked.decimal, asked.displacement, asked.on_corrupt
        check_reading(*words, **{name: getattr(asked, name) for name in numbers})
        check_pattern(asked.from_name)
        return asked

    def table(self, path: Path) -> RawTable:
        return add_from_name(read_table(path, self.columns, self.decimal), path, self.from_name)

    def converter(self, table: RawTable, needed: Sequence[str], unread: Sequence[str] = ()) -> ColumnConverter:
        given = {"displacement": self.displacement, "zero_length": self.zero_length}
        return ColumnConverter(table, self.columns, self.initial_length, needed, self.decimal, unread=unread, **given)

    def netcdf(self, kind: type[Kind], path: Path) -> Kind:
        """Dataset or recording of a NetCDF file, with the given sign and attributes."""
        if self.columns or self.from_name:
            problem = Problem("columns cannot be renamed in NetCDF", remedy="leave columns and from_name out")
            raise DatasetError(str(path), [problem])
        if problems := impossible_settings(self.initial_length, self.slack_force):
            raise DatasetError(str(path), problems)
        found = kind.from_netcdf(path)
        given = {name: getattr(self, name) for name in ("initial_length", "specimen", "slack_force")}
        changes = {name: value for name, value in given.items() if value not in (None, "")}
        if self.force_sign < 0:
            found = kind(found.table.assign(force=-found.table["force"]))
        if self.largest_force is not None:
            below = (found.table["force"] < self.largest_force).to_numpy()
            found = kind(found.table.isel({found.table["force"].dims[0]: below}))
        return kind(found.table.assign_attrs(changes)) if changes else found


def _read_points(path: Path, asked: _Options) -> tuple[IsobaricDataset, bool, bool]:
    """Points of a file as they are; whether this program wrote it, and whether its slack force is known."""
    if path.suffix.lower() == ".nc":
        return asked.netcdf(IsobaricDataset, path), True, True
    file = asked.converter(one_row_per_point(asked.table(path), asked.columns), _NEEDED)
    attrs = file.attributes(path, asked.specimen, asked.slack_force)
    data, found = file.settle(path, file.columns(asked.force_sign, asked.largest_force), asked.on_corrupt)
    dataset = _made(IsobaricDataset, path, data, {"initial_length": file.initial_length, **attrs}, found, file.units)
    dataset = replace(dataset, lines=(FileLines(file.sheet.unit, file.lines, file.units),))
    slack_known = asked.slack_force is not None or "slack_force" in file.sheet.comments
    return dataset, written_by_us(file.sheet.names, file.sheet.comments), slack_known


def _mapping(columns: Mapping[str, str] | None) -> dict[str, str]:
    """Names by header; raises a `RangeError` for anything but a mapping."""
    if columns is not None and not isinstance(columns, Mapping):
        remedy = "give names by header, such as {'Druck [bar]': 'pressure_bar'}"
        raise RangeError(f"columns is {columns!r:.60}", field="columns", value=columns, remedy=remedy)
    return {str(header).strip(): str(name) for header, name in (columns or {}).items()}


def _paths(path: FilePaths) -> list[Path]:
    """The files of a test."""
    several = [path] if isinstance(path, str | os.PathLike) else path
    if (
        not isinstance(several, Sequence)
        or not several
        or not all(isinstance(one, str | os.PathLike) for one in several)
    ):
        raise RangeError(
            f"{described(path)} is not a file", field="path", value=path, remedy="give a path, or a list of paths"
        )
    return [Path(one) for one in several]


def _made(
    kind: type[Kind],
    path: Path,
    data: Mapping[str, Any],
    attrs: Mapping[str, Any],
    found: Mapping[str, str],
    units: Mapping[str, str],
) -> Kind:
    """Dataset or recording from the columns of a file; an argument error names the file and the unit of its column."""
    try:
        made = kind.of(**data, **attrs)
    except DatasetError as error:
        problems = [
            problem
            for one in error.problems
            for problem, _ in (
                check_pressures(float(one.value), units["pressure"])
                if one.field == "pressure" and isinstance(one.value, float)
                else [(one, True)]
            )
        ]
        raise DatasetError(str(path), problems) from None
    return kind(made.table.assign_attrs(found)) if found else made


def _joined(parts: Sequence[Kind], path: FilePaths, slack_known: Sequence[bool]) -> tuple[Kind, str]:
    """Points or samples of several files as one dataset or recording, and its name for messages."""
    names = [str(one) for one in _paths(path)]
    if len(parts) == 1:
        return parts[0], names[0]
    source = f"{names[0]} and {len(names) - 1} more"
    tables = [part.table for part in parts]
    attrs = dict(tables[0].attrs)
    for name in ("specimen", "initial_length"):
        if len(values := list(dict.fromkeys(table.attrs.get(name) for table in tables))) > 1:
            shown = " and ".join(_shown(value) for value in values)
            remedy = _DIFFERENT_REMEDY[name]
            raise DatasetError(source, [Problem(f"differs between the files: {shown}", field=name, remedy=remedy)])
    if any(slack_known) and not all(slack_known):  # an offset was subtracted from some of the forces only
        known = ", ".join(one for one, yes in zip(names, slack_known, strict=True) if yes)
        text = f"is known for {known} only, and forces of the other files may have an offset"
        raise DatasetError(source, [Problem(text, field="slack_force", remedy=_SLACK_REMEDY)])
    attrs["source"] = ", ".join(dict.fromkeys(str(table.attrs["source"]) for table in tables))
    attrs["slack_force"] = max(table.attrs["slack_force"] for table in tables)
    for name in (*OF_FILE, "preprocessing"):
        texts = {one: table.attrs[name] for one, table in zip(names, tables, strict=True) if name in table.attrs}
        attrs |= {name: "\n".join(f"{one}:\n{text}" for one, text in texts.items())} if texts else {}
    columns = [name for name, variable in parts[0].schema.items() if len(variable.dims) == 1]
    kept = [name for name in columns if all(name in table for table in tables)]
    if lost := sorted({name for name in columns for table in tables if name in table} - {*kept}):
        warnings.warn(
            f"{source}: not all files have {', '.join(lost)}: left out", McKibbenWarning, stacklevel=user_level()
        )
    tables = [table[kept] for table in tables]
    if "repeat" in kept:
        tables = _distinct_repeats(tables)
    if "time" in kept:
        tables = _one_after_another(tables, apart=isinstance(parts[0], Recording))
    import xarray as xr

    joined = xr.concat(tables, next(iter(parts[0].schema.values())).dims[0])
    read = [part.lines or (FileLines("row", range(1, len(part) + 1), {}),) for part in parts]
    lines = (one._replace(file=name) for name, (one,) in zip(names, read, strict=True))
    return type(parts[0])(joined.assign_attrs(attrs), tuple(lines)), source


_DIFFERENT_REMEDY = {
    "specimen": "give specimen (command line: a recipe with the line `specimen: NAME`), or read files of one specimen",
    "initial_length": "give initial_length (command line: --initial-length '180 mm')",
}
_SLACK_REMEDY = "give slack_force (command line: --slack-force '1 N'), which then applies to all files as they are"
_PAUSE = 20  # intervals between two files


def _shown(value: object) -> str:
    return f"{value / mm:g} mm" if isinstance(value, float) else str(value or "unknown")


def _distinct_repeats(tables: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """Tables whose repeats go on from file to file, since no stroke extends across two."""
    found, first = [], 0
    for table in tables:
        found.append(table.assign(repeat=table["repeat"] + first))
        first = max(first, int(found[-1]["repeat"].max()) + 1) if table["repeat"].size else first
    return found


def _one_after_another(tables: Sequence[xr.Dataset], *, apart: bool) -> list[xr.Dataset]:
    """Tables whose clocks go on: the time of one that starts again is moved behind the one before.

    With `apart`, a file that follows without a pause is moved too, so that no plateau extends across two.
    """
    steps = [np.diff(table["time"].to_numpy()) for table in tables]
    pause = _PAUSE * max((float(np.median(one[one > 0])) for one in steps if (one > 0).any()), default=1 / _PAUSE)
    found: list[xr.Dataset] = []
    for table in tables:
        time = table["time"].to_numpy()
        before = found[-1]["time"].to_numpy() if found else time[:0]
        if len(before) and len(time) and (time[0] <= before[-1] or (apart and time[0] < before[-1] + pause)):
            table = table.assign(time=table["time"] - time[0] + before[-1] + pause)
        found.append(table)
    return found


def check_reading(
    force_sign: int, decimal: str, displacement: str, on_corrupt: str = "raise", **numbers: object
) -> None:
    """Raise `RangeError` for texts or arrays in place of numbers, and for an invalid sign, direction or word."""
    if displacement not in ("", "shortening", "lengthening"):
        remedy = "give 'shortening' or 'lengthening', the direction of positive displacements"
        raise RangeError(f"displacement is {displacement!r}", field="displacement", value=displacement, remedy=remedy)
    if decimal not in ("", ".", ","):
        remedy = "give decimal='.' or decimal=',' (command line: --decimal)"
        raise RangeError(f"decimal is {decimal!r}", field="decimal", value=decimal, remedy=remedy)
    if on_corrupt not in ("raise", "report"):
        remedy = "give 'raise', or 'report' to leave corrupt rows out (command line: --skip-corrupt)"
        raise RangeError(f"on_corrupt is {on_corrupt!r:.60}", field="on_corrupt", value=on_corrupt, remedy=remedy)
    check_number("reading", **numbers)
    for name, value in numbers.items():
        if np.ndim(value):  # type: ignore[arg-type]
            raise RangeError(f"{name} is {value!r:.60}", field=name, value=value, remedy="give one number")
    if force_sign not in (1, -1):
        remedy = "give 1, or force_sign=-1 (command line: --force-sign -1) for pulls that are read as negative"
        raise RangeError(f"force_sign is {force_sign!r}", field="force_sign", value=force_sign, remedy=remedy)


_KEPT = ("time", "pressure", "force", "contraction", "set_pressure")
_OWN_CONTRACTION = "contraction is given, but the file has its own"
_RATE_REMEDY = "give sample_rate (command line: --sample-rate '1000 Hz'), or a column time_s, time_ms or time_min"


@checked_call
def read_recording(
    path: FilePaths,
    *,
    columns: Mapping[str, str] | None = None,
    initial_length: float | None = None,
    displacement: Displacement = "",
    zero_length: float | None = None,
    contraction: float | None = None,
    sample_rate: float | None = None,
    specimen: str = "",
    slack_force: float | None = None,
    largest_force: float | None = None,
    force_sign: int = 1,
    on_corrupt: OnCorrupt = "raise",
    decimal: Decimal = "",
    from_name: str = "",
) -> Recording:
    """Read a raw recording from a file of any format of `read_dataset`, with its columns and arguments.

    Of several files, the samples are joined: no plateau extends across two of them, since a file whose clock goes on is
    moved by a pause of 20 sampling intervals. Required are pressure and force.
    The time is a column, or follows from `sample_rate` or the waveforms of a TDMS file. A length or displacement is
    converted to a contraction. A file named ``*.nc`` was written by `Recording.to_netcdf`.

    Parameters
    ----------
    contraction
        Contraction of the test [-], if the file has neither contractions nor lengths.
    sample_rate
        Sample rate [Hz] of a file without times.
    on_corrupt, decimal, from_name
        As for `read_dataset`. Omitted samples leave a gap in time.

    Raises
    ------
    DatasetError, RangeError
        As `read_dataset`, with the same warnings.
    """
    asked = _Options.checked(**locals())
    parts = [_read_samples(one, asked) for one in _paths(path)]
    return _joined(parts, path, [bool(part.table.attrs["slack_force"]) for part in parts])[0]


def _read_samples(path: Path, asked: _Options) -> Recording:
    """Recording of one file."""
    contraction, sample_rate = asked.contraction, asked.sample_rate
    if path.suffix.lower() == ".nc":
        found = asked.netcdf(Recording, path)
        if contraction is None:
            return found
        if "contraction" in found.table:
            raise DatasetError(str(path), [Problem(_OWN_CONTRACTION, remedy="leave contraction out")])
        return Recording(found.table.assign(contraction=("sample", np.full(len(found), contraction))))
    sheet = asked.table(path)
    file = asked.converter(sheet, ("pressure", "force"), () if contraction is None else ("displacement",))
    attrs = file.attributes(path, asked.specimen, asked.slack_force)
    data = {
        name: values for name, values in file.columns(asked.force_sign, asked.largest_force).items() if name in _KEPT
    }
    file.ignored += [
        sheet.channels[file.places[name][0]].name
        for name in file.places
        if name not in (*_KEPT, "length", "displacement")
    ]
    if "time" not in data and "pressure" in data:
        step = sheet.interval if sample_rate is None else 1 / sample_rate if sample_rate > 0 else None
        if step is None or not np.isfinite(step):
            file.problems.append(Problem("no column for time, and no sample rate", remedy=_RATE_REMEDY))
        else:
            # by row number: omitted rows keep their time
            rows = file.line_numbers().astype(np.float64)
            data["time"] = (rows - (rows[0] if len(rows) else 0)) * step
    elif sample_rate is not None and "time" in data:
        file.problems.append(Problem("sample_rate is given, but the file has times", remedy="leave sample_rate out"))
    if contraction is not None and "contraction" in data:
        file.problems.append(Problem(_OWN_CONTRACTION, remedy="leave contraction out"))
    data, found = file.settle(path, data, asked.on_corrupt)
    if contraction is not None:
        data["contraction"] = np.full(len(data["pressure"]), contraction)
    return _made(Recording, path, data, {"initial_length": file.initial_length, **attrs}, found, file.units)
