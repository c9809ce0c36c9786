"""What a recorder left, read back: whole, or chunk by chunk."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mckibben.errors import DatasetError, Problem
from mckibben.rig.chunks import EVENT, SAMPLES, Column, chunks, read_header, unpack_rows


class Event(NamedTuple):
    """Something that happened.

    Attributes
    ----------
    kind, text
        In one word, and in words.
    row
        How many rows of the record came before.
    data
        What belongs to it.
    """

    kind: str
    text: str
    row: int
    data: dict[str, Any]


class Rows(NamedTuple):
    """Rows of a record that were written together: the number of the first, and the columns."""

    first: int
    columns: dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Record:
    """A record in memory.

    Attributes
    ----------
    header
        As the first recorder was given it.
    units
        Of the columns, by name.
    columns
        Of each name an array of all rows.
    events
        In their order.
    """

    header: dict[str, Any]
    units: dict[str, str]
    columns: dict[str, np.ndarray]
    events: tuple[Event, ...]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))


def read_record(folder: str | os.PathLike[str]) -> Record:
    """Read a record; what a process that died left of its last chunk is passed over.

    Raises
    ------
    DatasetError
        If there is none, or rows are missing from the middle of it.
    """
    header, columns = header_of(folder)
    rows: list[dict[str, np.ndarray]] = []
    events: list[Event] = []
    for one in passages(folder):
        if isinstance(one, Event):
            events.append(one)
        else:
            rows.append(one.columns)
    empty = {column.name: np.empty(0, column.dtype) for column in columns}
    found = {
        name: np.concatenate([nothing, *(part[name] for part in rows)]).astype(nothing.dtype, copy=False)
        for name, nothing in empty.items()
    }
    return Record(header, {column.name: column.unit for column in columns}, found, tuple(events))


def header_of(folder: str | os.PathLike[str]) -> tuple[dict[str, Any], list[Column]]:
    """The header of a record and its columns.

    Raises
    ------
    DatasetError
        If there is none.
    """
    there = segments(Path(folder))
    if not there:
        raise DatasetError(
            str(folder), [Problem("holds no record of a rig", remedy="give the folder of `rig run --out`")]
        )
    content, columns = read_header(there[0])
    return content["header"], columns


def passages(folder: str | os.PathLike[str]) -> Iterator[Rows | Event]:
    """Rows and events of a record in their order, a chunk at a time: as much memory as one chunk takes.

    Raises
    ------
    DatasetError
        If there is no record, or rows are missing from the middle of it.
    """
    expected = 0
    for path in segments(Path(folder)):
        _, columns = read_header(path)
        for chunk in chunks(path):
            if chunk.first != expected:
                message = f"rows {expected} to {chunk.first - 1} are missing, or {expected - chunk.first} stand twice"
                raise DatasetError(str(path), [Problem(message, remedy="the file was changed, or one is missing")])
            if chunk.kind == SAMPLES:
                rows = unpack_rows(columns, chunk.payload)
                expected += len(rows[columns[0].name])
                yield Rows(chunk.first, rows)
            elif chunk.kind == EVENT:
                content = json.loads(chunk.payload)
                yield Event(content["kind"], content["text"], chunk.first, content["data"])


def rows_in(folder: str | os.PathLike[str]) -> int:
    """How many rows a record has."""
    return max((one.first + len(next(iter(one.columns.values()))) for one in _rows(folder)), default=0)


def segments(folder: Path) -> list[Path]:
    """The files of a record in their order; none where there is no folder."""
    return sorted(folder.glob("record-*.chunks"))


def _rows(folder: str | os.PathLike[str]) -> Iterator[Rows]:
    return (one for one in passages(folder) if isinstance(one, Rows))
