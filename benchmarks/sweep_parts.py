"""Memory, disk and time of a sweep in parts and of their merging, per million runs.

    python benchmarks/sweep_parts.py [--runs 40000] [--parts 4] [--made-up]

Each part and the merging is a process of its own, as on a cluster; runs of 0.2 s with one metric, two inputs. With
--made-up nothing is simulated: the memory and the disk of many runs, in little time.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PART = """
import sys
from mckibben.scenario import Scenario
from mckibben.study.sweep import merge, summary, sweep
runs, part, made_up, out, *folders = sys.argv[1:]
if made_up == "True":
    import numpy as np
    from mckibben.study.sweep.compute import FEASIBILITY, BatchTask
    def invented(task, table):
        mass, gain = table.values()
        nothing = np.zeros(len(mass))
        return {"angle_rmse": mass / gain, "outcome": nothing.astype(np.int8), **dict.fromkeys(FEASIBILITY, nothing)}
    BatchTask.__call__ = invented
if folders:
    summary(merge(folders, out))
else:
    scenario = Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.2})
    over = ["load.mass2=0.2 kg..1.0 kg", "controller.position.kp=0.5..10 bar/rad log"]
    sweep(scenario, over, samples=int(runs), metrics=["angle_rmse"], out=out, part=part or None)
import resource
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6)
"""


def main():
    """Compute and merge the parts, and print what each took."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--runs", type=int, default=40_000)
    options.add_argument("--parts", type=int, default=4)
    options.add_argument("--made-up", action="store_true")
    asked = options.parse_args()
    million = asked.runs / 1e6
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        numbers = range(1, asked.parts + 1)
        begin = time.perf_counter()
        memory = [memory_of(asked.runs, f"{k}/{asked.parts}", asked.made_up, folder / f"{k}") for k in numbers]
        seconds = time.perf_counter() - begin
        print(f"{asked.runs} runs in {asked.parts} parts: {seconds:.0f} s, at most {max(memory):.2f} GB of memory")
        for file in ("sweep.journal", "sweep.nc"):
            size = sum((folder / f"{k}" / file).stat().st_size for k in numbers)
            print(f"{file}: {size / 1e6 / million:.1f} MB per million runs")
        begin = time.perf_counter()
        merged = memory_of(asked.runs, "", asked.made_up, folder / "merged", *(folder / f"{k}" for k in numbers))
        seconds = time.perf_counter() - begin
        print(f"merging and statistics: {seconds:.1f} s, {merged:.2f} GB of memory")


def memory_of(*arguments):
    """Largest memory [GB] of a process."""
    command = [sys.executable, "-c", PART, *map(str, arguments)]
    root = Path(__file__).parents[1]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=root)
    return float(done.stdout.split()[-1])


if __name__ == "__main__":
    main()
