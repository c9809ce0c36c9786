"""Study of a leg: what is computed is kept, so that an interrupted study can be continued."""

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
from mckibben.storage.store import open_store, read_store

Floats = NDArray[np.float64]


class StudyKind(NamedTuple):
    """Format of a study, its version, and what its blocks hold, in the plural."""

    format: str
    version: int
    contents: str

    def software(self, path: Path) -> Mapping[str, str] | None:
        """Software of the study in a file."""
        with read_store(path) as store:
            return (store.about() or {}).get("software")


def check_continued(journal: Path | None, resume: bool) -> None:
    """Raise `FileError` before the work if the study to be continued does not exist."""
    if resume and journal is not None and not journal.is_file():
        remedy = "leave out --resume (resume=True)"
        raise FileError(str(journal), [Problem("there is no study to continue", remedy=remedy)])


class StudyJournal:
    """Context with the finished blocks of a study, kept in a file if there is one; it locks out other processes.

    Raises `FileError` as `study_landing`.
    """

    def __init__(self, path: Path | None, kind: StudyKind, scenario: LegScenario, engine: str, resume: bool) -> None:
        self._path, self._resume = path, resume
        self._stack = ExitStack()
        self._about = {
            "format": kind.format,
            "version": kind.version,
            "software": software(engine),
            "leg": scenario.dumps(),
        }

    def __enter__(self) -> StudyJournal:
        with ExitStack() as stack:
            store = stack.enter_context(open_store(self._path, resume=self._resume))
            self._job = store.job(self._about)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> bool | None:
        return self._stack.__exit__(*error)  # type: ignore[arg-type]

    def found(self, number: int) -> dict[str, Floats] | None:
        """Return a kept block; None if it is to be computed."""
        return self._job.read_arrays(number) if number in self._job.numbers else None

    def keep(self, number: int, columns: dict[str, Floats]) -> None:
        """Keep a block."""
        if self._path is not None:
            self._job.add_arrays(number, columns)
