"""How long a step of each controller takes in the loop by XLA, on one core.

    python benchmarks/steps.py [SUITE.yaml]

Each controller of the suite (examples/comparison/knee.yaml) is given the measurements of a run again, without the
plant: 100 periods a call, so that a slow step shows. Median and slowest of all calls, a step.
"""

import argparse
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from mckibben.control import Measurement, Setpoint
from mckibben.simulation import simulate
from mckibben.study.compare import Suite

SUITE = Path(__file__).parent.parent / "examples" / "comparison" / "knee.yaml"
TOGETHER, REPEATS = 100, 20


def main():
    parser = argparse.ArgumentParser(description="How long a step of each controller takes.")
    parser.add_argument("suite", nargs="?", type=Path, default=SUITE)
    suite = Suite.read(parser.parse_args().suite)
    reference = next(iter(suite.references))
    moved = None
    print("| controller | median | slowest |\n|---|---|---|")
    for name in suite.controllers:
        scenario = suite.scenario(name, reference)
        plant, control = scenario.plant(), scenario.control()
        if moved is None:
            moved = simulate(
                plant, control, scenario.reference(), duration=suite.duration, control_period=suite.control_period
            ).columns
        given = [jnp.asarray(moved[key]) for key in ("desired_angle", "desired_stiffness", "angle")]
        pressures = tuple(jnp.asarray(moved[key]) for key in ("pressure1", "pressure2"))

        @jax.jit
        def replayed(state, angle, stiffness, measured, pressures, control=control):
            def step(state, at):
                setpoint, measured = Setpoint(*at[:2]), Measurement(*at[2:])
                return control.step(state, setpoint, measured, suite.control_period)

            return lax.scan(step, state, (angle, stiffness, measured, pressures))

        def calls(state, given=given, pressures=pressures, replayed=replayed):
            taken = []
            for at in range(0, given[0].size - TOGETHER + 1, TOGETHER):
                piece = slice(at, at + TOGETHER)
                args = [each[piece] for each in given], tuple(each[piece] for each in pressures)
                jax.block_until_ready(args)
                begun = time.perf_counter()
                state, _ = jax.block_until_ready(replayed(state, *args[0], args[1]))
                taken.append((time.perf_counter() - begun) / TOGETHER)
            return taken

        first = control.init(Measurement(given[2][0], tuple(each[0] for each in pressures)))
        first = jax.tree.map(jnp.asarray, first)
        calls(first)
        taken = np.concatenate([calls(first) for _ in range(REPEATS)])
        print(f"| {name} | {np.median(taken) * 1e6:.2f} us | {taken.max() * 1e6:.1f} us |", flush=True)


if __name__ == "__main__":
    main()
