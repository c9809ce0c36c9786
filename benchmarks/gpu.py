"""Batches on a GPU: kernels of one thread per run, and XLA's programs; XLA's in a process of its own.

Without a GPU the kernels are compiled all the same: their registers, and the bytes that they spill, are known.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

from rows import Candidate, Row, Table
from timing import Bench, inverted

LANES = (4096, 65536)
PERIODS_OF_XLA = 200
ARCHITECTURE = 90
"""Compute capability for which kernels are compiled where there is no device."""


def gpu(*, quick: bool) -> Table:
    """The table of batches on a GPU."""
    from mckibben.codegen import cuda
    from mckibben.errors import DeviceError

    try:
        rows = _on_cuda(cuda.device(), quick=quick)
    except DeviceError as error:
        rows = _without_device(error.message)
    rows += tuple(_by_xla(rows, quick=quick))
    notes = (
        f"As the table above; XLA's rows are of the first {PERIODS_OF_XLA} control periods.",
        "Registers and spilled bytes are per thread; an NVRTC that takes a kernel from its cache does not report them.",
    )
    return Table("Batches on a GPU", "million control steps", "speed", "RMS errors", rows, notes)


def _on_cuda(device, *, quick: bool) -> tuple[Row, ...]:
    """Our batches on the processor and on a device."""
    from batch import DTYPES, LANES_OF_OURS
    from machine import cores
    from reference import reference_problem

    problem, bench = reference_problem(), Bench(rounds=3 if quick else 7, budget=10.0)
    with tempfile.TemporaryDirectory() as folder:
        for precision, dtype in DTYPES.items():
            base = f"ours, simulate_many, {precision}, {cores()} cores"
            made = partial(_candidate, problem, Path(folder), precision, base=base)
            bench.add(base, partial(made, base, LANES_OF_OURS * cores(), "native", ""))
            note = f"{device.name}; {resources_of(problem, dtype, device.architecture)}"
            for count in LANES:
                name = f"ours, engine='cuda', {precision}, {count} lanes"
                bench.add(name, partial(made, name, count, "cuda", note))
        return inverted(bench.timed())


def _candidate(problem, folder, precision, name, count, engine, note, *, base="", **options) -> Candidate:
    import ours
    from batch import DTYPES, MILLION, TOLERANCE, deviation, loads
    from machine import cores

    masses = loads(count)
    run = ours.batch(problem, masses, DTYPES[precision], cores=cores(), engine=engine, **options)
    off = deviation(problem, folder, masses, run())
    return Candidate(name, run, count * problem.periods / MILLION, off, TOLERANCE[precision], note, base)


def _without_device(missing: str) -> tuple[Row, ...]:
    """What is known of the kernels of our batches."""
    from batch import DTYPES
    from reference import reference_problem

    def row(precision: str) -> Row:
        resources = resources_of(reference_problem(), DTYPES[precision], ARCHITECTURE)
        return Row(f"ours, engine='cuda', {precision}", note=f"not run: {missing}; {resources}")

    bench = Bench(rounds=1, budget=0.0)
    for precision in DTYPES:
        try:
            bench.entries.append(row(precision))
        except Exception as error:
            bench.say(f"ours, engine='cuda', {precision}", f"not run: {missing}; not compiled: {error}")
    return bench.timed()


class _CompiledError(Exception):
    """A kernel is compiled, and need not run."""


def resources_of(problem, dtype, architecture: int) -> str:
    """Registers per thread of the kernel of a batch, and the bytes that it spills."""
    import ours
    from batch import loads

    from mckibben.codegen import cuda
    from mckibben.simulation import engine

    programs, compiler = [], cuda.nvrtc()

    def compile_(source: str, _: int):
        programs.append(compiler.compile(source, architecture))
        raise _CompiledError

    device = SimpleNamespace(architecture=architecture, compiler="of the benchmark", name="")
    with (
        patch.object(cuda, "device", lambda: device),
        patch.object(engine, "device", lambda: device),
        patch.object(cuda, "nvrtc", lambda: SimpleNamespace(compile=compile_)),
        patch.dict(os.environ, MCKIBBEN_PROGRAMS_DIR=""),
        suppress(_CompiledError),
    ):
        ours.batch(problem, loads(64), dtype, engine="cuda")()
    found = programs[0]
    if not found.registers:
        return f"sm_{architecture}"
    return f"{found.registers} registers, {found.spilled} bytes spilled on sm_{architecture}"


def _by_xla(ours: tuple[Row, ...], *, quick: bool) -> Iterator[Row]:
    """XLA's rows, from a process in which JAX may use a GPU; ratios against our rows of the processor."""
    environment = {name: value for name, value in os.environ.items() if name != "JAX_PLATFORMS"}
    command = [sys.executable, str(Path(__file__)), *(["--quick"] if quick else [])]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    try:
        found = json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        last = (done.stderr.strip().splitlines() or ["no output"])[-1]
        found = [{"engine": "ours, engine='xla'", "note": f"failed: {last[:120]}"}]
    for each in found:
        row = Row(**{name: value for name, value in each.items() if name in Row.__dataclass_fields__})
        precision = "f32" if "f32" in row.engine else "f64"
        base = next((one for one in ours if one.engine == one.base and precision in one.engine), Row(""))
        if row.time and row.least and base.time and base.least:
            row = replace(row, base=base.engine, ratio=base.time / row.time, ratio_of_least=base.least / row.least)
        yield row


def measured(*, quick: bool) -> list[dict]:
    """The rows of XLA, as dictionaries; run where JAX may use a GPU."""
    import mckibben  # noqa: F401, I001  # before JAX starts: it sets JAX up
    import jax

    try:
        device = jax.devices("gpu")[0]
    except RuntimeError:
        note = "no GPU found by JAX (if there is one: pip install 'jax[cuda12]')"
        return [Row("ours, engine='xla'", note=note).as_dict()]

    from batch import DTYPES
    from reference import reference_problem

    # kernels of each operation are launched in turn, at a rate that does not depend on the period
    problem, bench = reference_problem().shortened(PERIODS_OF_XLA), Bench(rounds=3 if quick else 7, budget=10.0)
    with tempfile.TemporaryDirectory() as folder:
        made = partial(_candidate, problem, Path(folder))
        for precision, count in itertools.product(DTYPES, LANES):
            name = f"ours, engine='xla', {precision}, {count} lanes"
            bench.add(name, partial(made, precision, name, count, "xla", device.device_kind, chunk=count))
        return [row.as_dict() for row in bench.timed()]


if __name__ == "__main__":
    print(json.dumps(measured(quick="--quick" in sys.argv)))
