"""Steps per second of the exported environments and of the MuJoCo model, and its deviation from the simulation.

    python benchmarks/simulators.py [--seconds 2]

All of `examples/pre-contracted-step-pid.yaml`: control periods of 1 ms with 4 Runge-Kutta steps, from random commands.
"""

import argparse
import tempfile
import time

import mujoco
import numpy as np

from mckibben.export import export
from mckibben.export.gym import JointEnv, JointVectorEnv
from mckibben.export.mujoco import load_mujoco
from mckibben.scenario import Scenario, run_scenario

SCENARIO = "examples/pre-contracted-step-pid.yaml"
RANDOM = ["load.mass2=+-50 %"]
SIZES = (1, 64, 1024, 8192)


def rate(step, seconds, each=1):
    """Steps a second of calls that make `each` of them."""
    step()
    count, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        step()
        count += each
    return count / (time.perf_counter() - start)


def environments(seconds):
    """Rows of the table of environments."""
    draw = np.random.default_rng(0)
    env = JointEnv(SCENARIO, random_plant=RANDOM)
    env.reset(seed=0)
    action = draw.uniform(-1, 1, 2).astype(np.float32)
    yield "JointEnv", rate(lambda: env.step(action), seconds)
    for size in SIZES:
        envs = JointVectorEnv(SCENARIO, size, random_plant=RANDOM)
        envs.reset(seed=0)
        actions = draw.uniform(-1, 1, (size, 2)).astype(np.float32)
        yield (
            f"JointVectorEnv, {size} joints",
            rate(lambda envs=envs, actions=actions: envs.step(actions), seconds, size),
        )


def in_mujoco(seconds):
    """Rows for MuJoCo, and the largest deviation of the angle over 2 s [rad]."""
    scenario = Scenario.read(SCENARIO).model_copy(update={"substeps": 4})
    with tempfile.TemporaryDirectory() as folder:
        export(scenario, "mjcf", folder)
        model = load_mujoco(folder)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    result = run_scenario(scenario).result
    commands = np.stack([result["command1"], result["command2"]], -1)
    deviation = 0.0
    for period in range(2000):
        deviation = max(deviation, abs(data.qpos[0] - result["angle"][period]))
        data.ctrl[:] = commands[period]
        mujoco.mj_step(model, data, nstep=scenario.substeps)
    step = lambda: mujoco.mj_step(model, data, nstep=4)  # noqa: E731
    return rate(step, seconds), deviation


def main():
    """Measure and print."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seconds", type=float, default=2.0)
    seconds = options.parse_args().seconds
    print("| | control periods a second |\n|---|---|")
    for name, found in environments(seconds):
        print(f"| {name} | {found:,.0f} |")
    found, deviation = in_mujoco(seconds)
    print(f"| MuJoCo with the plugin | {found:,.0f} |")
    print(f"\nlargest deviation of MuJoCo's angle over 2 s: {deviation:.2g} rad")


if __name__ == "__main__":
    main()
