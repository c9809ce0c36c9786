"""Errors of `SmoothLaw` at points left out, relative to those of Eq. 2, on simulated muscles of other laws.

    python benchmarks/laws.py [--seeds 4] [--laws Sarosi,Hunt] [--cases 600]

A muscle has a law that is neither of the two, fitted to the measured map or the maker's chart of the catalog, at two
sizes, with and without a deviation that is smooth in contraction and bends over pressure, with noise of three sizes.
It is measured at 16 to 96 points, and both laws are cross-validated as `mk.rank` does: over pressures and inner
contractions. The highest pressure is predicted by `mk.identify` from all others, which repeats the choice of the law.
`--cases` takes a random part of the cases. Prints the table of docs/laws.md; all cases take 20 min of one core.
"""

import argparse
import itertools
import random
import warnings

import numpy as np

import mckibben as mk
from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.muscle import ExponentialLaw, ForceLaw, SmoothLaw, forces
from mckibben.units import bar, percent

TRUTHS = {
    "TonduLopezVariable": "festo-tool-10mm",
    "Sarosi": "festo-tool-10mm",
    "MartensBoblan": "dmsp-10-250-martens2017",
    "TsagarakisCaldwell": "dmsp-10-250-martens2017",
    "Hunt": "dmsp-10-250-martens2017",
}
DESIGNS = ((4, 5), (5, 7), (7, 9), (8, 13))  # pressures, contractions
NOISES = (0.3, 1.2, 5.0)  # N
SIZES = (1.0, 4.0)  # of the force: diameters of 10 and 20 mm
DEVIATION = 0.05  # of the largest force
TAUT = 10.0  # N
WORSE = 1.05
HIGHEST = "highest pressure"


def measured(law: ForceLaw, design, noise: float, size: float, bent: bool, seed: int) -> IsobaricDataset:
    """Taut points of a muscle in a grid, with noise [N]."""
    pressures, contractions = np.linspace(0, 6, design[0]) * bar, np.linspace(0, 24, design[1]) * percent
    p, eps = (axis.ravel() for axis in np.meshgrid(pressures, contractions, indexing="ij"))
    force = size * forces(law, eps, p)
    rng = np.random.default_rng(seed)
    if bent:
        phase, q = rng.uniform(0, 2 * np.pi), p / pressures[-1]
        force += DEVIATION * force.max() * np.sin(2 * np.pi * eps / 0.3 + phase) * q * (1.5 - q)
    force += rng.normal(0, noise, force.size)
    taut = force > TAUT
    return IsobaricDataset.of(pressure=p[taut], contraction=eps[taut], force=force[taut])


def ratios(data: IsobaricDataset) -> dict[str, float]:
    """RMSE of SmoothLaw at left-out points over that of Eq. 2 by kind of block."""
    ranking = mk.rank(data, [SmoothLaw, ExponentialLaw])
    ours, theirs = (ranking.of(law.__name__).cross_validation for law in (SmoothLaw, ExponentialLaw))
    found = {kind: ours[kind].rmse / theirs[kind].rmse for kind in ours if kind in theirs and kind != HIGHEST}
    top = data.levels == data.levels.max()
    rest, new = data.select(~top), data.select(top)
    try:
        fits = [mk.identify(law, rest) for law in (SmoothLaw, ExponentialLaw)]
    except IdentificationError:
        return found
    ours, theirs = (np.linalg.norm(forces(fit.law, new.contraction, new.pressure) - new.force) for fit in fits)
    return found | {HIGHEST: float(ours / theirs)}


def main():
    parser = argparse.ArgumentParser(description="SmoothLaw against Eq. 2 at points left out.")
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--laws", default=",".join(TRUTHS), help="laws of the simulated muscles")
    parser.add_argument("--cases", type=int, help="number of cases drawn from all")
    options = parser.parse_args()
    warnings.simplefilter("ignore", McKibbenWarning)
    found: dict[str, list[tuple[float, str]]] = {}
    both, refused = [], 0
    names = options.laws.split(",")
    truths = {name: mk.identify(mk.muscle.LAWS[f"{name}Law"], catalog.dataset(TRUTHS[name])).law for name in names}
    cases = list(itertools.product(names, DESIGNS, NOISES, SIZES, (False, True), range(options.seeds)))
    random.Random(7).shuffle(cases)
    for name, *case in cases[: options.cases]:
        data = measured(truths[name], *case)
        try:
            ratio = ratios(data)
        except IdentificationError:
            refused += 1
            continue
        label = f"{name} {case}, {len(data)} points"
        for kind, value in ratio.items():
            found.setdefault(kind, []).append((value, label))
        if {"pressure", "contraction"} <= ratio.keys():
            both.append((float(np.sqrt(ratio["pressure"] * ratio["contraction"])), label))
    found["pressure and contraction"] = list(both)
    print("| blocks | cases | geometric mean | median | above 1.05 | largest |\n|---|---|---|---|---|---|")
    for kind, cases in found.items():
        values = np.array([value for value, _ in cases])
        mean = np.exp(np.log(values).mean())
        row = (f"{mean:.2f}", f"{np.median(values):.2f}", (values > WORSE).sum(), f"{values.max():.2f}")
        print(f"| {kind} | {len(values)} | {' | '.join(map(str, row))} |")
    print(f"\n{refused} data sets do not determine the laws. Ratios above {WORSE}:")
    for kind, cases in found.items():
        for value, label in sorted(cases, reverse=True):
            if value > WORSE:
                print(f"  {value:.3f} {kind}: {label}")


if __name__ == "__main__":
    main()
