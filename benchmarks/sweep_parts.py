"""Memory, disk and time of a sweep in parts and of their merging, per million runs.

    python benchmarks/sweep_parts.py [--runs 40000] [--parts 4] [--short] [--undivided]

Each part and the merging is a process of its own, as on a cluster; runs of 0.2 s with one metric, two inputs. With
--short, runs take 0.1 s, with one integration step per control period, in 32 bits: many runs in little time. With
--undivided, the sweep is computed without parts as well, and has to be the same, byte for byte.
"""

import argparse
import filecmp
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PART = """
import sys
from pathlib import Path
from mckibben.scenario import Scenario
from mckibben.study.sweep import merge, summary, sweep
runs, part, short, out, *folders = sys.argv[1:]
if folders:
    (Path(out) / "statistics").write_text(repr(summary(merge(folders, out))))
else:
    short = short == "True"
    changed = {"duration": 0.1, "substeps": 1} if short else {"duration": 0.2}
    scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update=changed)
    over = ["load.mass2=0.2 kg..1.0 kg", "controller.position.kp=0.5..10 bar/rad log"]
    precision = 32 if short else 64
    swept = sweep(
        scenario, over, samples=int(runs), metrics=["angle_rmse"], precision=precision, out=out, part=part or None
    )
    if not part:
        (Path(out) / "statistics").write_text(repr(summary(swept)))
import resource
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_maxrss / 1e6, used.ru_utime + used.ru_stime)
"""


def main():
    """Compute and merge the parts, and print what each took."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--runs", type=int, default=40_000)
    options.add_argument("--parts", type=int, default=4)
    options.add_argument("--short", action="store_true")
    options.add_argument("--undivided", action="store_true")
    asked = options.parse_args()
    million = asked.runs / 1e6
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        numbers = range(1, asked.parts + 1)
        begin = time.perf_counter()
        each = [taken(asked.runs, f"{k}/{asked.parts}", asked.short, folder / f"{k}") for k in numbers]
        memory, used = zip(*each, strict=True)
        seconds = f"{time.perf_counter() - begin:.0f} s ({sum(used):.0f} s of processor time)"
        print(
            f"{asked.runs} runs in {asked.parts} parts: {seconds}, at most {max(memory):.2f} GB of memory", flush=True
        )
        for file in ("sweep.journal", "sweep.nc"):
            size = sum((folder / f"{k}" / file).stat().st_size for k in numbers)
            print(f"{file}: {size / 1e6 / million:.1f} MB per million runs")
        begin = time.perf_counter()
        merged, _ = taken(asked.runs, "", asked.short, folder / "merged", *(folder / f"{k}" for k in numbers))
        seconds = time.perf_counter() - begin
        print(f"merging and statistics: {seconds:.1f} s, {merged:.2f} GB of memory", flush=True)
        if asked.undivided:
            taken(asked.runs, "", asked.short, folder / "undivided")
            for file in ("sweep.nc", "statistics"):
                same = filecmp.cmp(folder / "merged" / file, folder / "undivided" / file, shallow=False)
                print(f"{file}: {'the same bytes' if same else 'DIFFERENT'} without parts")


def taken(*arguments):
    """Largest memory [GB] and processor time [s] of a process."""
    command = [sys.executable, "-c", PART, *map(str, arguments)]
    root = Path(__file__).parents[1]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=root)
    memory, seconds = map(float, done.stdout.split()[-2:])
    print(f"{' '.join(map(str, arguments[:2]))}: {memory:.2f} GB, {seconds:.0f} s of processor time", flush=True)
    return memory, seconds


if __name__ == "__main__":
    main()
