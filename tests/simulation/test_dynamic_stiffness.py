"""Simulated tests of the stiffness against its closed forms: pressures held, valves closed, and in between."""

import dataclasses
import math
import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import IdealValve, PressureRegulator
from mckibben.control import Setpoint
from mckibben.errors import RangeError
from mckibben.mechanism.dynamics import joint_load
from mckibben.muscle import MaxwellSlip
from mckibben.muscle.friction import polygon
from mckibben.plant import JointFriction, JointPlant
from mckibben.plant.robot_plant import RobotPlant
from mckibben.robot import RobotScenario
from mckibben.simulation import closed_valves, dynamic_stiffness
from mckibben.units import bar, deg, mm, ms
from tests.robot.test_control import ONE, TORQUE

SLIP = MaxwellSlip(7.5, 0.5 * mm)
AMPLITUDES = np.array([0.01, 0.3, 3.0]) * deg
SLOW, FAST = 0.05, 10.0


@pytest.fixture(scope="module")
def held(knee, load):
    muscle = dataclasses.replace(knee.muscle1, friction=SLIP)
    return JointPlant(dataclasses.replace(knee, muscle1=muscle, muscle2=muscle), load, IdealValve())


@pytest.fixture(scope="module")
def start(held):
    return held.equilibrium(0.0, stiffness=15.0)


@jax.jit
def secant(joint, pressures, amplitude, index=None):
    return joint.secant_stiffness(0.0, pressures, amplitude, polytropic_index=index)


@pytest.mark.slow
def test_at_pressures_held_it_is_the_secant_stiffness_at_any_rate(held, start):
    found = dynamic_stiffness(held, start, AMPLITUDES, (SLOW, FAST))
    assert found.frequency == pytest.approx([SLOW, FAST])
    expected = np.asarray(secant(held.joint, start.pressures, AMPLITUDES))
    np.testing.assert_allclose(found.stiffness, [expected, expected], rtol=1e-5)
    # a spring dissipates nothing
    assert np.abs(found.loss[:, 0]).max() < 1e-6 * expected[0]
    assert (found.loss[:, 1:] > 1.0).all()


@pytest.mark.slow
def test_damping_of_the_muscles_is_the_loss_over_the_rate(knee, load):
    """K'' = 2 pi f sum of c r^2 at small amplitudes, with a half width of almost nothing."""
    friction = MaxwellSlip(
        *(1e-6, 0.5 * mm), viscous=20.0, viscous_growth=10 / bar, viscous_length_growth=1e3, reference_length=0.16
    )
    muscles = [dataclasses.replace(each, friction=friction) for each in (knee.muscle1, knee.muscle2)]
    plant = JointPlant(dataclasses.replace(knee, muscle1=muscles[0], muscle2=muscles[1]), load, IdealValve())
    pressures = np.array([4.0, 5.0]) * bar
    assert min(map(float, knee.tensions(0.0, pressures))) > 10
    found = dynamic_stiffness(plant, plant.init_state(0.0, tuple(pressures)), 1e-3 * deg, FAST, cycles=2)
    lengths = 0.18 * (1 - np.array(knee.contractions(0.0, pressures)))
    damping = np.maximum(20.0 + 10 * pressures / bar + 1e3 * (lengths - 0.16), 0)
    arms = np.array([float(arm) for arm in knee.geometry.moment_arms(0.0)])
    assert found.loss[0, 0] == pytest.approx(2 * np.pi * found.frequency[0] * np.sum(damping * arms**2), rel=1e-2)


@pytest.mark.slow
def test_friction_of_the_joint_adds_to_the_stiffness_and_its_loop_to_the_loss(knee, load):
    """At the reversals it is T against the motion; the area is 4 T a, less what its springs give back."""
    torque, presliding = 0.3, 0.05 * deg
    plant = JointPlant(knee, load, IdealValve(), friction=JointFriction(torque, presliding))
    angles, pressures = np.array([1.0, 4.0]) * deg, (3e5, 3e5)
    found = dynamic_stiffness(plant, plant.init_state(0.0, pressures), angles, FAST, substeps=2, cycles=2)
    springs = np.asarray(secant(knee, pressures, angles))
    np.testing.assert_allclose(found.stiffness[0], springs + torque / angles, rtol=1e-6)
    share, stiffness = polygon(4)
    area = 4 * torque * (angles - share @ (share / stiffness) * presliding)
    np.testing.assert_allclose(found.loss[0], area / (np.pi * angles**2), rtol=2e-3)
    np.testing.assert_allclose(found.magnitude**2, found.stiffness**2 + found.loss**2)


@pytest.mark.slow
def test_with_closed_valves_the_air_adds_to_it(held, start):
    found = dynamic_stiffness(closed_valves(held, polytropic_index=1.4), start, AMPLITUDES, (SLOW, FAST))
    expected = np.asarray(secant(held.joint, start.pressures, AMPLITUDES, 1.4))
    np.testing.assert_allclose(found.stiffness, [expected, expected], rtol=1e-5)
    frictionless = dataclasses.replace(
        held.joint, muscle1=_plain(held.joint.muscle1), muscle2=_plain(held.joint.muscle2)
    )
    slope = float(frictionless.closed_valve_stiffness(0.0, start.pressures, polytropic_index=1.4))
    assert slope > float(frictionless.stiffness(0.0, start.pressures)) + 10


def _plain(muscle):
    return type(muscle)(muscle.specimen, muscle.law)


