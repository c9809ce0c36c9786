"""Batches on a GPU, by kernels of one thread per run, against the processor."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import ours
from batch import DTYPES, LANES_OF_OURS, MILLION, TOLERANCE, deviation, loads
from machine import cores
from reference import Problem
from rows import Candidate, Row, Table
from timing import Bench, inverted

from mckibben.codegen import cuda
from mckibben.errors import DeviceError

LANES = (4096, 65536)


def gpu(problem: Problem, folder: Path, *, quick: bool) -> Table:
    """The table of batches on a GPU; without one, a row that says what is missing."""
    bench = Bench(rounds=3 if quick else 7, budget=10.0)
    try:
        device = cuda.device().name
    except DeviceError as error:
        rows: tuple[Row, ...] = (Row("ours, engine='cuda'", note=f"not run: {error.message}"),)
    else:
        for precision in DTYPES:
            base = f"ours, simulate_many, {precision}, {cores()} cores"
            build = partial(_candidate, problem, folder, precision, base)
            bench.add(base, partial(build, base, LANES_OF_OURS * cores(), "native"))
            for count in LANES:
                name = f"ours, engine='cuda', {precision}, {count} lanes"
                bench.add(name, partial(build, name, count, "cuda", device))
        rows = inverted(bench.timed())
    notes = ("As the table above; with all copies to and from the device.",)
    return Table("Batches on a GPU", "million control steps", "speed", "RMS errors", rows, notes)


def _candidate(
    problem: Problem, folder: Path, precision: str, base: str, name: str, count: int, engine: str, note: str = ""
) -> Candidate:
    masses = loads(count)
    run = ours.batch(problem, masses, DTYPES[precision], cores=cores(), engine=engine)
    off = deviation(problem, folder, masses, run())
    return Candidate(name, run, count * problem.periods / MILLION, off, TOLERANCE[precision], note, base)
