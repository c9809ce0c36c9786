"""SciPy: solve_ivp called anew for each control period, as most scripts do it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from reference import PERIOD, Problem
from scipy.integrate import solve_ivp

from engines.knee import FLOATS, knee

RELATIVE = 1e-8  # its own step control, at a tolerance that keeps the angle within 1e-6 rad
ABSOLUTE = [1e-10, 1e-8, 1e-3, 1e-3]


def angles(problem: Problem) -> Callable[[], NDArray[np.float64]]:
    """One episode; what it returns runs it and gives the angle of each period."""
    functions = knee(FLOATS, problem.numbers)
    setpoints = list(zip(*(reference.tolist() for reference in problem.wanted), strict=True))
    start = tuple(problem.first.tolist())

    def run() -> NDArray[np.float64]:
        x, memory, record = start, functions.init(start), []
        for wanted_angle, wanted_stiffness in setpoints:
            memory, u1, u2, _ = functions.control(memory, wanted_angle, wanted_stiffness, x)
            record.append(x[0])
            solution = solve_ivp(
                lambda _, y, u1, u2: functions.rate(y.tolist(), u1, u2),
                (0.0, PERIOD),
                x,
                args=(u1, u2),
                rtol=RELATIVE,
                atol=ABSOLUTE,
            )
            x = tuple(solution.y[:, -1].tolist())
        return np.array(record)

    return run
