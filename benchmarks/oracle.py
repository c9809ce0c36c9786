"""Errors on real valves against those of commands optimised off line for the plant of each run.

    python benchmarks/oracle.py [--runs 6] [--seed 1] [--setup NAME]

The runs are the first of those of `mckibben compare examples/comparison/valves.yaml`, for each setup; the controller is
the compensated decoupling with the gains of examples/valves/. To show what its error comes from, it also runs with
perfect sensors, without disturbance torques, with the plant of the run as its model, and with all of them.
"""

import argparse
from pathlib import Path

import numpy as np
from lab_valves import FILES

from mckibben.errors import McKibbenError
from mckibben.plant import NoDisturbance, PerfectSensors
from mckibben.scenario import Scenario, run_scenario
from mckibben.study.benchmark import Suite, draw
from mckibben.study.oracle import oracle
from mckibben.units import deg

SUITE, GAINS = Path("examples/comparison/valves.yaml"), Path("examples/valves")
QUIET = {"sensors": PerfectSensors()}
STILL = {"disturbance": NoDisturbance()}


def variants(run: Scenario, tuned: Scenario) -> dict[str, Scenario]:
    """The run with other conditions for the controller."""
    fixed = {"controller": tuned.with_fixed_model().controller}
    known = {"controller": tuned.controller}  # takes the plant as its model
    changes = {
        "as it is": fixed,
        "perfect sensors": fixed | QUIET,
        "no disturbance": fixed | STILL,
        "true model": known,
        "all three": known | QUIET | STILL,
    }
    return {name: run.model_copy(update=change) for name, change in changes.items()}


def main() -> None:
    """Optimise the runs and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--setup", choices=FILES)
    options = parser.parse_args()
    suite = Suite.read(SUITE)
    for setup, file in FILES.items():
        if options.setup not in (None, setup):
            continue
        tuned = Scenario.read(GAINS / f"{file}-decoupling.yaml")
        runs = draw(suite.of_setup(setup), suite.evaluation.runs, options.seed)
        name = next(iter(suite.controllers))
        rows, apart = [], []
        errors: dict[str, list[float]] = {}
        for number in range(options.runs):
            several = variants(runs.scenario(name, number), tuned)
            try:
                found = oracle(several["as it is"])
            except McKibbenError as error:
                print(f"{setup}, run {number}: left out, {error}", flush=True)
                continue
            controlled, optimal = (each.metrics["angle_rmse"] / deg for each in (found.controlled, found.optimal))
            costs = [start.cost for start in found.starts]
            rows.append((controlled, optimal, found.ratio))
            apart.append(max(costs) / min(costs) - 1)
            for variant, each in several.items():
                errors.setdefault(variant, []).append(run_scenario(each).result.metrics["angle_rmse"] / deg)
            stiffness = [each.metrics["stiffness_rmse"] for each in (found.controlled, found.optimal)]
            print(
                f"{setup}, run {number}, {runs.reference_name[number]}: {found.controlled.outcome.name}, "
                f"angle {controlled:.3g} deg, optimal {optimal:.2g} deg, ratio {found.ratio:.3g}; "
                f"stiffness {stiffness[0]:.2g}, optimal {stiffness[1]:.2g} N*m/rad; starts {apart[-1]:.2%} apart",
                flush=True,
            )
        if not rows:
            continue
        middle, low, high = (np.percentile(np.array(rows), part, axis=0) for part in (50, 0, 100))
        print(
            f"{setup}: {len(rows)} runs, median (least to largest): controller {middle[0]:.2g} deg, "
            f"optimal {middle[1]:.2g} deg ({low[1]:.1g} to {high[1]:.2g}), "
            f"ratio {middle[2]:.3g} ({low[2]:.3g} to {high[2]:.3g}); starts at most {max(apart):.2%} apart"
        )
        print(f"{setup}: " + ", ".join(f"{one} {np.median(each):.2g} deg" for one, each in errors.items()), flush=True)


if __name__ == "__main__":
    main()
