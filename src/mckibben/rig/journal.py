"""Append-only journals: a duplicated header that identifies the job, then records bound to it.

Each record has a checksum, a digest of the header and its own position, so that a record of another journal, or one
that was moved or repeated, is not read as one of this job.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import struct
import threading
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NamedTuple, Self

from mckibben.errors import FileError, Problem
from mckibben.storage.files import atomic_write, is_same_file

HEADER = b"H"
"""Kind of the first two records: JSON that identifies the job."""

_MAGIC, _VERSION = b"MCKCHUNK", 2
_FRONT = struct.Struct("<8s1sB2xIQQ8sQ")
"""Magic, kind, version, CRC-32 of the rest, length of the payload [bytes], number, digest of the header, position."""
_MAX_PAYLOAD = 1 << 31
_WINDOW = 1 << 20


class JournalRecord(NamedTuple):
    """One record of a journal.

    Attributes
    ----------
    kind
        Its kind, one byte.
    number
        Number of the writer's choice.
    payload
        Its content.
    """

    kind: bytes
    number: int
    payload: bytes


def json_record(kind: bytes, number: int, content: Mapping[str, Any]) -> JournalRecord:
    """A record that holds JSON."""
    return JournalRecord(kind, number, json.dumps(content, ensure_ascii=False, allow_nan=False).encode())


def _digest(header: JournalRecord) -> bytes:
    """Digest of a header, by which the records of its journal are known."""
    return hashlib.sha256(header.number.to_bytes(8, "little") + header.payload).digest()[:8]


def _encoded(record: JournalRecord, owner: bytes, position: int) -> bytes:
    """Bytes of a record of a header's digest at a position."""

    def front(checksum: int) -> bytes:
        kind, number, payload = record
        return _FRONT.pack(_MAGIC, kind, _VERSION, checksum, len(payload), number, owner, position)

    return front(zlib.crc32(record.payload, zlib.crc32(front(0)))) + record.payload


class JournalReader:
    """Iterates over the intact records of a journal, header included; an incomplete last record is not damage.

    Parameters
    ----------
    path
        File of the journal.
    error
        Class of the errors.

    Raises
    ------
    FileError
        Of that class, at a record that belongs to another journal, or that was moved, removed or repeated.
    """

    def __init__(self, path: Path, error: type[FileError] = FileError) -> None:
        self.path = path
        self.damaged = 0
        self.end = 0
        self.owner = b""
        self._error = error

    def __iter__(self) -> Iterator[JournalRecord]:
        position = skipped = 0
        with self.path.open("rb") as file:
            while True:
                found = _read(file, position)
                if found is not None:
                    self._check(found, position)
                    self.damaged += skipped
                    position, skipped = file.tell(), 0
                    self.end = position
                    yield found.record
                    continue
                skipped += 1
                following = _find_magic(file, position + 1)
                if following is None:
                    self.damaged += skipped - _is_cut(file, position)
                    return
                position = following

    def _check(self, found: _Found, position: int) -> None:
        """Raise an error unless an intact record was written at this position of this journal."""
        record, owner, written = found
        if not self.owner:
            if record.kind != HEADER:
                raise self._unknown()
            self.owner = owner
        is_own = owner == self.owner and (record.kind != HEADER or _digest(record) == owner)
        if is_own and written == position:
            return
        what = f"it was written at byte {written}" if is_own else "it belongs to another journal"
        problem = Problem(
            f"record {record.number} at byte {position} was not written there: {what}",
            field="record",
            value=position,
            remedy="restore the file from a copy, or choose another folder",
        )
        raise self._error(str(self.path), [problem])

    def _unknown(self) -> FileError:
        message = "is damaged or incomplete: the job that wrote the file is unknown"
        remedy = "restore the file from a copy, or start again: choose another folder, or remove the file"
        return self._error(str(self.path), [Problem(message, field="header", remedy=remedy)])

    def header(self) -> dict[str, Any] | None:
        """Content of the first intact record, if it is a header."""
        record = next(iter(self), None)
        if record is None or record.kind != HEADER:
            return None
        content = json.loads(record.payload)
        return content if isinstance(content, dict) else None

    def checked_header(self) -> dict[str, Any] | None:
        """Return the content of the header; None if the file is not a journal.

        Raises
        ------
        FileError
            If the header is damaged, truncated, missing, or of another version.
        """
        if (header := self.header()) is not None:
            return header
        with self.path.open("rb") as file:
            begin = file.read(_FRONT.size)
            begun = _MAGIC.startswith(begin[: len(_MAGIC)]) or _find_magic(file, 0) is not None
        if len(begin) == _FRONT.size and begin.startswith(_MAGIC) and (version := begin[9]) != _VERSION:
            message = f"it is a journal of format version {version}; this version of mckibben reads {_VERSION}"
            remedy = "use the version of mckibben that wrote it, or choose another folder"
            raise self._error(str(self.path), [Problem(message, field="version", value=version, remedy=remedy)])
        if begun:
            raise self._unknown()
        return None


