"""Sensors, delays, joint friction and disturbances of a robot."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, IdealValve
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


def schedule(*switches, last=4.8e5):
    levels = [(one, last) if i == 2 and switches else (one,) for i, one in enumerate(PRESSURES)]
    return PressureSchedule(tuple(levels), tuple(switches if i == 2 else () for i in range(len(PRESSURES))))


@pytest.mark.slow
def test_a_delay_is_that_of_a_schedule_that_switches_later(fixed):
    late = dataclasses.replace(fixed, command_delay=4.5 * ms)
    delayed, shifted = (
        simulate_robot(plant, schedule(at), START, **RUN) for plant, at in ((late, 10 * ms), (fixed, 14.5 * ms))
    )
    assert abs(delayed["angle"] - shifted["angle"]).max() < 1e-12
    assert abs(delayed["angle"] - simulate_robot(fixed, schedule(10 * ms), START, **RUN)["angle"]).max() > 0.1 * deg


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
def test_a_joint_sticks_below_its_friction(fixed):
    held = with_joints(fixed, friction=JointFriction(20.0, 1 * deg))
    moved = [
        float(abs(simulate_robot(plant, schedule(5 * ms), START, **RUN)["angle"]).max()) / deg
        for plant in (held, fixed)
    ]
    assert moved[0] < 0.5 and moved[1] > 1


@pytest.mark.slow
def test_friction_is_the_only_loss_of_a_free_robot(pair):
    """Without muscles' pressure and damping, energy falls by the friction torque times the angle that is turned."""
    plant = RobotPlant(robot_of(pair, "fixed", ("hip",)), IdealValve())
    rubbing = with_joints(plant, friction=JointFriction(0.05, 0.01 * deg), lower=-25 * deg, upper=25 * deg)
    state = rubbing.init_state((10 * deg,), (0.0, 0.0), clearance=1.0)
    advance = eqx.filter_jit(lambda state: rubbing.advance(state, (0.0, 0.0), 2 * ms, 20))
    energies, angles = [], []
    for _ in range(40):
        state = advance(state)
        energies.append(float(rubbing.energy(state)))
        angles.append(float(state.angle[0]))
    lost, turned = energies[0] - energies[-1], angles[0] - angles[-1]
    assert turned > 0.5 * deg
    assert lost == pytest.approx(0.05 * turned, abs=0.05 * 0.01 * deg)  # less what the presliding springs hold


@pytest.mark.slow
def test_a_disturbance_turns_its_joint(fixed):
    pulses = TorquePulses(2.0, width=20 * ms, start=5 * ms)
    plant = with_joints(fixed, disturbance=pulses)
    state = plant.init_state((0.0, 0.0, 0.0), PRESSURES)
    for period, torque in ((0, 0.0), (6, 2.0), (30, 0.0)):
        at = state._replace(io=state.io._replace(sample=jnp.asarray(float(period))))
        sampled, _ = plant.sample(at, 1 * ms)
        np.testing.assert_allclose(np.subtract(plant.forces(sampled).torques, plant.forces(state).torques), torque)
    pushed, free = (simulate_robot(one, schedule(), START, **RUN)["angle"] for one in (plant, fixed))
    assert float((pushed - free)[2, 30]) > 1 * deg


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
