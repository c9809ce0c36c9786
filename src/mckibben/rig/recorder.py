"""The recorder: every sample is on disk within a second of being taken, and survives a crash of this process."""

from __future__ import annotations

import errno
import json
import os
import platform
import threading
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

import mckibben
from mckibben.errors import FileError, Problem, RangeError, RigError
from mckibben.rig.mcap_file import McapMessage, McapWriter, Topic
from mckibben.rig.record import EVENTS, HEADER, Column, pack_rows, read_header, rows_in, segments
from mckibben.storage.files import make_folder

PERIOD = 0.25
"""Interval [s] at which appended rows are written and synced to the disk."""

_MOST_PENDING = 1 << 17  # numbers: an append waits while more than that is pending
_RESERVE = 1 << 22  # bytes kept free for pending rows, and for the reason, when the disk is full
_RESERVE_NAME = "reserve"
_FULL = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC))


class Recorder:
    """Appends samples and events to a record; a thread writes and syncs them.

    On a full disk, pending rows and the reason are written into a reserve; after any other error nothing more is
    written, so that a record has no gaps. As a context it is closed at the end; after an error before the first sample
    or event, its file is removed.

    Examples
    --------
    >>> import tempfile
    >>> from mckibben.rig.record import read_record
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Recorder.create(folder, {"specimen": "ours"}, [Column("time", "s")]) as recorder:
    ...         recorder.append({"time": [0.0, 0.1]})
    ...         recorder.event("point", number=0)
    ...     record = read_record(folder)
    >>> record.columns["time"].tolist(), record.events[0].kind, record.events[0].row
    ([0.0, 0.1], 'point', 2)
    """

    def __init__(
        self,
        path: Path,
        header: Mapping[str, Any],
        columns: Sequence[Column],
        first: int,
        attachments: Mapping[str, bytes] | None = None,
    ) -> None:
        self.path = path
        self.columns = tuple(columns)
        self.rows = first  # of the record, those included that are still to be written
        self._is_empty = True
        self._written = first  # of those, in the file
        self._pending: list[list[np.ndarray] | dict[str, Any]] = []
        self._waiting = 0  # numbers in pending rows
        self._time = 0.0  # of the latest row [s]
        self._failure: Exception | None = None
        self._closing = self._hurry = False
        self._asked = self._done = 0  # flushes
        self._change = threading.Condition()
        content = {
            "format": "mckibben record",
            "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "columns": [column._asdict() for column in self.columns],
            "header": dict(header),
        }
        files = {HEADER: json.dumps(content, ensure_ascii=False, allow_nan=False).encode(), **(attachments or {})}
        topics = [Topic("samples", {column.name: column.unit for column in columns}), Topic("events", {})]
        try:
            self._reserve = path.with_name(_RESERVE_NAME)
            _keep_free(self._reserve)
            self._file = McapWriter(path, topics, files)
        except OSError as error:
            self._reserve.unlink(missing_ok=True)
            raise FileError(str(path), [Problem(f"it cannot be written: {error.strerror}")]) from error
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    @classmethod
    def create(
        cls,
        folder: str | os.PathLike[str],
        header: Mapping[str, Any],
        columns: Sequence[Column],
        attachments: Mapping[str, bytes] | None = None,
    ) -> Self:
        """Begin a record.

        Parameters
        ----------
        folder
            Its folder, made if need be.
        header
            Description of the test, an object of JSON.
        columns
            Columns of its rows, of unique names.
        attachments
            Files that it carries, by name.

        Raises
        ------
        FileError
            If the folder has a record, or cannot be written.
        RangeError
            If columns have one name.
        """
        folder = make_folder(folder)
        if segments(folder):
            remedy = "resume it, or choose another folder"
            raise FileError(str(folder), [Problem("contains a record", remedy=remedy)])
        return cls(folder / _name(1), header, _checked(columns), 0, attachments)

    @classmethod
    def resume(
        cls,
        folder: str | os.PathLike[str],
        header: Mapping[str, Any],
        columns: Sequence[Column],
        attachments: Mapping[str, bytes] | None = None,
    ) -> Self:
        """Continue a record in a new file of its folder; parameters as `create`.

        Raises
        ------
        FileError
            If there is no record, or one with other columns.
        """
        folder = Path(folder)
        there = segments(folder)
        if not there:
            raise FileError(str(folder), [Problem("contains no record to continue", remedy="begin one")])
        if read_header(there[-1])[1] != list(_checked(columns)):
            raise FileError(
                str(folder), [Problem("contains a record with other columns", remedy="choose another folder")]
            )
        number = int(there[-1].stem.rpartition("-")[2]) + 1
        return cls(folder / _name(number), header, columns, rows_in(folder), attachments)

    def append(self, table: Mapping[str, ArrayLike]) -> None:
        """Append rows; they are copied, and on the disk within a second.

        Parameters
        ----------
        table
            For each column an array of shape (rows,), or a number for one row.

        Raises
        ------
        RangeError
            If columns are missing, unknown or of different lengths.
        RigError
            If the recorder is closed, or earlier rows could not be written.
        """
        arrays = [np.array(table[column.name], column.dtype, ndmin=1) for column in self.columns]
        count = len(arrays[0])
        if len(table) != len(arrays) or any(array.shape != (count,) for array in arrays):
            given = ", ".join(f"{name} {np.shape(values)}" for name, values in table.items())
            names = ", ".join(column.name for column in self.columns)
            raise RangeError(f"no rows of {names} can be made from {given}")
        if not count:
            return
        with self._change:
            self._raise_closed()
            self._raise_failure()
            while self._waiting > _MOST_PENDING and self._failure is None:
                self._hurry = True
                self._change.notify_all()
                self._change.wait(PERIOD)
            self._raise_failure()
            self._pending.append(arrays)
            self._is_empty = False
            self._waiting += count * len(arrays)
            self.rows += count

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
            As `append`, but not if the disk is full.
        """
        with self._change:
            self._raise_closed()
            self._raise_failure(but_full=True)
            self._pending.append({"kind": kind, "text": text, "row": self.rows, "data": data})
            self._is_empty = False

    def flush(self) -> None:
        """Return when everything that was appended before is on the disk.

        Raises
        ------
        RigError
            If it could not be written.
        """
        with self._change:
            self._asked += 1
            asked = self._asked
            self._change.notify_all()
            while self._done < asked and self._thread.is_alive():
                self._change.wait(PERIOD)
            self._raise_failure()

    def close(self) -> None:
        """Write pending rows, and release the file; may be called again.

        Raises
        ------
        RigError
            If they could not be written.
        """
        with self._change:
            self._closing = True
            self._change.notify_all()
        self._thread.join()
        if not self._file.closed:
            self._file.close(summary=self._failure is None)
            self._reserve.unlink(missing_ok=True)
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

    def _raise_closed(self) -> None:
        if self._closing:
            raise RigError(f"{self.path} is closed", remedy="record before that")

    def _raise_failure(self, *, but_full: bool = False) -> None:
        failure = self._failure
        if failure is not None and not (but_full and getattr(failure, "errno", None) in _FULL):
            reason = getattr(failure, "strerror", None) or f"{type(failure).__name__}: {failure}".rstrip(": ")
            remedy = "what was recorded before is kept; make room and resume"
            if isinstance(failure, FileNotFoundError):
                remedy = f"nothing is kept at {self.path.parent}; if it was moved, what was recorded before is with it"
            raise RigError(f"{self.path} cannot be written: {reason}", remedy=remedy) from failure

    def _work(self) -> None:
        lost = False
        while True:
            with self._change:
                if not (self._closing or self._hurry or self._asked > self._done):
                    self._change.wait(PERIOD)
                pending, self._pending = self._pending, []
                asked, closing = self._asked, self._closing
                self._waiting, self._hurry = 0, False
            try:
                if pending and not lost:
                    self._write(self._packed(pending))
            except Exception as error:  # any exception: a thread that ends here would silently lose the rest
                lost = True  # later rows would follow a gap
                with self._change:
                    self._failure = error
            with self._change:
                self._done = asked
                self._change.notify_all()
                if closing and not self._pending:
                    return

    def _packed(self, pending: list[list[np.ndarray] | dict[str, Any]]) -> list[list[McapMessage]]:
        """Chunks of rows and events in their order, each of which ends with an event: damage costs one point."""
        chunks: list[list[McapMessage]] = [[]]
        for entry in pending:
            if isinstance(entry, dict):
                data = json.dumps(entry, ensure_ascii=False, allow_nan=False).encode()
                chunks[-1].append(McapMessage(EVENTS, 0, self._time, data))
                chunks.append([])
                continue
            rows = pack_rows(self.columns, entry, self._written)
            self._written, self._time = self._written + len(rows), rows[-1].time
            chunks[-1] += rows
        return [chunk for chunk in chunks if chunk]

    def _write(self, chunks: list[list[McapMessage]]) -> None:
        """Append to the file; on a full disk, in the space of the reserve."""
        try:
            self._file.append(*chunks)
        except OSError as error:
            if error.errno not in _FULL:
                raise
            self._reserve.unlink(missing_ok=True)
            self._file.append(*chunks)
            with self._change:
                self._failure = error  # it is kept, but nothing more should come


def software_versions(*packages: str) -> dict[str, str]:
    """Versions of mckibben, other packages, Python and the system, for the header of a record."""
    others = {"python": platform.python_version(), "platform": platform.platform()}
    return {"mckibben": mckibben.__version__} | {name: version(name) for name in packages} | others


def _keep_free(path: Path) -> None:
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_NOFOLLOW", 0), 0o644)
    try:
        os.posix_fallocate(file, 0, _RESERVE) if hasattr(os, "posix_fallocate") else os.write(file, bytes(_RESERVE))
    finally:
        os.close(file)


def _name(number: int) -> str:
    return f"record-{number:04d}.mcap"


def _checked(columns: Sequence[Column]) -> Sequence[Column]:
    names = [column.name for column in columns]
    if not names or len(set(names)) < len(names):
        raise RangeError(f"columns {names} cannot be told apart", remedy="give each a unique name")
    return columns
