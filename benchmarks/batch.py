"""Many episodes at once: control steps a second, by precision, on one core and on all."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import ours
from engines.plain_c import PlainC
from engines.simd_lanes import SimdLanes
from machine import cores as all_cores
from numpy.typing import NDArray
from reference import Problem, numbers, with_mass
from rows import Candidate, Table
from timing import Bench, inverted

DTYPES = {"f64": np.float64, "f32": np.float32}
TOLERANCE = {"f64": 1e-9, "f32": 1e-4}
CHECKED = 32  # lanes
LANES_OF_C, LANES_OF_SIMD, LANES_OF_OURS = 32, 256, 2048  # per core
MILLION = 1e6
BASE = "plain C, f64, 1 core"


def batch(problem: Problem, folder: Path, *, quick: bool) -> Table:
    """The table of batches."""
    bench = Bench(rounds=3 if quick else 9, budget=1.0 if quick else 4.0)
    problem = problem.shortened(2000) if quick else problem
    for precision in DTYPES:
        for count in sorted({1, all_cores()}):
            _add_engines(bench, problem, folder, precision, count)
    notes = (
        f"Lanes are the episode above{', its first 2 s,' if quick else ''} with external loads of 0.3 to 0.7 kg; each "
        "gives only the RMS errors of angle and stiffness. All cores: one thread per core. Four substeps, by hand of "
        "RK4, ours of the Hermite method, except where the accuracy chooses them.",
        f"Deviation: the largest of both RMS errors (rad, N*m/rad) from plain C in f64 over {CHECKED} of the lanes; "
        f"beyond {TOLERANCE['f64']:.0e} in f64 or {TOLERANCE['f32']:.0e} in f32 nothing is timed.",
    )
    return Table("Batches", "million control steps", "speed", "RMS errors", inverted(bench.timed()), notes)


def loads(count: int) -> NDArray[np.float64]:
    """The external loads [kg] of so many lanes."""
    return np.linspace(0.3, 0.7, count)


def rows_of(problem: Problem, masses: NDArray[np.float64]) -> NDArray[np.float64]:
    """A row of `Numbers` for each load."""
    return np.array([numbers(with_mass(problem.plant, float(mass)), problem.pid) for mass in masses])


def deviation(problem: Problem, folder: Path, masses: NDArray[np.float64], errors: NDArray[np.floating]) -> float:
    """The largest deviation of RMS errors, shape (lanes, 2), from plain C in f64, over some of the lanes."""
    some = np.linspace(0, len(masses) - 1, CHECKED).astype(int)
    truth = PlainC(folder).metrics(problem, rows_of(problem, masses[some]))()
    return float(np.abs(errors[some] - truth).max())


def _add_engines(bench: Bench, problem: Problem, folder: Path, precision: str, cores: int) -> None:
    dtype, where = DTYPES[precision], f"{precision}, {cores} core{'s' if cores > 1 else ''}"

    def candidate(name: str, run: Callable[[], NDArray[Any]], masses: NDArray[np.float64], note: str = "") -> Candidate:
        off = deviation(problem, folder, masses, run())
        work = len(masses) * problem.periods / MILLION
        return Candidate(f"{name}, {where}", run, work, off, TOLERANCE[precision], f"{len(masses)} lanes{note}", BASE)

    def by_hand(name: str, engine: Callable[..., PlainC], lanes: int, note: str) -> Candidate:
        masses = loads(lanes * cores)
        return candidate(name, threaded(engine(folder, dtype), problem, masses, cores), masses, note)

    def our_own(name: str, note: str = "", **options) -> Candidate:
        masses = loads(LANES_OF_OURS * cores)
        return candidate(name, ours.batch(problem, masses, dtype, cores=cores, **options), masses, note)

    chosen, least = "; substeps by step doubling of some lanes", 1e-6 if precision == "f32" else 1e-9
    builders = {
        "plain C": lambda: by_hand("plain C", PlainC, LANES_OF_C, ""),
        "SIMD by hand": lambda: by_hand("SIMD by hand", SimdLanes, LANES_OF_SIMD, ", C++: the limit"),
        "ours, simulate_many": lambda: our_own("ours, simulate_many"),
        f"ours, accuracy={least:g}": lambda: our_own(
            f"ours, accuracy={least:g}", chosen, substeps=None, accuracy=least
        ),
        "ours, engine='xla'": lambda: our_own("ours, engine='xla'", engine="xla"),
    }
    for name, build in builders.items():
        bench.add(f"{name}, {where}", build)


def threaded(engine: PlainC, problem: Problem, masses: NDArray[np.float64], cores: int) -> Callable[[], NDArray[Any]]:
    """The engine's metrics, the lanes shared out between threads; ctypes lets go of the GIL."""
    parts = [engine.metrics(problem, part) for part in np.split(rows_of(problem, masses), cores)]
    if cores == 1:
        return parts[0]
    pool = ThreadPoolExecutor(cores)
    return lambda: np.concatenate(list(pool.map(lambda part: part(), parts)))
