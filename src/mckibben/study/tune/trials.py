"""Trials of a search, read from its study or computed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mckibben.storage.store import Job, read_store
from mckibben.study.tune.search import Vector
from mckibben.study.tune.space import SearchSpace


class Trial(NamedTuple):
    """An evaluated point of the unit cube, its cost and, if known, metrics [SI]."""

    point: tuple[float, ...]
    cost: float
    metrics: dict[str, float] | None = None


class Evaluated(NamedTuple):
    """Costs of rows of values, and metrics [SI] per row, if any."""

    costs: Vector
    metrics: Sequence[dict[str, float] | None] | None = None


class Trials:
    """Trials of a search by point: kept ones are read from its job, others computed in batches of fixed size.

    A search that is repeated asks for the same points in the same order, so that it goes on where it was broken off.
    """

    def __init__(self, job: Job, space: SearchSpace, batch: int, compute: Callable[[Vector], Evaluated]) -> None:
        self._job, self._space, self._batch, self._compute = job, space, batch, compute
        self._known = {trial.point: (number, trial) for number, trial in _read_job(job)}
        self.first = len(self._known)

    @property
    def all(self) -> list[Trial]:
        """All trials, in the order of the search."""
        return [trial for _, trial in sorted(self._known.values(), key=lambda pair: pair[0])]

    @property
    def best(self) -> Trial:
        """Trial of the lowest cost; among equals the first by its point, independent of their order."""
        return min((trial for _, trial in self._known.values()), key=lambda trial: (trial.cost, trial.point))

    def at(self, points: Vector) -> list[Trial]:
        """Return the trials at points, shape (n, parameters)."""
        new = np.array([point for point in points if tuple(point.tolist()) not in self._known])
        for start in range(0, len(new), self._batch):
            some = new[start : start + self._batch]
            values = self._padded(self._space.values(some))
            costs, metrics = self._compute(values)
            absent = [None] * len(some)
            rows = zip(some.tolist(), costs.tolist(), metrics or absent, strict=False)
            self._keep([Trial(tuple(point), cost, medians) for point, cost, medians in rows])
        return [self._known[tuple(point.tolist())][1] for point in points]

    def _keep(self, trials: Sequence[Trial]) -> None:
        new = {trial.point: trial for trial in trials}
        free = (number for number in range(len(self._known) + len(new)) if number not in self._job.numbers)
        numbered = dict(zip(list(free), new.values(), strict=False))
        self._job.add({number: json.dumps(trial._asdict()).encode() for number, trial in numbered.items()})
        self._known |= {trial.point: (number, trial) for number, trial in numbered.items()}

    def costs(self, points: Vector) -> Vector:
        """Return the costs at points."""
        return np.array([trial.cost for trial in self.at(points)])

    def cost(self, values: Vector) -> float:
        """Return the cost of values [SI], which may lie outside their ranges."""
        return float(self._compute(self._padded(values[None])).costs[0])

    def _padded(self, rows: Vector) -> Vector:
        """Rows padded with the last one, for one compiled program."""
        return np.concatenate([rows, np.repeat(rows[-1:], self._batch - len(rows), axis=0)])


def read_trials(path: str | os.PathLike[str], job: str = "") -> list[Trial]:
    """Return the trials in a study.sqlite of `tune`, or of a controller of `compare`; `FileError` if it has none."""
    with read_store(Path(path)) as store:
        return [trial for _, trial in _read_job(store.job(store.about(job) or {}, job))]


def _read_job(job: Job) -> list[tuple[int, Trial]]:
    """Numbers and trials of a job."""
    trials = []
    for number in sorted(job.numbers):
        content = json.loads(job.read(number))
        trials.append((number, Trial(tuple(content["point"]), content["cost"], content["metrics"])))
    return trials
