"""Good points that `identify` leaves out as outliers, and what that changes.

    python benchmarks/outliers.py [--sets 20]

Hunt's law, fitted to the measured map of the catalog, is measured at 8 pressures and 16 contractions with little noise:
beside its steepest point, at the highest pressure and the longest muscle, no smooth surface follows it. Prints, per
noise, in how many data sets good points are named, and among these the largest change of a coefficient by leaving them
out, in its standard errors, of Hunt's law and of Eq. 2, and the median RMSE to the truth without them and with all
points, of Eq. 2 and of the smooth law. Takes seven minutes; the figures are those of docs/uncertainty.md.
"""

import argparse
import warnings

import numpy as np

import mckibben as mk
from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import McKibbenWarning
from mckibben.muscle import ExponentialLaw, HuntLaw, SmoothLaw, forces
from mckibben.units import bar, percent

NOISES = (0.05, 0.1, 0.3, 1.0)  # N
_GRID = np.meshgrid(np.linspace(0, 6, 8) * bar, np.linspace(0, 24, 16) * percent)
PRESSURE, CONTRACTION = (one.ravel() for one in _GRID)
SLACK = 2.5  # N


def measured(law, noise, seed):
    force = forces(law, CONTRACTION, PRESSURE) + noise * np.random.default_rng(seed).standard_normal(CONTRACTION.size)
    return IsobaricDataset.of(
        pressure=PRESSURE, contraction=CONTRACTION, force=np.maximum(force, 0.0), slack_force=max(SLACK, 5 * noise)
    )


def error(fit, truth, points):
    """RMSE [N] to the truth at points."""
    at = points.contraction, points.pressure
    return float(np.sqrt(np.mean((forces(fit.law, *at) - forces(truth, *at)) ** 2)))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=20)
    sets = parser.parse_args().sets
    warnings.simplefilter("ignore", McKibbenWarning)
    truth = mk.identify(HuntLaw, catalog.dataset("dmsp-10-250-martens2017")).law
    print("| noise | named in | Hunt changes | Eq. 2 changes | Eq. 2 without, with | smooth without, with |")
    print("|---|---|---|---|---|---|")
    for noise in NOISES:
        changes, errors = {HuntLaw: [], ExponentialLaw: []}, {ExponentialLaw: [], SmoothLaw: []}
        for seed in range(sets):
            data = measured(truth, noise, seed)
            if not mk.identification.find_outliers(data):
                continue
            for law in (HuntLaw, ExponentialLaw, SmoothLaw):
                without, with_all = (mk.identify(law, data, robust=robust) for robust in (True, False))
                if law in changes:
                    moved = [abs(without.estimates[name] - with_all.estimates[name]) for name in without.estimates]
                    changes[law].append(max(np.array(moved) / list(without.standard_errors.values())))
                if law in errors:
                    errors[law].append((error(without, truth, data.taut), error(with_all, truth, data.taut)))
        named = len(changes[HuntLaw])
        cells = [f"{max(found):.1f}" for found in changes.values()] if named else ["-", "-"]
        medians = [np.median(found, axis=0) if found else () for found in errors.values()]
        cells += [", ".join(f"{one:.2f} N" for one in found) or "-" for found in medians]
        print(f"| {noise:g} N | {named} of {sets} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
