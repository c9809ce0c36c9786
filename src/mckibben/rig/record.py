"""Records of a rig: written so that they survive a crash, read, and the dataset of their points."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import queue
import threading
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import compress
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from pydantic_core import from_json

from mckibben.errors import DatasetError, FileError, McKibbenWarning, Problem, RigError
from mckibben.rig.bench import Bench
from mckibben.storage.files import make_folder
from mckibben.storage.mcap import MAGIC, Column, McapWriter, library, pack_rows, unpack_rows
from mckibben.version import __version__

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recording

HEADER = "header.json"
"""Attachment that describes the record."""


def _parts(path: Path) -> Iterator[Any]:
    """Attachments and chunks (lists of messages) of a file, up to an incomplete end.

    Warns of damaged chunks, which are left out. Raises `DatasetError` if the file cannot be read to its end, although
    it was closed.
    """
    records, stream_reader = library("mcap.records"), library("mcap.stream_reader")
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        try:
            for record in stream_reader.StreamReader(file, emit_chunks=True, record_size_limit=size).records:
                if isinstance(record, records.Attachment):
                    yield record
                elif isinstance(record, records.Chunk):
                    try:
                        parts = stream_reader.breakup_chunk(record, validate_crc=True)
                    except Exception:  # whatever damaged bytes lead to
                        warnings.warn(f"{path} is damaged: rows or events are lost", McKibbenWarning, stacklevel=3)
                        continue
                    yield [part for part in parts if isinstance(part, records.Message)]
        except Exception as error:
            file.seek(max(size - len(MAGIC), 0))
            if file.read() == MAGIC:  # it was closed; otherwise a kill has cut its end
                problem = Problem("is damaged", remedy="`mcap recover` saves the rest of it")
                raise DatasetError(str(path), [problem]) from error


def read_header(path: Path) -> tuple[dict[str, Any], list[Column]]:
    """Content of a segment's header and its columns; `DatasetError` if the file is not a record of a rig."""
    for part in _parts(path):
        if getattr(part, "name", "") == HEADER:
            with contextlib.suppress(ValueError):
                content = json.loads(part.data)
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

    header: dict[str, Any]
    units: dict[str, str]
    columns: dict[str, np.ndarray]
    events: tuple[Event, ...]
    rows: np.ndarray

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def points(self) -> list[RecordedPoint]:
        """Points in the order of their numbers, each as it was measured last."""
        return points(self.events)

    def samples(self, name: str, point: RecordedPoint) -> np.ndarray:
        """Samples of a point by the name of a column, shape (samples,); NaN where they are lost."""
        numbers = point.first + point.every * np.arange(point.samples)
        if not len(self.rows):
            return np.full(numbers.shape, np.nan)
        at = np.minimum(np.searchsorted(self.rows, numbers), len(self.rows) - 1)
        return np.where(self.rows[at] == numbers, self.columns[name][at], np.nan)


def read_record(folder: str | os.PathLike[str]) -> RigRecord:
    """Read a record without an incomplete end.

    Parameters
    ----------
    folder
        Folder of `rig run --out`.

    Raises
    ------
    DatasetError
        If there is no record, or rows repeat; rows that are missing are a warning.
    """
    header, columns = header_of(folder)
    tables, numbers, events = [unpack_rows(columns, ())], list[int](), list[Event]()
    for path in segments(Path(folder)):
        for part in _parts(path):
            messages = part if isinstance(part, list) else []
            rows = [message for message in messages if message.channel_id == 1]
            numbers += [message.sequence for message in rows]
            tables.append(unpack_rows(columns, (message.data for message in rows)))
            events += [Event(**from_json(message.data)) for message in messages if message.channel_id != 1]
    missing = np.diff(np.array(numbers, np.int64), prepend=-1) - 1
    if (missing < 0).any():
        raise DatasetError(str(folder), [Problem("rows repeat", remedy="a file was changed, or copied")])
    if missing.any():
        message = f"{folder}: {missing.sum()} rows are missing: a file is damaged, was changed, or is missing"
        warnings.warn(message, McKibbenWarning, stacklevel=2)
    table = {column.name: np.concatenate([part[column.name] for part in tables]) for column in columns}
    units = {column.name: column.unit for column in columns}
    return RigRecord(header, units, table, tuple(events), np.array(numbers, np.int64))


def header_of(folder: str | os.PathLike[str]) -> tuple[dict[str, Any], list[Column]]:
    """The header of a record and its columns; `DatasetError` if there is none."""
    there = segments(Path(folder))
    if not there:
        raise DatasetError(
            str(folder), [Problem("contains no record of a rig", remedy="give the folder of `rig run --out`")]
        )
    content, columns = read_header(there[0])
    return content["header"], columns


def segments(folder: Path) -> list[Path]:
    """The files of a record in order; none if the folder does not exist."""
    return sorted(folder.glob("record-*.mcap"))


