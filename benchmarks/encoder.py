"""Cost of an encoder's steps: error and air of decoupling control and of its oracle, by encoder and bandwidth.

    python benchmarks/encoder.py [--runs 128]

Runs of `examples/comparison/knee.yaml`, the same for all encoders, which have no steps, or 14 or 12 bits a turn. The
observers are 10/3 times as fast as the poles, as in the file, where these have 60 rad/s.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from mckibben.study.compare import Suite, draw, evaluate
from mckibben.units import deg, litre

SUITE = Path(__file__).parents[1] / "examples" / "comparison" / "knee.yaml"
NAMES = ("decoupling, friction fed forward", "oracle")
BITS = (0, 14, 12)
POLES = np.array([30.0, 60.0, 120.0])  # rad/s
FACTORS = {"poles": 1.0, "disturbance_observer": 10 / 3, "pressure_observer": 10 / 3}


def main():
    """Evaluate and print the table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--runs", type=int, default=128)
    count, suite = options.parse_args().runs, Suite.read(SUITE)
    table = {f"controller.decoupling.{part}.bandwidth": POLES * factor for part, factor in FACTORS.items()}
    found = {}
    for name in NAMES:
        for bits in BITS:
            sensors = dataclasses.replace(suite.sensors, encoder=360 * deg / 2**bits if bits else 0.0)
            runs = draw(suite.model_copy(update={"sensors": sensors}), count, suite.evaluation.seed)
            batch = evaluate(runs, name, table, metrics=("angle_rmse", "air"))
            shape = (POLES.size, count)
            found[name, bits] = [np.nanmedian(batch[key].reshape(shape), axis=1) for key in ("angle_rmse", "air")]
    print("| controller | poles | " + " | ".join(f"{bits} bits" if bits else "no steps" for bits in BITS) + " |")
    print("|---" * (len(BITS) + 2) + "|")
    for name in NAMES:
        for i, poles in enumerate(POLES):
            pairs = [(angle[i] / deg, air[i] / litre) for angle, air in (found[name, bits] for bits in BITS)]
            cells = " | ".join(f"{angle:.3f} deg, {air:.2f} L" for angle, air in pairs)
            print(f"| {name} | {poles:g} rad/s | {cells} |")


if __name__ == "__main__":
    main()
