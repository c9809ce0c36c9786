"""Cuts the power of a computer at random instants: nothing is lost that was said to be kept, and every job resumes.

    python benchmarks/power.py [CUTS]

Each command writes to a file system in a file (ext4 on a loop device). At a random instant the process is stopped, the
file is copied without a sync, and the copy is mounted, which replays its journal: it holds what a power cut would have
left. There every file that was complete and every record that was appended has to be intact, and the command, resumed
or repeated, has to give the numbers of a run that nobody cut. Where nothing can be mounted (that needs root), the
system calls are recorded instead, and only what was synced by then is left: content by the sync of its file, a name by
the sync of its folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
SIZE = 96 << 20  # bytes of the file system
AFTER = 1.5  # s after the end of a job, in which the power may fail as well
CUTS_PER_RUN = 4

SCENARIO = (ROOT / "examples/pre-contracted-step-pid.yaml").read_text().replace("duration: 10 s", "duration: 200 ms")
PROTOCOL = """name: a short test
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {simulated: {seed: 1, friction: {half_width: 12 N, presliding_length: 0.5 mm}}}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}
protocol:
  isobaric: {pressures: [2 bar, 3 bar, 4 bar], contraction_min: 2 %, contraction_max: 8 %, repeats: 3, speed: 4 mm/s,
    dwell: 200 ms, acquisition: 100 ms, samples: 100}
"""
LEG = (ROOT / "examples/leg/lei-leg.yaml").read_text().replace("draws: 64", "draws: 20")
LEG = LEG.replace("drop: [20 mm, 50 mm, 100 mm]", "drop: [50 mm]\n  levels: 4\n  duration: 100 ms")
KNEE = (ROOT / "examples/calibration/knee.yaml").read_text().replace("../comparison", f"{ROOT}/examples/comparison")
VALVES = (ROOT / "examples/calibration/valves.yaml").read_text()


@dataclass(frozen=True)
class Case:
    """A command, the files by which it is resumed, and those whose content has to come out the same."""

    arguments: tuple[str, ...]
    resumes_by: str  # a pattern of files; empty for a command that is repeated instead
    results: tuple[str, ...]
    before: tuple[tuple[str, ...], ...] = ()  # commands that make what this one reads
    repeated_with: str = "--force"  # if there are results; empty: not repeated once all are there
    records: tuple[str, ...] = ()  # of an experiment: used if all are there, else it is repeated in another folder


SWEEP = ("sweep", "scenario.yaml", "--over", "load.mass2=0.4..0.6 kg", "--samples", "96")
CASES = {
    "sweep": Case(
        SWEEP,
        "sweep.journal",
        ("sweep.nc", "results.json"),
    ),
    "merge": Case(
        ("merge", "part1", "part2"),
        "",
        ("sweep.nc", "results.json"),
        tuple((*SWEEP, "--part", f"{number}/2", "--out", f"part{number}") for number in (1, 2)),
        repeated_with="",
    ),
    "tune": Case(
        tuple("tune scenario.yaml --method evolution --population 8 --iterations 6".split())
        + tuple("--parameters controller.position.kp --parameters controller.position.ki".split()),
        "history.journal",
        ("results.json",),
    ),
    "compare": Case(("compare", "suite.yaml"), "tuning/*.journal", ("results.json", "runs.nc", "suite.yaml")),
    "simulate": Case(("simulate", "scenario.yaml"), "", ("results.json", "result.nc", "scenario.yaml")),
    "identify": Case(("identify", "festo-tool-10mm"), "", ("results.json", "fit.yaml", "data.nc")),
    "land": Case(("leg", "land", "leg.yaml"), "landing.journal", ("results.json", "landing.nc", "leg.yaml")),
    "calibrate": Case(
        ("calibrate", "knee.yaml", "--recording", "measured/result.nc"),
        "",
        ("results.json", "model.yaml", "scenario.yaml"),
        (("simulate", "knee.yaml", "--out", "measured"),),
    ),
    "valves": Case(
        ("calibrate", "valves.yaml", "--valves", "--duration", "20 s"),
        "",
        ("results.json", "valve.yaml", "scenario.yaml"),
        records=("steps/result.nc", "multisine/result.nc"),
    ),
    "rig": Case(("rig", "run", "protocol.yaml"), "protocol.yaml", ()),
}


def write_inputs(folder: Path) -> None:
    """Write the files that the commands read."""
    files = {
        "scenario": SCENARIO,
        "protocol": PROTOCOL,
        "leg": LEG,
        "knee": KNEE.replace("duration: 3 s", "duration: 6 s"),
        "valves": VALVES,
    }
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text)
    shutil.copy(ROOT / "tests/small-suite.yaml", folder / "suite.yaml")


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def listing(folder: Path) -> dict[str, str]:
    """Digest of each file below a folder, but for locks and temporary ones."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and not path.is_symlink())
    return {str(p.relative_to(folder)): digest(p) for p in files if "lock" not in p.name and p.suffix != ".part"}


