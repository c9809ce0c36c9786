"""Submissions and baselines in tasks: errors with intervals, as a table and in files."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.bench.baselines import BASELINES, Fit
from mckibben.bench.submission import predictions, read_submission
from mckibben.bench.task import ScoreInterval, Task, TaskScore
from mckibben.errors import McKibbenError, ParameterError, SubmissionError, suggest
from mckibben.storage.files import atomic_write

REFERENCE = "eq2"
"""Baseline to which errors are relative."""

FILES = ("scores.csv", "blocks.csv", "results.json")


@dataclass(frozen=True, eq=False)
class BenchEntry:
    """One submission or baseline in one task; without score if it does not apply, or the data do not determine it."""

    task: str
    method: str
    score: TaskScore | None
    relative: ScoreInterval | None
    seconds: float
    reason: str = ""


@dataclass(frozen=True, eq=False)
class BenchTable:
    """Entries of all tasks, the tasks, and whether a submission failed in one."""

    entries: tuple[BenchEntry, ...]
    tasks: tuple[Task, ...]
    failed: bool = False

    headers = ("task", "method", "NRMSE", "95 %", "relative to Eq. 2", "95 %", "s", "")

    def rows(self) -> list[tuple[str, ...]]:
        """Rows of the table as text."""
        found: list[tuple[str, ...]] = []
        for one in self.entries:
            error, relative = _shown(one.score.nrmse if one.score else None), _shown(one.relative)
            found.append((one.task, one.method, *error, *relative, f"{one.seconds:.1f}", one.reason))
        return found

    def records(self) -> dict[str, Any]:
        """Tasks with digests, and entries, as numbers."""
        tasks = {
            one.name: {"kind": one.training.kind, "digest": one.digest(), "source": one.source} for one in self.tasks
        }
        entries = [
            {
                "task": one.task,
                "method": one.method,
                "nrmse": one.score.nrmse._asdict() if one.score else None,
                "relative": one.relative._asdict() if one.relative else None,
                "blocks": one.score.by_block() if one.score else {},
                "seconds": one.seconds,
                "reason": one.reason,
            }
            for one in self.entries
        ]
        return {"tasks": tasks, "entries": entries}

    def save(self, folder: Path) -> None:
        """Write scores.csv, one row per task and method, and blocks.csv, one row per test block and method."""
        scores: list[tuple[object, ...]] = [
            ("task", "method", "nrmse", "nrmse_lower", "nrmse_upper", "relative", "relative_lower", "relative_upper")
        ]
        blocks: list[tuple[object, ...]] = [("task", "method", "block", "nrmse")]
        for one in self.entries:
            if one.score:
                scores.append((one.task, one.method, *one.score.nrmse, *(one.relative or ("", "", ""))))
                blocks += [(one.task, one.method, *row) for row in one.score.by_block().items()]
        for name, table in zip(FILES, (scores, blocks), strict=False):
            with (
                atomic_write(folder / name, overwrite=True) as part,
                part.open("w", encoding="utf-8", newline="") as to,
            ):
                csv.writer(to).writerows(table)


def _shown(one: ScoreInterval | None) -> tuple[str, str]:
    if one is None:
        return "-", "-"
    return f"{one.value:.4f}", "-" if np.isnan(one.lower) else f"{one.lower:.4f}..{one.upper:.4f}"


def compare_submissions(
    tasks: Sequence[Task],
    submissions: Sequence[str | os.PathLike[str]] = (),
    baselines: Sequence[str] = tuple(BASELINES),
    *,
    progress: Callable[[str, float], None] | None = None,
) -> BenchTable:
    """Fit submissions and baselines to the training data of tasks, and score them on the test data.

    Submissions are run before the baselines, so that their mistakes are found first. Errors are also given relative to
    the baseline "eq2" if it is among the baselines.

    Raises
    ------
    SubmissionError
        If a submission cannot be read; it names the file. One that fails in a task has no score there, but a reason.
    ParameterError
        If a baseline does not exist, or two tasks or methods have one name.
    """
    for one in baselines:
        if one not in BASELINES:
            raise ParameterError(f"there is no baseline {one!r}", value=one, remedy=suggest(one, list(BASELINES)))
    files = {Path(one).stem: os.fspath(one) for one in submissions}
    names = [*(Path(one).stem for one in submissions), *baselines]
    if repeated := [one for one in names if names.count(one) > 1]:
        raise ParameterError(f"two methods are named {repeated[0]!r}", value=repeated[0], remedy="rename a file")
    if len({one.name for one in tasks}) < len(tasks):
        raise ParameterError("two tasks have one name", field="name", remedy="rename one in its task.yaml")
    fits: Mapping[str, Fit] = {name: read_submission(file) for name, file in files.items()}
    fits = {**fits, **{name: BASELINES[name] for name in baselines}}
    runs = [(task, method) for method in fits for task in tasks]
    found: dict[tuple[str, str], tuple[TaskScore | None, float, str]] = {}
    failed = False
    for number, (task, method) in enumerate(runs):
        if progress:
            progress(f"{method}: {task.name}", number / len(runs))
        begun, score, reason = time.monotonic(), None, ""
        try:
            predicted = predictions(fits[method], task, files.get(method, ""))
            score = task.score(predicted) if predicted is not None else None
            reason = "" if score else "does not apply"
        except McKibbenError as error:  # the other results are kept
            reason = error.message
            failed |= isinstance(error, SubmissionError)
        found[task.name, method] = score, time.monotonic() - begun, reason
    entries = []
    for task in tasks:
        reference = found.get((task.name, REFERENCE), (None,))[0]
        for method in fits:
            score, seconds, reason = found[task.name, method]
            relative = score.relative_to(reference) if score and reference else None
            entries.append(BenchEntry(task.name, method, score, relative, seconds, reason))
    return BenchTable(tuple(entries), tuple(tasks), failed)
