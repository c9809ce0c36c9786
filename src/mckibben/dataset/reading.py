"""Readers of measurement files: what is plain is read, anything else is one error that lists all questions."""

from __future__ import annotations

import os
import re
import warnings
import zipfile
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from mckibben.component.calls import user_level
from mckibben.dataset.at_joint import AT_LEVER
from mckibben.dataset.checks import questions_of
from mckibben.dataset.clocks import PAIRED, join_clocks, join_pairs
from mckibben.dataset.faults import offset_from, turned_absolute, without_faults
from mckibben.dataset.file_names import SeveralPartsError, add_from_name, numbers_in
from mckibben.dataset.formats import read_table
from mckibben.dataset.isobaric import IsobaricDataset
from mckibben.dataset.matrix import MATRIX
from mckibben.dataset.preprocessing import preprocess, restarts, sample_rate
from mckibben.dataset.raw import LIMIT_REMEDY, RawColumn, RawTable
from mckibben.dataset.recipe import Recipe
from mckibben.dataset.recording import Recording
from mckibben.dataset.schema import CSV_COLUMNS, OF_FILE, holds_own_table, load_validated
from mckibben.dataset.table import Table, open_problems, question, refusal
from mckibben.dataset.understanding import understand
from mckibben.dataset.vocabulary import OF_MUSCLES
from mckibben.errors import DatasetError, McKibbenWarning, Problem, RangeError, described
from mckibben.units import show

if TYPE_CHECKING:
    import xarray as xr

    from mckibben.dataset.at_joint import JointPaths
    from mckibben.muscle import Specimen

FilePaths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]
"""One file, or several files of one test in their order."""

_POINTS = ("pressure", "contraction", "force")
_SAMPLES = ("time", "pressure", "force", "contraction", "set_pressure")
_PAUSE = 20  # intervals between two files
_NAMED = re.compile(r"(HEADER(?:': '|=)-?)(?:force_(?:N|(UNIT))|pressure_bar)(_abs)?")  # in a remedy
_RATE = (
    "name the column of the time: columns={'HEADER': 'time_s'} (command line: --column 'HEADER=time_s'), or give "
    "sample_rate (command line: --read 'sample_rate=1000 Hz')"
)
Kind = TypeVar("Kind", IsobaricDataset, Recording)


def read_dataset(
    path: FilePaths, recipe: Recipe | None = None, *, geometry: JointPaths | None = None, **options: object
) -> IsobaricDataset:
    """Read the points of isobaric tests from a file, or from several files of one test.

    Formats are recognised by their first bytes: text (comma, semicolon, tab, ``|`` or blanks between cells), Excel,
    MATLAB, HDF5, NetCDF, TDMS and LabVIEW. Required are a pressure, a force, and a contraction or length, each with its
    unit: ``Druck [bar]``, ``Force (N)``, ``contraction_percent``; optional are direction, phase, repeat, time and set
    pressure. `mckibben.dataset.read_columns` shows what is understood of a file, without reading its points.

    If the file does not give them, pressure levels are estimated from gaps between the pressures, directions and
    repeats from reversals of the contraction, and the force of the slack muscle from its noise; the attribute
    ``preprocessing`` lists the estimates.

    Parameters
    ----------
    path
        File, or a list of files in the order of the test. No stroke extends across two, and repeats are numbered on.
    recipe
        Options of reading; or give them by name, see `Recipe`: ``columns``, ``initial_length``, ``ambient`` ...
    geometry
        Geometry of the `joint` of the recipe, at which torques of one muscle were measured: they become its forces, and
        angles its contractions.

    Raises
    ------
    DatasetError
        With everything in the file that is wrong or not plain; each problem has its line, column and the option that
        answers it.
    ScenarioError
        For options that do not exist or are out of their range.

    Notes
    -----
    The numbers are checked by what holds for any muscle: it pulls, the more the higher the pressure and the less the
    shorter it is. Points that break this, or that look like summaries, copies, saturation, absolute pressures or an
    offset of the load cell, are questions, which ``accept=[topic]`` answers.
    """
    files = _files(path, recipe, options)
    parts = [_read_points(file, geometry) for file in files]
    recipe = (recipe or Recipe()).with_options(options)
    dataset, source = _joined([part for part, _ in parts], files)
    own = all(written for _, written in parts)
    if own and len(parts) == 1:
        return dataset
    known = recipe.slack_force is not None or bool(dataset.table.attrs["slack_force"])
    files = np.repeat(np.arange(len(parts)), [len(part) for part, _ in parts])
    samples, faults = dataset.table, []
    sound = np.arange(len(files))
    if recorded := not own and bool(sample_rate(samples)):
        files += np.cumsum(restarts(samples))
        samples, sound, faults = without_faults(samples)
    if problems := open_problems(faults, recipe.accept):
        raise DatasetError(source, problems)
    table, rows = preprocess(samples, slack_known=known, files=files[sound])
    if len(sound) < len(files) and not {"direction", "phase"} & {*table}:
        text = f"of {len(files)} samples {len(sound)} are left, too few to find directions: no friction is identified"
        warnings.warn(f"{text}; record again, or give a column 'direction'", McKibbenWarning, stacklevel=user_level())
    dataset = replace(dataset, table=table, lines=tuple(_lines_of(dataset.lines, sound[rows])))
    if not own:
        check_points(dataset, source, recipe.accept)
    faults = ([*turned_absolute(dataset)] or [*offset_from(dataset)]) if recorded else []
    if problems := open_problems(faults, recipe.accept):
        raise DatasetError(source, problems)
    return dataset