@pytest.mark.slow
def test_regulators_hold_the_pressure_against_a_slow_push_and_the_air_against_a_fast_one(held, start):
    """In between it is first order, with the time constant of the pressure."""
    regulator = PressureRegulator(1e-10, 7 * bar, time_constant=20 * ms, polytropic_index=1.2)
    plant = dataclasses.replace(held, valve=regulator)
    found = dynamic_stiffness(plant, start, AMPLITUDES[:1], (SLOW, 0.5, FAST))
    isobaric = float(secant(held.joint, start.pressures, AMPLITUDES[0]))
    air = float(secant(held.joint, start.pressures, AMPLITUDES[0], 1.2)) - isobaric
    volume = float(held.joint.muscle1.specimen.volume(0.1))
    lag = np.mean([regulator.time_constant_at(float(p), volume) for p in start.pressures]) - regulator.command_lag
    expected = isobaric + air / (1 + 1 / (2j * math.pi * found.frequency * lag))
    assert (expected[0].real - isobaric, expected[-1].real - isobaric) == pytest.approx((0.0, air), abs=0.05 * air)
    np.testing.assert_allclose(found.stiffness[:, 0], expected.real, atol=0.01 * air)
    np.testing.assert_allclose(found.loss[:, 0], expected.imag, atol=0.01 * air)


@pytest.mark.slow
def test_what_does_not_fit_is_refused(held, start):
    for field, given in (("frequency", (1 * deg, 20.0)), ("amplitude", (0.0, 1.0))):
        with pytest.raises(RangeError) as refused:
            dynamic_stiffness(held, start, *given)
        assert refused.value.field == field
    with pytest.raises(RangeError):
        dynamic_stiffness(held, start, 1 * deg, 1.0, setpoint=Setpoint(jnp.asarray(0.0), jnp.asarray(15.0)))


@pytest.mark.slow
def test_a_joint_of_a_robot_has_the_stiffness_of_the_joint_alone():
    """With friction of muscles and joint, and a motion of the size of both."""
    robot = RobotScenario.parse(ONE + TORQUE).robot
    pair, friction = robot.pair(0), JointFriction(0.2, 0.05 * deg)
    muscle = dataclasses.replace(pair.muscle1, friction=SLIP)
    robot = dataclasses.replace(
        robot,
        muscles=(dataclasses.replace(robot.muscles[0], muscle1=muscle, muscle2=muscle),),
        joints=(dataclasses.replace(robot.joints[0], friction=friction),),
    )
    joint = dataclasses.replace(pair, muscle1=muscle, muscle2=muscle)
    load, options = joint_load(robot, (0.0,), 0, 9.81), {"substeps": 2, "cycles": 2}
    plants = RobotPlant(robot, IdealValve()), JointPlant(joint, load, IdealValve(), friction=friction)
    starts = plants[0].init_state((0.0,), (3e5, 3e5)), plants[1].init_state(0.0, (3e5, 3e5))
    motion = np.array([0.1, 3.0]) * deg, (1.0, FAST)
    found, alone = (dynamic_stiffness(*pair, *motion, **options) for pair in zip(plants, starts, strict=True))
    np.testing.assert_allclose(found.stiffness, alone.stiffness, rtol=1e-9)
    np.testing.assert_allclose(found.loss, alone.loss, rtol=1e-9)
    expected = np.asarray(secant(joint, (3e5, 3e5), motion[0])) + 0.2 / motion[0]
    np.testing.assert_allclose(found.stiffness[0, 1], expected[1], rtol=1e-5)


@pytest.mark.slow
def test_muscles_over_several_joints_stiffen_each_of_them():
    """At constant pressures, in small motion, it is the isobaric stiffness of that joint with the other held."""
    text = re.sub(r", friction: \{[^}]*\}", "", Path("examples/robot/neck.yaml").read_text(encoding="utf-8"))
    robot = RobotScenario.parse(text).robot
    plant, count = RobotPlant(robot, IdealValve()), len(robot.all_muscles)
    angles, pressures = (0.05, -0.03), np.linspace(2e5, 3e5, count)
    state = plant.init_state(angles, tuple(pressures))
    expected = jax.jit(robot.stiffness)(angles, tuple(pressures))
    for joint, stiffness in enumerate(expected):
        found = dynamic_stiffness(plant, state, 1e-3 * deg, FAST, joint=joint, substeps=1, cycles=1)
        assert found.stiffness[0, 0] == pytest.approx(float(stiffness), rel=1e-6)


@pytest.mark.slow
def test_the_stiffness_of_a_motion_of_a_robot_has_the_friction_of_its_muscles():
    robot = RobotScenario.parse(ONE + TORQUE).robot
    muscle = dataclasses.replace(robot.pair(0).muscle1, friction=SLIP)
    robot = dataclasses.replace(robot, muscles=(dataclasses.replace(robot.muscles[0], muscle1=muscle, muscle2=muscle),))
    plant = RobotPlant(robot, IdealValve())
    state = plant.init_state((0.0,), (3e5, 3e5))
    found = plant.mechanism.statics(state.position, state.velocity, state.pressures, state.muscles, 1 * deg)
    joint = dataclasses.replace(robot.pair(0), muscle1=muscle, muscle2=muscle)
    assert float(found.stiffness[0]) == pytest.approx(float(secant(joint, (3e5, 3e5), 1 * deg)), rel=1e-9)
    assert float(found.stiffness[0]) > float(robot.stiffness((0.0,), (3e5, 3e5))[0]) + 5
