"""Degenerate tests of foreign muscles: how many give a law without a word.

    python benchmarks/designs.py [COUNT]

A muscle of random size after Chou and Hannaford, with an elastic bladder that no law of this project contains, is
measured, with noise, at one load, one pressure or one length, at two that are nearly equal, at one load but for one
point, along a curve through pressures and contractions, in loops, or without pressure. Such points determine no force
law: each must be refused, its law carry a severe remark, or its intervals hold the truth in the range of the points.
Prints the number of each kind, of refusals, of severe remarks, of right laws, and of laws that are silent.
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

KINDS = [
    *("one load", "one pressure", "one length", "curve", "no pressure", "noisy pressure", "two near loads"),
    *("two near pressures", "two near lengths", "proportional", "one loop", "one other load"),
]


def muscle(rng):
    """Force [N] over contraction and pressure [Pa]."""
    angle, area, stiffness = rng.uniform(18, 28) * deg, np.pi / 4 * (rng.uniform(8, 40) * mm) ** 2, rng.uniform(0, 300)
    slope, intercept = 3 / np.tan(angle) ** 2, 1 / np.sin(angle) ** 2

    def force(contraction, pressure):
        bladder = stiffness * (np.exp(-20 * contraction) - 0.2) * area / 1e-4
        return pressure * area * (slope * (1 - contraction) ** 2 - intercept) + 0.01 * bladder

    return force


def places(kind, force, rng):
    """Contractions, pressures [Pa] and forces [N] of a degenerate test."""
    count = int(rng.integers(10, 60))
    pressure, contraction = np.sort(rng.uniform(1, 6, count)) * bar, np.linspace(0, 0.12, count)
    largest, near, some = float(force(0.0, 6 * bar)), 1 + rng.uniform(0.002, 0.02), np.arange(count) % 2 == 0
    if kind in ("one load", "two near loads", "one loop", "one other load"):
        load = np.full(count, rng.uniform(0.05, 0.25) * largest)
        if kind == "two near loads":
            load[some] *= near
        elif kind == "one other load":
            load[-1] *= rng.uniform(1.2, 2)
        rubbing = np.zeros(count)
        if kind == "one loop":
            pressure = np.tile(np.append(pressure[::2], pressure[::-2]), 3)
            load, rubbing = np.full(len(pressure), load[0]), np.full(len(pressure), rng.uniform(0.002, 0.02) * largest)
            rubbing *= np.sign(np.gradient(pressure))
        held = zip(pressure, load + rubbing, strict=True)
        return np.array([brentq(lambda e, p=p, f=f: force(e, p) - f, -0.5, 0.6) for p, f in held]), pressure, load
    if kind in ("one pressure", "noisy pressure", "two near pressures"):
        pressure = np.full(count, rng.uniform(3, 6) * bar) * np.where(some & ("two" in kind), near, 1.0)
    elif kind in ("one length", "two near lengths"):
        contraction = rng.uniform(0.02, 0.1) * np.where(some & ("two" in kind), near, np.ones(count))
    elif kind == "no pressure":
        pressure = np.zeros(count)
    else:
        exponent = 1.0 if kind == "proportional" else rng.uniform(0.5, 2)
        contraction = 0.12 * ((pressure - pressure[0]) / np.ptp(pressure)) ** exponent
    return contraction, pressure, force(contraction, pressure)


def degenerate(kind, rng):
    """Points of a degenerate test, and the force of its muscle."""
    force = muscle(rng)
    contraction, pressure, pulls = places(kind, force, rng)
    largest = float(force(0.0, 6 * bar))
    noise = rng.uniform(0, 2e-3, 3)[:, None] * rng.standard_normal((3, len(pulls)))
    noise[0] *= kind not in ("one pressure", "no pressure")  # a regulator, or a valve to the air
    noise[2] *= "load" not in kind or rng.random() < 0.5  # weights that are typed
    data = IsobaricDataset.of(
        pressure=pressure + 6 * bar * noise[0],
        contraction=contraction + 0.1 * noise[1],
        force=pulls + largest * noise[2],
        slack_force=0.0,
    )
    return data, force


def outcome(data, force):
    """How a test ends: refused, severe, right in the range of its points, or silent."""
    try:
        fit = fit_law(ExponentialLaw, data)
    except IdentificationError:
        return "refused"
    if any(note.severity is Severity.SEVERE for note in fit.notes):
        return "severe"
    ends = ((column.min(), column.max()) for column in (data.contraction, data.pressure))
    contraction, pressure = (axis.ravel() for axis in np.meshgrid(*(np.linspace(*pair, 9) for pair in ends)))
    true = force(contraction, pressure)
    band = fit.force_intervals(contraction, pressure).confidence
    return "right" if np.mean(np.asarray(band.contains(true))[true > 0]) > 0.5 else "silent"


def outcomes(count, seed=0):
    """Numbers of outcomes by kind of test."""
    rng = np.random.default_rng(seed)
    return {kind: Counter(outcome(*degenerate(kind, rng)) for _ in range(-(-count // len(KINDS)))) for kind in KINDS}


def main():
    warnings.simplefilter("ignore", McKibbenWarning)
    for kind, numbers in outcomes(int(sys.argv[1]) if len(sys.argv) > 1 else 1000).items():
        print(f"{kind:14}", ", ".join(f"{number} {word}" for word, number in numbers.items()))


if __name__ == "__main__":
    main()
