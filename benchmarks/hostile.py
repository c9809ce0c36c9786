"""Hostile measurement files: each is read or refused with an error of ours, soon and in little memory; Linux only.

``python benchmarks/hostile.py`` writes files of all kinds (the modules `hostile_...`), one after the other, and has a
worker process read each with `mckibben.dataset.read_dataset` (even seeds) or `read_recording` (odd seeds). Outcomes:
read; refused (a `McKibbenError` with a message); traceback (any other exception, a crash, a message that is empty or
longer than 100,000 characters); too long (more than 15 s of processor time); too large (more than 1 GB, or a
`MemoryError` anywhere below the error). The last three are failures, and so is a refused control: a sound file whose
kind is named ``control_...``. ``--repeat KIND SEED`` keeps its file in the current folder.

Seconds are processor time of the worker and its children, which other programs do not change, and are the wall-clock
time where nothing else runs; the worker is killed after 120 s of wall-clock time, which is too long, too.

Memory is that of the worker and all its child processes while the file is read, with some 200 MB of imports: the
largest sum of resident sets (VmRSS in /proc), taken every 20 ms, or the largest VmHWM of one process, which is reset
before, if that is larger. A worker may take 3 GB of addresses more than after its imports, so that no file harms the
machine. It reads the next file too, unless it was killed or keeps more than 500 MB.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import gc
import json
import os
import queue
import selectors
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import hostile_excel  # noqa: F401  its kinds
import hostile_hdf5  # noqa: F401
import hostile_loggers  # noqa: F401
import hostile_texts  # noqa: F401
import numpy as np
from hostile_kinds import KINDS, File

OUTCOMES = ("read", "refused", "traceback", "too long", "too large")
FAILURES = OUTCOMES[2:]
SECONDS, KILLED, START = 15.0, 120.0, 600.0
MEMORY, ADDRESSES, KEPT = 1e9, 3 * 10**9, 500e6  # bytes
INTERVAL = 0.02  # s
LONGEST = 100_000  # characters of a message
SEEDS = 10


class Read(NamedTuple):
    """How a file was read: one of `OUTCOMES`, the message, processor and wall-clock time [s], peak memory [bytes]."""

    outcome: str
    text: str
    seconds: float
    wall: float
    memory: float


def tree(pid: int) -> Iterator[int]:
    """A process and all its children that still run."""
    yield pid
    for thread in Path(f"/proc/{pid}/task").glob("*"):
        with contextlib.suppress(OSError):
            for child in (thread / "children").read_text().split():
                yield from tree(int(child))


def status(pid: int, field: str) -> float:
    """A memory [bytes] from the status of a process; 0 if it has ended."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith(field):
                return int(line.split()[1]) * 1024.0
    return 0.0


def processor_time(pid: int) -> float:
    """Processor time [s] of a process, its children that still run, and those that have ended."""
    ticks = 0
    for each in tree(pid):
        with contextlib.suppress(OSError):
            fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
            ticks += sum(map(int, fields[11:15]))  # user and system, of the process and of ended children
    return ticks / os.sysconf("SC_CLK_TCK")


