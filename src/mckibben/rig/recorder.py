"""The recorder: every sample is on disk within a second of being taken, and survives a crash of this process."""

from __future__ import annotations

import json
import os
import platform
import queue
import threading
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from types import TracebackType
from typing import Any, Self

import mckibben
from mckibben.errors import FileError, Problem, RigError
from mckibben.rig.record import HEADER, read_header, read_record, segments
from mckibben.storage.files import make_folder
from mckibben.storage.mcap import Column, McapWriter, pack_rows

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
        Whether to continue the record of the folder, in a new file.

    Raises
    ------
    FileError
        If the folder has a record and `resume` is not set, or the reverse; if that record has other columns; or if the
        folder cannot be written.

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
        header: Mapping[str, Any],
        columns: Sequence[Column],
        attachments: Mapping[str, bytes] | None = None,
        *,
        resume: bool = False,
    ) -> None:
        folder = make_folder(folder)
        there = segments(folder)
        if bool(there) != resume:
            message, remedy = ("contains a record", "resume it, or choose another folder")
            if resume:
                message, remedy = "contains no record to continue", "begin one"
            raise FileError(str(folder), [Problem(message, remedy=remedy)])
        if resume and read_header(there[-1])[1] != [*columns]:
            problem = Problem("contains a record with other columns", remedy="choose another folder")
            raise FileError(str(folder), [problem])
        number = int(there[-1].stem.rpartition("-")[2]) + 1 if resume else 1
        self.path, self.columns = folder / f"record-{number:04d}.mcap", tuple(columns)
        self.rows = self._written = 1 + int(read_record(folder).rows.max(initial=-1)) if resume else 0
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

    def event(self, kind: str, text: str = "", /, **data: Any) -> None:
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
    return {"mckibben": mckibben.__version__} | {name: version(name) for name in packages} | others
