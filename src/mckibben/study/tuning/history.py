"""What was tried, kept line by line: an interrupted search finds its answers there and goes on where it was."""

from __future__ import annotations

import json
import math
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import FileError, Problem
from mckibben.files import folder, whole
from mckibben.study.keeping import alone


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
    numbers
        How many numbers are searched.
    slopes
        Whether trials have derivatives.
    resume
        Whether to take up the file of an interrupted search.

    Raises
    ------
    FileError
        If there is such a file and it is not to be taken up, or there is none, or it is about something else, or its
        lines are no trials of this search.
    """

    def __init__(
        self, path: Path | None, about: Mapping[str, Any], *, numbers: int, slopes: bool, resume: bool = False
    ) -> None:
        self._path, self._lock, self._numbers, self._slopes = path, threading.Lock(), numbers, slopes
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

    @classmethod
    @contextmanager
    def kept(
        cls, path: Path | None, about: Mapping[str, Any], *, numbers: int, slopes: bool, resume: bool = False
    ) -> Iterator[Self]:
        """A history that no other process writes to; its folder is made if need be.

        Raises
        ------
        FileError
            As for the class, and if another process is at it.
        """
        if path is None:
            yield cls(None, about, numbers=numbers, slopes=slopes)
            return
        if resume:
            _check_there(path)
        else:
            folder(path.parent)
        with alone(path.with_name(f".{path.name}.lock"), "going on with this search"):
            yield cls(path, about, numbers=numbers, slopes=slopes, resume=resume)

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
        _check_there(path)
        content = path.read_bytes()
        complete = content[: content.rfind(b"\n") + 1]  # a line that was cut off is tried again
        first, *rest = complete.decode("utf-8", "replace").split("\n")
        try:
            found = dict(json.loads(first))
        except (ValueError, TypeError) as error:
            problem = Problem(f"it is no history of a search: {error}", line=1, remedy="choose another folder")
            raise FileError(str(path), [problem]) from None
        wanted = json.loads(json.dumps(about))
        differing = sorted(name for name in {*wanted, *found} if wanted.get(name) != found.get(name))
        if differing:
            problems = [Problem(_difference(name, found.get(name), wanted.get(name))) for name in differing]
            raise FileError(str(path), problems)
        problems = []
        for number, line in enumerate(rest[:-1], start=2):
            try:
                trial = self._trial(line)
            except ValueError as error:
                remedy = "remove the line: what it said is tried again"
                problems.append(Problem(f"it is no trial of this search: {error}", line=number, remedy=remedy))
            else:
                self._known[trial.point] = trial
        if problems:
            raise FileError(str(path), problems)
        if complete != content:
            with path.open("rb+") as file:
                file.truncate(len(complete))

    def _trial(self, line: str) -> Trial:
        """The trial of a line; a ValueError if it is none of this search."""
        said = json.loads(line)
        if not isinstance(said, dict) or {*said} != {"point", "cost", "gradient"}:
            raise ValueError("it has no point, cost and gradient")
        point = self._floats("point", said["point"])
        if not all(0 <= place <= 1 for place in point):
            raise ValueError("its point is outside the ranges")
        if not (_is_number(said["cost"]) and math.isfinite(said["cost"])):
            raise ValueError("its cost is no number")
        if not self._slopes:
            if said["gradient"] is not None:
                raise ValueError("it has a gradient")
            return Trial(point, float(said["cost"]))
        return Trial(point, float(said["cost"]), self._floats("gradient", said["gradient"]))

    def _floats(self, what: str, values: Any) -> tuple[float, ...]:
        if not (isinstance(values, list) and all(_is_number(value) for value in values)):
            raise ValueError(f"its {what} is no list of numbers")
        if len(values) != self._numbers:
            raise ValueError(f"its {what} has {len(values)} numbers, not {self._numbers}")
        return tuple(float(value) for value in values)


def _check_there(path: Path) -> None:
    if not path.is_file():
        raise FileError(str(path), [Problem("there is no search to go on with", remedy="start it without --resume")])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _difference(name: str, kept: Any, asked: Any) -> str:
    if len(str(kept)) + len(str(asked)) > 160:
        return f"it is a search that differs in {name}; nothing was changed"
    return f"it is a search with {name} {kept}, not {asked}; nothing was changed"
