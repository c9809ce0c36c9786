"""Processor time over error of the angle in a single run, by integration steps per control period."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np
from engines import scipy_ivp
from numpy.typing import NDArray
from reference import PERIOD, Problem
from rows import Row, Table

from mckibben import JointFriction
from mckibben.numerics.compiled import numeric
from mckibben.simulation.engine import run_alone
from mckibben.units import deg

PERIODS, STEPS, FINEST = 1000, (1, 2, 4, 8, 16), 256
BASE = "Hermite: 4 steps"
Angles = NDArray[np.float64]


def precision(problem: Problem, *, quick: bool) -> Table:
    """The table of errors and times."""
    smooth = problem.shortened(PERIODS)
    plant = dataclasses.replace(smooth.plant, friction=JointFriction(0.3, 1 * deg))
    rough = dataclasses.replace(smooth, plant=plant, start=plant.equilibrium(0.0, stiffness=12.0))
    rounds, rows = 3 if quick else 9, []
    for name, part in (("Hermite", smooth), ("RK4, friction of the joint", rough)):
        truth = solver(part, FINEST)()
        rows += [measured(f"{name}: {n} step{'s' * (n > 1)}", solver(part, n), truth, rounds) for n in STEPS]
    truth = solver(smooth, FINEST)()
    rows.append(measured(f"SciPy RK45: rtol {scipy_ivp.RELATIVE:.0e}", scipy_ivp.angles(smooth), truth, 1))
    base = next(row.time for row in rows if row.engine == BASE)
    notes = (
        "The episode above, cut to 1 s, by the native loop on one core, and the same with friction of the joint (0.3 "
        "N\\*m) by RK4. Times are of the processor. The response of the valve is exact, so that one step is enough for "
        "a smooth motion.",
        f"Deviation: the largest distance of the angle [rad] from the solution with {FINEST} steps per control period.",
    )
    rows = [dataclasses.replace(row, ratio=row.time / base) for row in rows]
    return Table("Work and precision", "second", "time", "largest error of the angle, rad", tuple(rows), notes)


def solver(problem: Problem, substeps: int) -> Callable[[], Angles]:
    """The native loop with a number of steps per control period."""
    start = problem.plant.complete_state(problem.start)
    parts = numeric((problem.plant, problem.pid, problem.setpoints, start))
    return lambda: np.asarray(run_alone("auto", (*parts, np.float64(PERIOD), np.asarray(substeps)))[0][1].state.angle)


def measured(name: str, run: Callable[[], Angles], truth: Angles, rounds: int) -> Row:
    """Largest error [rad], and processor times [s]."""
    error, times = float(np.abs(run() - truth).max()), []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return Row(name, deviation=error, base=BASE, seconds=tuple(times))