POINT, PLACE = "point", "place"
"""Kinds of events: a point of the dataset was measured; a point was measured that only served to find a boundary."""


@dataclass(frozen=True, kw_only=True)
class RecordedPoint:
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
    position, contraction
        Position of the motor from the mounted one [m], and contraction [-].
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
    position: float
    contraction: float
    force: float
    pressure: float
    set_pressure: float
    set_force: float | None
    direction: str
    phase: str
    repeat: int
    keep: bool


def points(events: Iterable[Event]) -> list[RecordedPoint]:
    """The points among events, in the order of their numbers, each as it was measured last."""
    found: dict[int, RecordedPoint] = {}
    for event in events:
        if event.kind in (POINT, PLACE):
            found[event.data["number"]] = RecordedPoint(**event.data)
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
        With the means of the samples of each point, and the spread of its forces.

    Raises
    ------
    DatasetError
        If no point is complete. Points of which samples are missing are left out, with a warning.
    """
    from mckibben.dataset import IsobaricDataset  # pandas and xarray take 0.5 s

    kept, samples = _complete_points(Path(folder))
    means = {name: [array.mean(dtype=np.float64) for array in arrays] for name, arrays in samples.items()}
    names = ("contraction", "repeat", "time", "set_pressure", "set_force", "direction", "phase")
    columns: dict[str, Any] = {name: [getattr(point, name) for point in kept] for name in names}
    columns = {name: values for name, values in columns.items() if None not in values and {*values} != {""}}
    columns["force_spread"] = [array.std(dtype=np.float64) for array in samples["force"]]
    columns.update(means | _origin_of(bench, source))
    return IsobaricDataset.of(**columns)


def _complete_points(folder: Path) -> tuple[list[RecordedPoint], dict[str, list[np.ndarray]]]:
    """Points of the dataset, and their samples of force and pressure."""
    record = read_record(folder)
    kept = [point for point in record.points if point.keep]
    if not kept:
        raise DatasetError(str(folder), [Problem("contains no point yet", remedy="resume it")])
    whole = [bool(np.isfinite(record.samples("force", point)).all()) for point in kept]
    complete = list(compress(kept, whole))
    if not complete:
        raise DatasetError(str(folder), [Problem("contains no complete point", remedy="record again")])
    if lost := ", ".join(str(point.number) for point, there in zip(kept, whole, strict=True) if not there):
        message = f"{folder}: samples of the points {lost} are missing; they are left out"
        warnings.warn(message, McKibbenWarning, stacklevel=3)
    return complete, {name: [record.samples(name, point) for point in complete] for name in ("force", "pressure")}


def _origin_of(bench: Bench, source: str) -> dict[str, Any]:
    """Specimen, initial length, source and slack force of a dataset or a recording."""
    specimen = bench.specimen
    length = float(specimen.initial_length)
    return {"specimen": specimen.name, "initial_length": length, "source": source, "slack_force": bench.slack_force}


def recording_of(folder: str | os.PathLike[str], bench: Bench, *, source: str = "") -> Recording:
    """Return all samples over time, between points as decimated as they were recorded; parameters as `assemble`."""
    from mckibben.dataset import Recording

    columns = read_record(folder).columns
    return Recording.of(
        time=columns["time"],
        pressure=columns["pressure"].astype(float),
        force=columns["force"].astype(float),
        contraction=[bench.contraction_at(position) for position in columns["position"].tolist()],
        **_origin_of(bench, source),
    )


PERIOD = 0.25
"""Interval [s] at which appended rows are written and synced to the disk."""


class Recorder:
    """Appends samples and events to a record; a thread writes and syncs them.

    After an error nothing more is written, so that a record has no gaps. As a context it is closed at the end; after an
    error before the first sample or event, its file is removed.

    Parameters
    ----------
    folder
        Folder of the record, made if need be.
    header
        Description of the test, an object of JSON.
    columns
        Columns of its rows, of unique names; the first is the time [s].
    attachments
        Files that it carries, by name.
    resume
        Whether to continue the record of the folder, if there is one, in a new file.

    Raises
    ------
    FileError
        If the folder has a record and `resume` is not set; if that record has other columns; or if the folder cannot
        be written.

    Examples
    --------
    >>> import tempfile
    >>> from mckibben.rig.record import read_record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Recorder(folder, {"specimen": "ours"}, [Column("time", "s")]) as recorder:
    ...         recorder.append([[0.0], [0.1]])
    ...         recorder.event("point", number=0)
    ...     record = read_record(folder)
    >>> record.columns["time"].tolist(), record.events[0].kind, record.events[0].row
    ([0.0, 0.1], 'point', 2)
    """

    def __init__(
        self,
        folder: str | os.PathLike[str],
        header: Mapping[str, object],
        columns: Sequence[Column],
        attachments: Mapping[str, bytes] | None = None,
        *,
        resume: bool = False,
    ) -> None:
        folder = make_folder(folder)
        there = segments(folder)
        if there and not resume:
            problem = Problem("contains a record", remedy="resume it, or choose another folder")
            raise FileError(str(folder), [problem])
        if there and read_header(there[-1])[1] != [*columns]:
            problem = Problem("contains a record with other columns", remedy="choose another folder")
            raise FileError(str(folder), [problem])
        number = int(there[-1].stem.rpartition("-")[2]) + 1 if there else 1
        self.path, self.columns = folder / f"record-{number:04d}.mcap", tuple(columns)
        self.rows = self._written = 1 + int(read_record(folder).rows.max(initial=-1)) if there else 0
        content = {
            "format": "mckibben record",
            "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "columns": [column._asdict() for column in columns],
            "header": dict(header),
        }
        files = {HEADER: json.dumps(content, ensure_ascii=False, allow_nan=False).encode(), **(attachments or {})}
        try:
            self._file = McapWriter(self.path, columns, files)
        except OSError as error:
            raise FileError(str(self.path), [Problem(f"it cannot be written: {error.strerror}")]) from error
        self._pending: queue.Queue[Sequence[Sequence[float]] | bytes] = queue.Queue(1000)
        self._is_empty, self._closing, self._time = True, False, 0.0
        self._failure: Exception | None = None
        self._hurry = threading.Event()
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def append(self, rows: Sequence[Sequence[float]]) -> None:
        """Append rows, a number for each column; they are on the disk within a second.

        Raises
        ------
        RigError
            If the recorder is closed, or earlier rows could not be written.
        """
        if len(rows):
            self._put(rows)
            self.rows += len(rows)

    def event(self, kind: str, text: str = "", /, **data: object) -> None:
        """Record an event between the rows before and after it.

        Parameters
        ----------
        kind, text
            A word, and a sentence.
        data
            Values for JSON.

        Raises
        ------
        RigError
            As `append`.
        """
        content = {"kind": kind, "text": text, "row": self.rows, "data": data}
        self._put(json.dumps(content, ensure_ascii=False, allow_nan=False).encode())

    def _put(self, entry: Sequence[Sequence[float]] | bytes) -> None:
        if self._closing:
            raise RigError(f"{self.path} is closed", remedy="record before that")
        self._raise_failure()
        if self._pending.full():
            self._hurry.set()
        self._pending.put(entry)
        self._is_empty = False

    def flush(self) -> None:
        """Return when everything that was appended before is on the disk.

        Raises
        ------
        RigError
            If it could not be written.
        """
        self._hurry.set()
        self._pending.join()
        self._raise_failure()

    def close(self) -> None:
        """Write pending rows, and release the file; may be called again.

        Raises
        ------
        RigError
            If they could not be written.
        """
        if self._closing:
            return
        self._closing = True
        self._hurry.set()
        self._thread.join()
        self._file.close(summary=self._failure is None)
        self._raise_failure()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        try:
            self.close()
        except RigError:
            if error is None:  # the first failure is more informative
                raise
        if error is not None and self._is_empty:
            self.path.unlink(missing_ok=True)

    def _raise_failure(self) -> None:
        if (failure := self._failure) is not None:
            reason = getattr(failure, "strerror", None) or f"{type(failure).__name__}: {failure}".rstrip(": ")
            remedy = "what was recorded before is kept; make room and resume"
            if isinstance(failure, FileNotFoundError):
                remedy = f"nothing is kept at {self.path.parent}; if it was moved, what was recorded before is with it"
            raise RigError(f"{self.path} cannot be written: {reason}", remedy=remedy) from failure

    def _work(self) -> None:
        closing = False
        while not closing:
            self._hurry.wait(PERIOD)
            self._hurry.clear()
            closing = self._closing
            entries = [self._pending.get() for _ in range(self._pending.qsize())]
            try:
                if entries and self._failure is None:  # later rows would follow a gap
                    self._file.append(self._chunks(entries))
            except Exception as error:  # any exception: a thread that ends here would silently lose the rest
                self._failure = error
            for _ in entries:
                self._pending.task_done()

    def _chunks(
        self, entries: Sequence[Sequence[Sequence[float]] | bytes]
    ) -> list[list[tuple[int, int, float, bytes]]]:
        """Chunks of rows and events in their order, each of which ends with an event: damage costs one point."""
        chunks: list[list[tuple[int, int, float, bytes]]] = [[]]
        for entry in entries:
            if isinstance(entry, bytes):
                chunks[-1].append((2, 0, self._time, entry))
                chunks.append([])
                continue
            for row, data in zip(entry, pack_rows(self.columns, entry), strict=True):
                chunks[-1].append((1, self._written, row[0], data))
                self._written, self._time = self._written + 1, row[0]
        return [chunk for chunk in chunks if chunk]


def software_versions(*packages: str) -> dict[str, str]:
    """Versions of mckibben, other packages, Python and the system, for the header of a record."""
    others = {"python": platform.python_version(), "platform": platform.platform()}
    return {"mckibben": __version__} | {name: version(name) for name in packages} | others
