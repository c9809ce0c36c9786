"""Control periods per second of the exported joint: environments, MuJoCo with the plugin, and MuJoCo Warp.

    python benchmarks/simulators.py

All of `examples/pre-contracted-step-pid.yaml`: control periods of 1 ms with 4 Runge-Kutta steps.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rows import Candidate, Table
from tables import as_text
from timing import Bench, inverted

from mckibben.export import export
from mckibben.scenario import Scenario, run_scenario

SCENARIO, SUBSTEPS = "examples/pre-contracted-step-pid.yaml", 4
RANDOM = ["load.mass2=+-50 %"]
SIZES = (64, 1024, 8192)
WORLDS = {"cpu": (64, 4096), "cuda": (4096, 65536)}  # on devices of Warp
CHECKED = 1000  # periods
BASE = "MuJoCo with the plugin"
Advance = Callable[[NDArray[np.float64]], Any]


def simulators(folder: Path, *, quick: bool) -> Table:
    """The table of simulators."""
    bench = Bench(rounds=3 if quick else 9, budget=2.0 if quick else 6.0)
    scenario = Scenario.read(SCENARIO).model_copy(update={"substeps": SUBSTEPS})
    result = run_scenario(scenario)
    commands = np.stack([result["command1"], result["command2"]], -1)[:CHECKED]
    angles = np.asarray(result["angle"])[1 : CHECKED + 1]
    bench.add(BASE, lambda: in_mujoco(scenario, folder / "mjcf", commands, angles), install="mujoco")
    bench.add("environments", environments, install="gymnasium")
    if not quick:  # its kernels take minutes to compile
        bench.add("MuJoCo Warp", lambda: in_warp(scenario, folder / "warp", commands, angles), install="mujoco-warp")
    return Table(
        "Exported joint in simulators",
        "1000 control periods",
        "speed",
        "angle [rad]",
        inverted(bench.timed()),
        (
            f"Pre-contracted knee with 20 ms valves, {SUBSTEPS} Runge-Kutta steps per control period of 1 ms. The "
            "ratio is per joint and period. MuJoCo is one joint on one core; MuJoCo Warp, in 32 bits, runs on a GPU if "
            "there is one, with the steps of a period as a CUDA graph, and otherwise on its CPU device.",
            f"Deviation: the largest of the angle from the simulation over {CHECKED} periods.",
        ),
    )


def in_mujoco(
    scenario: Scenario, folder: Path, commands: NDArray[np.float64], angles: NDArray[np.float64]
) -> Candidate:
    """A joint in MuJoCo."""
    import mujoco

    from mckibben.export.mujoco import load_mujoco

    export(scenario, "mjcf", folder)
    model = load_mujoco(folder)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)

    def advance(command: NDArray[np.float64]) -> float:
        data.ctrl[:] = command
        mujoco.mj_step(model, data, nstep=SUBSTEPS)
        return data.qpos[0]

    deviation = float(np.abs([advance(one) for one in commands] - angles).max())
    return Candidate(BASE, repeated(advance, commands), len(commands) / 1000, deviation, 1e-9, base=BASE)


def environments() -> list[Candidate]:
    """Environments of many joints, with commands from the first."""
    from mckibben.export.gym import JointEnv, JointVectorEnv

    draw, made = np.random.default_rng(0), []
    for size in (1, *SIZES):
        env = (
            JointVectorEnv(SCENARIO, size, random_plant=RANDOM) if size > 1 else JointEnv(SCENARIO, random_plant=RANDOM)
        )
        env.reset(seed=0)
        actions = draw.uniform(-1, 1, (size, 2) if size > 1 else 2).astype(np.float32)
        name = f"JointVectorEnv, {size} joints" if size > 1 else "JointEnv"
        run = repeated(lambda _, env=env, actions=actions: env.step(actions), range(200))
        made.append(Candidate(name, run, 200 * size / 1000, base=BASE))
    return made


def in_warp(
    scenario: Scenario, folder: Path, commands: NDArray[np.float64], angles: NDArray[np.float64]
) -> list[Candidate]:
    """Joints in MuJoCo Warp."""
    import mujoco
    import mujoco_warp
    import warp

    warp.config.quiet = True
    export(scenario, "warp", folder)
    spec = spec_from_file_location("joint_warp", folder / "joint_warp.py")
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["joint_warp"] = module_from_spec(spec)
    spec.loader.exec_module(module)
    model = mujoco.MjModel.from_xml_path(str(folder / "joint.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    device, made = warp.get_device(), []
    for worlds in WORLDS["cuda" if device.is_cuda else "cpu"]:
        m, d = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=worlds)
        module.Muscles(model, worlds).install(m)

        def period(m: Any = m, d: Any = d) -> None:
            for _ in range(SUBSTEPS):
                mujoco_warp.step(m, d)

        def control(command: NDArray[np.float64], worlds: int = worlds) -> Any:
            return warp.array(np.tile(command, (worlds, 1)), dtype=float)

        def advance(command: Any, d: Any = d, period: Callable[[], None] = period) -> None:
            warp.copy(d.ctrl, command)
            period()

        deviation = None
        if not made:
            found = []
            for one in commands:
                advance(control(one))
                found.append(d.qpos.numpy()[-1, 0])
            deviation = float(np.abs(found - angles).max())
        else:
            period()  # compiled
        if device.is_cuda:
            with warp.ScopedCapture() as capture:
                period()
            advance = partial(advance, period=partial(warp.capture_launch, capture.graph))
        repeat = repeated(advance, [control(one) for one in commands[:5]])
        run = lambda repeat=repeat: (repeat(), warp.synchronize())  # noqa: E731
        name, note = f"MuJoCo Warp, {worlds} joints", device.name if device.is_cuda else ""
        made.append(Candidate(name, run, 5 * worlds / 1000, deviation, 1e-5, note, BASE))
    return made


def repeated(advance: Advance, given: Any) -> Callable[[], None]:
    """A run of one control period for each command."""

    def run() -> None:
        for one in given:
            advance(one)

    return run


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        print(as_text(simulators(Path(temporary), quick=False)))
