"""Flips a bit at random places of every kind of kept file: the right numbers, or a plain message.

    python benchmarks/rot.py [PLACES [KIND ...]]

Of each kind of file that is read again (on resume, by another command, from Python) as many copies are damaged, each in
one bit. The command that reads it has to give the numbers of the undamaged file, or end with a message and another exit
code than 0, within a minute. A record of a rig of which a chunk is lost may give fewer points, with a warning.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from power import CASES, Worker, digest, write_inputs

WITHIN = 60.0  # s


@dataclass(frozen=True)
class Kind:
    """A kind of file: the folder that has it, its name or a pattern of names, and how it is read again.

    `read` is a command, in which DIR stands for the folder, or a function of the file's path; `results` are files that
    it writes, besides what it prints. `lossy`: fewer numbers are right if a warning says so.
    """

    made_by: str
    name: str
    read: tuple[str, ...] | Callable[[Path], object]
    results: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    lossy: bool = False


def resumed(name: str) -> tuple[str, ...]:
    return (*CASES[name].arguments, "--resume", "--out", "DIR")


def table_of(path: Path) -> object:
    from mckibben.study.sweep import SweepResult

    return SweepResult.from_netcdf(path).table


def result_of(path: Path) -> object:
    from mckibben.simulation import SimulationResult

    return SimulationResult.from_netcdf(path).to_dataset()


def data_of(path: Path) -> object:
    from mckibben.dataset import read_dataset

    return read_dataset(path).table


def merged(path: Path) -> object:
    from mckibben.study.sweep import merge, summary

    with tempfile.TemporaryDirectory() as folder:
        swept = merge([path.parent], folder)
        return {"table": swept.table.load(), "statistics": summary(swept)}


def law_of(path: Path) -> object:
    from mckibben.identification.storage import read_law

    return repr(read_law(path))


def model_of(path: Path) -> object:
    from mckibben import AntagonisticJoint
    from mckibben.component.schema import read_component

    return repr(read_component(AntagonisticJoint, path))


def valve_of(path: Path) -> object:
    from mckibben.actuator import Actuator
    from mckibben.component.schema import read_component

    return repr(read_component(Actuator, path))


def simulated(path: Path) -> object:
    """What a new process prints that loads compiled programs, one of which is the file."""
    environment = {**os.environ, "XDG_CACHE_HOME": str(path.parents[2])}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-m", "mckibben", "simulate", "scenario.yaml", "--json"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=WITHIN, check=True)
    return done.stdout


SWEPT = ("sweep.nc", "results.json")
KINDS = {
    "sweep.nc, resumed": Kind("sweep", "sweep.nc", resumed("sweep"), SWEPT),
    "sweep.nc, read": Kind("sweep", "sweep.nc", table_of),
    "sweep.journal": Kind("sweep", "sweep.journal", resumed("sweep"), SWEPT, ("sweep.nc",)),
    "history.journal": Kind("tune", "history.journal", resumed("tune"), ("results.json",)),
    "search of compare": Kind("compare", "tuning/pid-3.journal", resumed("compare"), ("results.json", "runs.nc")),
    "runs.nc, repeated": Kind("compare", "runs.nc", ("compare", "suite.yaml", "--repeat", "PID 3 7", "--out", "DIR")),
    "results.json, repeated": Kind(
        "compare", "results.json", ("compare", "suite.yaml", "--repeat", "PID 3 7", "--out", "DIR")
    ),
    "suite.yaml, repeated": Kind(
        "compare", "suite.yaml", ("compare", "suite.yaml", "--repeat", "PID 3 7", "--out", "DIR")
    ),
    "result.nc": Kind("simulate", "result.nc", result_of),
    "fit.yaml": Kind("identify", "fit.yaml", ("validate", "DIR/fit.yaml", "festo-tool-10mm", "--json")),
    "data.nc": Kind("identify", "data.nc", data_of),
    "isobaric.nc": Kind("rig", "isobaric.nc", data_of),
    "record of a rig, data": Kind("rig", "record-0001.chunks", ("rig", "data", "DIR"), ("isobaric.nc",), lossy=True),
    "record of a rig, resumed": Kind(
        "rig", "record-0001.chunks", resumed("rig"), ("isobaric.nc",), ("isobaric.nc",), lossy=True
    ),
    "protocol of a rig, data": Kind("rig", "protocol.yaml", ("rig", "data", "DIR"), ("isobaric.nc",)),
    "protocol of a rig, resumed": Kind("rig", "protocol.yaml", resumed("rig"), ("isobaric.nc",), ("isobaric.nc",)),
    "compiled programs": Kind("cache", "mckibben/*/*.program", simulated),
    "table of a part, merged": Kind("sweep", "sweep.nc", merged),
    "fit.yaml, as a law": Kind("identify", "fit.yaml", law_of),
    "landing.journal": Kind("land", "landing.journal", resumed("land"), ("results.json", "landing.nc")),
    "model.yaml": Kind("calibrate", "model.yaml", model_of),
    "valve.yaml": Kind("valves", "valve.yaml", valve_of),
}


def flip(path: Path) -> int:
    """Flip a random bit of a file, and return its place."""
    place = random.randrange(8 * path.stat().st_size)
    with path.open("r+b") as file:
        file.seek(place // 8)
        byte = file.read(1)[0]
        file.seek(place // 8)
        file.write(bytes([byte ^ 1 << place % 8]))
    return place


def numbers(folder: Path, names: tuple[str, ...]) -> dict[str, object]:
    """Content of files: tables as they are read, others as digests."""
    return {name: data_of(folder / name) if name == "isobaric.nc" else digest(folder / name) for name in names}


def same(one: object, other: object) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return one.identical(other) if hasattr(one, "identical") else one == other


def tried(kind: Kind, folder: Path, path: Path, worker: Worker) -> tuple[str, object, str]:
    """Read a folder's file again: "right" or the kind of failure, what came out, and what was printed."""
    from mckibben.errors import McKibbenError

    if callable(kind.read):
        begin = time.monotonic()
        try:
            found = kind.read(path)
        except McKibbenError as error:
            return "message", None, str(error)
        except BaseException as error:
            return "crash", None, repr(error)
        return "right" if time.monotonic() - begin < WITHIN else "late", found, ""
    arguments = tuple(word.replace("DIR", str(folder)) for word in kind.read)
    try:
        done = worker.run(arguments, within=WITHIN)
    except AssertionError as error:
        return "crash", None, str(error)
    printed = worker.log.read_text()
    if "fault of mckibben" in printed or "Traceback" in printed:
        return "crash", None, printed
    if done["end"] != 0:
        return "message" if "error:" in printed else "crash", None, printed
    spoken = [line for line in printed.splitlines() if not line.startswith(("warning:", "recorded in", " "))]
    kept = [line.replace(str(folder), "DIR") for line in spoken] if not kind.results else []
    return "right", {"printed": kept, **numbers(folder, kind.results)}, printed


