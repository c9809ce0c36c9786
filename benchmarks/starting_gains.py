"""Gains to start from for each setup of examples/comparison/valves.yaml: those of examples/valves/.

    python benchmarks/starting_gains.py [--setup NAME] [--disk-margin 0.4] [--runs 240] [--seed 7]

A grid of gains of the compensated decoupling, with none, half and all of the friction in the observer, runs on plants
drawn from the conditions of the suite, none of them a run of the comparison. Of the gains whose loop in the file keeps
the disk margin, the table has those with the fewest failed runs (diverged or limit cycles) and, of these, with the
least sum of the median angle RMSE over 0.2 deg and the median air over 0.3 L, the scales of the suite. The last columns
are those of the file's present gains on the evaluation runs of the comparison, which the grid has not seen.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
from lab_valves import FILES

from mckibben.component.schema import replaced
from mckibben.scenario import Scenario, with_values
from mckibben.study.benchmark import Suite, draw, evaluate
from mckibben.units import deg, litre

SUITE, GAINS = Path("examples/comparison/valves.yaml"), Path("examples/valves")
CONTROLLERS = "decoupling, delay compensated", "decoupling, friction in the observer"
BANDWIDTHS = tuple(f"controller.{name}.bandwidth" for name in ("feedback", "observer", "pressure_observer"))
SHARE = "controller.friction_in_observer"
GRID = (20.0, 30.0, 40.0, 60.0), (0.5, 1.0, 2.0, 4.0), (60.0, 300.0)  # rad/s; the observer's, of the feedback's; rad/s
SHARES = 0.5, 1.0
MOST = 24  # of a batch


def grid(runs):
    """Gains [SI] by name; failed runs, median angle RMSE [deg] and air [L] of each."""
    bandwidths = [(feedback, ratio * feedback, pressures) for feedback, ratio, pressures in itertools.product(*GRID)]
    for controller, shares in zip(CONTROLLERS, ((), SHARES), strict=True):
        several = [one + share for one in bandwidths for share in ([(each,) for each in shares] or [()])]
        names = BANDWIDTHS + ((SHARE,) if shares else ())
        for first in range(0, len(several), MOST):
            sets = several[first : first + MOST]
            values = {name: np.array(column) for name, column in zip(names, zip(*sets, strict=True), strict=True)}
            batch = evaluate(runs, controller, values, metrics=["angle_rmse", "air"])
            usable, error, air = (
                np.reshape(column, (len(sets), -1))
                for column in (batch.usable, batch.metrics["angle_rmse"] / deg, batch.metrics["air"] / litre)
            )
            for row, gains in enumerate(sets):
                kept = usable[row]
                found = np.median(np.where(kept, error[row], np.inf)), np.median(air[row, kept])
                yield dict(zip(names, gains, strict=True)), int((~kept).sum()), *map(float, found)


def main():
    """Search the grid of each setup."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=240)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--setup", choices=FILES)
    parser.add_argument("--disk-margin", type=float, default=0.4)
    given = parser.parse_args()
    columns = "friction in the observer | feedback | observer | pressures | disk margin | angle | failed | air"
    print(f"| setup | {columns} | unseen runs | failed |")
    print(f"|{11 * '---|'}", flush=True)
    for setup in [given.setup] if given.setup else FILES:
        suite = Suite.read(SUITE).of_setup(setup)
        scenario = Scenario.read(GAINS / f"{FILES[setup]}-decoupling.yaml")
        found = list(grid(draw(suite, given.runs, given.seed)))
        row = "none" + 7 * " | "
        for gains, failed, error, air in sorted(found, key=lambda one: (one[1], one[2] / 0.2 + one[3] / 0.3)):
            control = replaced(scenario.controller, {"friction_in_observer": gains.get(SHARE)})
            tried = with_values(scenario.replace(controller=control), gains)
            margin = float(tried.margins(points=6).disk.min())
            if margin >= given.disk_margin:
                feedback, observer, pressures = (f"{gains[name]:g} rad/s" for name in BANDWIDTHS)
                row = f"{gains.get(SHARE, 0):.0%} | {feedback} | {observer} | {pressures} | {margin:.2f} | "
                row += f"{error:.2f} deg | {failed} of {given.runs} | {air:.2f} L"
                break
        present = suite.model_copy(update={"controllers": {setup: scenario.controller}})
        unseen = draw(present, suite.evaluation.runs, suite.evaluation.seed)
        batch = evaluate(unseen, setup, {}, metrics=["angle_rmse"])
        error = float(np.median(np.where(batch.usable, batch.metrics["angle_rmse"], np.inf))) / deg
        print(f"| {setup} | {row} | {error:.2f} deg | {int((~batch.usable).sum())} |", flush=True)


if __name__ == "__main__":
    main()
