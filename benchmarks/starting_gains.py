"""Gains to start from for each setup of examples/comparison/valves.yaml.

    python benchmarks/starting_gains.py [--setup NAME] [--disk-margin 0.4] [--runs 240] [--more 2000] [--seed 7]

A grid of gains of the compensated decoupling, with none, half and all of the friction in the observer, runs on plants
drawn from the conditions of the suite, none of them a run of the comparison. The best of them run on many more plants,
as few runs do not distinguish failure rates below a percent. Of the gains whose loop in the file keeps the disk
margin, the table has those with the fewest failed runs (diverged or limit cycles) and, of these, with the least sum of
the median angle RMSE over 0.2 deg and the median air over 0.3 L, the scales of the suite. The last columns are those of
the file's present gains on the evaluation runs of the comparison, which the grid has not seen: the median angle error,
the failed runs, and those of them that fail with a single pulse of the disturbance, too. The others end in oscillations
that decay, and that every pulse excites again.
"""

import argparse
import itertools
from pathlib import Path

import numpy as np
from foreign_valves import BANDWIDTHS
from lab_valves import FILES

from mckibben.component.schema import replaced
from mckibben.scenario import Scenario, with_values
from mckibben.study.compare import Suite, draw, evaluate
from mckibben.units import deg, litre

SUITE, GAINS = Path("examples/comparison/valves.yaml"), Path("examples/valves")
CONTROLLERS = "decoupling, delay compensated", "decoupling, friction in the observer"
SHARE = "controller.friction_in_observer"
GRID = (20.0, 30.0, 40.0, 60.0), (1.0, 2.0, 4.0, 6.0), (60.0, 200.0, 600.0)  # rad/s; observer over feedback; rad/s
SHARES = 0.0, 0.5, 1.0
MOST = 24  # of a batch
BEST = 24  # that run on more plants


def tried(several, runs):
    """Gains, failed runs, median angle RMSE [deg] and air [L] of each on the runs, the best first.

    Gains are the bandwidths of feedback, observer and pressures [rad/s], and the share of the friction.
    """
    found = []
    for controller, names in zip(CONTROLLERS, (BANDWIDTHS, (*BANDWIDTHS, SHARE)), strict=True):
        chosen = [one for one in several if bool(one[-1]) == (SHARE in names)]
        for first in range(0, len(chosen), MOST):
            sets = chosen[first : first + MOST]
            values = dict(zip(names, np.array(sets).T, strict=False))  # without the share, where it is zero
            batch = evaluate(runs, controller, values, metrics=["angle_rmse", "air"])
            usable, error, air = (
                np.reshape(column, (len(sets), -1))
                for column in (batch.usable, batch.metrics["angle_rmse"] / deg, batch.metrics["air"] / litre)
            )
            for row, gains in enumerate(sets):
                kept = usable[row]
                median = np.median(np.where(kept, error[row], np.inf)), np.median(air[row, kept])
                found.append((gains, int((~kept).sum()), *map(float, median)))
    return sorted(found, key=lambda one: (one[1], one[2] / 0.2 + one[3] / 0.3))


def least_disk_margin(scenario, gains):
    """Least disk margin of the loop of a scenario with other gains."""
    control = replaced(scenario.controller, {"friction_in_observer": gains[-1] or None})
    values = dict(zip(BANDWIDTHS, gains, strict=False))
    return float(with_values(scenario.replace(controller=control), values).margins(points=6).disk.min())


def main():
    """Search the grid of each setup."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=240)
    parser.add_argument("--more", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--setup", choices=FILES)
    parser.add_argument("--disk-margin", type=float, default=0.4)
    given = parser.parse_args()
    columns = "friction in the observer | feedback | observer | pressures | disk margin | angle | failed | air"
    print(f"| setup | {columns} | unseen runs | failed | and after one pulse |")
    print(f"|{12 * '---|'}", flush=True)
    errors, airs = [], []
    for setup in [given.setup] if given.setup else FILES:
        suite = Suite.read(SUITE).of_setup(setup)
        scenario = Scenario.read(GAINS / f"{FILES[setup]}-decoupling.yaml")
        grid = [(feedback, ratio * feedback, *others) for feedback, ratio, *others in itertools.product(*GRID, SHARES)]
        ranked = (one for one, *_ in tried(grid, draw(suite, given.runs, given.seed)))
        robust = (one for one in ranked if least_disk_margin(scenario, one) >= given.disk_margin)
        row = "none" + 7 * " | "
        best = tried(list(itertools.islice(robust, BEST)), draw(suite, given.more, given.seed + 1))
        for gains, failed, error, air in best[:1]:
            feedback, observer, pressures = (f"{bandwidth:g} rad/s" for bandwidth in gains[:-1])
            row = f"{gains[-1]:.0%} | {feedback} | {observer} | {pressures} | "
            margin = least_disk_margin(scenario, gains)
            row += f"{margin:.2f} | {error:.2f} deg | {failed} of {given.more} | {air:.2f} L"
        present = suite.model_copy(update={"controllers": {setup: scenario.controller}})
        once = replaced(suite.disturbance, {"interval": 2 * suite.duration})
        batch, single = (
            evaluate(draw(one, suite.evaluation.runs, suite.evaluation.seed), setup, {}, metrics=["angle_rmse", "air"])
            for one in (present, present.model_copy(update={"disturbance": once}))
        )
        errors.append(np.where(batch.usable, batch.metrics["angle_rmse"], np.inf) / deg)
        airs.append(batch.metrics["air"] / litre)
        failed = ~batch.usable
        counts = f"{failed.sum()} | {(failed & ~single.usable).sum()}"
        print(f"| {setup} | {row} | {np.median(errors[-1]):.2f} deg | {counts} |", flush=True)
    unseen, air = np.concatenate(errors), np.median(np.concatenate(airs))
    print(f"{unseen.size} runs: median {np.median(unseen):.2f} deg with {air:.2f} L, {np.isinf(unseen).sum()} failed")


if __name__ == "__main__":
    main()
