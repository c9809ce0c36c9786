"""Our own SIMD by hand (lanes.cpp): the limit of what a core can do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from reference import Problem

from engines.plain_c import PlainC, compile_library

FLAGS = (
    "-std=c++17",
    "-mprefer-vector-width=512",
    *("-fno-math-errno", "-fno-trapping-math", "-ffinite-math-only", "-fno-signed-zeros"),
)
BUNDLE = 16  # lanes that any bundle's width divides


class SimdLanes(PlainC):
    """Metrics of lanes, as `PlainC.metrics` gives them."""

    def __init__(self, folder: Path, dtype: DTypeLike) -> None:
        self.dtype = np.dtype(dtype)
        real = "float" if self.dtype == np.float32 else "double"
        self.library = compile_library(folder, ("lanes.cpp",), compiler="c++", flags=(f"-DREAL={real}", *FLAGS))

    def metrics(self, problem: Problem, lanes: NDArray[np.float64]) -> Callable[[], NDArray[Any]]:
        if len(lanes) % BUNDLE:
            raise ValueError(f"{len(lanes)} lanes are no multiple of {BUNDLE}")
        return super().metrics(problem, lanes)
