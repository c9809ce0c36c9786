"""Recordings of a test: file format, reading, points and the dataset."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mckibben.errors import DatasetError, McKibbenWarning, Problem
from mckibben.rig.bench import Bench
from mckibben.rig.journal import HEADER, JournalReader

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recording

VERSION = 2

SAMPLES, EVENT = b"S", b"E"
"""Kinds of journal records after the header; their index is the number of rows before them."""


class Column(NamedTuple):
    """One quantity of a record.

    Attributes
    ----------
    name, unit
        Its name, and its SI unit; "V" for a reading.
    dtype
        NumPy type of its values, stored little-endian.
    """

    name: str
    unit: str
    dtype: str = "float64"

    @property
    def stored(self) -> np.dtype[Any]:
        """The type of the values in a file."""
        return np.dtype(self.dtype).newbyteorder("<")


def pack_rows(columns: Sequence[Column], arrays: Sequence[np.ndarray]) -> bytes:
    """Return the payload of samples: one column after the other.

    Parameters
    ----------
    columns, arrays
        Columns, and an array of shape (rows,) for each.

    Examples
    --------
    >>> columns = [Column("time", "s"), Column("pulses", "1", "int32")]
    >>> payload = pack_rows(columns, [np.array([0.0, 0.1]), np.array([1, 2])])
    >>> len(payload), unpack_rows(columns, payload)["pulses"].tolist()
    (24, [1, 2])
    """
    return b"".join(
        np.ascontiguousarray(array, column.stored).tobytes() for column, array in zip(columns, arrays, strict=True)
    )


def unpack_rows(columns: Sequence[Column], payload: bytes) -> dict[str, np.ndarray]:
    """The columns of a payload of samples, read-only."""
    row = sum(column.stored.itemsize for column in columns)
    count, at = len(payload) // row, 0
    found: dict[str, np.ndarray] = {}
    for column in columns:
        found[column.name] = np.frombuffer(payload, column.stored, count, at)
        at += count * column.stored.itemsize
    return found


def read_header(path: Path) -> tuple[dict[str, Any], list[Column]]:
    """Content of a segment's header and its columns; `DatasetError` if the file is not a record of this version."""
    content = JournalReader(path, DatasetError).checked_header()
    if content is None or "columns" not in content:
        raise DatasetError(str(path), [Problem("is not a rig record", remedy="give the folder of `rig run --out`")])
    if content["version"] != VERSION:
        message = f"is of version {content['version']}, and this mckibben reads version {VERSION}"
        raise DatasetError(str(path), [Problem(message, remedy="update mckibben")])
    return content, [Column(**column) for column in content["columns"]]


class Event(NamedTuple):
    """An event of a record.

    Attributes
    ----------
    kind, text
        Its kind, in a word, and its text.
    row
        Number of rows before it.
    data
        Its data, an object of JSON.
    """

    kind: str
    text: str
    row: int
    data: dict[str, Any]


class Rows(NamedTuple):
    """Rows of a record that were written together.

    Attributes
    ----------
    first
        Number of the first of them.
    columns
        Columns by name, shape (rows,).
    """

    first: int
    columns: dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class RigRecord:
    """A record in memory.

    Attributes
    ----------
    header
        Header of its first segment.
    units, columns
        Units and values by column, the values of shape (rows,).
    events
        Events in order.
    """

    header: dict[str, Any]  # of the first segment
    units: dict[str, str]
    columns: dict[str, np.ndarray]
    events: tuple[Event, ...]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def read_record(folder: str | os.PathLike[str]) -> RigRecord:
    """Read a record without an incomplete end.

    Parameters
    ----------
    folder
        Folder of `rig run --out`.

    Raises
    ------
    DatasetError
        If there is no record, or rows are missing that no damage explains; damaged parts are a warning.
    """
    header, columns = header_of(folder)
    rows: list[dict[str, np.ndarray]] = []
    events: list[Event] = []
    for one in entries(folder):
        if isinstance(one, Event):
            events.append(one)
        else:
            rows.append(one.columns)
    empty = {column.name: np.empty(0, column.dtype) for column in columns}
    found = {
        name: np.concatenate([nothing, *(part[name] for part in rows)]).astype(nothing.dtype, copy=False)
        for name, nothing in empty.items()
    }
    return RigRecord(header, {column.name: column.unit for column in columns}, found, tuple(events))


