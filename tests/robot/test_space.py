"""A robot in space: conservation laws, closed forms, batches in both engines, gradients, and files."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import approx_fprime

import mckibben as mk
from mckibben.errors import RangeError, ScenarioError, SimulationError
from mckibben.mechanism.dynamics import Posture, acceleration, at_rest, contacts, frames, motion, posture_of
from mckibben.numerics.batching import batched_program
from mckibben.numerics.calculus import rk4
from mckibben.numerics.spatial import Vector
from mckibben.robot import Body, Foot, Ground, Joint, Place, Robot, RobotPlant, RobotScenario, RobotStart, read_robot
from mckibben.units import deg
from tests.robot.conftest import limb, pair_over, robot_of

FILE = "examples/robot/lei-leg-in-space.yaml"
AXES = (1.0, 0.0, 0.0), (0.3, -0.8, 0.2), (0.0, -1.0, 0.0)


def oblique(pair, freedom):
    """A robot of three joints in space, the last of which is parallel to no other."""
    robot = robot_of(pair, freedom)
    joints = tuple(dataclasses.replace(one, axis=axis) for one, axis in zip(robot.joints, AXES, strict=True))
    trunk, *limbs = robot.bodies
    limbs = (dataclasses.replace(body, inertia=(body.inertia[0], 0.0004)) for body in limbs)
    trunk = dataclasses.replace(trunk, inertia=(0.015, 0.02, 0.011))
    return dataclasses.replace(robot, joints=joints, bodies=(trunk, *limbs))


def in_motion(robot):
    posture = posture_of(robot, (0.5, -0.8, 0.3), z=1.0)
    velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, (2.0, -3.0, 1.0))))
    turned = {"yaw": 0.4, "pitch": 0.2, "roll": -0.3, "x": 0.3, "y": -0.2, "z": 1.0}
    rates = {name: jnp.asarray(turned[name]) for name in robot.motions}
    posture = posture._replace(**{name: one for name, one in rates.items() if name in ("yaw", "pitch", "roll")})
    return posture, velocity._replace(**rates)


@pytest.mark.slow
def test_energy_and_momenta_in_flight(pair):
    robot = oblique(pair, "floating")

    def rate(state):
        posture, velocity = state
        return Posture(*velocity), acceleration(robot, posture, velocity, (0.0, 0.0, 0.0), (), 9.81)

    def step(_, state):
        return rk4(rate, state, 1e-4)

    start = in_motion(robot)
    with batched_program():
        end = jax.jit(lambda state: jax.lax.fori_loop(0, 2000, step, state))(start)
    before, after = motion(robot, *start, 9.81), motion(robot, *end, 9.81)
    assert float(after.kinetic + after.potential) == pytest.approx(float(before.kinetic + before.potential), abs=1e-10)
    assert float(after.forward_speed) == pytest.approx(float(before.forward_speed), abs=1e-12)
    assert float(after.sideward_speed) == pytest.approx(float(before.sideward_speed), abs=1e-12)
    assert float(after.upward_speed) == pytest.approx(float(before.upward_speed) - 9.81 * 0.2, abs=1e-12)
    np.testing.assert_allclose(after.spin, before.spin, atol=1e-12)
    assert np.linalg.norm(np.array(before.spin)) > 0.01


def test_a_side_swing_alone_is_a_pendulum(pair):
    """About the forward axis with the robot locked: I theta'' = torque - m g c sin(theta)."""
    side = Joint("side", (0.5, 0.0, 0.0), -10 * deg, 10 * deg, "arm")  # an axis of any length
    bodies = Body("trunk", 1.0), limb("arm", 0.5, 0.19, 0.009, 0.0004)
    robot = Robot(bodies, (side,), foot=Foot("arm", Place(z=-0.4)))
    posture = posture_of(robot, (0.1,))
    found = acceleration(robot, posture, at_rest(posture), (0.7,), (), 9.81).angles[0]
    inertia = 0.009 + 0.5 * 0.19**2
    assert float(found) == pytest.approx((0.7 - 0.5 * 9.81 * 0.19 * np.sin(0.1)) / inertia, rel=1e-13)
    foot = contacts(robot, frames(robot, posture, at_rest(posture)))[0].position
    np.testing.assert_allclose(foot, [0.0, 0.4 * np.sin(0.1), -0.4 * np.cos(0.1)], atol=1e-15)


def test_a_robot_without_swing_to_the_side_is_the_planar_robot():
    """The same accelerations, also under a force in the plane."""
    robots = [read_robot(name) for name in ("lei-leg-planar", "lei-leg")]
    assert [robot.is_planar for robot in robots] == [True, False]
    assert robots[1].muscle_names == ("side1", "side2", "hip1", "hip2", "knee1", "knee2")
    found = []
    for robot, before in zip(robots, ((), (0.0,)), strict=True):
        posture = posture_of(robot, (*before, 0.05, -0.2))
        velocity = at_rest(posture)._replace(z=jnp.asarray(-1.0), angles=tuple(map(jnp.asarray, (*before, 1.0, -2.0))))
        found.append(acceleration(robot, posture, velocity, (*before, 2.0, -1.0), [Vector(20.0, 0.0, 90.0)], 9.81))
    assert float(found[1].angles[0]) == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose([found[1].z, *found[1].angles[1:]], [found[0].z, *found[0].angles], rtol=1e-12)


def test_friction_is_along_the_ground_and_against_the_slip():
    ground = Ground(friction=0.5, slope=10 * deg, side_slope=-20 * deg)
    normal = np.array(ground.normal)
    rise = np.array([[1, 0, np.tan(10 * deg)], [0, 1, np.tan(-20 * deg)]])
    np.testing.assert_allclose(rise @ normal, 0, atol=1e-15)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
    velocity = np.array([0.3, -0.4, 0.1])
    robot = read_robot("lei-leg")
    posture = posture_of(robot, (0.0, 0.0, 0.0))
    point = contacts(robot, frames(robot, posture, at_rest(posture)), ground.normal)[0]
    deep = point._replace(position=Vector(*(-0.002 * normal)), velocity=Vector(*velocity))
    force = np.array(ground.force(deep))
    along = velocity - normal * (velocity @ normal)
    pressed = force @ normal
    assert pressed == pytest.approx(20e3 * 0.002 * (1 - 0.5 * velocity @ normal))
    np.testing.assert_allclose(
        force - pressed * normal, -0.5 * pressed * along / np.hypot(np.linalg.norm(along), 0.1), atol=1e-12
    )


@pytest.mark.slow
def test_gradients_are_those_of_finite_differences():
    """The rate of a robot on the ground, over its posture and pressures."""
    plant = RobotScenario.read(FILE).plant()
    state = plant.begin(RobotStart((1 * deg, 0.0, 0.0), (2e5,) * 6, clearance=0.0, upward_speed=-1.0))
    angles, pressures = (jnp.stack(list(map(jnp.asarray, one))) for one in (state.position.angles, state.pressures))

    @jax.jit
    def accelerations(change):
        posture = state.position._replace(z=state.position.z - 3e-3 + change[0], angles=tuple(angles + change[1:4]))
        moved = plant.rate(state._replace(position=posture, pressures=tuple(pressures + 1e6 * change[4:])))
        return jnp.stack([moved.velocity.z, *moved.velocity.angles])

    found = np.asarray(jax.jit(jax.jacfwd(accelerations))(jnp.zeros(10)))
    expected = approx_fprime(np.zeros(10), lambda x: np.asarray(accelerations(x)), 1e-7)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4 * np.abs(found).max())


def test_what_cannot_be_is_refused(pair):
    link, base = limb("arm", 0.5, 0.19, 0.009), Body("trunk", 1.0, inertia=(0.01, 0.01, 0.01))
    joint = Joint("side", (1.0, 0.0, 0.0), -5 * deg, 5 * deg, "arm")
    robot = Robot((base, link), (joint,))
    for make, field in (
        (lambda: dataclasses.replace(joint, axis=(0.0, 0.0, 0.0)), "axis"),
        (lambda: dataclasses.replace(joint, axis=(1.0, 0.0)), "axis"),
        (lambda: dataclasses.replace(robot, bodies=(base, limb("arm", 0.0, 0.0, 0.0))), "joints.0.body"),
        (lambda: dataclasses.replace(robot, bodies=(base, link, link)), "bodies.2.name"),
        (lambda: dataclasses.replace(robot, joints=(dataclasses.replace(joint, body=None),)), "bodies.1.name"),
        (lambda: dataclasses.replace(robot, joints=(dataclasses.replace(joint, body="leg"),)), "joints.0.body"),
        (lambda: dataclasses.replace(robot, foot=Foot("leg")), "foot.body"),
        (lambda: dataclasses.replace(link, inertia=(0.01,)), "inertia"),
        (lambda: dataclasses.replace(link, inertia=(0.009, -1.0)), "inertia"),
        (lambda: dataclasses.replace(link, inertia=(0.009, 0.019)), "inertia"),
        (lambda: dataclasses.replace(link, inertia=(0.009, 0.009, 0.009, 0.01, 0.0, 0.0)), "inertia"),
        (lambda: dataclasses.replace(robot, base="floating", bodies=(Body("trunk", 1.0), link)), "yaw_inertia"),
        (lambda: Ground(slope=80 * deg), "slope"),
    ):
        with pytest.raises(RangeError) as caught:
            make()
        assert caught.value.field == field and caught.value.remedy


def test_a_slender_body_cannot_turn_about_its_own_line(pair):
    turn = Joint("yaw", (0.0, 0.0, 1.0), -5 * deg, 5 * deg, "arm")
    for axial in (0.0, 1e-20, 1e-4):
        bodies, foot = (Body("trunk", 1.0), limb("arm", 0.5, 0.19, 0.009, axial)), Foot("arm", Place(z=-0.4), 0.02)
        parts = bodies, (turn,), (pair_over("yaw", pair),), "vertical", foot
        if not axial:
            with pytest.raises(RangeError) as refused:
                Robot(*parts)
            assert refused.value.field == "joints.0.body" and refused.value.remedy
            continue
        plant = RobotPlant(Robot(*parts), mk.FirstOrderValve(0.02))
        if axial > 1e-9:
            assert plant.needed_substeps((0.0,), None, 0.25e-3) < 100
            continue
        with pytest.raises(SimulationError) as caught:
            plant.needed_substeps((0.0,), None, 0.25e-3)
        assert caught.value.field == "inertia" and caught.value.remedy


@pytest.mark.slow
def test_files_of_a_robot_in_space():
    scenario = RobotScenario.read(FILE)
    assert RobotScenario.parse(scenario.dumps()) == scenario
    head = "name: x\nrobot:\n  from: lei-leg\n"
    turned = RobotScenario.parse(head + "  joints: {hip: {axis: [0, 0, 1]}}\nground: {slope: 5 deg}\n")
    assert turned.robot.joints[1].axis == (0.0, 0.0, 1.0)
    assert turned.plant().ground.slope == pytest.approx(5 * deg)
    assert RobotScenario.parse(turned.dumps()) == turned
    for text, line, field in (
        ("  bodies: {trunk: {mass: -1 kg}}\n", 4, "robot.bodies[0].mass"),
        ("ground: {side_slope: 70 deg}\n", 4, "ground.side_slope"),
        ("  joints: {hip: {axis: [0, 0, 2]}}\n", 4, "robot.joints[1].axis[2]"),
    ):
        with pytest.raises(ScenarioError) as caught:
            RobotScenario.parse(head + text)
        problem = caught.value.problems[0]
        assert (problem.line, problem.field) == (line, field) and problem.remedy
