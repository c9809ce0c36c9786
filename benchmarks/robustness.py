"""Controllers outside the conditions that they were tuned for: slow valves, and a low supply.

    python benchmarks/robustness.py [--runs 96]

Runs of examples/comparison/knee.yaml (10 to 50 ms of valve lag, 20 believed; rated pressure 8 bar), then with valves of
55 to 65 ms, then with a supply of 4.5 to 5 bar. Gains are those of the suite's tuning, rounded, but where the name says
otherwise. Median and 95th percentile of the RMS angle error, median air, and diverged runs if there are any.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mckibben.control import SupplyLimit
from mckibben.study.compare import Suite, draw, evaluate
from mckibben.units import bar, deg, ms

SUITE = Suite.read(Path(__file__).parents[1] / "examples" / "comparison" / "knee.yaml")
PID = {
    "position.kp": 12.4 * bar,
    "position.ki": 872 * bar,
    "position.kd": 1.89 * bar,
    "position.filter_time": 0.96 * ms,
    "position.tracking_time": 15 * ms,
    "stiffness.kp": 0.155 * bar,
    "stiffness.ki": 17.5 * bar,
}


def decoupling(feedback, observer, pressure):
    """Values of a `DecouplingControl`: bandwidth [rad/s] of poles, or slope [1/s] and reach, and of observers."""
    law = {"feedback.bandwidth": feedback} if np.ndim(feedback) == 0 else dict(zip(_SLIDING, feedback, strict=True))
    return {**law, "observer.bandwidth": observer, "pressure_observer.bandwidth": pressure}


_SLIDING = ("feedback.slope", "feedback.reach")
FED, LAG = "decoupling, friction fed forward", "decoupling, valve lag adapted"
ROWS = {
    "PID": ("PID", PID, False),
    "PID, supply estimated": ("PID", PID, True),
    f"{FED}; pressure observer of 50 rad/s": (FED, decoupling(62, 170, 50), False),
    "141 rad/s, as tuned": (FED, decoupling(62, 170, 141), False),
    "200 rad/s": (FED, decoupling(62, 170, 200), False),
    "400 rad/s": (FED, decoupling(62, 170, 400), False),
    "141 rad/s, supply estimated": (FED, decoupling(62, 170, 141), True),
    "141 rad/s, valve lag adapted": (LAG, decoupling(62, 170, 141), False),
    "the same, supply estimated": (LAG, decoupling(62, 170, 141), True),
    "at the air of PID": (FED, decoupling(74, 209, 109), False),
    "at the air of PID, valve lag adapted": (LAG, decoupling(74, 209, 109), False),
    "sliding mode, 49 rad/s, as tuned": ("sliding mode", decoupling((38, 165), 155, 49), False),
    "sliding mode, 200 rad/s": ("sliding mode", decoupling((38, 165), 155, 200), False),
}


CONDITIONS = {
    "as tuned": (),
    "slow valves": ("valve.time_constant=55..65 ms",),
    "low supply": ("valve.supply=4.5..5 bar",),
}


def drawn(suite, condition, runs):
    """The runs of a suite under a condition."""
    changed = [text.split("=")[0] for text in CONDITIONS[condition]]
    kept = [text for text in suite.conditions if text.split("=")[0] not in changed]
    valve = dataclasses.replace(suite.valve, supply=8 * bar)
    return draw(suite.model_copy(update={"valve": valve, "conditions": (*kept, *CONDITIONS[condition])}), runs, 5)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=96)
    runs = parser.parse_args().runs
    print(f"| angle RMSE, median (95 %), and air | {' | '.join(CONDITIONS)} |\n|---{'|---' * len(CONDITIONS)}|")
    for name, (controller, values, estimated) in ROWS.items():
        control = SUITE.controllers[controller]
        if estimated:
            control = SupplyLimit(control)
        suite = SUITE.model_copy(update={"controllers": {controller: control}, "true_model": ()})
        cells = []
        for condition in CONDITIONS:
            prefix = "controller.controller" if estimated else "controller"
            values_by_name = {f"{prefix}.{key}": float(value) for key, value in values.items()}
            batch = evaluate(drawn(suite, condition, runs), controller, values_by_name)
            error = np.where(batch.failed, np.inf, batch["angle_rmse"]) / deg
            middle, tail = np.percentile(error, (50, 95))
            lost = f", {batch.failed.sum()} diverged" if batch.failed.any() else ""
            cells.append(f"{middle:.3f} ({tail:.2f}) deg, {np.median(batch['air']) * 1e3:.2f} L{lost}")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
