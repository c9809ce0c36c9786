"""A command in a new process: what a user waits for."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from rows import Candidate, Table
from timing import Bench

ROOT = Path(__file__).parents[1]
SCENARIO = "examples/pre-contracted-step-pid.yaml"
EMPTY = "python -c pass"
UNSET = ("JAX_PLATFORMS", "JAX_COMPILATION_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")


def cold(folder: Path, *, quick: bool) -> Table:
    """The table of commands."""
    bench = Bench(rounds=2 if quick else 5, budget=60.0)
    command = Path(sys.executable).parent / "mckibben"
    environment = {name: value for name, value in os.environ.items() if name not in UNSET}
    environment["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")  # as it is kept for users, in a folder we may write

    def candidate(name: str, arguments: list[str], *, cache: str = "cache", note: str = "", most: int = 5) -> Candidate:
        def run() -> None:
            cached = environment | {"XDG_CACHE_HOME": str(folder / cache)}
            done = subprocess.run(arguments, capture_output=True, text=True, env=cached, cwd=ROOT)
            if done.returncode:
                raise OSError(f"{name}: {done.stderr.strip()}")

        return Candidate(name, run, note=note, base=EMPTY, most=most, warm=most > 1)

    python, simulate = sys.executable, [str(command), "simulate", SCENARIO]
    bench.entries += [
        candidate(EMPTY, [python, "-c", "pass"]),
        candidate("python -c 'import jax'", [python, "-c", "import jax"]),
    ]
    if command.exists():
        bench.entries += [
            candidate("mckibben --help", [str(command), "--help"]),
            candidate(f"mckibben simulate {SCENARIO}", simulate, note="compiled programs are kept in the user's cache"),
            candidate("the same, for the first time", simulate, cache="empty", note="one run, nothing cached", most=1),
        ]
    else:
        bench.say("mckibben", f"no command {command} (pip install -e .)")
    return Table("A command in a new process", "command", "time", "", bench.timed())
