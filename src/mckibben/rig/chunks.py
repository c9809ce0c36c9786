"""The file format of a record: chunks in a row, each with its length and its checksum.

A file only ever grows. What a process that died left of its last chunk is told from a whole one by length and checksum,
and is passed over; all chunks before it stand. The layout is written down in docs/rig.md.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mckibben.errors import DatasetError, Problem

MAGIC = b"MCKCHUNK"
VERSION = 1

HEADER, SAMPLES, EVENT = b"H", b"S", b"E"
"""The kinds of chunk."""

_FRONT = struct.Struct("<8s1s3xIQQ")  # magic, kind, checksum, bytes of the payload, rows before it
_LARGEST = 1 << 31


class Column(NamedTuple):
    """One quantity of a record.

    Attributes
    ----------
    name, unit
        "force", "V" ...
    dtype
        A number type of NumPy by name, stored little-endian.
    """

    name: str
    unit: str
    dtype: str = "float64"

    @property
    def stored(self) -> np.dtype[Any]:
        """The type of the values in a file."""
        return np.dtype(self.dtype).newbyteorder("<")


class Chunk(NamedTuple):
    """One chunk of a file: its kind, how many rows came before it, and what it holds."""

    kind: bytes
    first: int
    payload: bytes


def pack(kind: bytes, first: int, payload: bytes) -> bytes:
    """A chunk as it is written.

    >>> pack(EVENT, 7, b"{}")[:8], len(pack(EVENT, 7, b"{}"))
    (b'MCKCHUNK', 34)
    """
    front = _FRONT.pack(MAGIC, kind, 0, len(payload), first)
    return _FRONT.pack(MAGIC, kind, zlib.crc32(payload, zlib.crc32(front)), len(payload), first) + payload


def pack_json(kind: bytes, first: int, content: Mapping[str, Any]) -> bytes:
    """A chunk that holds JSON."""
    return pack(kind, first, json.dumps(content, ensure_ascii=False, allow_nan=False).encode())


def chunks(path: Path) -> Iterator[Chunk]:
    """The whole chunks of a file, up to its end or to the first that is torn."""
    with path.open("rb") as file:
        while len(front := file.read(_FRONT.size)) == _FRONT.size:
            magic, kind, checksum, length, first = _FRONT.unpack(front)
            if magic != MAGIC or length > _LARGEST:
                return
            payload = file.read(length)
            blank = _FRONT.pack(magic, kind, 0, length, first)
            if len(payload) < length or zlib.crc32(payload, zlib.crc32(blank)) != checksum:
                return
            yield Chunk(kind, first, payload)


def pack_rows(columns: Sequence[Column], arrays: Sequence[np.ndarray]) -> bytes:
    """The payload of samples: one column after the other."""
    return b"".join(
        np.ascontiguousarray(array, column.stored).tobytes() for column, array in zip(columns, arrays, strict=True)
    )


def unpack_rows(columns: Sequence[Column], payload: bytes) -> dict[str, np.ndarray]:
    """The columns of a payload of samples, read-only.

    >>> columns = [Column("time", "s"), Column("count", "1", "int32")]
    >>> unpack_rows(columns, pack_rows(columns, [np.array([0.5, 1.5]), np.array([3, 4])]))["count"]
    array([3, 4], dtype=int32)
    """
    row = sum(column.stored.itemsize for column in columns)
    count, at = len(payload) // row, 0
    found: dict[str, np.ndarray] = {}
    for column in columns:
        found[column.name] = np.frombuffer(payload, column.stored, count, at)
        at += count * column.stored.itemsize
    return found


def read_header(path: Path) -> tuple[dict[str, Any], list[Column]]:
    """What stands at the beginning of a file: the header, and the columns.

    Raises
    ------
    DatasetError
        If the file is no record, or one of a later version.
    """
    with path.open("rb"):
        pass  # what the system objects to, in its own words
    front = next(chunks(path), None)
    if front is None or front.kind != HEADER:
        raise DatasetError(str(path), [Problem("is no record of a rig", remedy="give the folder of `rig run --out`")])
    content = json.loads(front.payload)
    if content["version"] != VERSION:
        message = f"is of version {content['version']}, and this mckibben reads version {VERSION}"
        raise DatasetError(str(path), [Problem(message, remedy="update mckibben")])
    return content, [Column(**column) for column in content["columns"]]
