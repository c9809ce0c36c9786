"""MuJoCo: the joint as a hinge, the valves as filtered actuators, the muscles' torque worked out in Python.

The hinge has the load's inertia, damping and gravity. Two actuators hold the pressures [bar] as activations, whose
filter is the valve's lag; they pull at nothing. The muscles' torque is added in Python, in one of two ways.
"""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray
from reference import PERIOD, SUBSTEPS, Problem

from engines.knee import FLOATS, knee
from mckibben.units import bar

MODEL = """
<mujoco>
  <option integrator="{integrator}" timestep="{step!r}" gravity="0 0 0">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body>
      <joint name="knee" type="hinge" axis="0 1 0" damping="{damping!r}"/>
      <inertial pos="0 0 0" mass="1" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
    </body>
  </worldbody>
  <actuator>
    <general joint="knee" dyntype="filter" dynprm="{lag!r}" gainprm="0"/>
    <general joint="knee" dyntype="filter" dynprm="{lag!r}" gainprm="0"/>
  </actuator>
</mujoco>
"""


def every_stage(problem: Problem, substeps: int = SUBSTEPS) -> Callable[[], NDArray[np.float64]]:
    """RK4 with the torque as a passive force: the reference's own method, with Python called at each of four stages."""
    model, torque, control, init = _parts(problem, "RK4", substeps)

    def passive(_: mujoco.MjModel, data: mujoco.MjData) -> None:
        p1, p2 = data.act
        data.qfrc_passive[0] += torque(float(data.qpos[0]), float(p1) * bar, float(p2) * bar)

    def run() -> NDArray[np.float64]:
        data = _at_start(model, problem)
        mujoco.set_mjcb_passive(passive)
        try:
            return _episode(problem, data, control, init, lambda: mujoco.mj_step(model, data, nstep=substeps))
        finally:
            mujoco.set_mjcb_passive(None)

    return run


def every_step(problem: Problem, substeps: int = SUBSTEPS) -> Callable[[], NDArray[np.float64]]:
    """MuJoCo's default, semi-implicit Euler, the torque set before each step: another method, less exact."""
    model, torque, control, init = _parts(problem, "Euler", substeps)

    def run() -> NDArray[np.float64]:
        data = _at_start(model, problem)

        def advance() -> None:
            for _ in range(substeps):
                p1, p2 = data.act
                data.qfrc_applied[0] = torque(float(data.qpos[0]), float(p1) * bar, float(p2) * bar)
                mujoco.mj_step(model, data)

        return _episode(problem, data, control, init, advance)

    return run


def _parts(problem: Problem, integrator: str, substeps: int) -> tuple:
    numbers = problem.numbers
    text = MODEL.format(
        integrator=integrator,
        step=PERIOD / substeps,
        damping=numbers.damping,
        inertia=numbers.inertia,
        lag=numbers.time_constant,
    )
    functions = knee(FLOATS, numbers)
    return mujoco.MjModel.from_xml_string(text), functions.torque, functions.control, functions.init


def _at_start(model: mujoco.MjModel, problem: Problem) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = problem.first[:2]
    data.act[:] = problem.first[2:] / bar
    return data


def _episode(
    problem: Problem, data: mujoco.MjData, control: Callable, init: Callable, advance: Callable[[], None]
) -> NDArray[np.float64]:
    def state() -> tuple[float, ...]:
        p1, p2 = data.act
        return float(data.qpos[0]), float(data.qvel[0]), float(p1) * bar, float(p2) * bar

    memory, record = init(state()), []
    for wanted_angle, wanted_stiffness in zip(*(reference.tolist() for reference in problem.wanted), strict=True):
        x = state()
        memory, u1, u2, _ = control(memory, wanted_angle, wanted_stiffness, x)
        record.append(x[0])
        data.ctrl[:] = u1 / bar, u2 / bar
        advance()
    return np.array(record)
