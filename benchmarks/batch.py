"""Many episodes at once: control steps a second, by precision, on one core and on all."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import ours
from engines.plain_c import PlainC
from engines.simd_lanes import SimdLanes
from machine import cores as all_cores
from numpy.typing import NDArray
from reference import SUBSTEPS, Problem, numbers, with_mass, with_smooth_law
from rows import Candidate, Row, Table
from timing import Bench, inverted

from mckibben import FlowValve, PressureRegulator, SwitchingValves
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.units import bar, ms

DTYPES = {"f64": np.float64, "f32": np.float32}
TOLERANCE = {"f64": 1e-9, "f32": 1e-4}
CHECKED = 32  # lanes
LANES_OF_C, LANES_OF_SIMD, LANES_OF_OURS = 32, 256, 2048  # a core
LANES_OF_NUMPY, PERIODS_OF_NUMPY = 4096, 50
MILLION = 1e6
BASE = "plain C, f64, 1 core"
OURS = "ours, simulate_many, f64, 1 core"


def batch(problem: Problem, folder: Path, *, quick: bool) -> Table:
    """The table of batches."""
    bench = Bench(rounds=3 if quick else 9, budget=1.0 if quick else 4.0)
    problem = problem.shortened(2000) if quick else problem
    counts = sorted({1, all_cores()})
    for precision in DTYPES:
        for count in counts:
            _add_engines(bench, problem, folder, precision, count)
    _add_valves(bench, problem)
    rows = inverted(bench.timed())
    starved = any(row.cores is not None and row.cores < 0.8 * _cores_of(row) for row in rows)
    busy = "Some rows had fewer cores than requested, as other programs used the machine: their ratios are misleading."
    return Table(
        "Batches",
        "million control steps",
        "speed",
        "RMS errors",
        rows,
        (
            f"Lanes are the PID episode above{', its first 2 s,' if quick else ''} with external loads of 0.3 to 0.7 "
            "kg; each gives only the RMS errors of angle and stiffness. All cores: one thread per core. Four substeps, "
            "except where the accuracy chooses them.",
            "Valves with air (the last rows) have two pressures, and state of the valves, to integrate; their ratio is "
            "against the first-order valve of the same batch.",
            f"Deviation: the largest of both RMS errors (rad, N*m/rad) from plain C in f64 over {CHECKED} of the "
            f"lanes; beyond {TOLERANCE['f64']:.0e} in f64 or {TOLERANCE['f32']:.0e} in f32 nothing is timed.",
            *([busy] if starved else []),
        ),
    )


def _cores_of(row: Row) -> int:
    return all_cores() if row.engine.endswith(f"{all_cores()} cores") else 1


def loads(count: int) -> NDArray[np.float64]:
    """The external loads [kg] of so many lanes."""
    return np.linspace(0.3, 0.7, count)


def rows_of(problem: Problem, masses: NDArray[np.float64]) -> NDArray[np.float64]:
    """A row of `Numbers` for each load."""
    return np.array([numbers(with_mass(problem.plant, float(mass)), problem.pid) for mass in masses])


def deviation(problem: Problem, folder: Path, masses: NDArray[np.float64], found: NDArray[np.floating]) -> float:
    """The largest deviation of `found`, shape (lanes, 2), from plain C in f64, over some of the lanes."""
    some = np.linspace(0, len(masses) - 1, CHECKED).astype(int)
    truth = PlainC(folder).metrics(problem, rows_of(problem, masses[some]))()
    return float(np.abs(found[some] - truth).max())


def _add_engines(bench: Bench, problem: Problem, folder: Path, precision: str, cores: int) -> None:
    dtype, where = DTYPES[precision], f"{precision}, {cores} core{'s' if cores > 1 else ''}"

    def candidate(
        name: str,
        run: Callable[[], NDArray[Any]],
        masses: NDArray[np.float64],
        part: Problem = problem,
        note: str = "",
        base: str = BASE,
    ) -> Candidate:
        off = deviation(part, folder, masses, run())
        work = len(masses) * part.periods / MILLION
        return Candidate(f"{name}, {where}", run, work, off, TOLERANCE[precision], note, base)

    def plain_c() -> Candidate:
        masses = loads(LANES_OF_C * cores)
        engine = PlainC(folder, dtype)
        return candidate("plain C", threaded(engine, problem, masses, cores), masses, note=f"{len(masses)} lanes")

    def simd() -> Candidate:
        masses = loads(LANES_OF_SIMD * cores)
        run = threaded(SimdLanes(folder, dtype), problem, masses, cores)
        return candidate("SIMD by hand", run, masses, note=f"C++, {len(masses)} lanes: the limit")

    def our_own() -> Candidate:
        masses = loads(LANES_OF_OURS * cores)
        run = ours.batch(problem, masses, dtype, cores=cores)
        return candidate("ours, simulate_many", run, masses, note=f"{len(masses)} lanes")

    def accurate() -> Candidate:
        masses = loads(LANES_OF_OURS * cores)
        run = ours.batch(problem, masses, dtype, cores=cores, substeps=None)
        note = f"{len(masses)} lanes; substeps chosen for 1e-6 rad, by step doubling of some lanes"
        return candidate("ours, accuracy=1e-6", run, masses, note=note, base=f"SIMD by hand, {where}")

    def xla() -> Candidate:
        masses = loads(LANES_OF_OURS * cores)
        run = ours.batch(problem, masses, dtype, cores=cores, engine="xla")
        return candidate("ours, engine='xla'", run, masses, note=f"{len(masses)} lanes")

    def smooth_law() -> Candidate:
        masses = loads(LANES_OF_OURS * cores)
        run = ours.batch(with_smooth_law(problem), masses, dtype, cores=cores)
        note = f"{len(masses)} lanes; the same muscle as `SmoothLaw` with negligible deviations"
        return candidate("ours, SmoothLaw", run, masses, note=note, base=f"ours, simulate_many, {where}")

    def numpy() -> Candidate:
        from engines import plain_python

        masses, short = loads(LANES_OF_NUMPY), problem.shortened(PERIODS_OF_NUMPY)
        run = plain_python.metrics(short, rows_of(problem, masses), dtype)
        note = f"{LANES_OF_NUMPY} lanes, {PERIODS_OF_NUMPY} of {problem.periods} control periods"
        return candidate("NumPy", run, masses, short, note)

    bench.add(f"plain C, {where}", plain_c)
    bench.add(f"SIMD by hand, {where}", simd)
    bench.add(f"ours, simulate_many, {where}", our_own)
    bench.add(f"ours, accuracy=1e-6, {where}", accurate)
    bench.add(f"ours, engine='xla', {where}", xla)
    if cores == 1:
        bench.add(f"ours, SmoothLaw, {where}", smooth_law)
        bench.add(f"NumPy, {where}", numpy)


def _add_valves(bench: Bench, problem: Problem) -> None:
    """Our own batch with valves with air, against that with the lag."""
    masses = loads(LANES_OF_OURS)
    work = len(masses) * problem.periods / MILLION
    conductance, supply = 0.4 * L_PER_S_BAR, 7 * bar
    valves = {
        "FlowValve": FlowValve(conductance, supply),
        "PressureRegulator": PressureRegulator(conductance, supply, time_constant=20 * ms),
        "SwitchingValves": SwitchingValves(conductance, supply, period=10 * ms),
        "FlowValve with a reservoir": FlowValve(
            conductance, supply, reservoir_volume=1e-3, line_conductance=conductance
        ),
    }
    for name, valve in valves.items():
        part = replace(problem, plant=replace(problem.plant, valve=valve))
        engine = f"ours, {name}, f64, 1 core"
        for end, steps in (("", SUBSTEPS), (", accuracy=1e-6", None)):
            run, row = ours.batch(part, masses, np.float64, substeps=steps), f"{engine}{end}"
            made = Candidate(row, run, work, note="0.4 dm^3/(s*bar), 7 bar", base=engine if end else OURS)
            bench.add(row, lambda made=made: made)


def threaded(engine: PlainC, problem: Problem, masses: NDArray[np.float64], cores: int) -> Callable[[], NDArray[Any]]:
    """The engine's metrics, the lanes shared out between threads; ctypes lets go of the GIL."""
    parts = [engine.metrics(problem, part) for part in np.split(rows_of(problem, masses), cores)]
    if cores == 1:
        return parts[0]
    pool = ThreadPoolExecutor(cores)
    return lambda: np.concatenate(list(pool.map(lambda part: part(), parts)))
