"""Pooled specimens of one make: errors at left-out specimens and lengths, and coverage for a length not measured.

    python benchmarks/pooling.py [--pools 20]

Five simulated specimens of 100 to 400 mm with Eq. 3 have four fixed lengths and six pressures each, noise of 0.5 N, a
dead length of 15 mm, and a strength with a scatter of 3 %. Prints the pool of the first seed, and how a sixth specimen
of 250 mm is predicted.
"""

import argparse
import warnings

import numpy as np

import mckibben as mk
from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenWarning
from mckibben.muscle import forces
from mckibben.units import bar, mm

LAW = catalog.law("lei-mas-10-180n")
LENGTHS, DEAD, SCATTER, NOISE = np.array([100, 150, 200, 300, 400]) * mm, 15 * mm, 0.03, 0.5


def specimen(length: float, rng: np.random.Generator, dead: float = DEAD, scatter: float = SCATTER) -> IsobaricDataset:
    """Points of a specimen."""
    contraction, pressure = (one.ravel() for one in np.meshgrid([0.0, 0.05, 0.1, 0.15], np.arange(1, 7) * bar))
    contraction = contraction + rng.uniform(-0.01, 0.01)
    force = np.maximum(forces(LAW, contraction * length / (length - dead), pressure), 0)
    force = force * (1 + scatter * rng.standard_normal()) + NOISE * rng.standard_normal(len(force))
    return IsobaricDataset.of(
        pressure=pressure,
        contraction=contraction,
        force=force,
        initial_length=length,
        slack_force=3.0,
        specimen=f"L{length / mm:g}",
    )


def main():
    parser = argparse.ArgumentParser(description="Pooled specimens of one make.")
    parser.add_argument("--pools", type=int, default=20)
    options = parser.parse_args()
    warnings.simplefilter("ignore", McKibbenWarning)
    inside, errors, dead = [], [], []
    for seed in range(options.pools):
        rng = np.random.default_rng(seed)
        found = mk.identify_pooled(mk.ExponentialLaw, [specimen(length, rng) for length in LENGTHS])
        if not seed:
            print(found.report(), flush=True)
        new = specimen(0.25, rng).taut
        force, lower, upper = found.predict(new.contraction, new.levels, 0.25)
        inside.append(float(np.mean((lower <= new.force) & (new.force <= upper))))
        errors.append(float(np.sqrt(np.mean((force - new.force) ** 2))))
        dead.append((found.dead_length - DEAD, found.dead_length_error))
    print(f"\n{options.pools} pools: a new specimen of 250 mm is predicted to {np.mean(errors):.3g} N (RMSE),")
    print(f"{100 * np.mean(inside):.0f} % of its points inside of 95 % intervals")
    error, stated = np.sqrt(np.mean(np.square(dead), axis=0)) / mm
    print(f"errors of the dead length: {error:.2g} mm (RMS), standard errors: {stated:.2g} mm")


if __name__ == "__main__":
    main()
