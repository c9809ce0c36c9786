"""Forward dynamics of UMArm, 12 joints and 24 muscles, on one core: ours against SoRoMoX, on JAX."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rows import Candidate, Table
from timing import Bench, inverted

from mckibben.codegen.native import NativeFunction
from mckibben.mechanism.dynamics import acceleration, at_rest, posture_of
from mckibben.numerics.compiled import numeric
from mckibben.robot import Robot, RobotScenario
from mckibben.units import deg

STATES, JOINTS, MUSCLES = 512, 12, 24
DAMPING = 2.25
"""Of each joint of SoRoMoX's arm [N*m*s/rad]; ours has it as a torque."""
FOLDER = Path(__file__).parent
OURS, THEIRS = "ours", "SoRoMoX"


def umarm(folder: Path, *, quick: bool) -> Table:
    """The table of accelerations of a batch of states."""
    rng = np.random.default_rng(0)
    angles, rates = rng.uniform(-10 * deg, 10 * deg, (JOINTS, STATES)), rng.normal(size=(JOINTS, STATES))
    states = angles, rates, rng.uniform(1e5, 4e5, (MUSCLES, STATES))
    bench = Bench(rounds=5 if quick else 30, budget=0.5 if quick else 3.0)
    expected: list[np.ndarray] = []

    def theirs() -> Candidate:
        run = soromox(folder, states)
        expected.append(np.asarray(run())[:, JOINTS:].T)
        return Candidate(THEIRS, run, base=THEIRS)

    def ours() -> Candidate:
        robot = RobotScenario.read(FOLDER.parent / "examples" / "robot" / "umarm.yaml").robot
        run = NativeFunction(accelerations).bound(numeric(robot), tuple(map(tuple, states)))
        off = [float(np.abs(np.array(run()) - known).max() / np.abs(known).max()) for known in expected]
        return Candidate(OURS, run, deviation=max(off, default=None), tolerance=1e-9, base=THEIRS)

    bench.add(THEIRS, theirs, install="soromox")
    bench.add(OURS, ours)
    return Table(
        "Forward dynamics of an arm",
        f"{STATES} states",
        "speed",
        "relative error of accelerations",
        inverted(bench.timed()),
        ("UMArm with ideal braids, without gravity, in 64 bits, one core. SoRoMoX: `jax.jit(jax.vmap(...))`.",),
    )


def accelerations(robot: Robot, states: tuple[Any, ...]) -> tuple[Any, ...]:
    """Accelerations [rad/s^2] at angles [rad], rates [rad/s] and pressures [Pa] of one state."""
    angles, rates, pressures = states
    posture = posture_of(robot, angles)
    torques = [torque - DAMPING * rate for torque, rate in zip(robot.torques(angles, pressures), rates, strict=True)]
    return acceleration(robot, posture, at_rest(posture)._replace(angles=rates), tuple(torques), (), 0.0).angles


def soromox(folder: Path, states: tuple[np.ndarray, ...]) -> Callable[[], jax.Array]:
    """The same by SoRoMoX, from the parameters that it distributes, without gravity."""
    from soromox.systems.articulated.mckibben_actuated_umarm import McKibbenActuatedUMArm

    read = json.loads((FOLDER / "umarm.json").read_text("utf-8"))
    numbers = {name: np.asarray(value) for name, value in read.items() if name != "source"} | {"gravity": np.zeros(3)}
    np.savez(folder / "umarm.npz", **numbers)
    arm = McKibbenActuatedUMArm.from_cached_parameters(folder / "umarm.npz")
    many = jax.jit(jax.vmap(lambda state, pressures: arm.forward_dynamics(jnp.zeros(()), state, (pressures,))))
    angles, rates, pressures = states
    packed = jnp.asarray(np.concatenate([angles, rates]).T), jnp.asarray(pressures.T)
    return lambda: many(*packed).block_until_ready()
