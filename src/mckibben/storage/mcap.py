"""MCAP files, https://mcap.dev: rows of numbers with units, and events; needs the package mcap."""

from __future__ import annotations

import errno
import importlib
import json
import math
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic_core import from_json

from mckibben.errors import RigError
from mckibben.storage.files import atomic_write, is_same_file

SAMPLES, EVENTS = "samples", "events"
"""Topics of a record; their channels are numbered from 1."""
MAGIC = b"\x89MCAP0\r\n"
"""First and last bytes of a whole file."""


def library(name: str) -> Any:
    """Module of the package mcap, or zstandard; `RigError` if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        message = f"the package {name.split('.')[0]} is missing, which records are written and read with"
        raise RigError(message, remedy="pip install 'mckibben[rig]'") from error


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


def pack_rows(columns: Sequence[Column], rows: Iterable[Sequence[float]]) -> Iterator[bytes]:
    """Return rows as objects of JSON; numbers that are missing (NaN) are left out.

    Parameters
    ----------
    columns, rows
        Columns, and a number for each of them in each row.

    Examples
    --------
    >>> columns = [Column("time", "s"), Column("force", "N", "float32")]
    >>> packed = [*pack_rows(columns, [(0.0, math.nan), (0.1, 2.0)])]
    >>> packed, unpack_rows(columns, packed)["force"].tolist()
    ([b'{"time":0.0}', b'{"time":0.1,"force":2}'], [nan, 2.0])
    """
    forms = [f'"{column.name}":{_FORMATS.get(column.dtype, "%d")}' for column in columns]
    whole = "{" + ",".join(forms) + "}"
    for row in rows:
        if all(map(math.isfinite, row)):
            yield (whole % tuple(row)).encode()
        else:
            finite = [form % value for form, value in zip(forms, row, strict=True) if math.isfinite(value)]
            yield ("{" + ",".join(finite) + "}").encode()


_FORMATS = {"float64": "%r", "float32": "%.9g"}


def unpack_rows(columns: Sequence[Column], packed: Iterable[bytes]) -> dict[str, np.ndarray]:
    """Columns of packed rows."""
    rows = from_json(b"[" + b",".join(packed) + b"]")
    return {column.name: np.array([row.get(column.name, math.nan) for row in rows], column.dtype) for column in columns}


class McapWriter:
    """Appends chunks of messages to a new MCAP file, https://mcap.dev/spec; each is on the disk when `append` returns.

    A file that was closed has a summary, by which other tools seek in it.

    Parameters
    ----------
    path
        New file.
    columns
        Columns of the samples, whose messages have the channel 1; events have the channel 2.
    attachments
        Files that it carries, by name.
    """

    def __init__(self, path: Path, columns: Sequence[Column], attachments: Mapping[str, bytes]) -> None:
        self.path, self._records, self._zstd = path, library("mcap.records"), library("zstandard")
        self._indexes: list[Any] = []
        self._attached: list[Any] = []
        self._counts = {1: 0, 2: 0}
        self._channels: list[Any] = []
        units = {column.name: {"type": "number", "unit": column.unit} for column in columns}
        for number, (topic, numbers) in enumerate(((SAMPLES, units), (EVENTS, {})), start=1):
            schema = json.dumps({"type": "object", "title": topic, "properties": numbers}).encode()
            self._channels.append(self._records.Schema(number, schema, "jsonschema", topic))
            self._channels.append(self._records.Channel(number, topic, "json", {}, number))
        content = MAGIC + _packed(self._records.Header(profile="", library="mckibben"))
        for name, data in attachments.items():
            packed = _packed(self._records.Attachment(0, 0, name, "text/plain", data))
            size = len(content), len(packed), 0, 0, len(data)
            self._attached.append(self._records.AttachmentIndex(*size, name, "text/plain"))
            content += packed
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        self._file, self._end = path.open("r+b", buffering=0), len(content)

    def append(self, chunks: Iterable[Sequence[tuple[int, int, float, bytes]]]) -> None:
        """Append chunks of messages: channel, sequence, time [s] and data.

        Raises
        ------
        FileNotFoundError
            If the file was removed or moved.
        OSError
            If they cannot be written; the file is then as before.
        """
        content, indexes = b"", []
        for chunk in chunks:
            packed, index = self._chunk(chunk, self._end + len(content))
            content += packed
            indexes.append(index)
        self._write(content)
        self._indexes += indexes
        self._end += len(content)
        if not is_same_file(self.path, self._file.fileno()):
            raise FileNotFoundError(errno.ENOENT, "it was removed or moved during writing")

    def _chunk(self, messages: Sequence[tuple[int, int, float, bytes]], position: int) -> tuple[bytes, Any]:
        """Chunk of messages at a position of the file, and its index."""
        records, times = [*self._channels], []
        for channel, sequence, time_s, data in messages:
            times.append(round(max(time_s, 0.0) * 1e9))
            records.append(self._records.Message(channel, times[-1], data, times[-1], sequence & 0xFFFFFFFF))
            self._counts[channel] += 1
        content, first, last = _packed(*records), min(times), max(times)
        packed = self._zstd.compress(content)
        record = _packed(self._records.Chunk("zstd", packed, last, first, zlib.crc32(content), len(content)))
        sizes = len(record), position, "zstd", len(packed)
        return record, self._records.ChunkIndex(*sizes, last, 0, {}, first, len(content))

    def close(self, *, summary: bool = True) -> None:
        """Close the file with its summary; may be called again."""
        with self._file:
            if summary and not self._file.closed:
                self._write(self._summary())

    def _summary(self) -> bytes:
        end = _packed(self._records.DataEnd(0))
        times = [(index.message_start_time, index.message_end_time) for index in self._indexes] or [(0, 0)]
        starts, ends = zip(*times, strict=True)
        counts = len(self._attached), 2, self._counts, len(self._indexes), sum(self._counts.values())
        statistics = self._records.Statistics(*counts, max(ends), min(starts), 0, 2)
        summary = _packed(*self._channels, statistics, *self._indexes, *self._attached)
        return end + summary + _packed(self._records.Footer(self._end + len(end), 0, 0)) + MAGIC

    def _write(self, content: bytes) -> None:
        """Write at the end, and sync."""
        try:
            self._file.seek(self._end)
            view = memoryview(content)
            while view:
                view = view[self._file.write(view) :]
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(self._end)
            raise


def _packed(*records: Any) -> bytes:
    builder = library("mcap.data_stream").RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def write_samples(path: Path, columns: Mapping[str, tuple[str, np.ndarray]], attachments: Mapping[str, bytes]) -> None:
    """Write columns, each a unit and values of shape (rows,) and the first of them the time [s], and files by name."""
    described = [Column(name, unit) for name, (unit, _) in columns.items()]
    table = np.stack([np.asarray(values, np.float64) for _, values in columns.values()], axis=1)
    path.unlink(missing_ok=True)
    writer = McapWriter(path, described, attachments)
    for first in range(0, len(table), 1000):
        rows = table[first : first + 1000].tolist()
        packed = zip(rows, pack_rows(described, rows), strict=True)
        writer.append([[(1, first + at, row[0], data) for at, (row, data) in enumerate(packed)]])
    writer.close()
