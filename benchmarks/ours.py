"""Our own batches and gradients, bound to a problem; what a function here returns runs it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from reference import PERIOD, REFERENCE, SUBSTEPS, Problem

from mckibben import differentiate, simulate_many

METRICS = ("angle_rmse", "stiffness_rmse")
GAINS = tuple(f"controller.{loop}.{gain}" for loop in ("position", "stiffness") for gain in ("kp", "ki", "kd"))


def batch(
    problem: Problem,
    masses: NDArray[np.float64],
    dtype: DTypeLike,
    *,
    cores: int = 1,
    chunk: int | None = None,
    engine: str = "auto",
    substeps: int | None = SUBSTEPS,
    accuracy: float = 1e-6,
) -> Callable[[], NDArray[Any]]:
    """One episode for each external load [kg]: two RMS errors a lane, shape (lanes, 2).

    Without substeps the accuracy [rad] chooses them.
    """

    def run() -> NDArray[Any]:
        found = simulate_many(
            problem.plant,
            problem.pid,
            REFERENCE,
            over={"load.mass2": masses},
            initial=problem.start,
            duration=problem.periods * PERIOD,
            metrics=METRICS,
            substeps=substeps,
            accuracy=accuracy,
            precision=np.finfo(dtype).bits,
            chunk=chunk,
            workers=cores,
            engine=engine,
        )
        return np.stack([found.metrics[name] for name in METRICS], axis=1)

    return run


def gradient(problem: Problem) -> Callable[[], NDArray[np.float64]]:
    """The derivative of the sum of both RMS errors with respect to six gains."""

    def run() -> NDArray[np.float64]:
        found = differentiate(
            problem.plant,
            problem.pid,
            REFERENCE,
            GAINS,
            metrics=METRICS,
            duration=problem.periods * PERIOD,
            initial=problem.start,
        ).gradients
        return np.array([sum(float(found[metric][gain]) for metric in METRICS) for gain in GAINS])

    return run
