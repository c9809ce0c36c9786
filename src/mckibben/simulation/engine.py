"""Runs by XLA, by the C compiler of the machine, or many on a CUDA device: one, or many in chunks."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import NDArray

from mckibben.codegen.engine import BatchFunction, check_engine
from mckibben.errors import SimulationError
from mckibben.notebook import Progress, notebook_progress
from mckibben.numerics.batching import batched_program, cores, map_chunks, pad_chunk
from mckibben.simulation.loop import episode
from mckibben.simulation.trajectories import Record

R = TypeVar("R")

CHUNK = 256
"""Runs per chunk of XLA on a CPU: they fit a core's cache and fill its vectors."""
NATIVE = 1024
"""Runs per chunk of the native engine, which computes one vector of them after the other."""
ON_ACCELERATOR = 16384
"""Runs per chunk of XLA on an accelerator."""
ON_CUDA = 65536
"""Runs per chunk of CUDA, one thread each: they fill the largest devices."""
MOST_NUMBERS = 2**28
"""Numbers of a chunk of CUDA in memory."""
VECTOR = 16
"""Smallest chunk: one vector of 32-bit numbers."""


@BatchFunction
def run_alone(parts: PyTree, _: None) -> tuple[PyTree, Record]:
    """State after one run with its record, of the `numeric` arguments of `episode`."""
    # The stages of many muscles take XLA minutes to compile, unless they are rolled; they are faster as well.
    with batched_program() if len(parts[0].muscles) > 2 else contextlib.nullcontext():
        return episode(*parts)


def compute_groups(
    compute: Callable[[PyTree, int], tuple[R, str]],
    lanes: PyTree,
    substeps: NDArray[np.int64],
    *,
    chunk: int | None = None,
    workers: int | None = None,
    engine: str = "auto",
    progress: Progress | None = None,
) -> tuple[R, str]:
    """Return the results of many runs in their order, and the engine that computed them.

    Runs with the same number of integration steps share chunks.

    Parameters
    ----------
    compute
        Function of a chunk of `lanes`, whose runs are along the last axis, and of its integration steps per control
        period: its results, likewise, and the engine.
    lanes
        Tree of arrays with the runs along the first axis.
    substeps
        Integration steps per control period, shape (runs,).
    chunk, workers
        Runs per chunk, and threads; None for the best (`chunk_size`).
    engine
        One of `ENGINES`, for the size of a chunk.
    progress
        Called with a text and the finished fraction, 0 to 1.

    Raises
    ------
    SimulationError
        If `chunk` or `workers` is not an integer from 1 up.
    """
    progress = progress or notebook_progress()
    order, answers, done = np.argsort(substeps, kind="stable"), [], 0
    for rows in np.split(order, np.flatnonzero(np.diff(substeps[order])) + 1):
        size = chunk_size(chunk, rows.size, workers, engine)

        def piece_of(piece: slice, rows: NDArray[np.int64] = rows, size: int = size) -> tuple[PyTree, str]:
            runs = pad_chunk(rows, piece, size)
            part = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf)[runs], 0, -1), lanes)
            answer, used = compute(part, int(substeps[runs[0]]))
            return jax.tree.map(lambda x: np.moveaxis(np.asarray(x), -1, 0)[: piece.stop - piece.start], answer), used

        for piece, answer in map_chunks(piece_of, rows.size, size, workers):
            answers.append(answer)
            done += piece.stop - piece.start
            if progress:
                progress(f"{done} of {order.size} runs", done / order.size)
    parts, used = zip(*answers, strict=True)
    back = np.argsort(order)
    return jax.tree.map(lambda *each: np.concatenate(each)[back], *parts), used[0]  # one engine, so the same for all


def dynamic_steps(substeps: int) -> int | NDArray:
    """Number of integration steps as an argument of a program, and a single step as part of it, which is faster."""
    return substeps if substeps == 1 else np.asarray(substeps)


def check_count(what: str, count: int) -> int:
    """A count; `SimulationError` unless it is an integer from 1 up."""
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise SimulationError(f"{count} {what}", value=count, remedy="give an integer from 1 up")
    return count


def chunk_size(chunk: int | None, count: int, workers: int | None, engine: str, numbers: int = 1) -> int:
    """Runs per chunk: the best number of the engine, fewer where that leaves cores idle or needs too much memory."""
    workers = cores() if workers is None else check_count("workers", workers)
    engine = check_engine(engine, many=True)
    if chunk is None:
        best = {"native": NATIVE, "cuda": min(ON_CUDA, max(VECTOR, MOST_NUMBERS // max(numbers, 1)))}
        chunk = best.get(engine, CHUNK if jax.default_backend() == "cpu" else ON_ACCELERATOR)
    check_count("runs per chunk", chunk)
    even = -(-count // (-(-count // chunk) if engine == "cuda" else workers))
    return min(chunk, max(VECTOR, -(-even // VECTOR) * VECTOR))
