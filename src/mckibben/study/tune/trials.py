"""Trials of a search, read from its study or computed."""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mckibben.simulation import Batch
from mckibben.simulation.software import engine_of_job
from mckibben.storage.store import Job, Store, read_store
from mckibben.study.tune.search import Vector
from mckibben.study.tune.space import SearchSpace


class Trial(NamedTuple):
    """An evaluated point of the unit cube, its cost and, if known, metrics [SI]."""

    point: tuple[float, ...]
    cost: float
    metrics: dict[str, float] | None = None

    @property
    def order(self) -> tuple[float, tuple[float, ...]]:
        """Key of an order by cost; among equals by the point, independent of the order of the trials."""
        return self.cost, self.point


class Evaluated(NamedTuple):
    """Costs of rows of values, and metrics [SI] per row, if any."""

    costs: Vector
    metrics: Sequence[dict[str, float] | None] | None = None

    def trials(self, points: Vector) -> list[Trial]:
        """Return the trials at the points of the first rows."""
        metrics = self.metrics or [None] * len(points)
        rows = zip(points.tolist(), self.costs.tolist(), metrics, strict=False)
        return [Trial(tuple(point), cost, numbers) for point, cost, numbers in rows]


class Trials:
    """Trials of a search by point: kept ones are read from its job, others computed in batches of fixed size.

    A search that is repeated asks for the same points in the same order, so that it goes on where it was broken off.
    """

    def __init__(self, job: Job, space: SearchSpace, batch: int, compute: Callable[[Vector], Evaluated]) -> None:
        self._job, self._space, self._batch, self._compute = job, space, batch, compute
        self._by_point = {trial.point: trial for trial in _read_job(job)}

    @property
    def all(self) -> list[Trial]:
        """All trials, in the order of the search."""
        return list(self._by_point.values())

    @property
    def best(self) -> Trial:
        """Trial of the lowest cost."""
        return min(self._by_point.values(), key=lambda trial: trial.order)

    def at(self, points: Vector) -> list[Trial]:
        """Return the trials at points, shape (n, parameters); new ones are on disk before it returns."""
        new = {point: None for point in map(tuple, points.tolist()) if point not in self._by_point}
        missing = np.array(list(new))
        for start in range(0, len(missing), self._batch):
            some = missing[start : start + self._batch]
            trials = self._compute(filled(self._space.values(some), self._batch)).trials(some)
            numbered = enumerate(trials, start=len(self._by_point))
            self._job.add({number: json.dumps(trial._asdict()).encode() for number, trial in numbered})
            self._by_point |= {trial.point: trial for trial in trials}
        return [self._by_point[tuple(point)] for point in points.tolist()]

    def costs(self, points: Vector) -> Vector:
        """Return the costs at points."""
        return np.array([trial.cost for trial in self.at(points)])


def filled(rows: Vector, count: int) -> Vector:
    """Return rows, filled up with the last one to a number for which there is a compiled program.

    >>> filled(np.array([[1.0], [2.0]]), 4).ravel().tolist()
    [1.0, 2.0, 2.0, 2.0]
    """
    return np.concatenate([rows, np.repeat(rows[-1:], count - len(rows), axis=0)])


def first_runs(
    store: Store, simulate: Callable[[str], Sequence[Batch]], name: str = "", engine: str = "auto"
) -> tuple[str, Sequence[Batch]]:
    """Return the engine of all trials of a search, that of a begun one if it has to be, and its runs at first."""
    begun = store.about(name)
    if begun:
        engine = engine_of_job(set, begun.get("software"), engine)
    batches = simulate(engine)
    return (engine if begun else engine_of_job(lambda: {batch.engine for batch in batches}, engine=engine)), batches


def read_trials(path: str | os.PathLike[str], job: str = "") -> list[Trial]:
    """Return the trials in a study.sqlite of `tune`, or of a controller of `compare`; `FileError` if it has none."""
    with read_store(Path(path)) as store:
        return _read_job(store.job(store.about(job) or {}, job))


def _read_job(job: Job) -> list[Trial]:
    """Trials of a job in the order of the search, up to a damaged one."""
    numbers = itertools.takewhile(job.numbers.__contains__, itertools.count())
    contents = (json.loads(job.read(number)) for number in numbers)
    return [Trial(tuple(content["point"]), content["cost"], content["metrics"]) for content in contents]