def read_recording(
    path: FilePaths, recipe: Recipe | None = None, *, geometry: JointPaths | None = None, **options: object
) -> Recording:
    """Read a raw recording over time from a file of any format of `read_dataset`, with its options.

    Required are pressure and force. The time is a column (seconds, epochs, stamps of date and time), or follows from
    ``sample_rate`` or the waveforms of a TDMS file. A length or displacement is converted to a contraction. Of several
    files, the samples are joined; a file whose clock goes on is moved by a pause of 20 sampling intervals, so that no
    plateau extends across two.

    Raises
    ------
    DatasetError, ScenarioError
        As `read_dataset`.
    """
    files = _files(path, recipe, options)
    return _joined([_read_samples(file, geometry) for file in files], files)[0]


def read_torques(
    path: FilePaths, recipe: Recipe | None = None, *, geometry: JointPaths | None = None, **options: object
) -> Table:
    """Read torques of a joint at angles and pressures of both muscles, the columns of `mckibben.dataset.at_joint`.

    Parameters and errors as for `read_dataset`, of one file, or of two with clocks of their own.
    """
    files = _files(path, (recipe or Recipe()).with_options({"joint": "joint"} if geometry else {}), options)
    if len(files) > 1:
        raise RangeError("torques are read from one file", field="path", value=path, remedy="join the files")
    table = _understood(files[0], ("angle", "torque", "pressure1", "pressure2"), geometry)[0]
    table.ask(files[0].recipe.accept)
    return table


def read_signals(
    path: Path,
    needed: Sequence[str],
    recipe: Recipe | None = None,
    *,
    of_muscles: Sequence[Sequence[str]] = OF_MUSCLES,
) -> dict[str, np.ndarray]:
    """Columns of joints over time by quantity, in SI units; errors as of `read_dataset`.

    Each of the quantities `of_muscles` is there for all muscles, or for none. Those of named joints and muscles have
    the name after a point: ``angle.hip``, ``pressure.hip1``.
    """
    (file, *_) = _files(path, recipe, {"joint": "joint"})
    named = [name for names in (needed, *of_muscles) for name in names if "." in name]
    table = _understood(file, needed, None, named)[0]
    names = {name for group in of_muscles if {*group} & {*table.columns} for name in group}
    if missing := sorted(names - {*table.columns, *needed}):
        text = f"no column for {missing[0]}, which other muscles have"
        table.questions.append(question(text, field=missing[0]))
    table.ask(file.recipe.accept)
    return {name: column.values for name, column in table.columns.items()}


def read_columns(
    path: str | os.PathLike[str], recipe: Recipe | None = None, *, geometry: JointPaths | None = None, **options: object
) -> Table:
    """Show what is understood of a file: its columns, where quantity and unit are from, and open questions.

    Parameters as for `read_dataset`. Raises a `DatasetError` if the file cannot be read, but not for questions.
    """
    recipe = (recipe or Recipe()).with_options(options)
    first = {"part": recipe.part[:1], "loads": recipe.loads[:1]}
    return _understood(_files(path, recipe, first)[0], _POINTS, geometry)[0]


def _lines_of(parts: Sequence[Table], rows: np.ndarray) -> Iterator[Table]:
    """Tables of files with the lines of some of their rows, counted through all files."""
    for part in parts:
        yield replace(part, lines=part.lines[rows[(rows >= 0) & (rows < len(part.lines))]])
        rows = rows - len(part.lines)


