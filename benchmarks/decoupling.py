"""Overshoot of decoupling and of prediction after large steps with slow valves: a table of docs/results/controllers.md.

python benchmarks/decoupling.py
"""

from pathlib import Path

import equinox as eqx

import mckibben as mk
from mckibben.units import bar, deg, mm, ms

SUITE = Path(__file__).parent.parent / "examples" / "comparison" / "knee.yaml"
KNEE = eqx.tree_at(lambda j: j.geometry.connector_length, mk.catalog.joint("knee-table-2"), 208 * mm)
LOAD = mk.catalog.load("knee-table-2")
SOFT = (3 * bar, 40 * bar, 0.5 * bar), (0.08 * bar, 5 * bar, 0.0)
CYCLES = (1, 2, 3, 5, 8)


def looking_ahead(steps=((20, 100), (40, 100), (40, 20))):
    """How far beyond the reference a joint goes after a step of an angle [deg], with valves of a lag [ms]."""
    print("| | inverse | predictive | and 120 ms ahead |\n|---|---|---|---|")
    for step, lag in steps:
        plant = mk.JointPlant(KNEE, LOAD, mk.FirstOrderValve(lag * ms))
        believed = {"valve": mk.FirstOrderValve(lag * ms)}
        parts = KNEE, LOAD, mk.ExtendedStateObserver(250.0)
        controllers = (
            mk.DecouplingControl(KNEE, LOAD, mk.PolePlacement(80.0), mk.ExtendedStateObserver(250.0), **believed),
            mk.PredictiveControl(*parts, bandwidth=80.0, **believed),
            mk.PredictiveControl(*parts, bandwidth=80.0, horizon=120 * ms, **believed),
        )
        half = step / 2 * deg
        reference = mk.Reference(angle=mk.Step(-half, half, 0.5), stiffness=16.5)
        cells = []
        for control in controllers:
            angle = mk.simulate(plant, control, reference, duration=1.5).columns["angle"]
            cells.append(f"{(angle[500:].max() - half) / deg:.2g} deg")
        print(f"| step of {step} deg, valves of {lag} ms: overshoot | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    looking_ahead()
