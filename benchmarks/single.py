"""One warm episode: ours and other people's engines against plain C."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from engines.plain_c import PlainC
from numpy.typing import NDArray
from reference import PERIOD, REFERENCE, SUBSTEPS, Problem
from rows import Candidate, Table
from timing import Bench

from mckibben import simulate
from mckibben.control import Controller
from mckibben.numerics.compiled import numeric
from mckibben.simulation.engine import native_episode, run_alone
from mckibben.simulation.loop import compiled_episode

SAME = 1e-9  # rad
PID_BASE, BP_BASE = "plain C, PID", "plain C, BP"
Angles = NDArray[np.floating]


def single(problem: Problem, folder: Path, *, quick: bool) -> Table:
    """The table of single episodes."""
    bench = Bench(rounds=9 if quick else 31, budget=0.7 if quick else 4.0)
    short = problem.shortened(500)
    truth: dict[str, Angles] = {}

    def plain_c() -> list[Candidate]:
        engine = PlainC(folder)
        runs = {PID_BASE: engine.episode(problem), BP_BASE: engine.episode_bp(problem)}
        truth.update({name: run()[:, 0].copy() for name, run in runs.items()})
        return [Candidate(name, run, base=name, note="-O3 -march=native, libm") for name, run in runs.items()]

    def candidate(
        engine: str, run: Callable[[], Angles], part: Problem = problem, *, base: str = PID_BASE, **more
    ) -> Candidate:
        if base not in truth:
            raise OSError("there is no plain C to compare with")
        deviation = float(np.abs(run() - truth[base][: part.periods]).max())
        work = part.periods / problem.periods
        if work < 1:
            shortened = f"{part.periods * PERIOD:g} s simulated, the time is scaled"
            more["note"] = f"{more['note']}; {shortened}" if "note" in more else shortened
        return Candidate(engine, run, work, deviation, base=base, **{"tolerance": SAME} | more)

    def compiled(controller: Controller, base: str) -> Candidate:
        loop = _loop(problem, controller)
        name, note = f"ours, loop by XLA, {_loops(base)}", "all records kept"
        return replace(candidate(name, _angle_of(loop), base=base, note=note), run=loop)

    def native(controller: Controller, base: str) -> Candidate:
        parts = numeric((problem.plant, controller, problem.setpoints, problem.start))
        kind = np.float64(PERIOD)

        def run() -> Angles:
            return run_alone("native", *parts, kind, SUBSTEPS)[0][1].state.angle

        return candidate(f"ours, native loop, {_loops(base)}", run, base=base, note="all records kept")

    def bound(controller: Controller, base: str) -> Candidate:
        parts = numeric((problem.plant, controller, problem.setpoints, problem.start))
        compute = native_episode.bound((*parts, np.float64(PERIOD), SUBSTEPS))
        note = "arguments packed beforehand, as for plain C"
        return candidate(f"ours, native program, {_loops(base)}", lambda: compute().state.angle, base=base, note=note)

    def simulated(controller: Controller, base: str) -> Candidate:
        def run() -> Angles:
            return simulate(problem.plant, controller, REFERENCE, initial=problem.start)["angle"]

        note = "1 and 2 substeps, for an accuracy of 1e-6 rad; with the feasibility of the reference"
        return candidate(f"ours, mk.simulate, {_loops(base)}", run, base=base, note=note)

    def by_xla(controller: Controller, base: str) -> Candidate:
        def run() -> Angles:
            return simulate(problem.plant, controller, REFERENCE, initial=problem.start, engine="xla")["angle"]

        return candidate(f"ours, mk.simulate, engine='xla', {_loops(base)}", run, base=base)

    def measured(controller: Controller, base: str) -> Candidate:
        def run() -> Angles:
            result = simulate(problem.plant, controller, REFERENCE, initial=problem.start)
            assert result.metrics["coupling"] >= 0
            return result["angle"]

        note = "and all metrics: torques, forces, and a second episode without the step of the stiffness"
        return candidate(f"ours, mk.simulate and metrics, {_loops(base)}", run, base=base, note=note)

    def python() -> Candidate:
        from engines import plain_python

        return candidate("plain Python, floats and math", plain_python.angles(problem))

    def scipy() -> Candidate:
        from engines import scipy_ivp

        note = f"RK45 with adaptive steps (rtol {scipy_ivp.RELATIVE:.0e}), called in each control period"
        return candidate("SciPy solve_ivp", scipy_ivp.angles(short), short, tolerance=1e-6, note=note)

    def casadi() -> Candidate:
        from engines import casadi_map

        return candidate("CasADi, virtual machine", casadi_map.interpreted(problem), note="mapaccum over the periods")

    def casadi_c() -> Candidate:
        from engines import casadi_map

        note = "its code for one period, cc -O3 -march=native; mapaccum over the periods"
        return candidate("CasADi, generated C", casadi_map.generated(problem, folder), note=note)

    def mujoco() -> list[Candidate]:
        from engines import mujoco_hinge

        return [
            candidate(
                "MuJoCo, RK4",
                mujoco_hinge.every_stage(problem),
                note="torque from Python at each stage: the same method as ours",
            ),
            candidate(
                "MuJoCo, Euler",
                mujoco_hinge.every_step(problem),
                note="its default, torque from Python before each step of 0.25 ms: a coarser method, held to 1e-3 rad",
                tolerance=1e-3,
            ),
        ]

    def control() -> Candidate:
        from engines import python_control

        part = problem.shortened(2000)
        note = "discrete nlsys in plain Python, input_output_response"
        return candidate("python-control", python_control.angles(part), part, note=note)

    bench.add("plain C", plain_c)
    bench.add("ours, native loop, PID", lambda: native(problem.pid, PID_BASE))
    bench.add("ours, native program, PID", lambda: bound(problem.pid, PID_BASE))
    bench.add("ours, loop by XLA, PID", lambda: compiled(problem.pid, PID_BASE))
    bench.add("ours, mk.simulate, PID", lambda: simulated(problem.pid, PID_BASE))
    bench.add("ours, mk.simulate, engine='xla', PID", lambda: by_xla(problem.pid, PID_BASE))
    bench.add("ours, mk.simulate and metrics, PID", lambda: measured(problem.pid, PID_BASE))
    bench.add("ours, native loop, BP", lambda: native(problem.bp, BP_BASE))
    bench.add("ours, native program, BP", lambda: bound(problem.bp, BP_BASE))
    bench.add("ours, loop by XLA, BP", lambda: compiled(problem.bp, BP_BASE))
    bench.add("ours, mk.simulate, BP", lambda: simulated(problem.bp, BP_BASE))
    bench.add("CasADi, generated C", casadi_c, install="casadi")
    bench.add("CasADi, virtual machine", casadi, install="casadi")
    bench.add("MuJoCo", mujoco, install="mujoco")
    bench.add("plain Python, floats and math", python)
    bench.add("python-control", control, install="control")
    bench.add("SciPy solve_ivp", scipy)
    return Table(
        "One warm episode",
        "episode of 10 s",
        "time",
        "angle [rad]",
        bench.timed(),
        (
            "10 s, control at 1 kHz with held commands, RK4 with 4 substeps, first-order valves, two loops over "
            "position and stiffness. BP: loops whose gains are adapted online by a network.",
            "Other engines run only the PID loops; they and plain C compute the stiffness by an explicit formula, ours "
            "differentiates the torque. Deviation: the largest of the angle from plain C [rad]; beyond 1e-9 (or the "
            "value in the note) nothing is timed.",
        ),
    )


def _loop(problem: Problem, controller: Controller) -> Callable[[], object]:
    traced = jax.device_put(numeric((problem.plant, controller, problem.setpoints, problem.start, PERIOD)))
    return lambda: jax.block_until_ready(compiled_episode(*traced, SUBSTEPS))


def _angle_of(loop: Callable) -> Callable[[], Angles]:
    return lambda: np.asarray(loop()[1].state.angle)


def _loops(base: str) -> str:
    return "PID" if base == PID_BASE else "BP"
