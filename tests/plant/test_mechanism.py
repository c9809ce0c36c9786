"""One plant for all mechanisms: a joint in closed form and a robot of one hinge move alike, and steps have order 4."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.plant.base import MOST_HERMITE
from mckibben.robot import Body, Joint, MusclePair, Place, Robot, RobotPlant
from mckibben.units import bar, deg, mm

KNEE = mk.catalog.joint("knee-table-2")
KNEE = dataclasses.replace(KNEE, geometry=dataclasses.replace(KNEE.geometry, connector_length=208 * mm))
MASS, DISTANCE, DAMPING = 0.8, 0.2, 0.03
SLIP = mk.MaxwellSlip(7.5, 0.5 * mm)
COMMANDS = 2.6 * bar, 3.4 * bar


def muscles(**parts):
    return dataclasses.replace(KNEE.muscle1, **parts)


def joint_plant(muscle, valve, **options):
    load = mk.PendulumLoad(MASS, DISTANCE, damping=DAMPING)
    return mk.JointPlant(dataclasses.replace(KNEE, muscle1=muscle, muscle2=muscle), load, valve, **options)


def arm(count, muscle, valve, friction=None):
    """Pendulums with a point mass each, hanging from each other; the hinges turn as the joint does."""
    links = range(count)
    bodies = [Body(f"link{i}", MASS, Place(z=-DISTANCE), (1e-9, 1e-9, 1e-9)) for i in links]
    options = {"lower": -20 * deg, "upper": 20 * deg, "damping": DAMPING, "friction": friction}
    joints = [
        Joint(f"hinge{i}", (0.0, -1.0, 0.0), body=f"link{i}", place=Place(z=-DISTANCE * (i > 0)), **options)
        for i in links
    ]
    pairs = [MusclePair(f"hinge{i}", KNEE.geometry, muscle, muscle) for i in links]
    return RobotPlant(Robot((Body("base", 1.0), *bodies), tuple(joints), tuple(pairs)), valve)


def mover(plant, commands):
    """Angles [rad] of all joints after a count of steps of a length [s], under constant commands."""

    @jax.jit
    def run(state, count, step):
        return jax.lax.fori_loop(0, count, lambda _, state: plant.follow(state, commands, step, 1), state)

    def angles_after(angles, pressures, count=60, step=2e-3):
        start = plant.with_last_step(plant.init_state(angles, pressures), step)
        return np.array(plant.mechanism.by_joint(run(jax.tree.map(jnp.asarray, start), count, step)[0]))

    return angles_after


@pytest.mark.slow
@pytest.mark.parametrize(
    ("muscle", "valve", "friction", "smooth"),
    [
        (muscles(), mk.FirstOrderValve(0.02), None, True),
        (muscles(friction=SLIP, creep=mk.MaxwellCreep(0.05, 2.0)), mk.FirstOrderValve(0.02), None, False),
        (muscles(), mk.FirstOrderValve(0.02), mk.JointFriction(0.2, 0.5 * deg), False),
        (muscles(), mk.FlowValve(conductance=1e-9, supply=7 * bar, dead_volume=5e-6), None, False),
    ],
)
def test_a_robot_of_one_hinge_moves_as_the_joint(muscle, valve, friction, smooth):
    joint, robot = joint_plant(muscle, valve, friction=friction), arm(1, muscle, valve, friction)
    assert joint.is_smooth == robot.is_smooth == smooth
    moved = mover(joint, COMMANDS)(0.05, (3 * bar, 3 * bar))
    same = mover(robot, COMMANDS)((0.05,), (3 * bar, 3 * bar))
    assert abs(moved[0] - 0.05) > 0.01
    np.testing.assert_allclose(same, moved, rtol=0, atol=3e-9)  # of the inertia about the centre of mass


@pytest.mark.slow
def test_steps_of_two_joints_have_order_four():
    plant = arm(2, muscles(), mk.FirstOrderValve(0.02))
    assert plant.is_smooth
    angles_after = mover(plant, (*COMMANDS, *reversed(COMMANDS)))
    exact, *coarse = (angles_after((0.05, -0.02), (3 * bar,) * 4, 30 * n, 8e-3 / n) for n in (32, 1, 2, 4))
    errors = [np.abs(angles - exact).max() for angles in coarse]
    assert errors[0] > 1e-9
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 3.5).all()


def test_more_joints_take_other_steps():
    plant = arm(MOST_HERMITE + 1, muscles(), mk.FirstOrderValve(0.02))
    state = plant.init_state((0.0,) * (MOST_HERMITE + 1), (3 * bar,) * 2 * (MOST_HERMITE + 1))
    assert not plant.is_smooth
    assert plant.with_last_step(state, 1e-3) is state
