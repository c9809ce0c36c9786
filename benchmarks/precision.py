"""Work-precision diagram of single runs: CPU time over error of the angle, by integration steps.

    python benchmarks/precision.py [DIAGRAM.png]

The reference episode, cut to 1 s, and the same with friction of the joint. SciPy begins anew each control period, with
one step of its own at any tolerance that matters.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from engines import scipy_ivp
from numpy.typing import NDArray
from reference import PERIOD, Problem, reference_problem
from rows import Row, Table
from tables import as_markdown

from mckibben import JointFriction
from mckibben.numerics.compiled import numeric
from mckibben.simulation.engine import run_alone
from mckibben.units import deg

PERIODS, ROUNDS = 1000, 9
STEPS = (1, 2, 4, 8, 16)
FINEST = 256
BASE = "ours, RK4: 4 steps"

Angles = NDArray[np.float64]


def precision(*, quick: bool) -> Table:
    """The table of errors and times."""
    smooth = reference_problem().shortened(PERIODS)
    plant = dataclasses.replace(smooth.plant, friction=JointFriction(0.3, 1 * deg))
    rough = dataclasses.replace(smooth, plant=plant, start=plant.equilibrium(0.0, stiffness=12.0))
    rounds, rows = 3 if quick else ROUNDS, []
    for name, problem in (("ours, RK4", smooth), ("ours, RK4, friction of the joint", rough)):
        truth = solver(problem, FINEST)()
        for n in STEPS:
            row = f"{name}: {n} step{'s' if n > 1 else ''}"
            rows.append(measured(row, solver(problem, n), truth, rounds))
    truth = solver(smooth, FINEST)()
    with tempfile.TemporaryDirectory() as folder:
        for name, n, run in others(smooth, Path(folder), quick=quick):
            rows.append(measured(f"{name}: {n} step{'s' if n > 1 else ''}", run, truth, rounds))
    row = f"SciPy solve_ivp, RK45: rtol {scipy_ivp.RELATIVE:.0e}"
    rows.append(measured(row, scipy_ivp.angles(smooth), truth, 1))
    base = next(one.time for one in rows if one.engine == BASE)
    rows = [dataclasses.replace(one, ratio=one.time / base) for one in rows]
    notes = (
        "The episode above, cut to 1 s, by the native loop on one core, and the same with friction of the joint "
        "(0.3 N\\*m). Times are of the processor. The response of the valve is exact, so that one step is enough for a "
        "smooth motion. MuJoCo calls Python for the torque of the muscles.",
        f"Deviation: the largest distance of the angle [rad] from the solution with {FINEST} steps per control period.",
    )
    return Table("Work and precision", "second", "time", "largest error of the angle, rad", tuple(rows), notes)


def others(problem: Problem, folder: Path, *, quick: bool) -> Iterator[tuple[str, int, Callable[[], Angles]]]:
    """CasADi and MuJoCo with as many steps, as far as they are installed."""
    steps = STEPS[:3] if quick else STEPS
    if find_spec("casadi"):
        from engines import casadi_map

        yield from (("CasADi, generated C, RK4", n, casadi_map.generated(problem, folder, n)) for n in steps)
    if find_spec("mujoco"):
        from engines import mujoco_hinge

        yield from (("MuJoCo, RK4", n, mujoco_hinge.every_stage(problem, n)) for n in steps)
        yield from (("MuJoCo, Euler", n, mujoco_hinge.every_step(problem, n)) for n in steps)


def solver(problem: Problem, substeps: int) -> Callable[[], Angles]:
    """The native loop with a number of steps per control period."""
    start = problem.plant.complete_state(problem.start)
    parts = numeric((problem.plant, problem.pid, problem.setpoints, start))
    return lambda: np.asarray(run_alone("auto", *parts, np.float64(PERIOD), substeps)[0][1].state.angle)


def measured(name: str, run: Callable[[], Angles], truth: Angles, rounds: int) -> Row:
    """Largest error [rad], and CPU times [s]."""
    error, times = float(np.abs(run() - truth).max()), []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return Row(name, deviation=error, base=BASE, seconds=tuple(times))


def diagram(table: Table, path: str) -> None:
    """Draw times over errors."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4.5), layout="constrained")
    for name in dict.fromkeys(row.engine.split(":")[0] for row in table.rows):
        points = [(row.deviation, row.time * 1e3) for row in table.rows if row.engine.split(":")[0] == name]
        axes.loglog(*zip(*points, strict=True), "o-", label=name)
    axes.set_xlabel("largest error of the angle [rad]")
    axes.set_ylabel("CPU time per simulated second [ms]")
    figure.legend(loc="outside upper center", ncols=2)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    found = precision(quick=False)
    print(as_markdown(found))
    if len(sys.argv) > 1:
        diagram(found, sys.argv[1])