class _Found(NamedTuple):
    """An intact record, the digest of its header, and the position at which it was written."""

    record: JournalRecord
    owner: bytes
    position: int


def _read(file: BinaryIO, position: int) -> _Found | None:
    """The record at a position; None if it is incomplete or damaged."""
    file.seek(position)
    front = file.read(_FRONT.size)
    if len(front) < _FRONT.size:
        return None
    magic, kind, version, checksum, length, number, owner, written = _FRONT.unpack(front)
    if magic != _MAGIC or version != _VERSION or length > _MAX_PAYLOAD:
        return None
    payload = file.read(length)
    blank = front[:12] + bytes(4) + front[16:]  # without the checksum
    if len(payload) < length or zlib.crc32(payload, zlib.crc32(blank)) != checksum:
        return None
    return _Found(JournalRecord(kind, number, payload), owner, written)


def _is_cut(file: BinaryIO, position: int) -> bool:
    """Whether the record at a position is incomplete, as after a crash during a write."""
    size = file.seek(0, os.SEEK_END)
    file.seek(position)
    front = file.read(_FRONT.size)
    if len(front) < _FRONT.size:
        return True
    magic, _, _, _, length, *_ = _FRONT.unpack(front)
    return magic != _MAGIC or position + _FRONT.size + length > size


def _find_magic(file: BinaryIO, start: int) -> int | None:
    """Position of the next start of a record; None at the end of the file."""
    overlap = len(_MAGIC) - 1
    while True:
        file.seek(start)
        window = file.read(_WINDOW)
        found = window.find(_MAGIC)
        if found >= 0:
            return start + found
        if len(window) < _WINDOW:
            return None
        start += len(window) - overlap


class Journal:
    """Appends records to a journal from any thread; each append is synced to disk before it returns.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Journal.create(Path(folder, "a"), {"format": "test", "version": 1}) as journal:
    ...         journal.append(JournalRecord(b"I", 0, b"first"), JournalRecord(b"I", 1, b"second"))
    ...     payloads = [record.payload for record in JournalReader(Path(folder, "a")) if record.kind == b"I"]
    >>> payloads
    [b'first', b'second']
    """

    def __init__(self, path: Path, owner: bytes, end: int) -> None:
        self.path = path
        self._owner, self._end = owner, end
        self._lock = threading.Lock()
        self._file = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))

    @classmethod
    def create(cls, path: Path, header: Mapping[str, Any], *, number: int = 0) -> Self:
        """Create a journal with its header. `FileError` if the file exists."""
        record = json_record(HEADER, number, header)
        owner = _digest(record)
        content = _encoded(record, owner, 0)
        content += _encoded(record, owner, len(content))
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        return cls(path, owner, len(content))

    def append(self, *records: JournalRecord) -> None:
        """Append records, all or none.

        Raises
        ------
        FileNotFoundError
            If the file was removed or moved.
        OSError
            If the records cannot be written; the file is then as before.
        """
        with self._lock:
            content = b""
            for record in records:
                content += _encoded(record, self._owner, self._end + len(content))
            try:
                _write_at(self._file, self._end, content)
            except OSError:
                os.ftruncate(self._file, self._end)
                raise
            self._end += len(content)
            if not is_same_file(self.path, self._file):
                raise FileNotFoundError(errno.ENOENT, "it was removed or moved during writing")

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file < 0

    def close(self) -> None:
        """Close the file; may be called again."""
        if not self.closed:
            os.close(self._file)
            self._file = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close()


def _write_at(file: int, position: int, content: bytes) -> None:
    os.lseek(file, position, os.SEEK_SET)
    view = memoryview(content)
    while view:
        view = view[os.write(file, view) :]
    os.fsync(file)
