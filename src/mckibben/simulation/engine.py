"""Runs by XLA, by the C compiler of the machine, or many on a CUDA device: one, or many in chunks."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence
from typing import TypeVar

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import DTypeLike, NDArray

from mckibben.codegen.cuda import CudaFunction, device
from mckibben.codegen.native import NativeFunction, OverPeriods, compiler, warn_of_fallback
from mckibben.errors import DeviceError, ExportError, ParameterError, SimulationError, quoted
from mckibben.notebook import Progress, notebook_progress
from mckibben.numerics.batching import batched_program, cores, map_chunks, pad_chunk
from mckibben.numerics.compiled import jit_arrays, jit_lanes, numeric
from mckibben.simulation.loop import Record, episode

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

ENGINES = ("auto", "native", "xla", "cuda")
"""Engines: programs emitted as C and compiled by the machine's compiler, XLA's, or the first if it can be used; or
batches emitted as CUDA kernels, which are never chosen automatically."""


def check_engine(engine: str, *, many: bool = False) -> str:
    """Return the engine to be tried: any but "auto".

    Parameters
    ----------
    engine
        One of `ENGINES`.
    many
        Whether a batch is computed; only batches can be computed by "cuda".

    Raises
    ------
    ParameterError
        If the engine is unknown, or cannot be used: without a C compiler, or without a CUDA device.
    """
    if engine not in ENGINES:
        raise ParameterError(
            f"{quoted(engine)} is not an engine", field="engine", value=engine, remedy=f"give {', '.join(ENGINES)}"
        )
    if engine == "cuda":
        _check_cuda(many)
    if engine in ("xla", "cuda"):
        return engine
    missing = "" if compiler() else "there is no C compiler"
    if not missing and jax.default_backend() != "cpu":
        missing = "runs are computed on an accelerator"
    if missing and engine == "native":
        raise ParameterError(
            f"the engine 'native' cannot be used: {missing}", field="engine", value=engine, remedy="use 'auto' or 'xla'"
        )
    return "xla" if missing else "native"


def _check_cuda(many: bool) -> None:
    """Raise `ParameterError` unless batches can be computed on a CUDA device."""
    missing, remedy = "it computes batches only", "use 'auto', 'native' or 'xla'"
    if many:
        try:
            device()
            return
        except DeviceError as error:
            missing, remedy = error.message, error.remedy
    raise ParameterError(f"the engine 'cuda' cannot be used: {missing}", field="engine", value="cuda", remedy=remedy)


class BatchFunction:
    """A pure function of a shared tree and of one with the runs along the last axis, compiled by any engine.

    Without the second tree it is a function of the first, of one run. `flags` are further options of the C compiler.
    """

    def __init__(self, function: Callable[[PyTree, PyTree], PyTree], flags: Sequence[str] = ()) -> None:
        self._function, self.native, self._cuda = function, NativeFunction(function, flags), CudaFunction(function)

    def __call__(
        self, engine: str, shared: PyTree, lanes: PyTree = None, precision: DTypeLike = np.float64
    ) -> tuple[PyTree, str]:
        """Return the results, and the engine that computed them.

        Parameters
        ----------
        engine
            One of `ENGINES`; "auto" takes XLA where the native one cannot be used.
        shared
            Tree of arrays, and of static leaves, that all runs have in common.
        lanes
            Tree of arrays with the runs along the last axis; None for one run.
        precision
            Float type of what differs between runs: 32 bits or 64.

        Raises
        ------
        ParameterError
            If the engine is unknown or unavailable.
        ExportError
            If the engine is "native", and the function cannot be written or compiled as C.
        """
        single, chosen = np.dtype(precision) == np.float32, check_engine(engine, many=lanes is not None)
        if chosen == "native":
            try:
                return self.native(shared, lanes, single=single), chosen
            except ExportError as error:
                if engine == "native":
                    raise
                warn_of_fallback(error)
        shared, lanes = jax.tree.map(lambda x: np.asarray(x) if isinstance(x, OverPeriods) else x, (shared, lanes))
        if chosen == "cuda":
            return self._cuda(shared, lanes, single=single), chosen
        by_xla = _run_by_xla if lanes is None else _batch_by_xla
        return by_xla(self._function, shared, lanes), "xla"


@jit_arrays
def _run_by_xla(function: Callable[[PyTree, PyTree], PyTree], shared: PyTree, _: None) -> PyTree:
    return function(shared, None)


@jit_lanes
def _batch_by_xla(function: Callable[[PyTree, PyTree], PyTree], shared: PyTree, lanes: PyTree) -> PyTree:
    def run(lane: PyTree) -> PyTree:
        with batched_program():
            return function(shared, lane)

    return jax.vmap(run, in_axes=-1, out_axes=-1)(lanes)


def compiled(function: Callable[[PyTree, PyTree], PyTree]) -> Callable[..., PyTree]:
    """`BatchFunction` by any engine, whose shared tree may have numbers, with results as arrays of NumPy."""
    program = BatchFunction(function)

    @functools.wraps(function)
    def call(shared: PyTree, lanes: PyTree = None) -> PyTree:
        return jax.tree.map(np.asarray, program("auto", numeric(shared), lanes)[0])

    return call


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
