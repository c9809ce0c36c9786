"""Recordings of a test: file format, reading, points and the dataset."""

from __future__ import annotations

import itertools
import json
import math
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from pydantic_core import from_json

from mckibben.errors import DatasetError, McKibbenWarning, Problem
from mckibben.rig.bench import Bench
from mckibben.rig.mcap_file import McapMessage, McapReader

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recording

SAMPLES, EVENTS = 0, 1
"""Numbers of the topics of a record."""
HEADER = "header.json"
"""Attachment that describes the record."""


class Column(NamedTuple):
    """One quantity of a record.

    Attributes
    ----------
    name, unit
        Its name, and its SI unit.
    dtype
        NumPy type of its values; of float32, nine digits are recorded.
    """

    name: str
    unit: str
    dtype: str = "float64"


def pack_rows(columns: Sequence[Column], arrays: Sequence[np.ndarray], first: int) -> list[McapMessage]:
    """Return samples as messages; numbers that are missing (NaN) are left out.

    Parameters
    ----------
    columns, arrays
        Columns, and an array of shape (rows,) for each.
    first
        Number of the first row.

    Examples
    --------
    >>> columns = [Column("time", "s"), Column("force", "N", "float32")]
    >>> messages = pack_rows(columns, [np.array([0.0, 0.1]), np.array([np.nan, 2.0])], first=5)
    >>> [message.data for message in messages], unpack_rows(columns, messages)["force"].tolist()
    ([b'{"time":0.0}', b'{"time":0.1,"force":2}'], [nan, 2.0])
    """
    places = [_PLACES.get(column.dtype, "%d") for column in columns]
    whole = "{" + ",".join(f'"{column.name}":{place}' for column, place in zip(columns, places, strict=True)) + "}"
    names = [column.name for column in columns]
    at = names.index("time") if "time" in names else None
    messages = []
    for number, row in enumerate(zip(*(array.tolist() for array in arrays), strict=True), start=first):
        if all(map(math.isfinite, row)):
            text = whole % row
        else:
            known = [cell for cell in zip(names, places, row, strict=True) if math.isfinite(cell[2])]
            parts = [f'"{name}":{place % value}' for name, place, value in known]
            text = "{" + ",".join(parts) + "}"
        time = number * 1e-9 if at is None else max(row[at], 0.0)
        messages.append(McapMessage(SAMPLES, number & _SEQUENCE, time, text.encode()))
    return messages


_PLACES = {"float64": "%r", "float32": "%.9g"}
_SEQUENCE = 0xFFFFFFFF


def unpack_rows(columns: Sequence[Column], messages: Sequence[McapMessage]) -> dict[str, np.ndarray]:
    """Columns of messages with samples."""
    rows = from_json(b"[" + b",".join(message.data for message in messages) + b"]")
    return {column.name: np.array([row.get(column.name, math.nan) for row in rows], column.dtype) for column in columns}


