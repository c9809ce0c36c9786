"""Ratio of the angle error of decoupling, with and without an estimate of the valve lag, to the oracle's at one air.

    mckibben compare examples/comparison/knee.yaml --out comparison
    python benchmarks/equal_air.py comparison [--runs 512] [--seed 1]

`compare` holds the air in its training runs; on others the controllers then differ in it. Here gains go along a
geometric line from those as tuned to those at equal air and a little beyond, and the errors of all are
interpolated, by their logarithms, at common amounts of air. No gain is chosen by these runs.
"""

import argparse
import json
from pathlib import Path

import numpy as np

from mckibben.study.compare import Suite, draw, evaluate
from mckibben.units import deg, litre

NAMES = ("decoupling, friction fed forward", "decoupling, valve lag adapted", "oracle")
SHARES = np.linspace(0.0, 1.25, 6)
AIRS = np.array([0.24, 0.26, 0.28, 0.30, 0.32])  # L


def main():
    """Evaluate and print both tables."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("folder", type=Path)
    options.add_argument("--runs", type=int, default=512)
    options.add_argument("--seed", type=int, default=1)
    given = options.parse_args()
    results = json.loads((given.folder / "results.json").read_text(encoding="utf-8"))
    runs = draw(Suite.read(given.folder / "suite.yaml"), given.runs, given.seed)
    errors = {}
    print("| controller | " + " | ".join(f"{share:.2f}" for share in SHARES) + " |")
    print("|---" * (SHARES.size + 1) + "|")
    for name in NAMES:
        first, last = results["controllers"][name]["tuned"], results["at_air_of_first"]["controllers"][name]["tuned"]
        table = {key: low * (last[key] / low) ** SHARES for key, low in first.items()}
        batch = evaluate(runs, name, table, metrics=("angle_rmse", "air"))
        shape = (SHARES.size, given.runs)
        angle, air = (np.nanmedian(batch[key].reshape(shape), axis=1) for key in ("angle_rmse", "air"))
        angle, air = angle / deg, air / litre
        cells = " | ".join(f"{one:.4f} deg, {other:.3f} L" for one, other in zip(angle, air, strict=True))
        print(f"| {name} | {cells} |")
        order = np.argsort(air)
        errors[name] = np.exp(np.interp(AIRS, air[order], np.log(angle[order]), left=np.nan, right=np.nan))
    *others, oracle = NAMES
    print("\n| air | " + " | ".join(f"{name} | ratio" for name in others) + f" | {oracle} |")
    print("|---" * (2 * len(NAMES)) + "|")
    for i, air in enumerate(AIRS):
        best = errors[oracle][i]
        cells = [f"{errors[name][i]:.4f} deg | {errors[name][i] / best:.2f}" for name in others]
        print(f"| {air:.2f} L | {' | '.join(cells)} | {best:.4f} deg |")


if __name__ == "__main__":
    main()
