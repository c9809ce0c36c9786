"""Sensors and disturbances of a robot; delays and friction are those of any plant."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.control.robot_control import RobotController
from mckibben.plant import JointFriction, SampledSensors, TorquePulses
from mckibben.robot import PressureSchedule, RobotPlant, RobotScenario, RobotStart, simulate_robot
from mckibben.units import deg, kPa, ms
from tests.robot.conftest import robot_of

RUN = {"duration": 0.06, "control_period": 1 * ms, "substeps": 4}
PRESSURES = (3e5, 3.2e5, 3.8e5, 3e5, 3e5, 3.1e5)
START = RobotStart((0.0, 0.0, 0.0), PRESSURES, clearance=1.0)


class Recorder(RobotController):
    """Constant commands; telemetry has what was measured."""

    follows_reference: ClassVar = False

    commands: tuple[float, ...]

    def init(self, measurement):
        return measurement

    def step(self, state, time, measurement, period):
        return measurement, tuple(map(jnp.asarray, self.commands))

    def telemetry(self, state):
        return {"seen_angle": state.angles[1], "seen_pressure": state.pressures[0]}


@pytest.fixture(scope="module")
def fixed(pair):
    """A robot of three joints that hangs from a fixed base."""
    return RobotPlant(robot_of(pair, "fixed"), FirstOrderValve(20 * ms))


def with_joints(plant, **changes):
    joints = tuple(dataclasses.replace(one, **changes) for one in plant.robot.joints)
    return eqx.tree_at(lambda p: p.robot, plant, dataclasses.replace(plant.robot, joints=joints))


@pytest.mark.slow
def test_sensors_quantise_angles_and_disturb_pressures(fixed):
    sensors = SampledSensors(encoder=0.1 * deg, pressure_noise=4 * kPa, seed=3)
    plant = dataclasses.replace(fixed, sensors=sensors)
    run, again = (simulate_robot(plant, Recorder(PRESSURES), START, **RUN) for _ in range(2))
    assert not run["saturated"].any()
    assert simulate_robot(plant, Recorder((9e5, *PRESSURES[1:])), START, **RUN)["saturated"].all()
    steps = run["seen_angle"] / (0.1 * deg)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.ptp(steps) > 3
    noise = run["seen_pressure"] - run["pressure"][0]
    assert float(noise.std()) == pytest.approx(4 * kPa, rel=0.3)
    assert run.to_dataset().equals(again.to_dataset())


@pytest.mark.slow
def test_a_disturbance_turns_its_joint(fixed):
    pulses = TorquePulses(2.0, width=20 * ms, start=5 * ms)
    plant = with_joints(fixed, disturbance=pulses)
    state = plant.init_state((0.0, 0.0, 0.0), PRESSURES)
    for period, torque in ((0, 0.0), (6, 2.0), (30, 0.0)):
        at = state._replace(io=state.io._replace(sample=jnp.asarray(float(period))))
        sampled, _ = plant.sample(at, 1 * ms)
        np.testing.assert_allclose(np.subtract(plant.forces(sampled).torques, plant.forces(state).torques), torque)
    pushed, free = (
        simulate_robot(one, PressureSchedule(tuple((p,) for p in PRESSURES)), START, **RUN)["angle"]
        for one in (plant, fixed)
    )
    assert float((pushed - free)[2, 30]) > 1 * deg


@pytest.mark.slow
def test_a_file_has_them_all():
    text = """name: robot with sensors
robot:
  from: lei-leg-planar
  joints: {knee: {friction: {torque: 0.3 N*m}, disturbance: {height: 1 N*m, width: 50 ms}}}
sensors: {encoder: 0.022 deg}
command_delay: 3 ms
"""
    scenario = RobotScenario.parse(text)
    plant = scenario.plant()
    assert plant.robot.joints[1].friction == JointFriction(0.3)
    assert plant.robot.joints[1].disturbance == TorquePulses(1.0, 50 * ms)
    assert plant.robot.joints[0].friction is None
    assert (plant.sensors, plant.command_delay) == (SampledSensors(0.022 * deg), pytest.approx(3 * ms))
    assert plant.delay_periods == 12  # of 0.25 ms
    assert RobotScenario.parse(scenario.dumps()) == scenario
