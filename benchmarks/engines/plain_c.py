"""Plain scalar C, compiled with -O3 -march=native and bound with ctypes (which lets go of the GIL)."""

from __future__ import annotations

import ctypes
import functools
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from reference import PERIOD, SUBSTEPS, Numbers, Problem

HERE = Path(__file__).parent
FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")


@functools.cache
def compile_library(folder: Path, sources: tuple[str, ...], *, compiler: str = "cc", flags: tuple[str, ...] = ()):
    """A shared library of these sources of ours."""
    library = folder / ("-".join([*sources, *flags]).replace("=", "") + ".so")
    paths = [str(HERE / source) for source in sources]
    command = [compiler, *FLAGS, *flags, "-o", str(library), *paths, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise OSError(f"{compiler}: {next((x for x in done.stderr.splitlines() if 'error' in x), 'failed')}")
    return ctypes.CDLL(str(library))


class PlainC:
    """The reference episode in C, of one precision. Its methods bind a problem; what they return runs it."""

    def __init__(self, folder: Path, dtype: DTypeLike = np.float64) -> None:
        self.dtype = np.dtype(dtype)
        real = "float" if self.dtype == np.float32 else "double"
        self.library = compile_library(folder, ("episode.c",), flags=(f"-DREAL={real}",))

    def episode(self, problem: Problem) -> Callable[[], NDArray[Any]]:
        """The record, shape (periods, 7): angle, velocity, p1, p2, u1, u2, estimated stiffness."""
        out = np.zeros((problem.periods, 7), self.dtype)
        return self._bound(self.library.episode, out, self._array(problem.numbers), run_of(problem, self.dtype), out, 0)

    def metrics(self, problem: Problem, lanes: NDArray[np.float64]) -> Callable[[], NDArray[Any]]:
        """RMS errors of angle and stiffness of each lane, shape (lanes, 2); `lanes` has a row of `Numbers` each."""
        out = np.zeros((len(lanes), 2), self.dtype)
        count, run = ctypes.c_long(len(lanes)), run_of(problem, self.dtype)
        return self._bound(self.library.episodes, out, self._array(lanes), count, run, out)

    def _array(self, values: Numbers | NDArray[np.float64]) -> NDArray[Any]:
        return np.ascontiguousarray(values, self.dtype)

    def _bound(self, function: Any, out: NDArray[Any], *arguments: Any) -> Callable[[], NDArray[Any]]:
        bound = [pointer(argument) for argument in arguments]

        def run() -> NDArray[Any]:
            function(*bound)
            return out

        run.keeps = arguments  # type: ignore[attr-defined]  # alive
        return run


def run_of(problem: Problem, dtype: np.dtype[Any]) -> ctypes.Structure:
    """`Run` of knee.h; it keeps its arrays alive."""
    real = np.ctypeslib.as_ctypes_type(dtype)

    class Run(ctypes.Structure):
        _fields_ = (
            ("wanted_angle", ctypes.c_void_p),
            ("wanted_stiffness", ctypes.c_void_p),
            ("start", real * 4),
            ("periods", ctypes.c_long),
            ("substeps", ctypes.c_long),
            ("period", real),
        )

    angle, stiffness = (np.ascontiguousarray(reference, dtype) for reference in problem.wanted)
    run = Run(
        angle.ctypes.data, stiffness.ctypes.data, (real * 4)(*problem.first), problem.periods, SUBSTEPS, float(PERIOD)
    )
    run.arrays = (angle, stiffness)
    return run


def pointer(argument: Any) -> Any:
    """An argument as ctypes passes it: arrays and structures by address, 0 as NULL."""
    if isinstance(argument, np.ndarray):
        return ctypes.c_void_p(argument.ctypes.data)
    if isinstance(argument, ctypes.Structure):
        return ctypes.byref(argument)
    return None if isinstance(argument, int) and argument == 0 else argument
