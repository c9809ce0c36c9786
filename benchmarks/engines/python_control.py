"""python-control: the sampled loop as one discrete-time system, run by `input_output_response`.

Its continuous systems take inputs that are straight lines between samples, which held commands are not; so the plant is
the discrete map of one control period (RK4 in plain Python), which is how such a loop is put there.
"""

from __future__ import annotations

from collections.abc import Callable

import control as ct
import numpy as np
from numpy.typing import NDArray
from reference import PERIOD, SUBSTEPS, Problem

from engines.knee import FLOATS, knee


def angles(problem: Problem) -> Callable[[], NDArray[np.float64]]:
    """One episode; what it returns runs it and gives the angle of each period."""
    functions = knee(FLOATS, problem.numbers)

    def update(_t: float, now: NDArray[np.float64], setpoints: NDArray[np.float64], _params: dict) -> tuple[float, ...]:
        values = now.tolist()
        x = tuple(values[:4])
        memory, u1, u2, _ = functions.control(tuple(values[4:]), *setpoints.tolist(), x)
        for _ in range(SUBSTEPS):
            x = functions.rk4(x, u1, u2)
        return *x, *memory

    def output(
        _t: float, now: NDArray[np.float64], _setpoints: NDArray[np.float64], _params: dict
    ) -> NDArray[np.float64]:
        return now[:1]

    system = ct.nlsys(update, output, inputs=2, outputs=1, states=10, dt=PERIOD)
    start = tuple(problem.first.tolist())
    first = [*start, *functions.init(start)]
    times, setpoints = np.arange(problem.periods) * PERIOD, np.array(problem.wanted)

    def run() -> NDArray[np.float64]:
        return ct.input_output_response(system, times, setpoints, first).outputs

    return run
