"""Journal of a study of a leg: what is computed is kept, so that an interrupted study can be continued."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import FileError, Problem
from mckibben.leg.scenario import LegScenario
from mckibben.simulation.software import software
from mckibben.storage.files import explain_write_errors, file_lock
from mckibben.storage.journal import (
    Journal,
    JournalReader,
    array_record,
    header_differences,
    read_header,
    unpack_arrays,
)

Floats = NDArray[np.float64]

_BLOCK = b"B"


class StudyKind(NamedTuple):
    """Format of a journal, its version, and what its blocks hold, in the plural."""

    format: str
    version: int
    contents: str

    def software(self, path: Path) -> Mapping[str, str] | None:
        """Software of the study in a journal."""
        return read_header(path, self.format, self.version).get("software")


def check_continued(journal: Path | None, resume: bool) -> None:
    """Raise `FileError` before the work if the study to be continued does not exist."""
    if resume and journal is not None and not journal.is_file():
        remedy = "leave out --resume (resume=True)"
        raise FileError(str(journal), [Problem("there is no study to continue", remedy=remedy)])


class StudyJournal:
    """Context with the finished blocks of a study, kept in a journal if there is one; it locks out other processes.

    Raises `FileError` as `study_landing`.
    """

    def __init__(self, path: Path | None, kind: StudyKind, scenario: LegScenario, engine: str, resume: bool) -> None:
        self._path, self._kind, self._resume = path, kind, resume
        self._kept: dict[int, bytes] = {}
        self._journal: Journal | None = None
        self._stack = ExitStack()
        self._header = {
            "format": kind.format,
            "version": kind.version,
            "software": software(engine),
            "leg": scenario.dumps(),
        }

    def __enter__(self) -> StudyJournal:
        path = self._path
        if path is None:
            return self
        kept, remedy = f"finished {self._kind.contents} are kept", "make room, and continue with --resume (resume=True)"
        with ExitStack() as stack:
            stack.enter_context(file_lock(path.with_name(f".{path.name}.lock"), "computing this study"))
            stack.enter_context(explain_write_errors(path.parent, lambda: kept, remedy))
            self._journal = self._continued(path) if self._resume else Journal.create(path, self._header)
            stack.callback(self._journal.close)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> bool | None:
        return self._stack.__exit__(*error)  # type: ignore[arg-type]

    def _continued(self, path: Path) -> Journal:
        """An existing journal, with its blocks."""
        remedy = "continue with the same leg, or begin anew with --force"
        before = read_header(path, self._kind.format, self._kind.version)
        if problems := header_differences(before, self._header, "the study", remedy=remedy):
            raise FileError(str(path), problems)
        reader = JournalReader(path)
        self._kept = {record.number: record.payload for record in reader if record.kind == _BLOCK}
        reader.warn_of_damage("blocks")
        return Journal.resume(reader)

    def found(self, number: int) -> dict[str, Floats] | None:
        """Return a kept block; None if it is to be computed."""
        content = self._kept.get(number)
        return None if content is None else unpack_arrays(content)

    def keep(self, number: int, columns: dict[str, Floats]) -> None:
        """Append a block."""
        if self._journal is not None:
            self._journal.append(array_record(_BLOCK, number, columns))