class Synced:
    """Records what was synced: the content of files, and the names in folders."""

    def __init__(self) -> None:
        self._content: dict[int, bytes] = {}
        self._names: dict[Path, dict[str, int]] = {}
        self._fsync = os.fsync

    def sync(self, file: int) -> None:
        self._fsync(file)
        path = Path(f"/proc/self/fd/{file}").readlink()
        if path.is_dir():
            with os.scandir(path) as entries:
                self._names[path] = {entry.name: entry.inode() for entry in entries if entry.is_file()}
        else:
            self._content[os.fstat(file).st_ino] = path.read_bytes()

    def leave(self, folder: Path, to: Path) -> None:
        """Write to a folder what a power cut leaves of another."""
        to.mkdir(parents=True)
        for name, entries in self._names.items():
            if name.is_relative_to(folder):
                place = to / name.relative_to(folder)
                place.mkdir(parents=True, exist_ok=True)
                for entry, number in entries.items():
                    (place / entry).write_bytes(self._content.get(number, b""))


def work(report: int, cuts: str) -> None:
    """Run commands that come on standard input as JSON, one a line; report what is kept, one JSON a line."""
    out = Path()
    synced = Synced() if cuts else None
    left: list[int] = []

    def tell(**told: object) -> None:
        os.write(report, (json.dumps(told) + "\n").encode())
        if synced and left and left.pop() == 1:
            name = Path(cuts) / str(time.monotonic_ns())
            synced.leave(out, name)
            os.write(report, (json.dumps({"left": str(name)}) + "\n").encode())

    from mckibben.storage import files, journal

    append, atomic_write = journal.Journal.append, files.atomic_write

    def appended(self: journal.Journal, *records: journal.JournalRecord) -> None:
        append(self, *records)
        tell(journal=str(self.path), end=self._end)

    @contextmanager
    def written(path: str | os.PathLike[str], *, overwrite: bool = False) -> Iterator[Path]:
        with atomic_write(path, overwrite=overwrite) as part:
            yield part
        tell(file=str(path), digest=digest(Path(path)))

    journal.Journal.append, files.atomic_write, journal.atomic_write = appended, written, written  # type: ignore[method-assign]
    if synced:
        os.fsync = synced.sync
    from mckibben.cli import main

    warnings.simplefilter("always")  # of each command, not of the first one alone
    for line in sys.stdin:
        job = json.loads(line)
        out = Path(job["out"])
        left[:] = [int(random.random() < 0.2) for _ in range(10_000)] if synced else []
        sys.argv = ["mckibben", *job["arguments"]]
        code: object = 0
        with Path(job["log"]).open("w") as log, contextlib.redirect_stdout(log), contextlib.redirect_stderr(log):
            try:
                main()
            except SystemExit as end:
                code = end.code or 0
        tell(end=code, files=listing(out) if out != Path() and out.is_dir() else {})


class Worker:
    """A process that runs commands, one after another."""

    def __init__(self, folder: Path, name: str, cuts: Path | None = None) -> None:
        self.log = folder / f"{name}.log"
        read, write = os.pipe()
        os.set_blocking(read, False)
        self._reports, self._rest = read, b""
        self._process = subprocess.Popen(
            [sys.executable, __file__, "--worker", str(write), str(cuts or "")],
            stdin=subprocess.PIPE, pass_fds=[write], cwd=folder, text=True,
        )  # fmt: skip
        os.close(write)

    def begin(self, arguments: tuple[str, ...], out: Path) -> None:
        """Start a command that writes to a folder."""
        job = {"arguments": [*arguments, "--out", str(out)] if out != Path() else arguments, "out": str(out)}
        job["log"] = str(self.log)
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(job) + "\n")
        self._process.stdin.flush()

    def reports(self) -> list[dict]:
        """What it has reported since the last call."""
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self._reports, 1 << 20):
                self._rest += part
        *lines, self._rest = self._rest.split(b"\n")
        return [json.loads(line) for line in lines]

    def end(self, within: float = 900.0) -> dict:
        """Wait so long [s] for the end of the command."""
        deadline = time.monotonic() + within
        while time.monotonic() < deadline:
            for told in self.reports():
                if "end" in told and "files" in told:
                    return told
            if self._process.poll() is not None:
                raise AssertionError(f"the process died ({self._process.returncode}): {self.log.read_text()[-2000:]}")
            time.sleep(5e-3)
        raise AssertionError(f"the command did not end within {within:g} s: {self.log.read_text()[-2000:]}")

    def run(self, arguments: tuple[str, ...], out: Path = Path(), *, within: float = 900.0) -> dict:
        """Run a command to its end; without a folder it has all its options."""
        self.begin(arguments, out)
        return self.end(within)

    def prepare(self, case: Case) -> None:
        """Run the commands that make what a case reads."""
        for arguments in case.before:
            assert self.run(arguments)["end"] == 0, self.log.read_text()

    def stop(self) -> None:
        """Stop the process as a power cut would, but for its going on later."""
        self._process.send_signal(signal.SIGSTOP)
        while Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()[0] not in "Tt":
            time.sleep(1e-3)

    def go_on(self) -> None:
        self._process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._reports)