class Worker:
    """Process that reads files, one after the other."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None

    def read(self, path: str, reader: str, options: dict[str, float]) -> Read:
        """Have a file read, and measure."""
        process = self._running()
        for pid in tree(process.pid):
            with contextlib.suppress(OSError):
                Path(f"/proc/{pid}/clear_refs").write_text("5")  # VmHWM starts again from VmRSS
        start, before, peak, used = time.perf_counter(), processor_time(process.pid), 0.0, 0.0
        assert process.stdin is not None
        process.stdin.write(json.dumps([path, reader, options]).encode() + b"\n")
        process.stdin.flush()
        while not (line := self._line(INTERVAL)):
            pids = list(tree(process.pid))
            peak = max(peak, sum(status(pid, "VmRSS") for pid in pids), *(status(pid, "VmHWM") for pid in pids))
            used = max(used, processor_time(process.pid) - before)
            wall = time.perf_counter() - start
            if wall > KILLED:
                self.close()
                return Read("too long", f"killed after {KILLED:g} s", used, wall, peak)
            if process.poll() is not None:
                self.close()
                return Read("traceback", f"the process ended with {process.returncode}", used, wall, peak)
        peak = max(peak, *(status(pid, "VmHWM") for pid in tree(process.pid)))
        used = max(used, processor_time(process.pid) - before)
        outcome, text, wall = json.loads(line)
        if peak > MEMORY:
            outcome = "too large"
        elif used > SECONDS and outcome not in FAILURES:
            outcome = "too long"
        if sum(status(pid, "VmRSS") for pid in tree(process.pid)) > KEPT:
            self.close()
        return Read(outcome, text, used, wall, peak)

    def close(self) -> None:
        """End the process and its children."""
        process, self.process = self.process, None
        if process is not None:
            for pid in list(tree(process.pid)):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            process.communicate()

    def _running(self) -> subprocess.Popen[bytes]:
        if self.process is None or self.process.poll() is not None:
            self.process = subprocess.Popen(
                [sys.executable, __file__, "--work"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                bufsize=0,
            )
            if not self._line(START):
                raise RuntimeError("the worker does not start: see hostile.py --work")
        return self.process

    def _line(self, seconds: float) -> bytes:
        """Answer of the process; empty if none comes in time."""
        assert self.process is not None and self.process.stdout is not None
        with selectors.DefaultSelector() as ready:
            ready.register(self.process.stdout, selectors.EVENT_READ)
            return self.process.stdout.readline() if ready.select(seconds) else b""


def work() -> None:
    """Read the files that standard input names, and answer in JSON."""
    import resource

    from mckibben.dataset import read_dataset, read_recording
    from mckibben.errors import McKibbenError

    answers, sys.stdout = sys.stdout, sys.stderr
    readers = {"dataset": read_dataset, "recording": read_recording}
    with tempfile.TemporaryDirectory() as folder:  # the sound files: what is imported on demand is no memory of a file
        for name in [name for name in KINDS if name.startswith("control_small")]:
            file = KINDS[name](np.random.default_rng(0))
            with warnings.catch_warnings(), contextlib.suppress(McKibbenError):
                warnings.simplefilter("ignore")
                readers[file.reader or "dataset"](file.write(Path(folder)))
    room = int(status(os.getpid(), "VmSize")) + ADDRESSES
    resource.setrlimit(resource.RLIMIT_AS, (room, room))
    libc = ctypes.CDLL(None)
    print("ready", file=answers, flush=True)
    for line in sys.stdin:
        path, reader, options = json.loads(line)
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                outcome, text = "read", f"{len(readers[reader](path, **options))} rows"
            except McKibbenError as error:
                text = str(error)
                outcome = "refused" if 0 < len(text) <= LONGEST else "traceback"
                outcome = "too large" if out_of_memory(error) else outcome
            except Exception as error:
                outcome = "too large" if out_of_memory(error) else "traceback"
                text = f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - start
        gc.collect()
        getattr(libc, "malloc_trim", int)(0)  # only glibc keeps what was freed
        print(json.dumps([outcome, text[:1000], seconds]), file=answers, flush=True)


def out_of_memory(error: BaseException | None) -> bool:
    """True if an error, or one that it stands for, is that of exhausted memory."""
    while error is not None and not isinstance(error, MemoryError):
        error = error.__cause__ or error.__context__
    return error is not None


def examine(worker: Worker, kind: str, seed: int, folder: Path) -> Read:
    """Write a file of a kind, have it read."""
    file: File = KINDS[kind](np.random.default_rng([seed, *kind.encode()]))
    path = file.write(folder)
    helper = subprocess.Popen(file.meanwhile(path)) if file.meanwhile else None
    try:
        found = worker.read(str(path), file.reader or ("dataset", "recording")[seed % 2], file.options)
    finally:
        if helper is not None:
            helper.kill()
            helper.wait()
    return found


def failed(kind: str, found: Read) -> bool:
    return found.outcome in FAILURES or (kind.startswith("control_") and found.outcome != "read")


def described(kind: str, seed: int, found: Read) -> str:
    text = " / ".join(found.text.split("\n"))[:200]
    size = f"{found.seconds:.1f} s ({found.wall:.1f} s), {found.memory / 1e6:.0f} MB"
    return f"{kind} {seed}: {found.outcome}, {size}: {text}"


def table(each: dict[str, list[Read]]) -> Iterator[str]:
    """Lines: outcomes of each kind, and its largest processor time, wall-clock time and memory."""
    width = max(map(len, each))
    yield f"{'kind':{width}}  {'  '.join(OUTCOMES)}  most s  most wall s  most MB"
    rows = [*each.items(), ("all", [one for found in each.values() for one in found])]
    for kind, found in rows:
        counts = Counter(one.outcome for one in found)
        cells = "  ".join(f"{counts[one] or '-':>{len(one)}}" for one in OUTCOMES)
        used, wall, memory = (max(each, default=0) for each in list(zip(*found, strict=True))[2:] or [()] * 3)
        yield f"{kind:{width}}  {cells}  {used:6.1f}  {wall:11.1f}  {memory / 1e6:7.0f}"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--files", type=int, metavar="N", help=f"number of files of all kinds together (default: {SEEDS} of each)"
    )
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument("--only", nargs="+", choices=sorted(KINDS), metavar="KIND", help="some kinds")
    parser.add_argument("--repeat", nargs=2, metavar=("KIND", "SEED"), help="one file, written to the current folder")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="number of worker processes")
    parser.add_argument("--verbose", action="store_true", help="print what came of each file, not only of the failures")
    parser.add_argument("--work", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.work:
        work()
        return 0
    if options.repeat:
        kind, seed = options.repeat[0], int(options.repeat[1])
        with closing(Worker()) as worker:
            found = examine(worker, kind, seed, Path())
        print(described(kind, seed, found))
        return int(failed(kind, found))
    kinds = options.only or list(KINDS)
    files = SEEDS * len(kinds) if options.files is None else options.files
    most = -(-files // len(kinds))
    tasks = [(kind, options.seed + at) for at in range(most) for kind in kinds][:files]
    free: queue.SimpleQueue[Worker] = queue.SimpleQueue()
    for _ in range(options.jobs):
        free.put(Worker())

    def tried(task: tuple[str, int]) -> Read:
        worker, folder = free.get(), Path(tempfile.mkdtemp())
        try:
            return examine(worker, *task, folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            free.put(worker)

    each: dict[str, list[Read]] = {kind: [] for kind in kinds}
    failures = []
    with ThreadPoolExecutor(options.jobs) as pool:
        for (kind, seed), found in zip(tasks, pool.map(tried, tasks), strict=True):
            each[kind].append(found)
            line = described(kind, seed, found)
            failures += [line] if failed(kind, found) else []
            if options.verbose or failed(kind, found):
                print(line, file=sys.stderr, flush=True)
    for _ in range(options.jobs):
        free.get().close()
    print(*table(each), sep="\n")
    print(f"{len(kinds)} kinds, {files} files: {len(failures)} failures")
    for one in failures:
        print(f"failure: {one}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
