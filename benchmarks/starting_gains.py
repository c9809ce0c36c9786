"""Gains to start from for each setup of examples/comparison/valves.yaml: those of examples/valves/.

    python benchmarks/starting_gains.py [--setup NAME] [--pressures 60] [--disk-margin 0.4] [--runs 60] [--seed 7]

A grid of gains of the compensated decoupling, with the friction in the observer and without, runs on plants drawn from
the conditions of the suite, none of them a run of the comparison. Of the gains whose loop in the file keeps the disk
margin, the table has those with the fewest failed runs (diverged or limit cycles) and, of these, with the least sum of
the median angle RMSE over 0.2 deg and the median air over 0.3 L, the scales of the suite.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
from lab_valves import FILES

from mckibben.component.schema import replaced
from mckibben.scenario import Scenario, with_values
from mckibben.simulation import simulate_many
from mckibben.study.benchmark import Suite, draw
from mckibben.units import deg, litre

SUITE, GAINS = Path("examples/comparison/valves.yaml"), Path("examples/valves")
FEEDBACK = (20.0, 30.0, 40.0, 60.0)  # rad/s
OBSERVER = (0.5, 1.0, 2.0, 4.0)  # of the bandwidth of the feedback


def candidates(path, pressures):
    """Scenarios of the file with the gains of the grid, and these gains as cells of the table."""
    given = Scenario.read(path)
    for observed, feedback, ratio in itertools.product((False, True), FEEDBACK, OBSERVER):
        bandwidths = {"feedback": feedback, "observer": ratio * feedback, "pressure_observer": pressures}
        tried = with_values(given, {f"controller.{name}.bandwidth": value for name, value in bandwidths.items()})
        tried = tried.replace(controller=replaced(tried.controller, {"friction_in_observer": observed}))
        yield tried, f"{'yes' if observed else 'no'} | {feedback:g} | {ratio * feedback:g}"


def main():
    """Search the grid of each setup."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--setup", choices=FILES)
    parser.add_argument("--pressures", type=float, default=60.0, help="bandwidth of their observer [rad/s]")
    parser.add_argument("--disk-margin", type=float, default=0.4)
    given = parser.parse_args()
    print("| setup | friction in the observer | feedback | observer | disk margin | angle | failed | air |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for setup in [given.setup] if given.setup else FILES:
        suite = Suite.read(SUITE).of_setup(setup)
        (runs,) = draw(suite, given.runs, given.seed).groups
        found = []
        for tried, gains in candidates(GAINS / f"{FILES[setup]}-decoupling.yaml", given.pressures):
            batch = simulate_many(
                runs.plant,
                tried.control(),
                runs.reference,
                duration=suite.duration,
                control_period=suite.control_period,
                substeps=suite.substeps,
                metrics=["angle_rmse", "air"],
            )
            error = np.median(np.where(batch.usable, batch.metrics["angle_rmse"], np.inf)) / deg
            failed, air = int((~batch.usable).sum()), np.nanmedian(batch.metrics["air"]) / litre
            found.append((failed, error / 0.2 + air / 0.3, gains, error, air, tried))
        for failed, _, gains, error, air, tried in sorted(found, key=lambda one: one[:3]):
            margin = float(tried.margins(points=6).disk.min())
            if margin >= given.disk_margin:
                row = f"{gains} | {margin:.2f} | {error:.2f} deg | {failed} of {given.runs} | {air:.2f} L"
                print(f"| {setup} | {row} |", flush=True)
                break
        else:
            print(f"{setup}: no gains keep the disk margin", flush=True)


if __name__ == "__main__":
    main()
