"""One warm episode: ours and other engines against plain C."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from engines.plain_c import PlainC
from numpy.typing import NDArray
from reference import PERIOD, REFERENCE, SUBSTEPS, Problem
from rows import Candidate, Table
from timing import Bench

from mckibben import simulate
from mckibben.numerics.compiled import numeric
from mckibben.simulation.engine import run_alone

SAME = 1e-9  # rad
BASE = "plain C"
Angles = NDArray[np.floating]


def single(problem: Problem, folder: Path, *, quick: bool) -> Table:
    """The table of single episodes."""
    bench = Bench(rounds=9 if quick else 31, budget=0.7 if quick else 4.0)
    short = problem.shortened(500)
    truth: list[Angles] = []

    def plain_c() -> Candidate:
        run = PlainC(folder).episode(problem)
        truth.append(run()[:, 0].copy())
        return Candidate(BASE, run, base=BASE, note="-O3 -march=native, libm")

    def candidate(engine: str, run: Callable[[], Angles], note: str = "", part: Problem = problem, **more) -> Candidate:
        if not truth:
            raise OSError("there is no plain C to compare with")
        deviation = float(np.abs(run() - truth[0][: part.periods]).max())
        work = part.periods / problem.periods
        if work < 1:
            note += f"; {part.periods * PERIOD:g} s simulated, the time is scaled"
        return Candidate(engine, run, work, deviation, note=note, base=BASE, **{"tolerance": SAME} | more)

    def program() -> Candidate:
        parts = numeric((problem.plant, problem.pid, problem.setpoints, problem.start))
        compute = run_alone.native.bound((*parts, np.float64(PERIOD), np.asarray(SUBSTEPS)))
        note = "arguments packed beforehand, as for plain C; all records kept"
        return candidate("ours, native program", lambda: compute()[1].state.angle, note)

    def simulated(engine: str, name: str, note: str, *, metrics: bool = False) -> Candidate:
        def run() -> Angles:
            result = simulate(problem.plant, problem.pid, REFERENCE, initial=problem.start, engine=engine)
            assert not metrics or result.metrics["coupling"] >= 0
            return result["angle"]

        return candidate(f"ours, mk.simulate{name}", run, note)

    def scipy() -> Candidate:
        from engines import scipy_ivp

        note = f"RK45 with adaptive steps (rtol {scipy_ivp.RELATIVE:.0e}), called in each control period"
        return candidate("SciPy solve_ivp", scipy_ivp.angles(short), note, short, tolerance=1e-6)

    def casadi() -> Candidate:
        from engines import casadi_map

        note = "its code for one period, cc -O3 -march=native; mapaccum over the periods"
        return candidate("CasADi, generated C", casadi_map.angles(problem, folder), note)

    def mujoco() -> Candidate:
        from engines import mujoco_hinge

        note = "torque from Python at each stage"
        return candidate("MuJoCo, RK4", mujoco_hinge.angles(problem), note)

    note = "1 and 2 substeps, for an accuracy of 1e-6 rad; with the feasibility of the reference"
    measured = "and all metrics: torques, forces, and a second episode without the step of the stiffness"
    bench.add(BASE, plain_c)
    bench.add("ours, native program", program)
    bench.add("ours, mk.simulate", lambda: simulated("auto", "", note))
    bench.add("ours, mk.simulate and metrics", lambda: simulated("auto", " and metrics", measured, metrics=True))
    bench.add("ours, engine='xla'", lambda: simulated("xla", ", engine='xla'", ""))
    bench.add("CasADi, generated C", casadi, install="casadi")
    bench.add("MuJoCo, RK4", mujoco, install="mujoco")
    bench.add("SciPy solve_ivp", scipy)
    notes = (
        "10 s, control at 1 kHz with held commands, 4 substeps (RK4, ours of the Hermite method), first-order valves, "
        "PID loops over position and stiffness.",
        "Other engines compute the stiffness by an explicit formula, ours differentiates the torque. Deviation: the "
        "largest of the angle from plain C [rad]; beyond 1e-9 (SciPy 1e-6) nothing is timed.",
    )
    return Table("One warm episode", "episode of 10 s", "time", "angle [rad]", bench.timed(), notes)
