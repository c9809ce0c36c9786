"""Damping of the poles and of the disturbance observer of decoupling control, at equal air.

    python benchmarks/damping.py [--runs 96]

Runs of `examples/comparison/knee.yaml`, other than those of its tuning and evaluation. By pair of dampings: the least
median angle RMSE at a median air, interpolated between bandwidths of the poles, for observers 2.2 to 3.9 times as fast.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from mckibben.study.compare import Suite, draw, evaluate
from mckibben.units import deg, litre

SUITE = Path(__file__).parents[1] / "examples" / "comparison" / "knee.yaml"
NAME, PARTS = "decoupling, friction fed forward", ("poles", "disturbance_observer", "pressure_observer")
DAMPINGS = tuple(product((3.0, 2.5, 2.0), (3.0, 2.0)))  # of the poles, of the observer
POLES = np.geomspace(50, 110, 13)  # rad/s
FACTORS, PRESSURES = (2.2, 2.5, 2.8, 3.1, 3.9), (100.0, 200.0, 400.0)  # rad/s
AIR = np.array([0.22, 0.25, 0.28, 0.31]) * litre


def main():
    """Evaluate and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=96)
    suite = Suite.read(SUITE)
    runs = draw(suite, options.parse_args().runs, 7)
    titles = (f"{air / litre:.2f} L" for air in AIR)
    print(f"| damping of the poles | of the observer | {' | '.join(titles)} |\n|---{'|---' * (AIR.size + 1)}|")
    for dampings in DAMPINGS:
        errors = []
        for factor, pressure in product(FACTORS, PRESSURES):
            table = dict(zip(PARTS, (POLES, POLES * factor, np.full(POLES.size, pressure)), strict=True))
            values = {f"controller.decoupling.{part}.bandwidth": value for part, value in table.items()}
            for part, damping in zip(PARTS, dampings, strict=False):
                values[f"controller.decoupling.{part}.damping"] = np.full(POLES.size, damping)
            batch = evaluate(runs, NAME, values, metrics=("angle_rmse", "air"))
            good = ~batch.failed.reshape(POLES.size, -1).any(axis=1)
            air, error = (np.median(batch[key].reshape(POLES.size, -1)[good], axis=1) for key in ("air", "angle_rmse"))
            order = np.argsort(air)
            errors.append(np.exp(np.interp(AIR, air[order], np.log(error[order]), left=np.inf, right=np.inf)))
        cells = (f"{error / deg:.4f} deg" for error in np.min(errors, axis=0))
        print(f"| {dampings[0]:g} | {dampings[1]:g} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