def header_of(folder: str | os.PathLike[str]) -> tuple[dict[str, Any], list[Column]]:
    """The header of a record and its columns; `DatasetError` if there is none."""
    there = segments(Path(folder))
    if not there:
        raise DatasetError(
            str(folder), [Problem("contains no record of a rig", remedy="give the folder of `rig run --out`")]
        )
    content, columns = read_header(there[0])
    return content["header"], columns


def entries(folder: str | os.PathLike[str]) -> Iterator[Rows | Event]:
    """Iterate over rows and events of a record in order, a chunk at a time.

    Warns of rows that are lost in damaged parts.

    Raises
    ------
    DatasetError
        If rows are missing or repeated without damage: a file was changed, or is missing.
    """
    expected, damaged = 0, False
    for path in segments(Path(folder)):
        _, columns = read_header(path)
        reader, known = JournalReader(path, DatasetError), 0
        for record in reader:
            gap, lost = record.number - expected, reader.damaged - known
            known, damaged = reader.damaged, damaged or lost > 0
            if gap < 0 or (gap and not damaged):
                message = f"{gap} rows are missing before row {record.number}" if gap > 0 else f"{-gap} rows repeat"
                raise DatasetError(str(path), [Problem(message, remedy="a file was changed, or is missing")])
            if gap or (lost and record.kind != HEADER):  # the header is stored twice
                what = f"rows {expected} to {record.number - 1}" if gap else f"{lost} chunk(s) before row {expected}"
                _warn_of_damage(path, f"{what} are lost")
                expected = record.number
            if record.kind == SAMPLES:
                rows = unpack_rows(columns, record.payload)
                expected += len(rows[columns[0].name])
                yield Rows(record.number, rows)
            elif record.kind == EVENT:
                content = json.loads(record.payload)
                yield Event(content["kind"], content["text"], record.number, content["data"])
        if reader.damaged > known:
            _warn_of_damage(path, "its end is lost")
        damaged = damaged or reader.end < path.stat().st_size


def _warn_of_damage(path: Path, lost: str) -> None:
    warnings.warn(f"{path} is damaged: {lost}", McKibbenWarning, stacklevel=3)


def rows_in(folder: str | os.PathLike[str]) -> int:
    """Number of rows of a record."""
    return max((one.first + len(next(iter(one.columns.values()))) for one in _rows(folder)), default=0)


def segments(folder: Path) -> list[Path]:
    """The files of a record in order; none if the folder does not exist."""
    return sorted(folder.glob("record-*.chunks"))


def _rows(folder: str | os.PathLike[str]) -> Iterator[Rows]:
    return (one for one in entries(folder) if isinstance(one, Rows))


