"""Degenerate tests of foreign muscles: how many give a law without a word.

    python benchmarks/designs.py [COUNT]

A muscle of random size after Chou and Hannaford, with an elastic bladder that no law of this project contains, is
measured, with noise, at one load, one pressure or one length, along a curve through pressures and contractions, or
without pressure. Such points determine no force law: each must be refused, or its law carry a severe remark. Prints the
number of each kind, of refusals, of severe remarks, and of laws that are silent.
"""

import sys
import warnings
from collections import Counter

import numpy as np
from scipy.optimize import brentq

from mckibben import ExponentialLaw, IsobaricDataset
from mckibben.errors import IdentificationError, McKibbenWarning
from mckibben.identification import fit_law
from mckibben.result import Severity
from mckibben.units import bar, deg, mm

KINDS = ("one load", "one pressure", "one length", "curve", "no pressure")


def muscle(rng):
    """Force [N] over contraction and pressure [Pa]."""
    angle, area, stiffness = rng.uniform(18, 28) * deg, np.pi / 4 * (rng.uniform(8, 40) * mm) ** 2, rng.uniform(0, 300)
    slope, intercept = 3 / np.tan(angle) ** 2, 1 / np.sin(angle) ** 2

    def force(contraction, pressure):
        bladder = stiffness * (np.exp(-20 * contraction) - 0.2) * area / 1e-4
        return pressure * area * (slope * (1 - contraction) ** 2 - intercept) + 0.01 * bladder

    return force


def degenerate(kind, rng):
    """Points of a degenerate test."""
    force, count = muscle(rng), int(rng.integers(10, 60))
    pressure = np.sort(rng.uniform(1, 6, count)) * bar
    largest = float(force(0.0, 6 * bar))
    if kind == "one load":
        load = rng.uniform(0.05, 0.25) * largest
        contraction = np.array([brentq(lambda e, p=p: force(e, p) - load, -0.5, 0.6) for p in pressure])
        pulls = np.full(count, load)
    else:
        contraction = np.linspace(0, 0.12, count)
        if kind == "one pressure":
            pressure = np.full(count, rng.uniform(3, 6) * bar)
        elif kind == "one length":
            contraction = np.full(count, rng.uniform(0, 0.1))
        elif kind == "no pressure":
            pressure = np.zeros(count)
        else:
            contraction = 0.12 * ((pressure - pressure[0]) / np.ptp(pressure)) ** rng.uniform(0.5, 2)
        pulls = force(contraction, pressure)
    noise = rng.uniform(0, 2e-3, 3)[:, None] * rng.standard_normal((3, count))
    noise[0] *= kind not in ("one pressure", "no pressure")  # a regulator, or a valve to the air
    noise[2] *= kind != "one load" or rng.random() < 0.5  # weights that are typed
    return IsobaricDataset.of(
        pressure=pressure + 6 * bar * noise[0],
        contraction=contraction + 0.1 * noise[1],
        force=pulls + largest * noise[2],
        slack_force=0.0,
    )


def outcome(data):
    """How a test ends: refused, severe or silent."""
    try:
        fit = fit_law(ExponentialLaw, data)
    except IdentificationError:
        return "refused"
    return "severe" if any(note.severity is Severity.SEVERE for note in fit.notes) else "silent"


def outcomes(count, seed=0):
    """Numbers of outcomes by kind of test."""
    rng = np.random.default_rng(seed)
    return {kind: Counter(outcome(degenerate(kind, rng)) for _ in range(-(-count // len(KINDS)))) for kind in KINDS}


def main():
    warnings.simplefilter("ignore", McKibbenWarning)
    for kind, numbers in outcomes(int(sys.argv[1]) if len(sys.argv) > 1 else 1000).items():
        print(f"{kind:14}", ", ".join(f"{number} {word}" for word, number in numbers.items()))


if __name__ == "__main__":
    main()