def campaign(places: int, kinds: list[str], folder: Path) -> Counter:
    """Damage files of each kind at so many places; failures are printed and counted."""
    write_inputs(folder)
    made, test = folder / "made", folder / "test"
    found: Counter = Counter()

    def started() -> Worker:
        return Worker(folder, "reader")

    worker = started()
    try:
        for name in {KINDS[kind].made_by for kind in kinds}:
            if name == "cache":
                (made / name).mkdir(parents=True)
                simulated(made / name / "mckibben/programs/program")
                continue
            worker.prepare(CASES[name])
            done = worker.run(CASES[name].arguments, made / name)
            assert done["end"] == 0, worker.log.read_text()
        for name in kinds:
            kind = KINDS[name]
            wanted = None
            count: Counter = Counter()
            for number in range(-1, places):  # first undamaged
                shutil.rmtree(test, ignore_errors=True)
                shutil.copytree(made / kind.made_by, test)
                for other in kind.without:
                    (test / other).unlink()
                path = random.choice(sorted(test.glob(kind.name)))
                place = flip(path) if number >= 0 else None
                size = path.stat().st_size
                verdict, came, printed = tried(kind, test, path, worker)
                if verdict == "crash" and "did not end" in printed + "died":
                    worker.close()
                    worker = started()
                if number < 0:
                    assert verdict == "right", f"{name}: {printed}"
                    wanted = came
                    continue
                if verdict == "right" and not same(came, wanted):
                    verdict = "lossy" if kind.lossy and "warning:" in printed else "wrong"
                if kind.lossy and path.stat().st_size != size and verdict != "wrong":
                    verdict = "moved"  # a record of a finished test must not grow
                count[verdict] += 1
                if verdict not in ("right", "message", "lossy"):
                    print(f"{name}, bit {place}: {verdict}: {printed[-600:]}", flush=True)
            print(f"{name}: {', '.join(f'{n} {verdict}' for verdict, n in sorted(count.items()))}", flush=True)
            found += count
    finally:
        worker.close()
    return found


def main() -> int:
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    kinds = sys.argv[2:] or list(KINDS)
    random.seed(1)
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        found = campaign(places, kinds, Path(name))
    bad = sum(count for verdict, count in found.items() if verdict not in ("right", "message", "lossy"))
    of = ", ".join(f"{count} {verdict}" for verdict, count in sorted(found.items()))
    print(f"{sum(found.values())} flipped bits: {of}; {time.perf_counter() - begin:.0f} s")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
