"""Bodies of robots as MJCF, read by MuJoCo: masses, limits, inertia and position of the foot at random postures."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.export import robot_mjcf
from mckibben.export.mjcf import mjcf
from mckibben.export.robot_mjcf import coordinates
from mckibben.robot import RobotPlant, read_robot
from mckibben.robot.dynamics import contact, frames, motion
from mckibben.units import deg
from tests.robot.test_space import oblique

mujoco = pytest.importorskip("mujoco")


def robots(pair, kind):
    """The paper's leg, that with its knee locked, or one with oblique axes on a trunk of some freedom."""
    if kind == "paper":
        return read_robot("lei-leg")
    if kind == "locked":
        robot = read_robot("lei-leg")
        knee = dataclasses.replace(robot.joints[2], locked=10 * deg)
        return dataclasses.replace(robot, joints=(*robot.joints[:2], knee))
    robot = oblique(pair, kind)
    return dataclasses.replace(robot, foot=dataclasses.replace(robot.foot, radius=0.02))


def posture_at(robot, start, places):
    """Posture and velocity 0 at coordinates in MuJoCo's order."""
    trunk, angles = places[: len(robot.motions)], iter(places[len(robot.motions) :])
    at = [jnp.asarray(next(angles)) if one.locked is None else jnp.asarray(one.locked) for one in robot.joints]
    named = {name: jnp.asarray(one) for name, one in zip(robot.motions, trunk, strict=True)}
    still = {name: jnp.zeros(()) for name in start.posture._fields if getattr(start.posture, name) is not None}
    posture = start.posture._replace(**{**still, "angles": tuple(at), **named})
    return posture, jax.tree.map(jnp.zeros_like, start.velocity)


def inertia_matrix(robot, posture, still):
    """Hessian of the kinetic energy over the velocities."""
    free = [i for i, joint in enumerate(robot.joints) if joint.locked is None]

    def kinetic(rates):
        trunk = dict(zip(robot.motions, rates, strict=False))
        angles = list(still.angles)
        for place, i in enumerate(free, len(robot.motions)):
            angles[i] = rates[place]
        return motion(robot, posture, still._replace(**trunk, angles=tuple(angles)), 9.81).kinetic

    return jax.hessian(kinetic)(jnp.zeros(len(robot.motions) + len(free)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["paper", "locked", "fixed", "free", "floating"])
def test_bodies_are_those_of_the_robot(pair, kind):
    if kind == "free":  # in the plane
        robot = read_robot("lei-leg-planar")
        robot = dataclasses.replace(robot, base="free")
    else:
        robot = robots(pair, kind)
    plant = RobotPlant(robot, mk.FirstOrderValve(0.02))
    start = plant.init_state(robot.posture_angles({}), [0.0] * len(robot.all_muscles))
    rigging = robot_mjcf._Rigging(plant)
    scene = robot_mjcf._scene(plant, rigging.bodies, start)
    model = mujoco.MjModel.from_xml_string(mjcf(plant, "robot", 1e-3, rigging.drives, [], scene))
    moving = len(coordinates(plant, start.posture))

    @jax.jit
    def expected(places):
        posture, still = posture_at(robot, start, places)
        foot = jnp.array([*contact(robot, frames(robot, posture, still)).position])
        return inertia_matrix(robot, posture, still), foot, posture.z

    assert model.nv == moving
    if robot.motions:  # MuJoCo makes a fixed trunk a part of the world
        assert model.body_mass.sum() == pytest.approx(float(robot.total_mass), abs=1e-9)
    for joint in robot.joints:
        if joint.locked is None:
            hinge = model.joint(joint.name)
            np.testing.assert_allclose(hinge.range, [float(joint.lower), float(joint.upper)], rtol=0, atol=1e-12)
            assert model.dof_damping[hinge.dofadr[0]] == pytest.approx(float(joint.damping))
    data = mujoco.MjData(model)
    for places in np.random.default_rng(1).uniform(-0.6, 0.6, (3, moving)):
        inertia, foot, height = map(np.asarray, expected(places))
        data.qpos[:] = places
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full) if hasattr(data, "M") else mujoco.mj_fullM(model, full, data.qM)
        np.testing.assert_allclose(full, inertia, rtol=0, atol=1e-9)
        lowest = data.geom("foot").xpos.copy()
        lowest[2] -= float(robot.foot.radius)
        if not robot.motions:  # a trunk that is held at the height of the start
            lowest[2] -= float(start.posture.z - height)
        np.testing.assert_allclose(lowest, foot, rtol=0, atol=1e-9)
