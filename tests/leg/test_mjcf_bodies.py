"""Bodies of legs as MJCF, read by MuJoCo: masses, limits, inertia and position of the foot at random postures."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.export import leg_mjcf
from mckibben.export.leg_mjcf import coordinates
from mckibben.export.mjcf import mjcf
from mckibben.leg import LegPlant, read_leg
from mckibben.leg.dynamics import contact, frames, motion
from mckibben.units import deg
from tests.leg.test_space import oblique

mujoco = pytest.importorskip("mujoco")


def legs(pair, kind):
    """The paper's leg, that with its knee locked, or one with oblique axes on a trunk of some freedom."""
    if kind == "paper":
        return read_leg("lei-leg")
    if kind == "locked":
        leg = read_leg("lei-leg")
        knee = dataclasses.replace(leg.joints[2], locked=10 * deg)
        return dataclasses.replace(leg, joints=(*leg.joints[:2], knee))
    return dataclasses.replace(oblique(pair, kind), foot_radius=0.02)


def posture_at(leg, start, places):
    """Posture and velocity 0 at coordinates in MuJoCo's order."""
    trunk, angles = places[: len(leg.trunk.motions)], iter(places[len(leg.trunk.motions) :])
    at = [jnp.asarray(next(angles)) if one.locked is None else jnp.asarray(one.locked) for one in leg.joints]
    named = {name: jnp.asarray(one) for name, one in zip(leg.trunk.motions, trunk, strict=True)}
    still = {name: jnp.zeros(()) for name in start.posture._fields if getattr(start.posture, name) is not None}
    posture = start.posture._replace(**{**still, "angles": tuple(at), **named})
    return posture, jax.tree.map(jnp.zeros_like, start.velocity)


def inertia_matrix(leg, posture, still):
    """Hessian of the kinetic energy over the velocities."""
    free = [i for i, joint in enumerate(leg.joints) if joint.locked is None]

    def kinetic(rates):
        trunk = dict(zip(leg.trunk.motions, rates, strict=False))
        angles = list(still.angles)
        for place, i in enumerate(free, len(leg.trunk.motions)):
            angles[i] = rates[place]
        return motion(leg, posture, still._replace(**trunk, angles=tuple(angles)), 9.81).kinetic

    return jax.hessian(kinetic)(jnp.zeros(len(leg.trunk.motions) + len(free)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["paper", "locked", "fixed", "free", "floating"])
def test_bodies_are_those_of_the_leg(pair, kind):
    if kind == "free":  # in the plane
        leg = read_leg("lei-leg-planar")
        leg = dataclasses.replace(leg, trunk=dataclasses.replace(leg.trunk, freedom="free"))
    else:
        leg = legs(pair, kind)
    plant = LegPlant(leg, mk.FirstOrderValve(0.02))
    start = plant.init_state(leg.posture_angles({}), [0.0] * len(leg.muscles))
    rigging = leg_mjcf._Rigging(plant)
    scene = leg_mjcf._scene(plant, rigging.bodies, start)
    model = mujoco.MjModel.from_xml_string(mjcf(plant, "leg", 1e-3, rigging.drives, [], scene))
    moving = len(coordinates(plant, start.posture))

    @jax.jit
    def expected(places):
        posture, still = posture_at(leg, start, places)
        foot = jnp.array([*contact(leg, frames(leg, posture, still)).position])
        return inertia_matrix(leg, posture, still), foot, posture.z

    assert model.nv == moving
    if leg.trunk.motions:  # MuJoCo makes a fixed trunk a part of the world
        assert model.body_mass.sum() == pytest.approx(float(leg.total_mass), abs=1e-9)
    for joint in leg.joints:
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
        lowest = data.geom_xpos[-1].copy()
        lowest[2] -= float(leg.foot_radius)
        if not leg.trunk.motions:  # a trunk that is held at the height of the start
            lowest[2] -= float(start.posture.z - height)
        np.testing.assert_allclose(lowest, foot, rtol=0, atol=1e-9)
