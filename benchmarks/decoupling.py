"""What parts of controllers are for: the tables of docs/results/controllers.md.

    python benchmarks/decoupling.py

Looking ahead: large steps and slow valves, with a right model. Learning: one sine again and again, on 64 knees of the
suite examples/comparison/knee.yaml.
"""

from pathlib import Path

import equinox as eqx
import numpy as np

from mckibben import catalog
from mckibben.actuator import FirstOrderValve
from mckibben.control import (
    PID,
    DecouplingControl,
    ExtendedStateObserver,
    InverseModelControl,
    PolePlacement,
    PositionStiffnessControl,
    PredictiveControl,
    Reference,
    Sine,
    Step,
)
from mckibben.plant import JointPlant
from mckibben.simulation import simulate, simulate_many
from mckibben.study.compare import Suite, draw
from mckibben.units import bar, deg, mm, ms

SUITE = Path(__file__).parent.parent / "examples" / "comparison" / "knee.yaml"
KNEE = eqx.tree_at(lambda j: j.geometry.connector_length, catalog.joint("knee-table-2"), 208 * mm)
LOAD = catalog.load("knee-table-2")
SOFT = (3 * bar, 40 * bar, 0.5 * bar), (0.08 * bar, 5 * bar, 0.0)
CYCLES = (1, 2, 3, 5, 8)


def looking_ahead(steps=((20, 100), (40, 100), (40, 20))):
    """How far beyond the reference a joint goes after a step of an angle [deg], with valves of a lag [ms]."""
    print("| | inverse | predictive | and 120 ms ahead |\n|---|---|---|---|")
    for step, lag in steps:
        plant = JointPlant(KNEE, LOAD, FirstOrderValve(lag * ms))
        believed = {"valve": FirstOrderValve(lag * ms)}
        parts = KNEE, LOAD, ExtendedStateObserver(250.0)
        controllers = (
            DecouplingControl(KNEE, LOAD, PolePlacement(80.0), ExtendedStateObserver(250.0), **believed),
            PredictiveControl(*parts, bandwidth=80.0, **believed),
            PredictiveControl(*parts, bandwidth=80.0, horizon=120 * ms, **believed),
        )
        half = step / 2 * deg
        reference = Reference(angle=Step(-half, half, 0.5), stiffness=16.5)
        cells = []
        for control in controllers:
            angle = simulate(plant, control, reference, duration=1.5).columns["angle"]
            cells.append(f"{(angle[500:].max() - half) / deg:.2g} deg")
        print(f"| step of {step} deg, valves of {lag} ms: overshoot | " + " | ".join(cells) + " |", flush=True)


def learning(count=64):
    """The RMSE of the angle in each cycle of a sine of 10 deg and 0.5 Hz."""
    suite = Suite.read(SUITE)
    plants = [group.plant for group in draw(suite, count, 3).groups]
    loops = PositionStiffnessControl(PID(*SOFT[0]), PID(*SOFT[1]), model=KNEE, minimum_tension=5.0)
    controllers = {
        "PID": loops,
        "a network alone, 10 1/s": InverseModelControl(loops, learning_rate=10.0),
        "the model's inverse, no learning": InverseModelControl(loops, LOAD, learning_rate=0.0),
        "the same, 10 1/s": InverseModelControl(loops, LOAD, learning_rate=10.0),
    }
    reference = Reference(angle=Sine(10 * deg, 0.5, 0.0, np.pi / 2), stiffness=15.0)
    print("| cycle | " + " | ".join(map(str, CYCLES)) + " |\n|---|" + "---|" * len(CYCLES))
    for name, control in controllers.items():
        asked = {"metrics": ("angle_rmse",), "keep": ("angle",), "substeps": 2}
        by_cycle = []
        for plant in plants:
            batch = simulate_many(plant, control, reference, duration=16.0, **asked)
            assert not batch.failed.any(), f"{name} lost {batch.failed.sum()} runs"
            table = batch.table.isel(time=slice(None, None, 10))  # each 10 ms
            error = table["angle"].to_numpy() - np.asarray(reference.angle(table["time"].to_numpy()))
            by_cycle.append(np.sqrt(np.mean(error.reshape(len(error), -1, 200) ** 2, axis=2)))
        cells = [f"{np.median(np.concatenate(by_cycle)[:, cycle - 1]) / deg:.2f}" for cycle in CYCLES]
        print(f"| {name} | " + " | ".join(cells) + " deg |", flush=True)


if __name__ == "__main__":
    looking_ahead()
    print()
    learning()
