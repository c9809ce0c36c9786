"""MuJoCo: the joint as a hinge, the valves as filtered actuators, the muscles' torque computed in Python.

The hinge has the load's inertia, damping and gravity. Two actuators hold the pressures [bar] as activations, whose
filter is the valve's lag; they pull at nothing. The torque of the muscles is a passive force, so that RK4 calls Python
at each of its four stages: the reference's own method.
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
  <option integrator="RK4" timestep="{step!r}" gravity="0 0 0"><flag contact="disable" constraint="disable"/></option>
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


def angles(problem: Problem) -> Callable[[], NDArray[np.float64]]:
    """One episode; the function that is returned runs it and gives the angle of each period."""
    numbers = problem.numbers
    functions = knee(FLOATS, numbers)
    text = MODEL.format(
        step=PERIOD / SUBSTEPS, damping=numbers.damping, inertia=numbers.inertia, lag=numbers.time_constant
    )
    model = mujoco.MjModel.from_xml_string(text)
    setpoints = list(zip(*(reference.tolist() for reference in problem.wanted), strict=True))

    def passive(_: mujoco.MjModel, data: mujoco.MjData) -> None:
        p1, p2 = data.act
        data.qfrc_passive[0] += functions.torque(float(data.qpos[0]), float(p1) * bar, float(p2) * bar)

    def run() -> NDArray[np.float64]:
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = problem.first[:2]
        data.act[:] = problem.first[2:] / bar
        mujoco.set_mjcb_passive(passive)
        try:
            memory, record = functions.init(state_of(data)), []
            for wanted_angle, wanted_stiffness in setpoints:
                x = state_of(data)
                memory, u1, u2, _ = functions.control(memory, wanted_angle, wanted_stiffness, x)
                record.append(x[0])
                data.ctrl[:] = u1 / bar, u2 / bar
                mujoco.mj_step(model, data, nstep=SUBSTEPS)
        finally:
            mujoco.set_mjcb_passive(None)
        return np.array(record)

    return run


def state_of(data: mujoco.MjData) -> tuple[float, ...]:
    """Angle, velocity and pressures [Pa]."""
    p1, p2 = data.act
    return float(data.qpos[0]), float(data.qvel[0]), float(p1) * bar, float(p2) * bar
