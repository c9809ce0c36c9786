"""Work-precision diagram of single runs: CPU time over error of the angle, by integration steps.

    python benchmarks/precision.py [DIAGRAM.png]

The reference episode, cut to 1 s, and the same with friction of the joint. Errors are the largest distance of the angle
from the solution with 256 steps per control period. SciPy begins anew each control period, with one step of its own at
any tolerance that matters.
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
from engines import scipy_ivp
from numpy.typing import NDArray
from reference import PERIOD, Problem, reference_problem

from mckibben import JointFriction
from mckibben.numerics.compiled import numeric
from mckibben.simulation.engine import run_alone
from mckibben.units import deg

PERIODS, ROUNDS = 1000, 9
STEPS = (1, 2, 4, 8, 16)
FINEST = 256

Angles = NDArray[np.float64]
Curve = list[tuple[str, float, float]]  # setting, error [rad], CPU time [s]


def curves() -> dict[str, Curve]:
    """Settings, errors and times by method."""
    smooth = reference_problem().shortened(PERIODS)
    plant = dataclasses.replace(smooth.plant, friction=JointFriction(0.3, 1 * deg))
    rough = dataclasses.replace(smooth, plant=plant, start=plant.equilibrium(0.0, stiffness=12.0))
    found = {}
    for name, problem in (("RK4", smooth), ("RK4, friction of the joint", rough)):
        truth = solver(problem, FINEST)()
        found[name] = [(f"{n} step{'s' if n > 1 else ''}", *measured(solver(problem, n), truth)) for n in STEPS]
    truth = solver(smooth, FINEST)()
    setting = f"rtol {scipy_ivp.RELATIVE:.0e}"
    return found | {"SciPy solve_ivp, RK45": [(setting, *measured(scipy_ivp.angles(smooth), truth, rounds=1))]}


def solver(problem: Problem, substeps: int) -> Callable[[], Angles]:
    """The native loop with a number of steps per control period."""
    start = problem.plant.complete_state(problem.start)
    parts = numeric((problem.plant, problem.pid, problem.setpoints, start))
    return lambda: np.asarray(run_alone("auto", *parts, np.float64(PERIOD), substeps)[0].state.angle)


def measured(run: Callable[[], Angles], truth: Angles, rounds: int = ROUNDS) -> tuple[float, float]:
    """Largest error [rad], and median CPU time [s]."""
    error, times = float(np.abs(run() - truth).max()), []
    for _ in range(rounds):
        begin = time.process_time()
        run()
        times.append(time.process_time() - begin)
    return error, statistics.median(times)


def main() -> None:
    """Print the table, and draw the diagram."""
    found = curves()
    print("| method | setting | error [rad] | CPU time per simulated second [ms] |\n|---|---|---:|---:|")
    for name, curve in found.items():
        for setting, error, seconds in curve:
            print(f"| {name} | {setting} | {error:.1e} | {seconds * 1e3:.3g} |")
    if len(sys.argv) > 1:
        import matplotlib

        matplotlib.use("Agg")
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
        for name, curve in found.items():
            _, errors, times = zip(*curve, strict=True)
            axes.loglog(errors, np.array(times) * 1e3, "o-", label=name)
        axes.set_xlabel("largest error of the angle [rad]")
        axes.set_ylabel("CPU time per simulated second [ms]")
        axes.legend()
        figure.savefig(sys.argv[1], dpi=120)


if __name__ == "__main__":
    main()
