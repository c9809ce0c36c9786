"""What tubes, a sagging supply, unequal valves and hysteresis cost controllers that were tuned without them.

    python benchmarks/lab_valves.py [--runs 64] [--setup NAME]

The gains of examples/valves/ on evaluation runs of examples/comparison/valves.yaml, and of lab.yaml with two models:
that of the plant's own valves with a tube, and that of valves with a dead volume in its place. Median angle RMSE,
in which failed runs count as infinite, the numbers of diverged runs and of limit cycles, and the median use of air.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mckibben.component.schema import replaced
from mckibben.scenario import Scenario
from mckibben.study.compare import Suite, compare
from mckibben.units import deg, litre

ROOT = Path(__file__).parent.parent / "examples"
FILES = {
    "SMC ITV0050": "itv0050",
    "regulator of 0.05 L/(s*bar)": "regulator",
    "Festo VPPE-6": "vppe-6",
    "Festo MPYE-5-M5": "mpye-5-m5",
    "Festo MH1, switching at 100 Hz": "mh1",
}


def evaluated(suite, controllers, runs):
    """Median angle RMSE, diverged runs and limit cycles, and median air of each controller."""
    tuning = suite.tuning.model_copy(update={"untuned": tuple(controllers), "starts_of": {}, "over": {}})
    evaluation = suite.evaluation.model_copy(update={"runs": runs})
    changed = {"controllers": controllers, "true_model": (), "tuning": tuning, "evaluation": evaluation}
    result = compare(suite.model_copy(update=changed))
    found = {}
    for name in controllers:
        errors = result.metric(name, "angle_rmse")
        median = np.median(np.where(np.isfinite(errors), errors, np.inf)) / deg
        air = np.nanmedian(result.metric(name, "air")) / litre
        failed = f"{result.diverged(name).sum()} + {result.oscillates(name).sum()}"
        found[name] = f"{median:.2f} deg ({failed}), {air:.2f} L"
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=64)
    parser.add_argument("--setup", choices=FILES)
    given = parser.parse_args()
    print("| setup | controller | valves.yaml | lab.yaml, tube known | lab.yaml, dead volume |")
    print("|---|---|---|---|---|")
    for name in [given.setup] if given.setup else FILES:
        plain, lab = (Suite.read(ROOT / "comparison" / f"{one}.yaml").of_setup(name) for one in ("valves", "lab"))
        tube = lab.valve.muscle1
        whole = dataclasses.replace(tube.valve, dead_volume=tube.dead_volume)
        paths = {one: ROOT / "valves" / f"{FILES[name]}-{one}.yaml" for one in ("decoupling", "pid")}
        read = {one: Scenario.read(path).controller for one, path in paths.items() if path.is_file()}
        before = evaluated(plain, {one: replaced(own, {"valve": plain.valve}) for one, own in read.items()}, given.runs)
        models = {"known": tube, "dead volume": whole}
        both = {
            f"{one}, {model}": replaced(own, {"valve": valve})
            for one, own in read.items()
            for model, valve in models.items()
        }
        after = evaluated(lab, both, given.runs)
        for one in read:
            print(
                f"| {name} | {one} | {before[one]} | {after[f'{one}, known']} | {after[f'{one}, dead volume']} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
