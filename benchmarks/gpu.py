"""Batches on a GPU, where JAX sees one; in a process of its own, since the others are told to use the CPU."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from rows import Candidate, Row, Table
from timing import Bench

LANES = (4096, 65536)


def gpu(*, quick: bool) -> Table:
    """The table of batches on a GPU; one row that says so where there is none."""
    environment = {name: value for name, value in os.environ.items() if name != "JAX_PLATFORMS"}
    command = [sys.executable, str(Path(__file__)), *(["--quick"] if quick else [])]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    try:
        found = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        found = [{"engine": "ours, GPU", "note": f"failed: {last[:120]}"}]
    fields = Row.__dataclass_fields__
    rows = tuple(Row(**{name: value for name, value in row.items() if name in fields}) for row in found)
    return Table("Batches on a GPU", "million control steps", "speed", "RMS errors", rows, ("As the table above.",))


def measured(*, quick: bool) -> list[dict]:
    """The rows, as dictionaries; run where JAX may use a GPU."""
    import mckibben  # noqa: F401, I001  # before JAX starts: it sets JAX up
    import jax

    try:
        device = jax.devices("gpu")[0]
    except RuntimeError:
        return [Row("ours, GPU", note="no GPU found by JAX (if there is one: pip install 'jax[cuda12]')").as_dict()]

    import ours
    from batch import DTYPES, MILLION, TOLERANCE, deviation, loads
    from reference import reference_problem

    problem = reference_problem()
    bench = Bench(rounds=3 if quick else 7, budget=10.0)
    with tempfile.TemporaryDirectory() as folder:
        for precision, dtype in DTYPES.items():
            for count in LANES:
                name = f"ours, simulate_many, {precision}, {count} lanes"

                def build(name=name, precision=precision, dtype=dtype, count=count) -> Candidate:
                    masses = loads(count)
                    run = ours.batch(problem, masses, dtype, chunk=count)
                    off = deviation(problem, Path(folder), masses, run())
                    work = count * problem.periods / MILLION
                    return Candidate(name, run, work, off, TOLERANCE[precision], device.device_kind)

                bench.add(name, build)
        return [row.as_dict() for row in bench.timed()]


if __name__ == "__main__":
    print(json.dumps(measured(quick="--quick" in sys.argv)))