POINT, PLACE = "point", "place"
"""Kinds of events: a point of the dataset was measured; a point was measured that only served to find a boundary."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """A plateau whose samples were all recorded.

    Attributes
    ----------
    number
        Its number among all plateaus of the test, from 0.
    first, rows, every
        Row of its first sample, rows to its last one, and rows per sample: a card may be faster than required.
    samples
        Number of its samples.
    time
        Time of the first one, by the clock of the record [s].
    pulses, contraction
        Position of the motor from the mounted one [pulses], and contraction [-].
    force, pressure, set_pressure
        Mean force [N] and pressure [Pa], and set pressure [Pa].
    direction, phase, repeat
        Words of the step, and number of the innermost repeat.
    keep
        Whether it is a point of the dataset.
    """

    number: int
    first: int
    rows: int
    every: int
    samples: int
    time: float
    pulses: int
    contraction: float
    force: float
    pressure: float
    set_pressure: float
    direction: str
    phase: str
    repeat: int
    keep: bool


def points(events: Iterable[Event]) -> list[Point]:
    """The points among events, in the order of their numbers, each once."""
    found: dict[int, Point] = {}
    for event in events:
        if event.kind in (POINT, PLACE):
            found.setdefault(event.data["number"], Point(**event.data))
    return [found[number] for number in sorted(found)]


def recorded_points(folder: str | os.PathLike[str]) -> list[Point]:
    """The points of a record, in the order of their numbers, each once."""
    return points(one for one in entries(folder) if isinstance(one, Event))


def assemble(folder: str | os.PathLike[str], bench: Bench, *, source: str = "") -> IsobaricDataset:
    """Return the dataset of a record: one row per point.

    Parameters
    ----------
    folder
        Folder of the record.
    bench
        Bench of the test, of whose calibrations the samples are converted.
    source
        Source of the dataset.

    Returns
    -------
    IsobaricDataset
        With the samples of each point, float32 of shape (points, samples), if all have equally many.

    Raises
    ------
    DatasetError
        If no point is complete. Points of which samples are missing are left out, with a warning.
    """
    from mckibben.dataset import IsobaricDataset  # pandas and xarray take 0.5 s

    kept = [point for point in recorded_points(folder) if point.keep]
    if not kept:
        raise DatasetError(str(folder), [Problem("contains no point yet", remedy="resume it")])
    counts = {point.samples for point in kept}
    shape = (len(kept), max(counts))
    force, pressure = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    _fill(folder, kept, {"force": force, "pressure": pressure})
    for name, samples in (("force", force), ("pressure", pressure)):
        _to_si(samples, bench, name)
    complete = np.count_nonzero(~np.isnan(force), axis=1) == [point.samples for point in kept]
    if not complete.all():
        lost = [point.number for point, whole in zip(kept, complete, strict=True) if not whole]
        if not complete.any():
            raise DatasetError(str(folder), [Problem("contains no complete point", remedy="record again")])
        warnings.warn(
            f"{folder}: samples of the points {', '.join(map(str, lost))} are missing; they are left out",
            McKibbenWarning,
            stacklevel=2,
        )
        kept = [point for point, whole in zip(kept, complete, strict=True) if whole]
        force, pressure = force[complete], pressure[complete]
    same = len(counts) == 1
    mean = np.mean if same else np.nanmean
    means = [mean(samples, axis=1, dtype=np.float64) for samples in (force, pressure)]
    return IsobaricDataset.of(
        pressure=means[1],
        contraction=[point.contraction for point in kept],
        force=means[0],
        direction=_words([point.direction for point in kept]),
        phase=_words([point.phase for point in kept]),
        repeat=[point.repeat for point in kept],
        time=[point.time for point in kept],
        set_pressure=[point.set_pressure for point in kept],
        force_samples=force if same else None,
        pressure_samples=pressure if same else None,
        specimen=bench.specimen.name,
        initial_length=float(bench.specimen.initial_length),
        source=source,
        slack_force=bench.slack_force,
    )


def recording_of(folder: str | os.PathLike[str], bench: Bench, *, source: str = "") -> Recording:
    """Return all samples over time, between points as decimated as they were recorded; parameters as `assemble`."""
    from mckibben.dataset import Recording

    columns = read_record(folder).columns
    force, pressure = (bench.calibrations[name].si(columns[name].astype(float)) for name in ("force", "pressure"))
    return Recording.of(
        time=columns["time"],
        pressure=pressure,
        force=force,
        contraction=[bench.contraction_at(pulses) for pulses in columns["pulses"].tolist()],
        specimen=bench.specimen.name,
        initial_length=float(bench.specimen.initial_length),
        source=source,
        slack_force=bench.slack_force,
    )


def _fill(folder: str | os.PathLike[str], kept: Sequence[Point], into: dict[str, np.ndarray]) -> None:
    """Copy the samples of each point from the rows of the record."""
    order = sorted(range(len(kept)), key=lambda index: kept[index].first)
    waiting = 0
    for one in entries(folder):
        if not isinstance(one, Rows):
            continue
        end = one.first + len(one.columns["time"])
        for index in order[waiting:]:
            point = kept[index]
            if point.first >= end:
                break
            wanted = range(point.first, point.first + point.rows, point.every)
            # the point's samples in this chunk
            begin = max(0, -(-(one.first - point.first) // point.every))
            stop = min(point.samples, -(-(end - point.first) // point.every))
            if stop > begin:
                rows = slice(wanted[begin] - one.first, wanted[stop - 1] - one.first + 1, point.every)
                for name, samples in into.items():
                    samples[index, begin:stop] = one.columns[name][rows]
        while waiting < len(order) and kept[order[waiting]].first + kept[order[waiting]].rows <= end:
            waiting += 1


def _to_si(samples: np.ndarray, bench: Bench, name: str) -> None:
    """Volts to newtons or pascals in place, some rows at a time."""
    calibration = bench.calibrations[name]
    for start in range(0, len(samples), 256):
        part = samples[start : start + 256]
        part[:] = calibration.si(part)


def _words(words: list[str]) -> list[str] | None:
    return words if any(words) else None
