"""CasADi: one control period as an expression, accumulated over the episode; interpreted, and as generated C."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from reference import SUBSTEPS, Problem

from engines.knee import Maths, knee

SYMBOLS = Maths(
    ca.sin,
    ca.cos,
    ca.exp,
    ca.sqrt,
    lambda x, value: ca.if_else(x > 0, value, 0),
    lambda x, low, high: ca.fmin(ca.fmax(x, low), high),
)


def interpreted(problem: Problem) -> Callable[[], NDArray[np.float64]]:
    """One episode in CasADi's virtual machine; what it returns runs it and gives the angle of each period."""
    return _bound(problem, _period(problem, SUBSTEPS))


def generated(problem: Problem, folder: Path, substeps: int = SUBSTEPS) -> Callable[[], NDArray[np.float64]]:
    """The same with the control period as C that CasADi wrote, compiled with -O3 -march=native."""
    period = _period(problem, substeps)
    generator = ca.CodeGenerator("period.c")
    generator.add(period)
    generator.generate(f"{folder}/")
    library = folder / f"period_{substeps}.so"
    source = str(folder / "period.c")
    subprocess.run(["cc", "-O3", "-march=native", "-shared", "-fPIC", "-o", str(library), source, "-lm"], check=True)
    return _bound(problem, ca.external("period", str(library)))


def _period(problem: Problem, substeps: int) -> Any:
    """(state and memory, setpoints) to (the next of both, the angle now)."""
    functions = knee(SYMBOLS, problem.numbers, substeps)
    now, setpoints = ca.SX.sym("now", 10), ca.SX.sym("setpoints", 2)
    values = ca.vertsplit(now)
    x, memory = tuple(values[:4]), tuple(values[4:])
    angle = x[0]
    memory, u1, u2, _ = functions.control(memory, setpoints[0], setpoints[1], x)
    for _ in range(substeps):
        x = functions.rk4(x, u1, u2)
    return ca.Function("period", [now, setpoints], [ca.vertcat(*x, *memory), angle], {"cse": True})


def _bound(problem: Problem, period: Any) -> Callable[[], NDArray[np.float64]]:
    functions = knee(SYMBOLS, problem.numbers)
    first = [float(value) for value in (*problem.first, *functions.init(ca.DM(problem.first).elements()))]
    setpoints = ca.DM(np.array(problem.wanted))
    whole = period.mapaccum("episode", problem.periods)

    def run() -> NDArray[np.float64]:
        return np.asarray(whole(first, setpoints)[1]).ravel()

    return run
