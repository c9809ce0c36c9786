"""Large texts of numbers, read in pieces."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mckibben.dataset.encodings import decode
from mckibben.dataset.sheet import RawTable, count_rows, numeric_bytes, parse_numbers
from mckibben.dataset.text import check_last_line, read_text, split_numbers
from mckibben.errors import DatasetError

_HEAD = 2**16  # bytes from which header, delimiter and decimal sign are determined
_PIECE = 2**24  # bytes


def read_large_text(path: Path, known: Callable[[str, str], bool], decimal: str) -> RawTable | None:
    """Columns of a text with nothing but numbers under its header; None for any other text, also for one in doubt."""
    with path.open("rb") as file:
        end = os.fstat(file.fileno()).st_size  # not what is added meanwhile
        head = file.read(_HEAD)
        head = head[: head.rfind(b"\n") + 1]
        try:
            sheet = read_text(decode(head, "")[0], "", known, decimal=decimal)
        except DatasetError:
            return None
        read = all(isinstance(column.cells, np.ndarray) for column in sheet.channels)
        if not read or sheet.delimiter == " " or sheet.problems or sheet.corrupt:
            return None
        lines = head.splitlines(keepends=True)
        first = sheet.channels[0].lines[0]
        start, body = sum(map(len, lines[: first - 1])), b"".join(lines[first - 1 :])
        sign = "," if b"," in body and sheet.delimiter != "," else "."
        certain = sheet.delimiter == "," or sign.encode() in body  # otherwise a first 1.234 may follow
        allowed = numeric_bytes(sheet.delimiter, sign if certain else "")
        counts: list[int] = []  # of rows in each piece
        tail = b""
        for piece in _pieces(file, start, end):
            if piece.translate(None, allowed):
                return None
            counts.append(count_rows(piece))
            tail = piece[-_HEAD:]
        rows = sum(counts)
        numbers = np.empty((len(sheet.channels), rows))
        at = 0
        try:
            for piece, count in zip(_pieces(file, start, end), counts, strict=True):
                part = parse_numbers(piece, sheet.delimiter, sign, len(numbers))
                if len(part) != count:
                    return None
                numbers[:, at : at + count] = part.T
                at += count
        except ValueError:  # an empty cell, rows of unequal length, or a file that has changed meanwhile
            return None
    places = range(first, first + rows)
    sheet.channels = [
        replace(column, cells=cells, lines=places) for column, cells in zip(sheet.channels, numbers, strict=True)
    ]
    sheet.suspect = [*dict.fromkeys([*sheet.suspect, *split_numbers(sheet, known)])]
    check_last_line(tail.decode(), places[-1], 0, sheet)
    return sheet


def _pieces(file: BinaryIO, start: int, end: int) -> Iterator[bytes]:
    """Pieces of whole lines between two positions of the file."""
    file.seek(start)
    rest = b""
    while piece := file.read(min(_PIECE, end - file.tell())):
        cut = piece.rfind(b"\n") + 1
        if cut:
            yield rest + piece[:cut]
            rest = piece[cut:]
        else:
            rest += piece
    if rest:
        yield rest