def check_points(
    dataset: IsobaricDataset, source: str, accept: Sequence[str], specimen: Specimen | None = None
) -> None:
    """Check the points of a dataset by what holds for any muscle, or for one of the catalog.

    Parameters
    ----------
    source
        Name of the data in the error.
    accept
        Topics of questions that are answered with yes.
    specimen
        Muscle whose diameter the forces have to fit.

    Raises
    ------
    DatasetError
        With the questions that remain, each with the column of the file in its remedy.
    """
    lines = np.concatenate([part.lines for part in dataset.lines]) if dataset.lines else np.arange(1, len(dataset) + 1)
    if problems := open_problems(questions_of(dataset, lines, specimen), accept):
        raise DatasetError(source, [_with_header(problem, dataset) for problem in problems])


def _with_header(problem: Problem, dataset: IsobaricDataset) -> Problem:
    """Problem whose remedy names the column of the file and its unit, if they are known."""
    columns = dataset.lines[0].columns if dataset.lines else {}
    column = columns.get(problem.field)
    if problem.field == "force" and "torque" in columns:
        column = columns.get(AT_LEVER, columns["torque"])
        turned = "" if _NAMED.search(problem.remedy) else "turn the sign of the torque: --column 'HEADER=-force_N'; or "
        problem = replace(problem, field=f"force, by {column.header}", remedy=f"{turned}{problem.remedy}")
    if column is None or not column.unit or not problem.remedy:
        return problem
    known, unit = column.quantity, column.unit
    remedy = _NAMED.sub(lambda match: f"{match[1]}{known}_{match[2] or unit}{match[3] or ''}", problem.remedy)
    return replace(problem, remedy=remedy.replace("HEADER", column.header))


def _paths(path: FilePaths) -> list[Path]:
    """The files of a test."""
    several = [path] if isinstance(path, str | os.PathLike) else path
    if not (isinstance(several, Sequence) and several and all(isinstance(name, str | os.PathLike) for name in several)):
        remedy = "give a path, or a list of paths"
        raise RangeError(f"{described(path)} is not a file", field="path", value=path, remedy=remedy)
    return [Path(name) for name in several]


class _File(NamedTuple):
    """File of a test, or its part, with the name of it, its recipe, which has at most one load, and further columns."""

    path: Path
    name: Path
    recipe: Recipe
    others: Sequence[_File] = ()

    def raw(self) -> RawTable:
        """Columns as the file has them."""
        recipe = self.recipe
        return read_table(self.path, recipe.columns or {}, recipe.decimal or "", "".join(recipe.part))


def _files(path: FilePaths, recipe: Recipe | None, options: Mapping[str, object]) -> list[_File]:
    """Files of a test and their parts; with clocks, the first of them with the others."""
    recipe = (recipe or Recipe()).with_options(options)
    columns = {**dict(zip(MATRIX, recipe.matrix, strict=False)), **(recipe.columns or {})}
    recipe = recipe.with_options({"columns": columns}) if recipe.matrix else recipe
    files = []
    for file in _paths(path):
        parts = recipe.part or _parts_named(file, recipe)
        files += [_File(file, Path(f"{file}: {part}"), recipe.with_options({"part": [part]})) for part in parts]
        files += [] if parts else [_File(file, file, recipe)]
    if len(recipe.loads) not in (0, len(files)):
        text, remedy = f"{len(recipe.loads)} loads are given for {len(files)} files", "give one load for each file"
        raise refusal(files[0].path, text, remedy, "loads")
    if recipe.clocks and recipe.clocks != PAIRED:
        return [files[0]._replace(others=files[1:])]
    loads = [recipe.loads[at : at + 1] for at in range(len(files))]
    return [
        file._replace(recipe=file.recipe.with_options({"loads": load})) for file, load in zip(files, loads, strict=True)
    ]


def _parts_named(path: Path, recipe: Recipe) -> tuple[str, ...]:
    """Sheets of measurements of a workbook, if the recipe has a pattern that the names of all match."""
    if recipe.from_name and zipfile.is_zipfile(path):
        try:
            _File(path, path, recipe).raw()
        except SeveralPartsError as error:
            return error.names if all(numbers_in(name, recipe.from_name) for name in error.names) else ()
    return ()


