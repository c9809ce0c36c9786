"""Good points that `identify` names as outliers, and wrong numbers that it finds, on simulated muscles of other laws.

    python benchmarks/outliers.py [--seeds 1] [--laws Hunt,MartensBoblan]

A muscle has Eq. 3, or a law that is not Eq. 2 as in `benchmarks/laws.py`, with and without a smooth deviation of 5 % of
the largest force. Its taut points are measured on two grids, and at contractions that differ from pressure to pressure,
with noise of three sizes. Prints, per law, in how many data sets good points are named; in how many one number that is
12 % too large or too small, and a slip of the decimal point, is named; and in how many of these good points are named,
too. The default takes a minute of one core; the figures are those of docs/uncertainty.md.
"""

import argparse
import itertools
import warnings

import numpy as np
from laws import TRUTHS

import mckibben as mk
from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenWarning
from mckibben.identification import find_outliers
from mckibben.muscle import forces
from mckibben.units import bar, percent

DESIGNS = ((8, 16, True), (7, 9, True), (10, 12, False))  # pressures, contractions, and whether these are on a grid
NOISES = (0.05, 0.3, 1.2)  # N
DEVIATION = 0.05  # of the largest force
LARGE = 0.1  # of the largest force: a number that may be wrong
WRONG = {"12 %": (0.88, 1.12), "slip": (0.1, 10.0)}


def measured(law, design, noise, bent, rng):
    """Taut points of a muscle: pressure [Pa], contraction and force [N]."""
    pressures, count, on_grid = design
    p = np.repeat(np.linspace(0, 6, pressures) * bar, count)
    even = np.tile(np.linspace(0, 24, count) * percent, pressures)
    eps = even if on_grid else np.sort(rng.uniform(0, 24, (pressures, count)) * percent, axis=1).ravel()
    force = np.array(forces(law, eps, p))
    if bent:
        phase, q = rng.uniform(0, 2 * np.pi), p / p.max()
        force += DEVIATION * force.max() * np.sin(2 * np.pi * eps / 0.3 + phase) * q * (1.5 - q)
    force += noise * rng.standard_normal(force.size)
    taut = force > max(2.5, 5 * noise)
    return p[taut], eps[taut], force[taut]


def named(p, eps, force):
    """Indices of the points that are named."""
    data = IsobaricDataset.of(pressure=p, contraction=eps, force=force, slack_force=0.0)
    return {one.row - 1 for one in find_outliers(data)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--laws", default="Exponential," + ",".join(TRUTHS), help="laws of the simulated muscles")
    options = parser.parse_args()
    warnings.simplefilter("ignore", McKibbenWarning)
    print("| law | data sets | good ones with a named point | 12 % named | slip named | good points named, too |")
    print("|---|---|---|---|---|---|")
    for name in options.laws.split(","):
        law = catalog.law("lei-mas-10-180n")
        if name in TRUTHS:
            law = mk.identify(mk.muscle.LAWS[f"{name}Law"], catalog.dataset(TRUTHS[name])).law
        cases = [*itertools.product(DESIGNS, (False, True), range(options.seeds))]
        good, too, found = 0, 0, dict.fromkeys(WRONG, 0)
        for noise, (case, (design, bent, _)) in itertools.product(NOISES, enumerate(cases)):
            rng = np.random.default_rng([case, *name.encode(), int(100 * noise)])
            p, eps, force = measured(law, design, noise, bent, rng)
            good += bool(named(p, eps, force))
            for kind, factors in WRONG.items():
                at = int(rng.choice(np.flatnonzero(force > LARGE * force.max())))
                wrong = np.where(np.arange(force.size) == at, force * rng.choice(factors), force)
                rows = named(p, eps, wrong)
                found[kind] += at in rows
                too += bool(rows - {at})
        count, hits = len(NOISES) * len(cases), " | ".join(f"{one}" for one in found.values())
        print(f"| {name} | {count} | {good} | {hits} | {too} of {2 * count} |", flush=True)


if __name__ == "__main__":
    main()
