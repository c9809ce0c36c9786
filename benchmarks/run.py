"""All benchmarks in one run: ratios, side by side, of engines that were seen to compute the same.

    python benchmarks/run.py [--markdown FILE] [--quick] [--only SECTION ...]

Times differ from machine to machine and hour to hour: look at the ratios. What is not installed is a row that says so;
the exit status is 1 where an engine that is there failed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

os.environ["JAX_PLATFORMS"] = "cpu"  # a GPU runs our own kernels

import machine
from rows import Row, Table
from tables import as_markdown, as_text
from timing import failure

SECTIONS = ("single", "precision", "batch", "gpu", "gradient", "cold", "identification", "robot", "umarm")


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables to this file")
    arguments.add_argument("--quick", action="store_true", help="fewer and shorter runs")
    arguments.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS, help="some sections")
    options = arguments.parse_args()

    described, begin = machine.sentence(), time.perf_counter()
    print(described, end="\n\n", flush=True)
    tables = []
    with tempfile.TemporaryDirectory() as folder:
        for name, section in sections(Path(folder), quick=options.quick).items():
            if name in options.only:
                started = time.perf_counter()
                tables.append(attempted(name, section))
                print(as_text(tables[-1]))
                print(f"({time.perf_counter() - started:.0f} s)\n", flush=True)
    seconds = time.perf_counter() - begin
    print(f"{seconds:.0f} s in all, load {os.getloadavg()[0]:.1f} at the end")
    if options.markdown:
        options.markdown.parent.mkdir(parents=True, exist_ok=True)
        text = "\n".join([f"# Benchmarks\n\n{described}\n", *map(as_markdown, tables)])
        options.markdown.write_text(text, encoding="utf-8")
    return int(any(row.note.startswith("failed:") for table in tables for row in table.rows))


def attempted(name: str, section: Callable[[], Table]) -> Table:
    """A section's table; where all of it fails, one that says so."""
    try:
        return section()
    except Exception as error:
        traceback.print_exc()
        return Table(name, "run", "time", "", (Row(name, note=failure(error)),))


def sections(folder: Path, *, quick: bool) -> dict[str, Callable[[], Table]]:
    """By name, in their order; built here, because they import JAX."""
    from batch import batch
    from cold import cold
    from gpu import gpu
    from gradient import gradient
    from identification import identification
    from precision import precision
    from reference import reference_problem
    from robot import robot
    from single import single
    from umarm import umarm

    problem = reference_problem()
    return {
        "single": lambda: single(problem, folder, quick=quick),
        "precision": lambda: precision(problem, quick=quick),
        "batch": lambda: batch(problem, folder, quick=quick),
        "gpu": lambda: gpu(problem, folder, quick=quick),
        "gradient": lambda: gradient(problem, folder, quick=quick),
        "cold": lambda: cold(folder, quick=quick),
        "identification": lambda: identification(folder, quick=quick),
        "robot": lambda: robot(folder, quick=quick),
        "umarm": lambda: umarm(folder, quick=quick),
    }


if __name__ == "__main__":
    sys.exit(main())