def _understood(
    file: _File, needed: Sequence[str], geometry: JointPaths | None, named: Sequence[str] = ()
) -> tuple[Table, bool]:
    """Table of a file, joined with others over time, and whether this program wrote it."""
    raw, recipe = file.raw(), file.recipe
    needless: list[str] = []
    if recipe.clocks == PAIRED:
        raw, needless = join_pairs(file.path, raw, recipe.columns or {})
    for other in file.others:
        raw, further = join_clocks(other.name, raw, other.raw(), recipe.columns or {}, recipe.clocks or "")
        needless += further
    if needless:
        recipe = recipe.with_options({"columns": {**(recipe.columns or {}), **dict.fromkeys(needless, "ignore")}})
    if recipe.from_name:
        add_from_name(raw, file.name, recipe.from_name)
    for load in recipe.loads:
        raw.columns.append(RawColumn("loads", np.full(len(raw.lines), load), label="force_N"))
    own = {"specimen", "source", "slack_force", "preprocessing"} <= {*raw.comments}
    own &= {column.name for column in raw.columns} <= {*CSV_COLUMNS.values()}
    try:
        return understand(file.name, raw, recipe, needed, geometry, named), own
    except MemoryError:
        raise refusal(file.path, "needs more memory than there is", LIMIT_REMEDY) from None


def _made(kind: type[Kind], table: Table, values: Mapping[str, np.ndarray], *, own: bool = False) -> Kind:
    """Dataset or recording of the columns of a file; errors name it."""
    try:
        attrs = {name: getattr(table, name) for name in ("specimen", "source", "initial_length")}
        made = kind.of(**values, **attrs, slack_force=table.slack_force or 0.0)  # type: ignore[arg-type]
    except DatasetError as error:
        raise DatasetError(str(table.path), error.problems) from None
    attrs = {"columns_read": str(table), "ignored_columns": ", ".join(table.ignored)} if not own else {}
    attrs |= {"repairs": "\n".join(table.repairs)}
    attrs |= {"preprocessing": table.preprocessing} if own and table.preprocessing != "none" else {}
    attrs |= {"preprocessing": table.joined} if table.joined else {}
    attrs = {name: text for name, text in attrs.items() if text}
    return replace(kind(made.table.assign_attrs(attrs)), lines=(table,))


def _read_points(file: _File, geometry: JointPaths | None) -> tuple[IsobaricDataset, bool]:
    """Points of a file as they are, and whether this program wrote it."""
    if holds_own_table(file.path):
        dataset = _own(IsobaricDataset, file)
        return dataset, dataset.table.attrs.pop("samples", "") == ""
    table, own = _understood(file, _POINTS, geometry)
    if own:
        table.questions = [asked for asked in table.questions if asked.topic in ("", "corrupt")]
    table.ask(file.recipe.accept)
    names = [name for name in CSV_COLUMNS if name in table.columns]
    return _made(IsobaricDataset, table, {name: table.columns[name].values for name in names}, own=own), own


def _read_samples(file: _File, geometry: JointPaths | None) -> Recording:
    """Recording of one file."""
    recipe = file.recipe
    if holds_own_table(file.path):
        recording = _own(Recording, file)
        if recipe.contraction is None or "contraction" in recording.table:
            return recording
        return Recording(recording.table.assign(contraction=("sample", np.full(len(recording), recipe.contraction))))
    table, _ = _understood(file, ("pressure", "force"), geometry)
    values = {name: table.columns[name].values for name in _SAMPLES if name in table.columns}
    if "time" not in values:
        rate = recipe.sample_rate
        step = 1 / rate if rate else table.interval
        if step is None:
            near = f"; {table.clock!r} is not understood as a clock" if table.clock else ""
            missing = question(f"no column for the time, and no sample rate{near}", field="time", remedy=_RATE)
            table.questions.append(missing)
        values["time"] = (table.lines - (table.lines[0] if len(table.lines) else 0)) * (step or 1.0)
    elif recipe.sample_rate:
        text, remedy = "sample_rate is given, but the file has times", "leave sample_rate out"
        table.questions.append(question(text, field="sample_rate", remedy=remedy))
    table.ask(recipe.accept)
    return _made(Recording, table, values)


def _own(kind: type[Kind], file: _File) -> Kind:
    """Dataset or recording of a file that this program wrote, with the options that apply."""
    path, recipe, others = file.path, file.recipe, ("columns", "from_name", "largest_force")
    if any(getattr(recipe, name) is not None for name in others):
        raise refusal(path, "was written by this program: it is read as it is", f"leave out {', '.join(others)}")
    data = load_validated(path, lambda table: kind(_samples_as_points(table) if kind is IsobaricDataset else table))
    options = {name: getattr(recipe, name) for name in ("initial_length", "specimen", "slack_force")}
    changes = {name: value for name, value in options.items() if value not in (None, "")}
    return kind(data.table.assign_attrs(changes)) if changes else data