class Disk:
    """A file system in a file."""

    def __init__(self, folder: Path) -> None:
        self._image, self._copy = folder / "disk", folder / "copy"
        self.path, self._second = folder / "mounted", folder / "mounted-copy"
        self.path.mkdir(), self._second.mkdir()
        with self._image.open("wb") as file:
            file.truncate(SIZE)
        options = ["-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0"]
        subprocess.run(["mkfs.ext4", *options, str(self._image)], check=True)
        subprocess.run(["mount", "-o", "loop", str(self._image), str(self.path)], check=True, capture_output=True)
        found = subprocess.run(["findmnt", "-no", "SOURCE", str(self.path)], check=True, capture_output=True, text=True)
        self._writes = Path("/sys/block") / Path(found.stdout.strip()).name / "stat"

    @contextmanager
    def cut(self) -> Iterator[Path]:
        """What a power cut now would leave."""
        while True:
            before = self._writes.read_text().split()[4:7]
            subprocess.run(["cp", "--sparse=auto", str(self._image), str(self._copy)], check=True)
            if self._writes.read_text().split()[4:7] == before:
                break
        subprocess.run(["mount", "-o", "loop", str(self._copy), str(self._second)], check=True)
        try:
            yield self._second
        finally:
            subprocess.run(["umount", str(self._second)], check=True)

    def close(self) -> None:
        subprocess.run(["umount", str(self.path)], check=True)


def verify(case: Case, told: list[dict], was: Path, left: Path, worker: Worker, reference: Path) -> None:
    """Hold what a cut left of a folder against what was said by then, and resume or repeat the command."""
    from mckibben.rig.record import segments
    from mckibben.storage.journal import JournalReader

    def here(path: str) -> Path:
        return left / Path(path).relative_to(was)

    ended = next((one for one in told if "end" in one and "files" in one), None)
    journals = {one["journal"]: one["end"] for one in told if "journal" in one}
    for path, end in journals.items():
        assert here(path).is_file(), f"{path} is missing, {end} bytes of it were kept"
        reader = JournalReader(here(path))
        for _ in reader:
            pass
        assert reader.end >= end, f"{end} bytes of {path} were kept, {reader.end} are intact"
        assert not reader.damaged, f"{path}: {reader.damaged} damaged records"
    files = {one["file"]: one["digest"] for one in told if "file" in one and one["file"] not in journals}
    for path, content in files.items():
        if not path.endswith((".chunks", ".journal")):
            assert here(path).is_file(), f"{path} is missing, and was written"
            finished = reference / Path(path).relative_to(was)
            assert digest(here(path)) in (content, finished.is_file() and digest(finished)), f"{path} is damaged"
    for name, content in (ended["files"] if ended else {}).items():
        assert (left / name).is_file(), f"{name} is missing, and the command had ended"
        assert digest(left / name) == content, f"{name} is damaged, and the command had ended"

    arguments = case.arguments
    if case.resumes_by and any(left.glob(case.resumes_by)):
        arguments += ("--resume",)
    elif case.resumes_by:
        assert not journals, "nothing is left to resume from, and records were kept"
    elif left.is_dir() and case.repeated_with and any(name in listing(left) for name in case.results):
        arguments += (case.repeated_with,)
    if any(segments((left / name).parent) for name in case.records):
        if all((left / name).is_file() for name in case.records):
            arguments += tuple(word for name in case.records for word in ("--recording", str(left / name)))
        else:
            left /= "again"
            arguments = case.arguments
    if case.repeated_with or not left.is_dir() or not set(case.results) <= set(listing(left)):
        done = worker.run(arguments, left)
        assert done["end"] == 0, f"it ended with {done['end']}: {worker.log.read_text()[-1500:]}"
    for name in case.results:
        assert digest(left / name) == digest(reference / name), f"{name} differs from that of a run that was not cut"
    if not case.results:
        check_test(left, reference)


