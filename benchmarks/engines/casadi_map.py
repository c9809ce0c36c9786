"""CasADi: one control period as C that it generates, accumulated over the episode."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

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


def angles(problem: Problem, folder: Path) -> Callable[[], NDArray[np.float64]]:
    """One episode; the function that is returned runs it and gives the angle of each period."""
    functions = knee(SYMBOLS, problem.numbers)
    now, setpoints = ca.SX.sym("now", 10), ca.SX.sym("setpoints", 2)
    values = ca.vertsplit(now)
    x, memory = tuple(values[:4]), tuple(values[4:])
    angle = x[0]
    memory, u1, u2, _ = functions.control(memory, setpoints[0], setpoints[1], x)
    for _ in range(SUBSTEPS):
        x = functions.rk4(x, u1, u2)
    period = ca.Function("period", [now, setpoints], [ca.vertcat(*x, *memory), angle], {"cse": True})
    generator = ca.CodeGenerator("period.c")
    generator.add(period)
    generator.generate(f"{folder}/")
    library, source = folder / "period.so", folder / "period.c"
    command = ["cc", "-O3", "-march=native", "-shared", "-fPIC", "-o", str(library), str(source), "-lm"]
    subprocess.run(command, check=True)
    whole = ca.external("period", str(library)).mapaccum("episode", problem.periods)
    first = [float(value) for value in (*problem.first, *functions.init(ca.DM(problem.first).elements()))]
    wanted = ca.DM(np.array(problem.wanted))
    return lambda: np.asarray(whole(first, wanted)[1]).ravel()
