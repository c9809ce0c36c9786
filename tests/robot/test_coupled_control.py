"""Control of all joints with the torques between them compensated by a model of the robot."""

import dataclasses
import runpy

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import RangeError
from mckibben.joint import Measurement
from mckibben.numerics.spatial import ZERO
from mckibben.robot import CoupledControl, RobotMeasurement, RobotStart, TimedReference, read_robot
from mckibben.robot.dynamics import acceleration, at_rest, joint_equations, posture_of
from mckibben.units import ms
from tests.robot.conftest import over_two

EXAMPLE = runpy.run_path("examples/robot/three_joints.py")
LOAD = mk.GeneralLoad(1.0, 0.0)
ANGLES, RATES = (0.05, -0.03, -0.2), (1.0, -2.0, 3.0)


def test_the_equations_of_the_joints_are_those_of_the_motion():
    robot = read_robot("lei-leg")
    robot = dataclasses.replace(
        robot, joints=(*robot.joints[:2], dataclasses.replace(robot.joints[2], axis=(0.0, 1.0, 0.0)))
    )
    made = joint_equations(robot, ANGLES, RATES, 9.81)
    matrix, bias, torques = np.array(made.matrix, float), np.array(made.bias, float), np.array([2.0, -1.0, 0.5])
    held = dataclasses.replace(robot, base="fixed")
    posture = posture_of(held, ANGLES)
    velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, RATES)))
    found = acceleration(held, posture, velocity, tuple(torques), ZERO, 9.81).angles
    np.testing.assert_allclose(matrix @ np.array(found) + bias, torques, atol=1e-12)
    np.testing.assert_allclose(matrix, matrix.T)
    assert abs(matrix[1, 2]) > 0.01


def test_each_load_has_the_torque_of_the_other_joints_and_of_biarticular_muscles():
    robot = read_robot("lei-leg")
    paths = mk.joint.Pulley(0.03, 0.08), mk.joint.Pulley(0.02, 0.08)
    rectus = over_two(robot.all_muscles[0], paths, ("hip", "knee"), ("shortens",) * 2, "rectus")
    robot = dataclasses.replace(robot, muscles=(*robot.muscles, rectus))
    controllers = tuple(mk.DecouplingControl(robot.pair(i), LOAD, mk.PolePlacement(30.0)) for i in range(3))
    control = CoupledControl(controllers, TimedReference(EXAMPLE["references"]()), (2e5,), robot=robot)
    measurement = RobotMeasurement(tuple(map(jnp.asarray, ANGLES)), tuple(map(jnp.asarray, (3e5,) * 7)), jnp.zeros(()))
    planned = (3.0, -4.0, 5.0)
    loads = control._loads(measurement, tuple(map(jnp.asarray, RATES)), tuple(map(jnp.asarray, planned)))
    made = joint_equations(robot, ANGLES, RATES, 9.81)
    alone = dataclasses.replace(robot, muscles=robot.muscles[:3])
    rectus_torque = np.subtract(robot.torques(ANGLES, (3e5,) * 7), alone.torques(ANGLES, (3e5,) * 6))
    damping = np.array([joint.damping for joint in robot.joints])
    needed = np.array(made.matrix) @ planned + np.array(made.bias) + damping * RATES - rectus_torque
    found = [
        one.required_torque(*motion)
        for one, motion in zip(loads, zip(ANGLES, RATES, planned, strict=True), strict=True)
    ]
    np.testing.assert_allclose(np.array(found, float), needed, atol=1e-12)


@pytest.mark.slow
def test_the_prediction_over_a_delay_is_the_motion_of_the_coupled_robot():
    plant, delay, period = EXAMPLE["plant"](), 8 * ms, 1 * ms
    each = tuple(
        mk.DecouplingControl(plant.robot.pair(i), LOAD, mk.PolePlacement(30.0), valve=plant.valve, command_delay=delay)
        for i in range(3)
    )
    control = CoupledControl(each, TimedReference(EXAMPLE["references"]()), robot=plant.robot).with_period(period)
    state = plant.begin(RobotStart(ANGLES, (3e5, 2e5) * 3, clearance=0.5))
    state = state._replace(velocity=state.velocity._replace(angles=tuple(map(jnp.asarray, RATES))))
    commands = (3e5, 2.2e5, 2.9e5, 2e5, 3e5, 2.1e5)
    end = plant.advance(state, commands, delay, 64).posture.angles
    begun = plant.rate(state).velocity.angles
    measurement = RobotMeasurement(state.posture.angles, state.pressures, jnp.zeros(()))
    zero = tuple(map(jnp.zeros_like, begun))
    loads, at_rest_loads = control._loads(measurement, RATES, begun), control._loads(measurement, zero, zero)
    for i in range(3):
        found = []
        for load in (loads[i], at_rest_loads[i]):
            one = dataclasses.replace(control.controllers[i], load=load)
            pair = slice(2 * i, 2 * i + 2)
            estimates = one.init_estimates(Measurement(ANGLES[i], state.pressures[pair]))
            estimates = estimates._replace(motion=estimates.motion._replace(velocity=RATES[i], disturbance=0.0))
            predicted = one._predicted(plant.robot.pair(i), estimates._replace(sent=(commands[pair],) * 9), period)
            found.append(abs(float(predicted.motion.angle - end[i])))
        assert found[0] < 0.01 * abs(float(end[i]) - ANGLES[i])
        assert found[0] < found[1] / 5


@pytest.mark.slow
def test_commands_that_arrive_late_are_predicted():
    plant = dataclasses.replace(EXAMPLE["plant"](), command_delay=16 * ms)
    prompt = EXAMPLE["controllers"](plant)["decoupling of the leg"]
    late = tuple(dataclasses.replace(one, command_delay=16 * ms) for one in prompt.controllers)
    unaware, aware = (EXAMPLE["errors"](plant, one) for one in (prompt, dataclasses.replace(prompt, controllers=late)))
    assert aware["side"][0] < unaware["side"][0] / 2
    for joint in ("hip", "knee"):  # which need slower gains to be free of oscillations
        assert aware[joint][0] < unaware[joint][0]


def test_controllers_without_a_model_of_the_load_are_refused():
    plant = EXAMPLE["plant"]()
    made = EXAMPLE["controllers"](plant)
    reference = TimedReference(EXAMPLE["references"]())
    first, *others = plant.robot.joints
    locked = dataclasses.replace(plant.robot, joints=(dataclasses.replace(first, locked=0.0), *others))
    for controllers, robot, field in (
        (made["PID per joint"].controllers, plant.robot, "controllers"),
        (made["decoupling per joint"].controllers, locked, "robot"),
        (made["decoupling per joint"].controllers[:2], plant.robot, "controllers"),
    ):
        with pytest.raises(RangeError) as caught:
            CoupledControl(controllers, reference, robot=robot)
        assert caught.value.field == field and caught.value.remedy


@pytest.mark.slow
def test_with_the_whole_robot_each_joint_follows_better():
    plant = EXAMPLE["plant"]()
    found = {name: EXAMPLE["errors"](plant, one) for name, one in EXAMPLE["controllers"](plant).items()}
    for joint in ("side", "hip", "knee"):
        pid, alone, together = (errors[joint][0] for errors in found.values())
        assert together < alone < pid / 5
        assert found["decoupling of the leg"][joint][1] < found["PID per joint"][joint][1]
