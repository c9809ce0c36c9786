"""Pure functions compiled by XLA, by the C compiler of the machine, or for a CUDA device."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import PyTree
from numpy.typing import DTypeLike

from mckibben.codegen.cuda import CudaFunction, device
from mckibben.codegen.native import NativeFunction, OverPeriods, compiler, warn_of_fallback
from mckibben.errors import DeviceError, ExportError, ParameterError, quoted
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit_arrays, jit_lanes, numeric

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
    The function itself, for other programs, is `function`.
    """

    def __init__(self, function: Callable[[PyTree, PyTree], PyTree], flags: Sequence[str] = ()) -> None:
        self.function, self.native, self._cuda = function, NativeFunction(function, flags), CudaFunction(function)

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
        return by_xla(self.function, shared, lanes), "xla"


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
