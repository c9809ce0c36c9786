"""Legs as URDF and MJCF, read by MuJoCo: masses, inertia matrix, gravity and place of the foot at random postures."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import ExportError
from mckibben.export.leg_mjcf import coordinates, leg_scene
from mckibben.export.leg_urdf import export_leg_urdf, leg_urdf
from mckibben.leg import Leg, LegPlant, LegScenario, read_leg
from mckibben.leg.dynamics import Posture, Velocity, contact, frames, motion
from mckibben.leg.plant import LegState
from mckibben.units import deg
from tests.leg.test_space import oblique

mujoco = pytest.importorskip("mujoco")

FILE = "examples/leg/lei-leg-in-space.yaml"


def legs(pair: mk.AntagonisticJoint, kind: str) -> Leg:
    """The paper's leg, that with its knee locked, or one with oblique axes on a trunk of some freedom."""
    if kind == "paper":
        return read_leg("lei-leg")
    if kind == "locked":
        leg = read_leg("lei-leg")
        knee = dataclasses.replace(leg.joints[2], locked=10 * deg)
        return dataclasses.replace(leg, joints=(*leg.joints[:2], knee))
    return dataclasses.replace(oblique(pair, kind), foot_radius=0.02)


def posture_at(leg: Leg, start: LegState, places: jax.Array) -> tuple[Posture, Velocity]:
    """Posture and velocity 0 at coordinates in MuJoCo's order."""
    trunk, angles = places[: len(leg.trunk.motions)], iter(places[len(leg.trunk.motions) :])
    at = [jnp.asarray(next(angles)) if one.locked is None else jnp.asarray(one.locked) for one in leg.joints]
    named = {name: jnp.asarray(one) for name, one in zip(leg.trunk.motions, trunk, strict=True)}
    still = {name: jnp.zeros(()) for name in start.posture._fields if getattr(start.posture, name) is not None}
    posture = start.posture._replace(**{**still, "angles": tuple(at), **named})
    return posture, jax.tree.map(jnp.zeros_like, start.velocity)


