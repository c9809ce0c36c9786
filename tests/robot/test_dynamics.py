"""The planar dynamics: the paper's knee as a special case, statics, and gradients."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import approx_fprime, fsolve

import mckibben as mk
from mckibben.mechanism.dynamics import Posture, Velocity, acceleration, at_rest, joint_equations, motion, posture_of
from mckibben.mechanism.ground import compliant_force
from mckibben.robot import Ground, RobotPlant, attainable_point_stiffness, point_stiffness
from mckibben.study.jumping import standing_torques
from tests.robot.conftest import robot_of, with_unit

zero = jnp.zeros(())


def moving():
    posture = Posture(zero, jnp.asarray(1.0), jnp.asarray(0.2), tuple(map(jnp.asarray, (0.5, -0.8, 0.3))))
    return posture, Velocity(*map(jnp.asarray, (0.3, 1.0, 0.7)), tuple(map(jnp.asarray, (2.0, -3.0, 1.0))))


def test_standing_torques_are_those_of_virtual_work(plant):
    angles = (0.02, -0.3)
    still = Velocity(zero, zero, zero, (zero, zero))

    def potential_above_foot(at):
        posture = Posture(zero, zero, zero, tuple(map(jnp.asarray, at)))
        state = plant.init_state(tuple(map(float, at)), (1e5,) * 4)
        return float(motion(plant.robot, posture._replace(z=state.position.z), still, 9.81).potential)

    gradient = approx_fprime(np.array(angles), potential_above_foot, 1e-6)
    assert standing_torques(plant, angles) == pytest.approx(gradient, abs=1e-4)


@pytest.mark.slow
def test_locked_joint_does_not_move_and_carries_its_link(pair):
    robot = robot_of(pair, "free")
    locked = dataclasses.replace(
        robot, joints=(robot.joints[0], dataclasses.replace(robot.joints[1], locked=0.0), robot.joints[2])
    )
    posture, velocity = moving()
    posture = posture._replace(angles=(posture.angles[0], zero, posture.angles[2]))
    velocity = velocity._replace(angles=(velocity.angles[0], zero, velocity.angles[2]))
    found = acceleration(locked, posture, velocity, (1.0, 5.0, 0.3), (), 9.81)
    assert float(found.angles[1]) == 0.0
    # The torque that the lock gives makes the free robot move alike.
    gain = jax.grad(lambda t: acceleration(robot, posture, velocity, (1.0, t, 0.3), (), 9.81).angles[1])(0.0)
    offset = acceleration(robot, posture, velocity, (1.0, 0.0, 0.3), (), 9.81).angles[1]
    held = acceleration(robot, posture, velocity, (1.0, float(-offset / gain), 0.3), (), 9.81)
    assert np.allclose(jax.tree.leaves(held), jax.tree.leaves(found), atol=1e-9)


def test_contact_pushes_only_and_begins_at_nought():
    assert float(compliant_force(-0.001, 1.0, 2e4, 0.5)) == 0.0
    assert float(compliant_force(0.001, 0.0, 2e4, 0.5)) == pytest.approx(20.0)
    assert float(compliant_force(0.001, -10.0, 2e4, 0.5)) == 0.0  # leaves faster than the ground follows
    with pytest.raises(mk.McKibbenError) as caught:
        Ground(stiffness=-1.0)
    assert caught.value.field == "stiffness"


@pytest.mark.slow
def test_friction_of_muscles_moves_with_the_robot(plant):
    """A muscle with friction and creep in the robot has the state that it has in the joint."""
    pair = plant.robot.pair(1)
    rough = dataclasses.replace(
        pair.muscle1, friction=mk.MaxwellSlip(7.5, 0.5e-3), creep=mk.MaxwellCreep(4e3, time_constant=0.1)
    )
    robot = with_unit(plant.robot, 1, muscle1=rough)
    both = RobotPlant(robot, mk.FirstOrderValve(0.02))
    start = both.init_state((0.0, 0.0), (3e5,) * 4, clearance=0.5)
    end = jax.jit(lambda state: both.advance(state, (3e5, 3e5, 2e5, 4e5), 0.1, 400))(start)
    alone = robot.pair(1).init_state(0.0, (3e5, 3e5))
    assert jax.tree.structure(end.muscles[2]) == jax.tree.structure(alone[0])
    assert any(
        abs(float(x - y)) > 0
        for x, y in zip(jax.tree.leaves(end.muscles[2]), jax.tree.leaves(start.muscles[2]), strict=True)
    )


def foot_of(robot, at):
    """The foot [m] forwards and up of the hip."""
    absolute = np.cumsum([joint.offset + angle for joint, angle in zip(robot.joints, at, strict=True)])
    lengths = np.array([0.4, 0.37])
    return np.array([np.sum(lengths * np.sin(absolute)), -np.sum(lengths * np.cos(absolute))])


def foot_jacobian(robot, at):
    absolute = np.cumsum([joint.offset + angle for joint, angle in zip(robot.joints, at, strict=True)])
    lengths = np.array([0.4, 0.37])
    moved = np.stack([lengths * np.cos(absolute), lengths * np.sin(absolute)])
    return moved @ np.tril(np.ones((len(lengths), len(lengths))))


@pytest.mark.parametrize("force", [(0.0, 6.0), (5.0, 3.0)])
def test_foot_stiffness_under_a_force_is_that_of_the_bent_robot(plant, force):
    """Springs at the joints hold the force; of a little more the foot gives way as the compliance says."""
    robot, angles, stiffness = plant.robot, np.array([0.02, -0.2]), np.array([18.0, 14.0])
    rest = angles - foot_jacobian(robot, angles).T @ force / stiffness

    def bent(by):
        return fsolve(lambda q: stiffness * (q - rest) - foot_jacobian(robot, q).T @ (force + by), angles, xtol=1e-13)

    found = point_stiffness(robot, angles, stiffness, force=force).compliance
    assert not np.allclose(found, point_stiffness(robot, angles, stiffness).compliance, rtol=0.02)
    for more in (np.array([1e-3, 0.0]), np.array([0.0, 1e-3])):
        moved = (foot_of(robot, bent(more)) - foot_of(robot, bent(-more))) / 2
        assert moved == pytest.approx(found @ more, rel=1e-4, abs=1e-9)


@pytest.mark.slow
def test_foot_stiffness_is_that_of_small_displacements(plant):
    robot, angles, stiffness = plant.robot, (0.02, -0.2), (18.0, 14.0)
    found = point_stiffness(robot, angles, stiffness)
    force = np.array([0.3, -0.2]) * 1e-3
    jacobian = approx_fprime(np.array(angles), lambda at: foot_of(robot, at), 1e-7)
    bent = np.array(angles) + (jacobian.T @ force) / stiffness
    assert foot_of(robot, bent) - foot_of(robot, np.array(angles)) == pytest.approx(found.compliance @ force, rel=1e-3)
    assert found.principal[0] < found.principal[1]
    low, high = robot.pair(1).attainable_stiffness(-0.2, 0.0)
    attainable = attainable_point_stiffness(robot, angles, (0.0, 0.0), levels=3)
    assert len(attainable) == 9 and float(low) < float(high)
    softest = min(one.principal[0] for one in attainable)
    assert softest < max(one.principal[0] for one in attainable)


@pytest.mark.slow
def test_gravity_of_any_direction_and_springs_are_the_slope_of_the_potential_energy(pair):
    robot = robot_of(pair, "fixed")
    joints = (dataclasses.replace(robot.joints[0], spring=3.0, spring_angle=0.2), *robot.joints[1:])
    robot = dataclasses.replace(robot, joints=joints, gravity=(0.3, -0.2, -0.9))

    def energy(angles):
        posture = posture_of(robot, tuple(angles))
        return motion(robot, posture, at_rest(posture), 9.81).potential

    angles = jnp.array([0.05, -0.03, 0.02])
    bias = joint_equations(robot, tuple(angles), (0.0,) * 3, 9.81).bias
    np.testing.assert_allclose(bias, jax.grad(energy)(angles), rtol=1e-9)
