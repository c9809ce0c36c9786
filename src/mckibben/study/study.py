"""Studies: rows in, records out, kept in one SQLite file, on threads or on a dask cluster."""

from __future__ import annotations

import abc
import hashlib
import os
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from pathlib import Path
from typing import ClassVar, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.errors import SimulationError
from mckibben.notebook import Progress, notebook_progress
from mckibben.numerics.batching import map_chunks
from mckibben.storage.store import STUDY, Job, open_store

Table = Mapping[str, NDArray]
"""Columns by name, one value per row."""


class InterruptedStudy(KeyboardInterrupt):
    """Ctrl-C during a study; the text says how many rows are kept, and where."""


class Records(NamedTuple):
    """Rows of a study and what was computed of them, arrays of shape (rows,) by name.

    `computed` rows come from this call, the others were kept.
    """

    rows: Table
    columns: Table
    computed: int


class Study(abc.ABC):
    """A study: rows made from parameters and a seed alone, and records computed from them in blocks.

    The records are equal to the last bit for any number of threads, processes and interruptions, as long as `compute`
    treats each row by itself. A subclass is picklable.

    Examples
    --------
    >>> class Squares(Study):
    ...     def about(self):
    ...         return {"format": "squares"}
    ...
    ...     def rows(self):
    ...         return {"x": np.random.default_rng(0).integers(0, 9, 5)}
    ...
    ...     def compute(self, rows):
    ...         return {"square": rows["x"] ** 2}
    >>> records = Squares().run()
    >>> bool((records.columns["square"] == records.rows["x"] ** 2).all())
    True
    """

    unit: ClassVar[str] = "rows"
    """Noun for the rows in messages."""

    @abc.abstractmethod
    def about(self) -> dict[str, object]:
        """Return all that determines the records, for JSON.

        A study in a folder is continued if these settings are the same; those whose names begin with "digest of " are
        reported if no other differs.
        """

    @abc.abstractmethod
    def rows(self) -> Table:
        """Return all rows, made from parameters and a seed alone."""

    @abc.abstractmethod
    def compute(self, rows: Table, /) -> Table:
        """Return the records of some rows, arrays of shape (rows,) in their order."""

    def checked(self, rows: Table) -> Table:
        """Return the records of some rows; raises `SimulationError` unless `compute` returns one for each."""
        records, count = self.compute(rows), len(next(iter(rows.values())))
        for name, column in records.items():
            if np.shape(column)[:1] != (count,):
                message = f"{type(self).__name__}.compute returns {name!r} of shape {np.shape(column)} for {count} rows"
                raise SimulationError(message, remedy="return arrays with one entry per row")
        return records

    def block_size(self) -> int:
        """Return the number of rows that are computed and kept together."""
        return 64

    def run(
        self,
        out: str | os.PathLike[str] | None = None,
        *,
        resume: bool = False,
        workers: int | None = None,
        dask: str | None = None,
        progress: Progress | None = None,
    ) -> Records:
        """Compute all records that are not kept.

        Parameters
        ----------
        out
            Folder of the study's file, study.sqlite. Default: in memory.
        resume
            Continue the study in `out`.
        workers
            Threads. Default: one per core.
        dask
            Address of a dask scheduler. Default: threads of this process.
        progress
            Called with the current step and the completed fraction, 0 to 1. Default: a progress bar in notebooks.

        Raises
        ------
        FileError
            If `out` has a study and `resume` is not set, or the reverse; if that is another study; if another process
            is computing it; or if the disk is full.
        InterruptedStudy
            On Ctrl-C; finished blocks are kept.
        """
        rows = self.rows()
        with open_store(None if out is None else Path(out) / STUDY, resume=resume) as store:
            job = store.job(self.about())
            return self._finish(job, rows, workers, dask, progress or notebook_progress())

    def _finish(
        self, job: Job, rows: Table, workers: int | None, dask: str | None, progress: Progress | None
    ) -> Records:
        count = len(next(iter(rows.values())))
        starts = range(0, count, self.block_size())
        spans = {number: slice(start, start + self.block_size()) for number, start in enumerate(starts)}

        def counted(numbers: set[int]) -> int:
            return sum(len(range(count)[spans[number]]) for number in numbers)

        before = counted(job.numbers)
        began = time.monotonic()

        def report(done: int) -> None:
            seconds, new = time.monotonic() - began, done - before
            rate = f", {new / seconds:.4g} {self.unit}/s" if new and seconds > 1 else ""
            if progress:
                progress(f"{done} of {count} {self.unit}{rate}", done / count)

        report(before)
        missing = {n: select(rows, span) for n, span in spans.items() if n not in job.numbers}
        try:
            if missing:
                with closing(self._computed(missing, job.add_arrays, workers, dask)) as finished:
                    for _ in finished:
                        report(counted(job.numbers))
        except KeyboardInterrupt:
            done = counted(job.numbers)
            text = f"{done} of {count} {self.unit} are kept; continue with --resume (resume=True)"
            raise InterruptedStudy(text) from None
        blocks = [job.read_arrays(number) for number in spans]
        if len({frozenset(block) for block in blocks}) > 1:
            message = f"{type(self).__name__} computes other records than those that are kept"
            raise SimulationError(message, remedy="begin anew in another folder")
        columns = {name: np.concatenate([block.pop(name) for block in blocks]) for name in list(blocks[0])}
        return Records(rows, columns, count - before)

    def _computed(
        self, blocks: dict[int, Table], keep: Callable[[int, Table], None], workers: int | None, dask: str | None
    ) -> Generator[int]:
        """Compute blocks and keep them; yield their numbers. If it is closed early, blocks that run are kept."""
        if dask is not None:
            from mckibben.study.cluster import compute_on_cluster

            yield from compute_on_cluster(self.checked, blocks, keep, dask)
            return
        numbers = list(blocks)

        def compute(place: slice) -> int:
            number = numbers[place.start]
            keep(number, self.checked(blocks[number]))
            return number

        finished = map_chunks(compute, len(numbers), 1, workers)
        with closing(finished):  # type: ignore[arg-type]  # it is a generator
            for _, number in finished:
                yield number


def digest(tree: PyTree) -> str:
    """Return a digest (SHA-256) of the numbers of a tree, with their places, types and shapes.

    >>> digest({"x": 1.0}) == digest({"x": 1.0}) != digest({"y": 1.0})
    True
    """
    content = hashlib.sha256()
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        array = np.asarray(leaf)
        content.update(f"{jax.tree_util.keystr(path)} {array.dtype} {array.shape}".encode())
        content.update(repr(leaf).encode() if array.dtype == object else array.tobytes())
    return content.hexdigest()


def select(rows: Table, span: slice) -> Table:
    """Return some of the rows."""
    return {name: column[span] for name, column in rows.items()}