def inertia_matrix(leg: Leg, posture: Posture, still: Velocity) -> jax.Array:
    """Hessian of the kinetic energy over the velocities."""
    free = [i for i, joint in enumerate(leg.joints) if joint.locked is None]

    def kinetic(rates: jax.Array) -> jax.Array:
        trunk = dict(zip(leg.trunk.motions, rates, strict=False))
        angles = list(still.angles)
        for place, i in enumerate(free, len(leg.trunk.motions)):
            angles[i] = rates[place]
        return motion(leg, posture, still._replace(**trunk, angles=tuple(angles)), 9.81).kinetic

    return jax.hessian(kinetic)(jnp.zeros(len(leg.trunk.motions) + len(free)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["paper", "locked", "fixed", "vertical", "free", "spatial", "floating"])
def test_bodies_are_those_of_the_leg(pair: mk.AntagonisticJoint, kind: str) -> None:
    if kind == "free":  # in the plane
        leg = read_leg("lei-leg-planar")
        leg = dataclasses.replace(leg, trunk=dataclasses.replace(leg.trunk, freedom="free"))
    else:
        leg = legs(pair, kind)
    plant = LegPlant(leg, mk.FirstOrderValve(0.02))
    start = plant.init_state(leg.posture_angles({}), [0.0] * len(leg.muscles))
    texts = {"urdf": leg_urdf(plant).files["leg.urdf"], "mjcf": leg_scene(plant, start).xml}
    models = {form: mujoco.MjModel.from_xml_string(text) for form, text in texts.items()}
    moving = len(coordinates(plant, start.posture))

    @jax.jit
    def expected(places: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        posture, still = posture_at(leg, start, places)
        foot = jnp.array([*contact(leg, frames(leg, posture, still)).position])
        return inertia_matrix(leg, posture, still), foot, posture.z

    for model in models.values():
        assert model.nv == moving
        if leg.trunk.motions:  # MuJoCo makes a fixed trunk a part of the world
            assert model.body_mass.sum() == pytest.approx(float(leg.total_mass), abs=1e-9)
        for joint in leg.joints:
            if joint.locked is None:
                found = model.joint(joint.name)
                np.testing.assert_allclose(found.range, [float(joint.lower), float(joint.upper)], rtol=0, atol=1e-12)
                assert model.dof_damping[found.dofadr[0]] == pytest.approx(float(joint.damping))
    for places in np.random.default_rng(1).uniform(-0.6, 0.6, (3, moving)):
        inertia, foot, height = map(np.asarray, expected(places))
        for form, model in models.items():
            data = mujoco.MjData(model)
            data.qpos[:] = places
            mujoco.mj_forward(model, data)
            full = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, full) if hasattr(data, "M") else mujoco.mj_fullM(model, full, data.qM)
            np.testing.assert_allclose(full, inertia, rtol=0, atol=1e-9, err_msg=form)
            lowest = data.geom_xpos[-1].copy()
            lowest[2] -= float(leg.foot_radius)
            if not leg.trunk.motions and form == "mjcf":  # a trunk that is held at the height of the start
                lowest[2] -= float(start.posture.z - height)
            np.testing.assert_allclose(lowest, foot, rtol=0, atol=1e-9, err_msg=form)


def test_the_file_names_what_is_left_out(tmp_path: Path) -> None:
    scenario = LegScenario.read(FILE)
    made = export_leg_urdf(scenario, tmp_path, name="paper")
    text = (tmp_path / "paper.urdf").read_text()
    assert all(one in text for one in made.left_out)
    assert any("knee2" in one for one in made.left_out)
    robot = ElementTree.fromstring(text)
    moving = [one.get("name") for one in robot.iter("joint") if one.get("type") != "fixed"]
    assert moving == ["trunk_z", "side", "hip", "knee"]
    knee = robot.find("joint[@name='knee']/limit")
    assert knee is not None
    leg = scenario.leg
    bent = float(leg.joints[2].lower)
    pressures = [0.0] * 5 + [float(leg.muscles[5].domain.pressure_max)]
    largest = float(leg.torques((0.0, 0.0, bent), pressures)[2])
    assert math.isclose(float(knee.get("effort", "")), max(largest, -float(_backward(leg))), rel_tol=1e-9)


def _backward(leg: Leg) -> float:
    pressures = [0.0] * 4 + [float(leg.muscles[4].domain.pressure_max), 0.0]
    return float(leg.torques((0.0, 0.0, float(leg.joints[2].upper)), pressures)[2])


def test_names_that_are_given_twice_are_refused() -> None:
    leg = read_leg("lei-leg")
    hip = dataclasses.replace(leg.joints[1], name="trunk_z")
    with pytest.raises(ExportError) as caught:
        leg_urdf(
            LegPlant(dataclasses.replace(leg, joints=(leg.joints[0], hip, leg.joints[2])), mk.FirstOrderValve(0.02))
        )
    assert caught.value.remedy


@pytest.mark.slow
def test_the_ends_of_straight_paths_are_links() -> None:
    plant = LegScenario.read(FILE).plant()
    start = plant.init_state(plant.leg.posture_angles({}), [0.0] * len(plant.leg.muscles))
    text = leg_urdf(plant).files["leg.urdf"]
    fused = '<mujoco><compiler fusestatic="false"/></mujoco>'
    head, end, tail = text.partition('<robot name="leg">')
    models = [mujoco.MjModel.from_xml_string(one) for one in (head + end + fused + tail, leg_scene(plant, start).xml)]
    states = [mujoco.MjData(model) for model in models]
    assert models[1].nsite == 12
    for places in np.random.default_rng(2).uniform(-0.3, 0.3, (5, models[0].nq)):
        for model, state in zip(models, states, strict=True):
            state.qpos[:] = places
            mujoco.mj_forward(model, state)
        for site in range(models[1].nsite):
            link = models[1].site(site).name.replace(" ", "_")
            assert states[0].body(link).xpos == pytest.approx(states[1].site_xpos[site], abs=1e-9)