def _samples_as_points(table: xr.Dataset) -> xr.Dataset:
    """Table of a recording as that of points, marked by an attribute; any other table as it is."""
    is_recording = "sample" in table.dims
    return table.rename(sample="point").assign_attrs(samples="yes") if is_recording else table


def _joined(parts: Sequence[Kind], files: Sequence[_File]) -> tuple[Kind, str]:
    """Points or samples of several files as one dataset or recording, and its name for messages."""
    names = [str(file.name) for file in files]
    if len(parts) == 1:
        return parts[0], names[0]
    source, tables = f"{names[0]} and {len(names) - 1} more", [part.table for part in parts]
    columns = [*parts[0].schema]
    common = [name for name in columns if all(name in table for table in tables)]
    if problems := _differences(tables, columns, common):
        raise DatasetError(source, problems)
    attrs = _joined_attributes(names, tables)
    tables = [table[common] for table in tables]
    tables = _distinct_repeats(tables) if "repeat" in common else tables
    tables = _one_after_another(tables, apart=isinstance(parts[0], Recording)) if "time" in common else tables
    import xarray as xr

    joined = xr.concat(tables, next(iter(parts[0].schema.values())).dims[0])
    lines = [
        part.lines or (Table(Path(name), lines=np.arange(1, len(part) + 1), place="row"),)
        for name, part in zip(names, parts, strict=True)
    ]
    return type(parts[0])(joined.assign_attrs(attrs), sum(lines, ())), source


def _joined_attributes(names: Sequence[str], tables: Sequence[xr.Dataset]) -> dict[Hashable, Any]:
    """Attributes of the first table, with all sources, and what is said of each file."""
    attrs = dict(tables[0].attrs)
    attrs["source"] = ", ".join(dict.fromkeys(str(table.attrs["source"]) for table in tables))
    for name in (*OF_FILE, "preprocessing"):
        said = [(file, table.attrs[name]) for file, table in zip(names, tables, strict=True) if name in table.attrs]
        attrs |= {name: "\n".join(f"{file}:\n{text}" for file, text in said)} if said else {}
    return attrs


def _differences(tables: Sequence[xr.Dataset], columns: Sequence[str], common: Sequence[str]) -> list[Problem]:
    """Why tables are not those of one test."""
    problems = []
    for name, unit in (("specimen", ""), ("initial_length", "mm"), ("slack_force", "N")):
        if len(values := list(dict.fromkeys(table.attrs.get(name) for table in tables))) > 1:
            shown = " and ".join(show(value, unit) if isinstance(value, float) else str(value) for value in values)
            remedy = f"give {name} for all (in a recipe, or as an argument)"
            problems.append(Problem(f"differs between the files: {shown}", field=name, remedy=remedy))
    if lost := sorted({name for name in columns for table in tables if name in table} - {*common}):
        problems.append(Problem(f"not all files have {', '.join(lost)}", remedy="ignore these columns"))
    return problems


def _distinct_repeats(tables: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """Tables whose repeats go on from file to file, since no stroke extends across two."""
    numbered, first = [], 0
    for table in tables:
        numbered.append(table.assign(repeat=table["repeat"] + first))
        first = max(first, int(numbered[-1]["repeat"].max()) + 1) if table["repeat"].size else first
    return numbered


def _one_after_another(tables: Sequence[xr.Dataset], *, apart: bool) -> list[xr.Dataset]:
    """Tables whose clocks go on: the time of one that starts again is moved behind the one before.

    With `apart`, a file that follows without a pause is moved too, so that no plateau extends across two.
    """
    steps = [np.diff(table["time"].to_numpy()) for table in tables]
    pause = _PAUSE * max((float(np.median(step[step > 0])) for step in steps if (step > 0).any()), default=1 / _PAUSE)
    moved: list[xr.Dataset] = []
    for table in tables:
        time = table["time"].to_numpy()
        before = moved[-1]["time"].to_numpy() if moved else time[:0]
        if len(before) and len(time) and (time[0] <= before[-1] or (apart and time[0] < before[-1] + pause)):
            table = table.assign(time=table["time"] - time[0] + before[-1] + pause)
        moved.append(table)
    return moved
