"""A sweep with its journal, feasibility and table, against the bare batch of the same runs.

    python benchmarks/sweep.py [--runs 20000] [--rounds 5]

Both in turns, each with a part of the runs a round; the ratio is the median over the rounds.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from mckibben import sweep
from mckibben.numerics.batching import cores
from mckibben.scenario import Scenario, run_many

SCENARIO = Path(__file__).parents[1] / "examples" / "pre-contracted-step-pid.yaml"
OVER = ["load.mass2=0.2 kg..1.0 kg", "controller.position.kp=0.5..10 bar/rad log"]


def main():
    """Run both in turns and print the ratio."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=20_000)
    options.add_argument("--rounds", type=int, default=5)
    asked = options.parse_args()
    scenario, runs = Scenario.read(SCENARIO), asked.runs // asked.rounds
    times = {"bare batch": [], "sweep": []}
    with tempfile.TemporaryDirectory() as folder:
        for number in range(asked.rounds + 1):  # the first compiles
            seconds, swept = timed(lambda n=number: sweep(scenario, OVER, samples=runs, seed=n, out=f"{folder}/{n}"))
            table = {name: swept.table[name].to_numpy() for name in swept.inputs}
            bare, batch = timed(lambda t=table: run_many(scenario, t, workers=cores()))
            assert abs(batch["angle_rmse"] - swept.table["angle_rmse"].to_numpy()).max() < 1e-9
            if number:
                times["sweep"].append(seconds)
                times["bare batch"].append(bare)
    for name, found in times.items():
        print(f"{name}: {statistics.median(found):.2f} s for {runs} runs of 10 s on {cores()} cores")
    ratios = [one / other for one, other in zip(*reversed(times.values()), strict=True)]
    print(f"ratio {statistics.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})")


def timed(call):
    """Seconds of a call, and its result."""
    begin = time.perf_counter()
    result = call()
    return time.perf_counter() - begin, result


if __name__ == "__main__":
    main()
