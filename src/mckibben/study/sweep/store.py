"""The folder of a sweep: its manifest, its finished blocks (each appears whole or not at all), and its table."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.errors import FileError, Problem
from mckibben.storage.files import atomic_write, check_free, file_lock, make_folder
from mckibben.study.reporting import write_json
from mckibben.study.sweep.blocks import Columns
from mckibben.study.sweep.plan import FORMAT, MANIFEST, Plan, SweepOptions, differences

BLOCKS = "blocks"
TABLE = "sweep.nc"
_LOCK = ".lock"
_FULL = (errno.ENOSPC, errno.EDQUOT)


class Store:
    """Keeps a sweep in a folder.

    Parameters
    ----------
    path
        The folder, made if need be.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.kept: set[int] = set()
        self._plan: Plan | None = None

    def begun(self) -> dict[str, Any] | None:
        """The manifest of a sweep in the folder; None if there is none.

        Raises
        ------
        FileError
            If it cannot be read.
        """
        path = self.path / MANIFEST
        try:
            text = path.read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(str(path), [Problem(f"it cannot be read: {error}")]) from None
        try:
            manifest = json.loads(text)
            if manifest["format"] != FORMAT:
                raise ValueError  # of another time
            if not all(isinstance(each, str) for each in [manifest["scenario"], *manifest["over"]]):
                raise TypeError
            return {name: manifest[name] for name in (*SweepOptions._fields, *manifest)}
        except (ValueError, KeyError, TypeError):
            remedy = "choose another folder, or remove this one"
            raise FileError(str(path), [Problem("it is no manifest of a sweep", remedy=remedy)]) from None

    def check_free(self) -> None:
        """Raise if there is a sweep already, or anything else of the names of its files.

        Raises
        ------
        FileError
            Which says what is there.
        """
        if self.begun() is not None:
            remedy = "go on with --resume (resume=True), or choose another folder"
            raise FileError(str(self.path), [Problem("there is a sweep already", remedy=remedy)])
        blocks = [f"{BLOCKS}/{path.name}" for path in (self.path / BLOCKS).glob("*.block")]
        check_free(self.path, [TABLE, *sorted(blocks)])

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Keep other processes out; the folder is made if need be.

        Raises
        ------
        FileError
            If another process is computing this sweep.
        """
        self._make()
        with file_lock(self.path / _LOCK, "computing this sweep"):
            yield

    def begin(self, plan: Plan) -> None:
        """Write the manifest of a new sweep.

        Raises
        ------
        FileError
            As for `check_free`.
        """
        self.check_free()
        self._plan = plan
        self._make()
        with self.room():
            write_json(self.path / MANIFEST, plan.manifest)

    def go_on(self, plan: Plan, begun: dict[str, Any]) -> None:
        """Go on with a sweep that was begun.

        Raises
        ------
        FileError
            If it was begun with something else; it names what.
        """
        found = differences(begun, plan.manifest)
        if found:
            raise FileError(str(self.path), found)
        plan.manifest["source"] = begun.get("source", "")
        self._plan = plan

    def look(self) -> list[Path]:
        """Find out which blocks are there; the answer are those that are damaged, and count as missing."""
        there = [block for block in range(self.plan.blocks) if self._path(block).exists()]
        whole_ones = {block for block in there if self._read(block) is not None}
        self.kept |= whole_ones
        return [self._path(block) for block in there if block not in whole_ones]

    @property
    def plan(self) -> Plan:
        """The sweep that is kept here."""
        assert self._plan is not None  # begun or gone on with
        return self._plan

    @property
    def missing(self) -> list[int]:
        """The blocks that are yet to be computed."""
        return [block for block in range(self.plan.blocks) if block not in self.kept]

    @property
    def runs(self) -> int:
        """How many runs are kept."""
        spans = [self.plan.span(block) for block in self.kept]
        return sum(span.stop - span.start for span in spans)

    def keep(self, block: int, columns: Columns) -> None:
        """Write the answers of a block; several threads may do so at once.

        Raises
        ------
        FileError
            If the disk is full.
        """
        content = io.BytesIO()
        np.savez(content, **columns)  # type: ignore[arg-type]  # names of ours, none of savez's own
        with self.room(), atomic_write(self._path(block), overwrite=True) as part:
            part.write_bytes(self._seal(block, content.getvalue()) + content.getvalue())
        self.kept.add(block)

    def columns(self) -> Columns:
        """The answers of all blocks.

        Raises
        ------
        FileError
            If one was damaged since it was written.
        """
        parts = []
        for block in range(self.plan.blocks):
            part = self._read(block)
            if part is None:
                remedy = "go on with --resume (resume=True): it will be computed again"
                raise FileError(str(self._path(block)), [Problem("it is damaged", remedy=remedy)])
            parts.append(part)
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def check_room(self, size: int) -> None:
        """Raise as `keep` does unless there is room for a file of so many bytes; HDF5 is not good at running out."""
        with self.room():
            if shutil.disk_usage(self.path).free < 1.2 * size + 200_000:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def tidy(self) -> None:
        """Remove what a killed process left half-written."""
        for place in (self.path, self.path / BLOCKS):
            for part in place.glob(".*.part"):
                part.unlink(missing_ok=True)

    @contextmanager
    def room(self) -> Iterator[None]:
        """Say of a full disk what is kept, and what to do."""
        try:
            yield
        except OSError as error:
            if error.errno not in _FULL and "No space left" not in str(error):
                raise
            kept = f"; {self.runs} of {self.plan.rows} runs are kept" if self._plan is not None else ""
            message = f"the disk is full{kept}"
            remedy = "make room, and go on with --resume (resume=True)"
            raise FileError(str(self.path), [Problem(message, remedy=remedy)]) from None

    def _make(self) -> None:
        with self.room():
            make_folder(make_folder(self.path) / BLOCKS)

    def _path(self, block: int) -> Path:
        return self.path / BLOCKS / f"{block:06d}.block"

    def _seal(self, block: int, content: bytes) -> bytes:
        """A line that only this content has, as this block of this sweep."""
        about = f"mckibben sweep {self.plan.identity} block {block}\n".encode()
        return hashlib.sha256(about + content).hexdigest().encode() + b"\n"

    def _read(self, block: int) -> Columns | None:
        """The answers of a block; None if it is missing or damaged."""
        try:
            content = self._path(block).read_bytes()
        except OSError:
            return None
        seal, _, content = content.partition(b"\n")
        if seal + b"\n" != self._seal(block, content):
            return None
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return dict(file.items())
