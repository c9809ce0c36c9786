"""A command in a new process: its processor time against that of `import jax`, in the same run."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from rows import Row, Table

ROOT = Path(__file__).parents[1]
PID, BP = "examples/pre-contracted-step-pid.yaml", "examples/pre-contracted-step-backprop.yaml"
DATA, KNEE = "examples/rig.csv", "examples/calibration/knee.yaml"
IMPORT = "python -c 'import jax'"
UNSET = ("JAX_PLATFORMS", "JAX_COMPILATION_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")
COMMANDS = [["--help"], ["catalog"]]
COMMANDS += [[name, file, *out] for name, file in (("simulate", PID), ("identify", DATA)) for out in ([], ["--out"])]
COMMANDS += [["envelope", PID], ["calibrate", KNEE, "--weight", "0.5 kg, 200 mm", "--limb", "estimated", "--out"]]
"""Commands of which all programs are in the user's cache; `--out` gets a new folder."""


@dataclass
class Command:
    """A command, and the processor times of its process and its children [s]."""

    name: str
    arguments: list[str]
    note: str = ""
    cache: str = "cache"
    seconds: list[float] = field(default_factory=list)

    def run(self, folder: Path, *, counts: bool = True) -> None:
        """Run it once; raises `OSError` if it fails."""
        environment = {name: value for name, value in os.environ.items() if name not in UNSET}
        environment["PYTHONPYCACHEPREFIX"] = str(folder / "bytecode")  # as kept for users, in a folder we may write to
        environment["XDG_CACHE_HOME"] = str(folder / self.cache)
        with tempfile.TemporaryDirectory(dir=folder) as out:
            arguments = [*self.arguments, *([f"{out}/results"] if self.arguments[-1] == "--out" else [])]
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            done = subprocess.run(arguments, capture_output=True, text=True, env=environment, cwd=ROOT)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise OSError(f"{self.name}: {done.stderr.strip()}")
        if counts:
            self.seconds.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)

    def row(self, imported: list[float]) -> Row:
        """Its times, and their ratio: the median of the ratios within a round."""
        ratios = [one / other for one, other in zip(self.seconds, imported, strict=False)]
        return Row(self.name, note=self.note, base=IMPORT, seconds=tuple(self.seconds), ratio=statistics.median(ratios))


def cold(folder: Path, *, quick: bool) -> Table:
    """The table of commands."""
    program = str(Path(sys.executable).parent / "mckibben")
    imported = Command(IMPORT, [sys.executable, "-c", "import jax"])
    commands = [Command(" ".join(("mckibben", *words)), [program, *words]) for words in COMMANDS]
    first = [
        Command(f"mckibben simulate {file}, for the first time", [program, "simulate", file], "nothing cached", name)
        for name, file in (("PID", PID), ("BP", BP))
    ]
    if not Path(program).exists():
        note = f"no command {program} (pip install -e .)"
        return Table("A command in a new process", "command", "time", "", (Row("mckibben", note=note),))
    for command in (imported, *commands):
        command.run(folder, counts=False)
    for number in range(2 if quick else 5):
        for command in (imported, *commands, *(first if number == 0 else [])):
            command.run(folder)
    rows = tuple(command.row(imported.seconds) for command in (imported, *commands, *first))
    notes = ("Processor time of the process and its children, in turns; programs and bytecode are cached.",)
    return Table("A command in a new process", "command", "time", "", rows, notes)
