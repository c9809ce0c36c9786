"""Plain Python over floats for one episode, and NumPy over lanes for a batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import DTypeLike, NDArray
from reference import SUBSTEPS, Numbers, Problem

from engines.knee import ARRAYS, FLOATS, knee


def angles(problem: Problem) -> Callable[[], NDArray[np.float64]]:
    """One episode over Python's floats and its `math`; what it returns runs it and gives the angle of each period."""
    functions = knee(FLOATS, problem.numbers)
    setpoints = list(zip(*(reference.tolist() for reference in problem.wanted), strict=True))
    start = tuple(problem.first.tolist())

    def run() -> NDArray[np.float64]:
        rk4, control = functions.rk4, functions.control
        x, memory, record = start, functions.init(start), []
        for wanted_angle, wanted_stiffness in setpoints:
            memory, u1, u2, _ = control(memory, wanted_angle, wanted_stiffness, x)
            record.append(x[0])
            for _ in range(SUBSTEPS):
                x = rk4(x, u1, u2)
        return np.array(record)

    return run


def metrics(problem: Problem, lanes: NDArray[np.float64], dtype: DTypeLike) -> Callable[[], NDArray[np.floating]]:
    """All lanes at once in NumPy arrays: RMS errors of angle and stiffness, shape (lanes, 2).

    `lanes` has a row of `Numbers` each; inertia and gravity may differ, all others are those of the first.
    """
    common = Numbers(*lanes[0].tolist())  # Python's floats leave float32 arrays float32
    varied = common._replace(
        inertia=lanes[:, Numbers._fields.index("inertia")].astype(dtype),
        gravity=lanes[:, Numbers._fields.index("gravity")].astype(dtype),
    )
    functions = knee(ARRAYS, varied)
    start = tuple(np.full(len(lanes), value, dtype) for value in problem.first)
    setpoints = list(zip(*(reference.tolist() for reference in problem.wanted), strict=True))

    def run() -> NDArray[np.floating]:
        x, memory = start, functions.init(start)
        angle_sum, stiffness_sum = np.zeros(len(lanes), dtype), np.zeros(len(lanes), dtype)
        for wanted_angle, wanted_stiffness in setpoints:
            memory, u1, u2, estimate = functions.control(memory, wanted_angle, wanted_stiffness, x)
            angle_sum += (wanted_angle - x[0]) ** 2
            stiffness_sum += (wanted_stiffness - estimate) ** 2
            for _ in range(SUBSTEPS):
                x = functions.rk4(x, u1, u2)
        return np.sqrt(np.stack([angle_sum, stiffness_sum], axis=1) / problem.periods)

    return run