def check_test(folder: Path, reference: Path) -> None:
    """Every point of a test once, with the force of the test that was not cut, but for noise."""
    import numpy as np

    from mckibben.dataset import read_dataset

    data, wanted = read_dataset(folder / "isobaric.nc"), read_dataset(reference / "isobaric.nc")
    assert len(data) == len(wanted), f"{len(data)} points instead of {len(wanted)}"
    np.testing.assert_allclose(data.contraction, wanted.contraction, atol=1e-9)
    np.testing.assert_allclose(data.force, wanted.force, atol=15.0)  # friction depends on where it was resumed


def cuts_of(case: Case, disk: Disk | None, folder: Path, out: Path, longest: float, recorded: Worker) -> Iterator:
    """Run a command and cut it: what was said by then, the folder at that time, and what is left of it."""
    if disk is None:
        recorded.begin(case.arguments, out)
        told: list[dict] = []
        lefts: list[tuple[list[dict], Path]] = []
        while not (told and "files" in told[-1]):
            for one in recorded.reports():
                lefts += [(list(told), Path(one["left"]))] if "left" in one else []
                told += [] if "left" in one else [one]
            time.sleep(5e-3)
        yield from random.sample(lefts, min(CUTS_PER_RUN, len(lefts)))
        return
    told, begin = [], time.monotonic()
    recorded.begin(case.arguments, out)
    instants = sorted(random.uniform(0, longest * 1.05 if i else longest + AFTER) for i in range(CUTS_PER_RUN))
    for instant in instants:
        time.sleep(max(begin + instant - time.monotonic(), 0))
        recorded.stop()
        told += recorded.reports()
        try:
            with disk.cut() as mounted:
                recorded.go_on()
                yield list(told), mounted / out.name
        finally:
            recorded.go_on()
    if not any("files" in one for one in told):
        recorded.end()


def campaign(cuts: int, cases: list[str], folder: Path, disk: Disk | None) -> Counter:
    """Cut so many times, over all cases in turn; failures are printed and counted."""
    write_inputs(folder)
    where = disk.path if disk else folder / "jobs"
    where.mkdir(exist_ok=True)
    lefts = None if disk else folder / "lefts"
    cut, resumer = Worker(folder, "cut", lefts), Worker(folder, "resumer")
    lengths: dict[str, float] = {}
    found: Counter = Counter()
    try:
        for name in cases:  # the programs are compiled, and the references are made
            resumer.prepare(CASES[name])
            for worker, out in ((resumer, folder / "reference" / name), (cut, where / f"{name}-warm")):
                for _ in range(2):
                    shutil.rmtree(out, ignore_errors=True)
                    begin = time.monotonic()
                    done = worker.run(CASES[name].arguments, out)
                    assert done["end"] == 0, worker.log.read_text()
                    lengths[name] = time.monotonic() - begin
            shutil.rmtree(where / f"{name}-warm")
        number = 0
        while number < cuts:
            name = cases[number // CUTS_PER_RUN % len(cases)]
            out = where / f"{name}-{number}"
            for told, left in cuts_of(CASES[name], disk, folder, out, lengths[name], cut):
                number += 1
                found[name] += 1
                try:
                    verify(CASES[name], told, out, left, resumer, folder / "reference" / name)
                except AssertionError as error:
                    found["failed"] += 1
                    print(f"{name}, after {len(told)} reports: {error}", flush=True)
            shutil.rmtree(out, ignore_errors=True)
            if lefts:
                shutil.rmtree(lefts, ignore_errors=True)
    finally:
        cut.close()
        resumer.close()
    return found


def mountable(folder: Path) -> Disk | None:
    """A file system in a file; None where nothing can be mounted."""
    try:
        return Disk(folder)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"nothing can be mounted here ({error}): system calls are recorded instead")
        return None


def main() -> int:
    cuts = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    cases = sys.argv[2:] or list(CASES)
    random.seed(1)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # nothing stays mounted
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        disk = mountable(Path(name)) if os.environ.get("POWER") != "recorded" else None
        try:
            found = campaign(cuts, cases, Path(name), disk)
        finally:
            if disk:
                disk.close()
    failed = found.pop("failed", 0)
    of = ", ".join(f"{count} of {name}" for name, count in found.items())
    print(
        f"{sum(found.values())} power cuts ({of}), {failed} with a loss; {time.perf_counter() - begin:.0f} s"
        f"{'' if disk else ' (recorded system calls)'}"
    )
    return int(failed > 0)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        work(int(sys.argv[2]), sys.argv[3])
    else:
        sys.exit(main())
