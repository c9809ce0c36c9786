"""Reading a CSV file: ours against `pandas.read_csv`, processor time and memory.

`python benchmarks/reading.py` prints this table alone, of 1e6 and 1e7 rows.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from rows import Row, Table
from tables import as_markdown

HEADER = "time (s),pressure (bar),force (N),contraction (%)\n"
PANDAS = "pandas.read_csv"
# Each reader has a process of its own. The memory is the largest sum over it and its child, every 5 ms.
PROGRAM = """
import os, resource, sys, threading, time, warnings
reader, path = sys.argv[1:]
warnings.simplefilter("ignore")
import pandas
if reader == "ours":
    from mckibben.dataset import read_recording
    read_recording(path + ".head")
pages, peak, done = os.sysconf("SC_PAGESIZE"), 0, False
def resident(process):
    try:
        with open(f"/proc/{process}/statm") as file:
            return int(file.read().split()[1]) * pages
    except OSError:
        return 0
def watch():
    global peak
    me = os.getpid()
    while not done:
        with open(f"/proc/{me}/task/{me}/children") as file:
            processes = [me, *file.read().split()]
        peak = max(peak, sum(map(resident, processes)))
        time.sleep(0.005)
def used():
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in both)
watcher = threading.Thread(target=watch)
watcher.start()
start = used()
found = read_recording(path) if reader == "ours" else pandas.read_csv(path)
if reader == "ours":
    from mckibben.dataset import child
    child._CHILD.end()  # its time counts when it has ended
seconds = used() - start
done = True
watcher.join()
print(seconds, peak, len(found))
"""


def write(path: Path, rows: int) -> None:
    """A recording at 1 kHz, and its first thousand rows in a second file."""
    block = 100_000
    with path.open("w") as file:
        file.write(HEADER)
        for start in range(0, rows, block):
            time = 1e-3 * np.arange(start, min(start + block, rows))
            swing = np.sin(time / 7)
            columns = np.column_stack([time, 3 + 2 * np.sin(time / 100), 100 + 50 * swing, 10 + 8 * swing])
            np.savetxt(file, columns, fmt=["%.4f", "%.5f", "%.4f", "%.5f"], delimiter=",")
    with path.open() as file, Path(f"{path}.head").open("w") as head:
        head.writelines(line for line, _ in zip(file, range(1001), strict=False))


def reading(folder: Path, *, quick: bool) -> Table:
    """The table of both readers."""
    rows: list[Row] = []
    environment = {**os.environ, "MCKIBBEN_READ_LIMITS": "4"}  # 1e7 rows of four columns are beyond the default
    for count in (1_000_000,) if quick else (1_000_000, 10_000_000):
        path = folder / f"{count}.csv"
        write(path, count)
        seconds: dict[str, list[float]] = {"pandas": [], "ours": []}
        memory = dict.fromkeys(seconds, 0.0)
        for _ in range(3):
            for reader, taken in seconds.items():
                command = [sys.executable, "-c", PROGRAM, reader, str(path)]
                answer = subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout
                used, peak, found = map(float, answer.split())
                if found != count:
                    raise ValueError(f"{reader} read {found:g} rows of {count}")
                taken.append(used)
                memory[reader] = max(memory[reader], peak)
        path.unlink()
        base = f"{PANDAS}, {count:.0e} rows"
        ratios = [one / other for one, other in zip(seconds["ours"], seconds["pandas"], strict=True)]
        for reader, name, ratio in (
            ("pandas", base, 1.0),
            ("ours", f"ours, read_recording, {count:.0e} rows", statistics.median(ratios)),
        ):
            note = f"{memory[reader] / 1e6:.0f} MB at most, with the interpreter"
            rows.append(Row(name, note=note, base=base, seconds=tuple(seconds[reader]), ratio=ratio))
    notes = (
        "Four columns. Processor time of the call in a process that has read a small file before, with its child "
        "process; ours checks and converts every number and reports the columns.",
    )
    return Table("Reading a CSV file", "file", "time", "", tuple(rows), notes)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        print(as_markdown(reading(Path(place), quick="--quick" in sys.argv)))
