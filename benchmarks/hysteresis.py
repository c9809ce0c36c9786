"""Errors of hysteresis and static law identified on the simulated rig.

    python benchmarks/hysteresis.py [--seeds 12] [--noisy 100]

Eq. 3 with a friction band of 12 N, 13 pressures, 2 repeats, 100 samples a plateau; with and without a drift of the
force sensor. With `--noisy`, that many data sets per row with noise of the length instead: a presliding length of 0.8
mm, 3 pressures, 3 repeats. Prints the tables of docs/hysteresis.md; the first takes a minute or two, a row of the
second with 100 data sets 3 to 5 min of one core.
"""

import argparse
import dataclasses

import numpy as np

from mckibben import catalog, identify
from mckibben.dataset import IsobaricDataset
from mckibben.identification import identify_hysteresis
from mckibben.muscle import ExponentialLaw, Muscle, forces
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar, mm

LAW = catalog.law("lei-mas-10-180n")
MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), LAW)
PROTOCOL = IsobaricProtocol(pressures=np.linspace(0, 6, 13) * bar, repeats=2, samples=100)
HALF_WIDTH = 12.0
PRESLIDING, LEVELS = 0.8 * mm, np.array([3, 4, 5]) * bar
STEP, NOISES = 0.5 * mm, (0.0, 20e-6)  # m: steps, and noise of the length
DRIFT, WALK = {"force_drift": 0.5}, {"force_drift": 0.5, "force_wander": 0.2}


def off(law):
    """RMSE of a law from the true one [N], over the taut domain."""
    contraction, pressure = np.meshgrid(np.linspace(0, 0.2, 41), np.linspace(0.5, 6, 23) * bar)
    true = forces(LAW, contraction, pressure)
    there = (true > 10) & (true < 600)
    return float(np.sqrt(np.mean((forces(law, contraction, pressure) - true)[there] ** 2)))


def noisy(noise, seed):
    """Points of loops with noise of the length [m]."""
    protocol = dataclasses.replace(PROTOCOL, pressures=LEVELS, step=STEP, repeats=3, samples=4)
    data = SimulatedIsobaricTest(MUSCLE, hysteresis=HALF_WIDTH, presliding_length=PRESLIDING).run(protocol, seed=seed)
    data = data.plateau_means()
    errors = noise / MUSCLE.specimen.initial_length * np.random.default_rng(seed).standard_normal(len(data))
    return IsobaricDataset(data.table.assign(contraction=data.table["contraction"] + errors))


def print_noisy(count):
    """Print the table of the friction found from loops with noise of the length."""
    share = "within two standard errors"
    print(f"| noise of the length | presliding length | {share} | half width | {share} |\n|---|---|---|---|---|")
    for noise in NOISES:
        cells = []
        found = [identify_hysteresis(ExponentialLaw, noisy(noise, seed), drift=False) for seed in range(count)]
        for name, true, unit in (("presliding_length", PRESLIDING, mm), ("half_width", HALF_WIDTH, 1.0)):
            values = np.array([getattr(one.friction, name) for one in found])
            inside = np.abs(values - true) < 2 * np.array([one.standard_errors[name] for one in found])
            cells += [f"{values.mean() / unit:.4g} +- {values.std() / unit:.2g}", f"{100 * inside.mean():.0f} %"]
        print(f"| {noise * 1e6:.0f} um | {' | '.join(cells)} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description="Hysteresis and law found on the simulated rig.")
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--noisy", type=int, default=0, help="number of data sets with noise of the length")
    options = parser.parse_args()
    if options.noisy:
        print_noisy(options.noisy)
        return
    seeds = range(options.seeds)
    rows = (
        ("no hysteresis, no drift", "`identify`", {"hysteresis": 0}, False),
        ("hysteresis", "`identify_hysteresis`", {}, True),
        ("hysteresis, drift 0.5 N/h", "`identify_hysteresis`", DRIFT, True),
        ("hysteresis, drift 0.5 N/h and a random walk of 0.2 N an hour", "`identify_hysteresis`", WALK, True),
        ("hysteresis", "`identify`, all points", {}, False),
        ("hysteresis, drift 0.5 N/h", "`identify`, all points", DRIFT, False),
    )
    print("| data | law | RMSE against the truth | half width off by at most |\n|---|---|---|---|")
    for name, how, rig, jointly in rows:
        errors, widths = [], []
        for seed in seeds:
            data = SimulatedIsobaricTest(MUSCLE, **{"hysteresis": HALF_WIDTH, **rig}).run(PROTOCOL, seed=seed)
            found = identify_hysteresis(ExponentialLaw, data) if jointly else identify(ExponentialLaw, data)
            errors.append(off(found.law))
            widths += [abs(found.friction.half_width / HALF_WIDTH - 1)] if jointly else []
        width = f"{100 * max(widths):.2g} %" if widths else ""
        print(f"| {name} | {how} | {np.sqrt(np.mean(np.square(errors))):.2g} N | {width} |", flush=True)


if __name__ == "__main__":
    main()
