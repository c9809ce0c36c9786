"""MCAP files that survive: each append is a chunk of its own on the disk, and a reader takes all intact chunks.

The format is that of https://mcap.dev/spec; a file that was closed has a summary, by which other tools seek in it.
"""

from __future__ import annotations

import errno
import importlib
import io
import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from mckibben.errors import RigError
from mckibben.storage.files import atomic_write, is_same_file

MAGIC = b"\x89MCAP0\r\n"
_HEADER, _CHUNK, _ATTACHMENT, _DATA_END = 0x01, 0x06, 0x09, 0x0F
_FRONT = struct.Struct("<BQ")
"""Opcode and length of a record."""
_MESSAGE = struct.Struct("<BQHIQQ")
"""Front of a message with its topic, sequence, time and time of publication [ns]."""
_CHUNK_MARK, _CHUNK_FIELDS = b"\x04\0\0\0zstd", struct.Struct("<QQQI")
"""Name of the compression in a chunk, after its times, size and checksum: where to look for the next chunk."""
MESSAGE_OPCODE = 0x05


def library(name: str) -> ModuleType:
    """Module of the package mcap, or zstandard; `RigError` if it is not installed."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        message = f"the package {name.split('.')[0]} is missing, which records are written and read with"
        raise RigError(message, remedy="pip install 'mckibben[rig]'") from error


class Topic(NamedTuple):
    """Topic of a file: its name, and the unit of each number of its messages, which are flat objects of JSON."""

    name: str
    units: Mapping[str, str]

    def schema(self) -> bytes:
        """JSON schema of its messages."""
        numbers = {name: {"type": "number", "unit": unit} for name, unit in self.units.items()}
        return json.dumps({"type": "object", "title": self.name, "properties": numbers}).encode()


class McapMessage(NamedTuple):
    """McapMessage of a file.

    Attributes
    ----------
    topic
        Number of its topic, from 0.
    sequence
        Number among the messages of its topic, as the writer counts.
    time
        Time [s], at least 0.
    data
        Object of JSON.
    """

    topic: int
    sequence: int
    time: float
    data: bytes


class McapWriter:
    """Appends chunks of messages from any thread; each append is synced to disk before it returns.

    Parameters
    ----------
    path
        New file.
    topics
        Its topics.
    attachments
        Files that it carries, by name; each is written twice, so that one survives damage.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp(), "a.mcap")
    >>> writer = McapWriter(path, [Topic("samples", {"force": "N"})], {"protocol.yaml": b"name: ours"})
    >>> writer.append([McapMessage(0, 7, 0.5, b'{"force": 585.0}')])
    >>> writer.close()
    >>> attachment, _, (message,) = McapReader(path)
    >>> attachment, message
    (('protocol.yaml', b'name: ours'), McapMessage(topic=0, sequence=7, time=0.5, data=b'{"force": 585.0}'))
    """

    def __init__(self, path: Path, topics: Sequence[Topic], attachments: Mapping[str, bytes]) -> None:
        self.path, self._topics = path, topics
        self._records, self._zstd = library("mcap.records"), library("zstandard").ZstdCompressor()
        self._indexes: list[Any] = []
        self._counts = dict.fromkeys(range(1, len(topics) + 1), 0)
        content = MAGIC + self._packed(self._records.Header(profile="", library="mckibben"))
        self._attached: list[Any] = []
        for name, data in [*attachments.items()] * 2:
            packed = self._packed(self._records.Attachment(0, 0, name, "text/plain", data))
            size = len(content), len(packed), 0, 0, len(data)
            self._attached.append(self._records.AttachmentIndex(*size, name, "text/plain"))
            content += packed
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        self._end = len(content)
        self._file = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0))

    def append(self, *chunks: Sequence[McapMessage]) -> None:
        """Append chunks of messages, all or none.

        Raises
        ------
        FileNotFoundError
            If the file was removed or moved.
        OSError
            If they cannot be written; the file is then as before.
        """
        content, indexes = b"", []
        for messages in chunks:
            packed, index = self._chunk(messages, self._end + len(content))
            content += packed
            indexes.append(index)
        self._write(content)
        self._indexes += indexes
        self._end += len(content)
        if not is_same_file(self.path, self._file):
            raise FileNotFoundError(errno.ENOENT, "it was removed or moved during writing")

    def _chunk(self, messages: Sequence[McapMessage], position: int) -> tuple[bytes, Any]:
        """Chunk of messages at a position of the file, and its index."""
        body = [self._packed(*self._channels())]
        stamps = [round(message.time * 1e9) for message in messages]
        for (topic, sequence, _, data), stamp in zip(messages, stamps, strict=True):
            body += [_MESSAGE.pack(MESSAGE_OPCODE, len(data) + 22, topic + 1, sequence, stamp, stamp), data]
            self._counts[topic + 1] += 1
        content, first, last = b"".join(body), min(stamps), max(stamps)
        packed = self._zstd.compress(content)
        chunk = self._records.Chunk("zstd", packed, last, first, zlib.crc32(content), len(content))
        record, size = self._packed(chunk), len(content)
        index = self._records.ChunkIndex(len(record), position, "zstd", len(packed), last, 0, {}, first, size)
        return record, index

    @property
    def closed(self) -> bool:
        """Whether the file is closed."""
        return self._file < 0

    def close(self, *, summary: bool = True) -> None:
        """Close the file with its summary; may be called again."""
        if self.closed:
            return
        try:
            if summary:
                self._write(self._summary())
        finally:
            os.close(self._file)
            self._file = -1

    def _channels(self) -> Iterator[Any]:
        for number, topic in enumerate(self._topics, start=1):
            yield self._records.Schema(number, topic.schema(), "jsonschema", topic.name)
            yield self._records.Channel(number, topic.name, "json", {}, number)

    def _summary(self) -> bytes:
        end = self._packed(self._records.DataEnd(0))
        starts = [index.message_start_time for index in self._indexes] or [0]
        ends = [index.message_end_time for index in self._indexes] or [0]
        topics, chunks = len(self._topics), len(self._indexes)
        messages, attached = sum(self._counts.values()), len(self._attached)
        statistics = self._records.Statistics(
            attached, topics, self._counts, chunks, messages, max(ends), min(starts), 0, topics
        )
        summary = self._packed(*self._channels(), statistics, *self._indexes, *self._attached)
        return end + summary + self._packed(self._records.Footer(self._end + len(end), 0, 0)) + MAGIC

    def _packed(self, *records: Any) -> bytes:
        builder = library("mcap.data_stream").RecordBuilder()
        for record in records:
            record.write(builder)
        return builder.end()

    def _write(self, content: bytes) -> None:
        try:
            write_at(self._file, self._end, content)
        except OSError:
            os.ftruncate(self._file, self._end)
            raise


def write_at(file: int, position: int, content: bytes) -> None:
    """Write at a position of an open file, and sync."""
    os.lseek(file, position, os.SEEK_SET)
    view = memoryview(content)
    while view:
        view = view[os.write(file, view) :]
    os.fsync(file)


def _next_chunk(content: mmap.mmap, start: int) -> int:
    """Position of the next chunk; -1 for none."""
    mark = start + _FRONT.size + _CHUNK_FIELDS.size
    while (mark := content.find(_CHUNK_MARK, mark)) >= 0:
        begin = mark - _FRONT.size - _CHUNK_FIELDS.size
        if content[begin] == _CHUNK:  # not its index
            return begin
        mark += 1
    return -1


class McapReader:
    """Iterates over the intact parts of a file: attachments as name and content, chunks as lists of messages.

    Parameters
    ----------
    path
        A file of `McapWriter`.

    Attributes
    ----------
    damaged
        Number of damaged parts so far; an incomplete end is not one.
    is_cut
        Whether the last part is incomplete.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damaged = 0
        self.is_cut = False

    def __iter__(self) -> Iterator[tuple[str, bytes] | list[McapMessage]]:
        with self.path.open("rb") as file:
            if os.fstat(file.fileno()).st_size <= len(MAGIC):
                return
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
                yield from self._parts(content)

    def _parts(self, content: mmap.mmap) -> Iterator[tuple[str, bytes] | list[McapMessage]]:
        at = len(MAGIC)
        while at + _FRONT.size <= len(content):
            opcode, length = _FRONT.unpack_from(content, at)
            begin, end = at + _FRONT.size, at + _FRONT.size + length
            found = self._part(opcode, content[begin:end]) if end <= len(content) else None
            if found is not None:
                yield found
            elif opcode == _DATA_END and length == 4:
                return
            elif opcode != _HEADER or end > len(content):
                self.is_cut = end > len(content)
                end = _next_chunk(content, at + 1)
                if end < 0:  # nothing follows: it is cut, as by a kill, unless all of it is there
                    self.damaged += not self.is_cut
                    return
                self.damaged += 1
            at = end

    def _part(self, opcode: int, body: bytes) -> tuple[str, bytes] | list[McapMessage] | None:
        """Content of an attachment or a chunk; None if it is damaged."""
        try:
            if opcode == _ATTACHMENT and zlib.crc32(body[:-4]) == int.from_bytes(body[-4:], "little"):
                stream = library("mcap.data_stream").ReadDataStream(io.BytesIO(body))
                attachment = library("mcap.records").Attachment.read(stream)
                return attachment.name, attachment.data
            if opcode == _CHUNK:
                return self._messages(body)
        except Exception:  # whatever damaged bytes lead to
            return None
        return None

    def _messages(self, body: bytes) -> list[McapMessage] | None:
        _, _, size, checksum = _CHUNK_FIELDS.unpack_from(body)
        rest = body[_CHUNK_FIELDS.size :]
        if not rest.startswith(_CHUNK_MARK):
            return None
        packed = rest[len(_CHUNK_MARK) + 8 :]
        content = library("zstandard").ZstdDecompressor().decompress(packed, max_output_size=size)
        if zlib.crc32(content) != checksum:
            return None
        messages, at = [], 0
        while at < len(content):
            opcode, length = _FRONT.unpack_from(content, at)
            if opcode == MESSAGE_OPCODE:
                _, _, topic, sequence, time, _ = _MESSAGE.unpack_from(content, at)
                data = content[at + _MESSAGE.size : at + _FRONT.size + length]
                messages.append(McapMessage(topic - 1, sequence, time / 1e9, data))
            at += _FRONT.size + length
        return messages
