"""Errors of hysteresis and static law identified on the simulated rig.

    python benchmarks/hysteresis.py [--seeds 12]

Eq. 3 with a friction band of 12 N, 13 pressures, 2 repeats, 100 samples a plateau; with and without a drift of the
force sensor. Prints the table of docs/hysteresis.md; takes a minute or two.
"""

import argparse

import numpy as np

from mckibben import catalog, identify
from mckibben.identification import identify_hysteresis
from mckibben.muscle import ExponentialLaw, Muscle, forces
from mckibben.rig import IsobaricProtocol, SimulatedIsobaricTest
from mckibben.units import bar

LAW = catalog.law("lei-mas-10-180n")
MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), LAW)
PROTOCOL = IsobaricProtocol(pressures=np.linspace(0, 6, 13) * bar, repeats=2, samples=100)
HALF_WIDTH = 12.0
DRIFT, WALK = {"force_drift": 0.5}, {"force_drift": 0.5, "force_wander": 0.2}


def off(law):
    """RMSE of a law from the true one [N], over the taut domain."""
    contraction, pressure = np.meshgrid(np.linspace(0, 0.2, 41), np.linspace(0.5, 6, 23) * bar)
    true = forces(LAW, contraction, pressure)
    there = (true > 10) & (true < 600)
    return float(np.sqrt(np.mean((forces(law, contraction, pressure) - true)[there] ** 2)))


def main():
    parser = argparse.ArgumentParser(description="Hysteresis and law found on the simulated rig.")
    parser.add_argument("--seeds", type=int, default=12)
    seeds = range(parser.parse_args().seeds)
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
