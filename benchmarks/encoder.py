"""Cost of an encoder's steps: errors and air of decoupling control and of its oracle, with steps and without.

    python benchmarks/encoder.py [--runs 256] [--generations 8]

The runs are those of `examples/comparison/knee.yaml` but for the encoder. The controllers are tuned for its steps of
0.022 deg (14 bits) and, anew, for none, with one search of so many generations each.
"""

import argparse
from pathlib import Path

import numpy as np

from mckibben.study.benchmark import Suite, compare, draw, evaluate
from mckibben.units import deg, litre

SUITE = Path(__file__).parents[1] / "examples" / "comparison" / "knee.yaml"
NAMES = ("decoupling, friction fed forward", "oracle")
STEPS = (0.0, 0.022 * deg, 0.088 * deg)  # none, 14 and 12 bits


def with_steps(suite, step):
    """The suite with another encoder."""
    return suite.model_copy(update={"sensors": suite.sensors.model_copy(update={"encoder": step})})


def show(name, step, tuned_for, batch):
    """Print a row of the table."""
    angle, air = batch.metrics["angle_rmse"] / deg, batch.metrics["air"] / litre
    numbers = f"{np.nanmedian(angle):.3f} deg ({np.nanpercentile(angle, 95):.2f}) | {np.nanmedian(air):.2f} L"
    print(f"| {name} | {step / deg:g} deg | {tuned_for / deg:g} deg | {numbers} |", flush=True)


def main():
    """Tune, evaluate and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=256)
    options.add_argument("--generations", type=int, default=8)
    given = options.parse_args()
    suite = Suite.read(SUITE)
    suite = suite.model_copy(
        update={
            "controllers": {name: suite.controllers[name] for name in NAMES},
            "tuning": suite.tuning.model_copy(update={"starts": 1, "generations": given.generations}),
            "evaluation": suite.evaluation.model_copy(update={"runs": given.runs}),
        }
    )
    print("| controller | encoder | tuned for | angle RMSE, median (95 %) | air |\n|---|---|---|---|---|")
    for tuned_for in (STEPS[1], STEPS[0]):
        result = compare(with_steps(suite, tuned_for), progress=lambda *_: None)
        for name in NAMES:
            for step in STEPS if tuned_for else (0.0,):
                runs = draw(with_steps(suite, step), given.runs, suite.evaluation.seed)
                show(name, step, tuned_for, evaluate(runs, name, result.tuned[name]))


if __name__ == "__main__":
    main()
