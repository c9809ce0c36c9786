"""What was tried, kept line by line: an interrupted search finds its answers there and goes on where it was."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import FileError, Problem
from mckibben.files import whole


@dataclass(frozen=True)
class Trial:
    """A point that was tried: its place, its cost, and the derivative of the cost there, if it was asked for."""

    point: tuple[float, ...]
    cost: float
    gradient: tuple[float, ...] | None = None


class History:
    """Trials in the order in which they were made; with a path, in a file too, one line of JSON each.

    A line is on disk before the search goes on. A search repeats itself exactly, so one that was interrupted is started
    again: what it asks for is answered from the file until something is new.

    Parameters
    ----------
    path
        The file; None keeps trials in memory alone.
    about
        All that makes the trials what they are; the file's first line.
    resume
        Whether to take up the file of an interrupted search.

    Raises
    ------
    FileError
        If there is such a file and it is not to be taken up, or there is none, or it is about something else.
    """

    def __init__(self, path: Path | None, about: Mapping[str, Any], *, resume: bool = False) -> None:
        self._path, self._lock = path, threading.Lock()
        self._known: dict[tuple[float, ...], Trial] = {}
        if path is None:
            return
        if resume:
            self._read(path, about)
        elif path.exists():
            remedy = "go on with it (--resume), or choose another folder"
            raise FileError(str(path), [Problem("there is the history of a search already", remedy=remedy)])
        else:
            with whole(path) as part:
                part.write_text(json.dumps(about) + "\n", encoding="utf-8")

    @property
    def trials(self) -> list[Trial]:
        """All of them."""
        return list(self._known.values())

    @property
    def best(self) -> Trial:
        """The trial that costs least; of equals the first by place, so that it does not matter who came first."""
        return min(self._known.values(), key=lambda trial: (trial.cost, trial.point))

    def find(self, point: NDArray[np.float64]) -> Trial | None:
        """The trial at exactly this point."""
        return self._known.get(tuple(point.tolist()))

    def add(self, trials: list[Trial]) -> None:
        """Keep trials."""
        with self._lock:
            new = [trial for trial in trials if trial.point not in self._known]
            for trial in new:
                self._known[trial.point] = trial
            if self._path is None or not new:
                return
            lines = [json.dumps({"point": t.point, "cost": t.cost, "gradient": t.gradient}) + "\n" for t in new]
            with self._path.open("a", encoding="utf-8") as file:
                file.write("".join(lines))
                file.flush()
                os.fsync(file.fileno())

    def _read(self, path: Path, about: Mapping[str, Any]) -> None:
        if not path.is_file():
            raise FileError(
                str(path), [Problem("there is no search to go on with", remedy="start it without --resume")]
            )
        content = path.read_bytes()
        complete = content[: content.rfind(b"\n") + 1]  # a line that was cut off is tried again
        first, *rest = complete.decode("utf-8", "replace").splitlines() or [""]
        try:
            found = dict(json.loads(first))
            kept = [_trial(json.loads(line)) for line in rest]
        except (ValueError, KeyError, TypeError) as error:
            problem = Problem(f"it is no history of a search: {error}", remedy="choose another folder")
            raise FileError(str(path), [problem]) from None
        wanted = json.loads(json.dumps(about))
        differing = sorted(name for name in {*wanted, *found} if wanted.get(name) != found.get(name))
        if differing:
            problems = [Problem(_difference(name, found.get(name), wanted.get(name))) for name in differing]
            raise FileError(str(path), problems)
        self._known = {trial.point: trial for trial in kept}
        if complete != content:
            with path.open("rb+") as file:
                file.truncate(len(complete))


def _trial(said: Any) -> Trial:
    slope = said["gradient"]
    return Trial(_floats(said["point"]), float(said["cost"]), None if slope is None else _floats(slope))


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


def _difference(name: str, kept: Any, asked: Any) -> str:
    if len(str(kept)) + len(str(asked)) > 160:
        return f"it is a search that differs in {name}; nothing was changed"
    return f"it is a search with {name} {kept}, not {asked}; nothing was changed"