def read_header(path: Path) -> tuple[dict[str, Any], list[Column]]:
    """Content of a segment's header and its columns; `DatasetError` if the file is not a record of a rig."""
    for part in McapReader(path):
        if isinstance(part, tuple) and part[0] == HEADER:
            content = json.loads(part[1])
            return content, [Column(**column) for column in content["columns"]]
    message = "is not a rig record, or its header is lost"
    raise DatasetError(str(path), [Problem(message, remedy="give the folder of `rig run --out`, or restore the file")])


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

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


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
    rows
        Number of each row; some are missing if the record is damaged.
    """

    header: dict[str, Any]  # of the first segment
    units: dict[str, str]
    columns: dict[str, np.ndarray]
    events: tuple[Event, ...]
    rows: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def points(self) -> list[Point]:
        """Points in the order of their numbers, each as it was measured last."""
        return points(self.events)

    def samples(self, name: str, point: Point) -> np.ndarray:
        """Samples of a point by the name of a column, shape (samples,); NaN where they are lost."""
        wanted = point.first + point.every * np.arange(point.samples)
        at = np.minimum(np.searchsorted(self.rows, wanted), max(len(self.rows) - 1, 0))
        there = np.append(self.rows, -1)[at] == wanted
        return np.where(there, np.append(self.columns[name], np.nan)[at], np.nan)


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
    rows, events = [Rows(0, {column.name: np.empty(0, column.dtype) for column in columns})], list[Event]()
    for entry in entries(folder):
        (events if isinstance(entry, Event) else rows).append(entry)  # type: ignore[arg-type]
    found = {
        column.name: np.concatenate([part.columns[column.name] for part in rows]).astype(column.dtype, copy=False)
        for column in columns
    }
    numbers = np.concatenate([part.first + np.arange(len(part)) for part in rows])
    return RigRecord(header, {column.name: column.unit for column in columns}, found, tuple(events), numbers)


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
        reader, known = McapReader(path), 0
        for part in reader:
            if isinstance(part, tuple):
                continue
            lost, known = reader.damaged - known, reader.damaged
            damaged |= lost > 0
            for topic, group in itertools.groupby(part, key=lambda message: message.topic):
                messages = list(group)
                if topic == EVENTS:
                    yield from (_event(message) for message in messages)
                    continue
                first = messages[0].sequence
                if first != expected and not (damaged and first > expected):
                    gap = first - expected
                    message = f"{gap} rows are missing before row {first}" if gap > 0 else f"{-gap} rows repeat"
                    raise DatasetError(str(path), [Problem(message, remedy="a file was changed, or is missing")])
                if first > expected:
                    _warn_of_damage(path, f"rows {expected} to {first - 1} are lost")
                    lost = 0
                expected = first + len(messages)
                yield Rows(first, unpack_rows(columns, messages))
            if lost:
                _warn_of_damage(path, f"{lost} part(s) before row {expected} are lost")
        if reader.damaged > known:
            damaged = True
            _warn_of_damage(path, "its end is lost")
        damaged |= reader.is_cut


def _event(message: McapMessage) -> Event:
    content = from_json(message.data)
    return Event(content["kind"], content["text"], content["row"], content["data"])


def _warn_of_damage(path: Path, lost: str) -> None:
    warnings.warn(f"{path} is damaged: {lost}", McKibbenWarning, stacklevel=3)


def rows_in(folder: str | os.PathLike[str]) -> int:
    """Number of rows of a record."""
    return max((part.first + len(part) for part in entries(folder) if isinstance(part, Rows)), default=0)


def segments(folder: Path) -> list[Path]:
    """The files of a record in order; none if the folder does not exist."""
    return sorted(folder.glob("record-*.mcap"))


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
    force, pressure, set_pressure, set_force
        Mean force [N] and pressure [Pa], set pressure [Pa], and force that is held [N], None if none is.
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
    set_force: float | None
    direction: str
    phase: str
    repeat: int
    keep: bool


def points(events: Iterable[Event]) -> list[Point]:
    """The points among events, in the order of their numbers, each as it was measured last."""
    found: dict[int, Point] = {}
    for event in events:
        if event.kind in (POINT, PLACE):
            found[event.data["number"]] = Point(**event.data)
    return [found[number] for number in sorted(found)]


def assemble(folder: str | os.PathLike[str], bench: Bench, *, source: str = "") -> IsobaricDataset:
    """Return the dataset of a record: one row per point.

    Parameters
    ----------
    folder
        Folder of the record.
    bench
        Bench of the test.
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

    record = read_record(folder)
    kept = [point for point in record.points if point.keep]
    if not kept:
        raise DatasetError(str(folder), [Problem("contains no point yet", remedy="resume it")])
    counts = {point.samples for point in kept}
    force, pressure = (np.full((len(kept), max(counts)), np.nan, np.float32) for _ in range(2))
    for row, point in enumerate(kept):
        force[row, : point.samples], pressure[row, : point.samples] = (
            record.samples(name, point) for name in ("force", "pressure")
        )
    complete = np.isfinite(force).sum(axis=1) == [point.samples for point in kept]
    if not complete.any():
        raise DatasetError(str(folder), [Problem("contains no complete point", remedy="record again")])
    if not complete.all():
        lost = ", ".join(str(kept[row].number) for row in np.flatnonzero(~complete))
        message = f"{folder}: samples of the points {lost} are missing; they are left out"
        warnings.warn(message, McKibbenWarning, stacklevel=2)
        kept = [kept[row] for row in np.flatnonzero(complete)]
        force, pressure = force[complete], pressure[complete]
    same = len(counts) == 1
    means = [np.nanmean(samples, axis=1, dtype=np.float64) for samples in (force, pressure)]
    names = ("contraction", "repeat", "time", "set_pressure", "set_force")
    columns = {name: [getattr(point, name) for point in kept] for name in names}
    return IsobaricDataset.of(
        pressure=means[1],
        force=means[0],
        direction=_words([point.direction for point in kept]),
        phase=_words([point.phase for point in kept]),
        **{name: None if None in values else values for name, values in columns.items()},  # type: ignore[arg-type]
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
    return Recording.of(
        time=columns["time"],
        pressure=columns["pressure"].astype(float),
        force=columns["force"].astype(float),
        contraction=[bench.contraction_at(pulses) for pulses in columns["pulses"].tolist()],
        specimen=bench.specimen.name,
        initial_length=float(bench.specimen.initial_length),
        source=source,
        slack_force=bench.slack_force,
    )


def _words(words: list[str]) -> list[str] | None:
    return words if any(words) else None
