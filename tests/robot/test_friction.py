"""Robots whose muscles and joints have friction: compensated, predicted, and known to the observer."""

import dataclasses
import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.control import Setpoint
from mckibben.errors import RangeError
from mckibben.mechanism.base import RobotMeasurement
from mckibben.plant import JointFriction
from mckibben.robot import ComputedTorque, RobotScenario
from mckibben.units import deg
from tests.robot.conftest import as_joint

ONE = Path(__file__).with_name("one-joint.yaml").read_text(encoding="utf-8")
LEG = Path("examples/robot/lei-leg-control.yaml").read_text(encoding="utf-8")
VALVE = mk.FirstOrderValve(0.02)


@pytest.mark.slow
def test_all_joints_of_a_leg_with_friction_follow():
    """Those of the example, with a margin; without compensation the knee does not."""
    assert LEG.count("half_width: 7.5 N") == 3
    leg = RobotScenario.parse(LEG)
    assert max(leg.run_once().metrics["angle_rmse"]) < 0.1 * deg
    assert leg.margins(3).disk.min() > 0.4
    blind = dataclasses.replace(leg.controller, friction_compensation=False, friction_in_observer=None)
    assert leg.model_copy(update={"controller": blind}).run_once().metrics["angle_rmse"][2] > 0.3 * deg


@pytest.mark.slow
def test_friction_of_a_robot_of_one_joint_is_that_of_the_joint():
    """Along the reference, in the observer, over a delay and with preview: in closed form, and as a tree."""
    law = "law: lei-mas-10-180n"
    text = ONE.replace(law, f"{law}, friction: {{half_width: 5 N, presliding_length: 0.5 mm}}")
    gains = "feedback: {bandwidth: 40 rad/s}, friction_compensation: true, friction_in_observer: 60 %"
    whole = RobotScenario.parse(f"{text}controller: {{{gains}, preview: 30 ms}}\n").run_once()
    apart = RobotScenario.parse(f"{text}controllers: {{knee: {{class: decoupling, {gains}, preview: 30 ms}}}}\n")
    joint = as_joint(apart).simulate()
    np.testing.assert_allclose(whole["angle"][0], joint["angle"], atol=1e-4)
    assert np.abs(whole["friction_compensation"][0]).max() > 0.2
    np.testing.assert_allclose(whole["friction_compensation"][0], joint["friction_compensation"], atol=1e-3)


@pytest.mark.slow
def test_friction_of_a_joint_is_compensated_along_its_reference():
    robot = RobotScenario.parse(ONE + "controller: {feedback: {bandwidth: 40 rad/s}}\n").robot
    (joint,) = robot.joints
    sticking = dataclasses.replace(robot, joints=(dataclasses.replace(joint, friction=JointFriction(0.3, 0.1 * deg)),))
    with pytest.raises(RangeError) as caught:
        ComputedTorque(mk.PolePlacement(30.0), robot=robot, valve=VALVE, friction_compensation=True)
    assert caught.value.field == "friction_compensation"
    control = ComputedTorque(mk.PolePlacement(30.0), robot=sticking, valve=VALVE, friction_compensation=True)
    here = RobotMeasurement((jnp.asarray(0.0),), (jnp.asarray(2e5), jnp.asarray(2e5)), jnp.asarray(0.0))
    state = control.init_linearised(here.angles, here.pressures)
    state, _ = control.step(state, (Setpoint(jnp.asarray(5 * deg), jnp.asarray(14.0)),), here, 2e-3)
    assert float(control.telemetry(state)["friction_compensation"][0]) == pytest.approx(-0.3, rel=1e-6)


def test_an_amplitude_needs_pairs_of_muscles():
    robot = RobotScenario.read("examples/robot/platform.yaml").robot
    with pytest.raises(RangeError) as caught:
        ComputedTorque(mk.PolePlacement(30.0), robot=robot, valve=VALVE, stiffness_amplitude=1 * deg)
    assert caught.value.field == "stiffness_amplitude"


@pytest.mark.slow
def test_a_step_known_ahead_is_met_in_the_middle():
    step = "angle: {class: step, before: 0 deg, after: 3 deg, at: 0.2 s}"
    text = re.sub(r"angle: \{class: \w+[^}]*\}", step, ONE)
    gains = "controller: {feedback: {bandwidth: 40 rad/s}"
    blind, known = (RobotScenario.parse(text + gains + more).run_once() for more in ("}\n", ", preview: 60 ms}\n"))
    assert known.metrics["angle_rmse"][0] < 0.5 * blind.metrics["angle_rmse"][0]
    before = known["angle"][0][np.searchsorted(known["time"], 0.2 - 1e-9)]
    assert 1 * deg < before < 2 * deg
    assert blind["angle"][0][np.searchsorted(blind["time"], 0.2 - 1e-9)] < 0.01 * deg
