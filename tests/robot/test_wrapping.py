"""Paths around spheres, cylinders and pulleys: closed forms, and MuJoCo at random places and states."""

import dataclasses
import math
import re
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.codegen.native import compiler
from mckibben.errors import ExportError, RangeError
from mckibben.export import export
from mckibben.export.mjcf import assembled, mujoco_model
from mckibben.export.mujoco import load_mujoco
from mckibben.export.muscle_plugin import plugin_files
from mckibben.mechanism.outline import outline
from mckibben.mechanism.wrapping import TendonPulley, WrapCylinder, WrapSphere
from mckibben.numerics.spatial import IDENTITY, Vector
from mckibben.robot import BodyPoint, PathMuscle, Place, PressureSchedule, RobotPlant, RobotScenario, simulate_robot
from mckibben.scenario.reading import read_mjcf
from mckibben.units import bar, deg
from tests.robot.test_control import ONE, TORQUE

mujoco = pytest.importorskip("mujoco")
SIDE = Place(-0.5, 1.2, 0.3)
LEG = """
name: wrapped
robot:
  base: fixed
  bodies:
    - {name: trunk, mass: 1 kg}
    - {name: thigh, mass: 1 kg, centre: [0 mm, 0 mm, -200 mm], inertia: [0.01 kg*m^2, 0.002 kg*m^2]}
    - {name: shank, mass: 1 kg, centre: [0 mm, 0 mm, -200 mm], inertia: [0.01 kg*m^2, 0.002 kg*m^2]}
  joints:
    - {name: hip, axis: [0, -1, 0], body: thigh, lower: -12 deg, upper: 12 deg}
    - {name: knee, axis: [0, 1, 0], lower: -12 deg, upper: 12 deg, place: [0 mm, 0 mm, -400 mm]}
    - {name: twist, axis: [0, 0, 1], body: shank, lower: -10 deg, upper: 10 deg}
  muscles:
    - name: front
      through:
        - {body: thigh, place: [55 mm, 10 mm, -100 mm]}
        - {body: thigh, place: [10 mm, 0 mm, -400 mm], radius: 40 mm}
        - {body: shank, place: [45 mm, -10 mm, -150 mm]}
      muscle: MUSCLE
      connector_length: 281 mm
    - name: back
      through:
        - {body: trunk, place: [-50 mm, 0 mm, 0 mm]}
        - {body: thigh, place: [-50 mm, 10 mm, -100 mm]}
        - {divisor: 2}
        - {body: thigh, place: [-60 mm, 10 mm, -100 mm]}
        - {body: thigh, place: [0 mm, 0 mm, -400 mm], radius: 30 mm, axis: [0.1, 1, 0], side: [-60 mm, 0 mm, -400 mm]}
        - {body: shank, place: [-35 mm, -10 mm, -150 mm]}
      muscle: MUSCLE
      connector_length: 163 mm
valve: {time_constant: 20 ms}
"""


def leg():
    """A leg with one muscle over a ball, and one by a tackle over a bone."""
    muscle = "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"
    return RobotScenario.parse(LEG.replace("MUSCLE", muscle))


@pytest.mark.slow
def test_a_quarter_of_a_helix():
    """Over an axis along z, with a rise: a straight line on the unrolled cylinder."""
    cylinder = WrapCylinder("bone", 0.03, axis=(0.0, 0.0, 1.0))
    path = cylinder.wrap(Vector(-0.02, 0.03, 0.0), Vector(0.03, -0.02, 0.1), IDENTITY)
    assert float(path.length) == pytest.approx(math.hypot(0.04 + 0.03 * math.pi / 2, 0.1), rel=1e-12)
    assert float(path.turn) == pytest.approx(math.pi / 2)


def test_a_path_on_its_side_goes_the_long_way():
    """As the straight line would pass on the other side of the centre."""
    start, end = Vector(-0.05, 0.06, 0.0), Vector(0.05, 0.06, 0.0)
    free = WrapSphere("bone", 0.03).wrap(start, end, IDENTITY)
    held = WrapSphere("bone", 0.03, side=Place(0.0, -0.05)).wrap(start, end, IDENTITY)
    assert (float(free.length), float(free.turn)) == (pytest.approx(0.1), 0.0)
    distance = math.hypot(0.05, 0.06)
    turn = 2 * math.pi - 2 * math.acos(0.03 / distance) - 2 * math.atan2(0.05, 0.06)
    assert float(held.length) == pytest.approx(2 * math.sqrt(distance**2 - 0.03**2) + 0.03 * turn, rel=1e-12)


@pytest.mark.parametrize(
    ("path", "field"),
    [
        ([BodyPoint("a"), WrapSphere("a", 0.1)], "through"),
        ([BodyPoint("a"), WrapSphere("a", 0.1), WrapSphere("a", 0.1), BodyPoint("b")], "through"),
        ([BodyPoint("a"), TendonPulley(2.0), BodyPoint("b"), BodyPoint("c")], "through"),
        ([BodyPoint("a"), WrapSphere("a", 0.1), BodyPoint("a")], "through"),
    ],
)
def test_paths_that_are_none(path, field, pair):
    with pytest.raises(RangeError) as caught:
        PathMuscle("front", pair.muscle1, through=tuple(path))
    assert caught.value.field == field


def test_surfaces_that_are_none():
    with pytest.raises(RangeError) as caught:
        WrapCylinder("a", 0.1, side=Place(0.05, 5.0), axis=(0.0, 1.0, 0.0))
    assert (caught.value.field, caught.value.lower) == ("side", 0.1)
    with pytest.raises(RangeError) as caught:
        WrapCylinder("a", 0.1, axis=(0.0, 0.0, 0.0))
    assert caught.value.field == "axis"


@pytest.mark.slow
@pytest.mark.parametrize("side", [None, SIDE], ids=["free", "side"])
@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_lengths_are_those_of_mujoco_between_any_points(kind, side):
    site = "" if side is None else 'sidesite="side"'
    x, y, z = (1.0, 1.0, 1.0) if side is None else side.vector
    model = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody>
        <geom name="surface" type="{kind}" size="1 5"/><site name="side" pos="{x} {y} {z}"/>
        <body mocap="true"><site name="a"/></body><body mocap="true"><site name="b"/></body></worldbody><tendon>
        <spatial><site site="a"/><geom geom="surface" {site}/><site site="b"/></spatial></tendon></mujoco>""")
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    points = rng.normal(scale=1.5, size=(2000, 2, 3))
    points[:500, 1] = points[:500, 0] + rng.normal(scale=0.2, size=(500, 3))
    lengths = []
    for pair in points:
        data.mocap_pos[:] = pair
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.ten_length[0])
    surface = (
        WrapSphere("x", 1.0, side=side) if kind == "sphere" else WrapCylinder("x", 1.0, side=side, axis=(0.0, 0.0, 1.0))
    )
    found = jax.jit(lambda ends: surface.wrap(Vector(*ends[:, 0].T), Vector(*ends[:, 1].T), IDENTITY))(points)
    assert 0.1 < np.mean(np.asarray(found.turn) > 0) < 0.5
    np.testing.assert_allclose(found.length, lengths, atol=1e-13)


def states(robot, count=100):
    low, high = ([getattr(joint, end) for joint in robot.joints] for end in ("lower", "upper"))
    return np.random.default_rng(0).uniform(low, high, (count, len(low)))


def along(robot, path):
    """Lengths, slopes, and bends by each pair of joints, at many angles."""
    size = len(robot.joints)

    def of(angles):
        length, slopes, bends = robot._skeleton(list(angles)).path_along(path)
        second = bends()
        pairs = [[second.get((min(i, j), max(i, j)), 0.0) for j in range(size)] for i in range(size)]
        return length, jnp.stack([slopes.get(i, 0.0 * length) for i in range(size)]), jnp.asarray(pairs)

    return jax.jit(jax.vmap(of))


@pytest.mark.slow
def test_slopes_and_bends_are_derivatives_of_the_length():
    robot = leg().robot
    for unit in robot.muscles:
        derivatives = along(robot, unit.elements)
        length = lambda angles, path=unit.elements: robot.path_along(path, list(angles))[0]  # noqa: E731
        _, slopes, bends = derivatives(states(robot))
        at = jnp.asarray(states(robot))
        np.testing.assert_allclose(slopes, jax.jit(jax.vmap(jax.grad(length)))(at), atol=1e-13)
        np.testing.assert_allclose(bends, jax.jit(jax.vmap(jax.hessian(length)))(at), atol=1e-12)
        assert np.abs(np.asarray(bends)).max(axis=0)[2, 1] > 1e-4  # over joints together, too


@pytest.mark.slow
def test_a_robot_that_we_write_is_read_back_with_its_surfaces(tmp_path):
    robot = leg().robot
    (tmp_path / "leg.xml").write_text(assembled(RobotPlant(robot, mk.FirstOrderValve(0.02))).mjcf("robot", 1e-3))
    read = read_mjcf(tmp_path / "leg.xml")
    assert not [text for text in read.left_out if "tendon" in text]  # lengths are compared with those of MuJoCo
    at = states(robot)
    for unit in robot.muscles:
        for ours, again in zip(
            along(robot, unit.elements)(at), along(read.robot, read.tendons[unit.names[0]])(at), strict=True
        ):
            np.testing.assert_allclose(ours, again, atol=1e-12)
    leg().to_yaml(tmp_path / "leg.yaml")
    assert RobotScenario.read(tmp_path / "leg.yaml").robot == robot


@pytest.mark.slow
def test_a_path_of_ones_own_is_not_exported_as_ours():
    class Ellipsoid(WrapSphere):
        pass

    robot = leg().robot
    front, back = robot.muscles
    first, ball, last = front.elements
    front = dataclasses.replace(front, through=(first, Ellipsoid(ball.body, ball.radius, ball.place), last))
    with pytest.raises(ExportError) as caught:
        assembled(RobotPlant(dataclasses.replace(robot, muscles=(front, back)), mk.FirstOrderValve(0.02)))
    assert caught.value.field == "through"


def test_an_arc_is_drawn_on_its_surface():
    robot = leg().robot
    drawn = outline(robot, [0.0, -0.2, 0.0]).muscles["back"]
    breaks = np.isnan(drawn).any(axis=1)
    assert breaks.sum() == 1
    centre, axis = np.array([0.0, 0.0, -0.4]), np.array([0.1, 1.0, 0.0]) / math.hypot(0.1, 1.0)
    away = drawn[3:] - centre
    distances = np.linalg.norm(away - np.outer(away @ axis, axis), axis=1)
    assert np.sum(np.isclose(distances, 0.03)) == 16 and np.nanmin(distances) > 0.03 - 1e-12


KNEE = """    - name: front
      muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
      connector_length: 208 mm
      through:
        - {body: thigh, place: [32 mm, 0 mm, 185 mm]}
        - {body: thigh, radius: 30 mm}
        - {body: shank, place: [32 mm, 0 mm, -185 mm]}
    - name: back
      muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
      connector_length: 208 mm
      through:
        - {body: thigh, place: [-32 mm, 0 mm, 185 mm]}
        - {body: thigh, radius: 30 mm, axis: [0, 1, 0]}
        - {body: shank, place: [-32 mm, 0 mm, -185 mm]}
"""


def knee():
    """A joint with two muscles, which its motion lays on a bone, under control."""
    text = re.sub(r"    - over: knee\n(      .*\n)+", KNEE, ONE)
    scenario = RobotScenario.parse(text + TORQUE)
    at = jnp.array([[-8 * deg], [0.0], [8 * deg]])
    front, back = (unit.elements for unit in scenario.robot.muscles)
    turns = [outline(scenario.robot, angles.tolist()).muscles for angles in at]
    assert [len(one["front"]) for one in turns] != [len(one["back"]) for one in turns] and front != back
    return scenario


@pytest.mark.slow
def test_it_moves_as_in_mujoco(tmp_path):
    plant = RobotPlant(knee().robot, mk.FirstOrderValve(0.02))
    start, commands = plant.init_state((0.0,), (3.5 * bar, 3.5 * bar)), (3.2 * bar, 3.9 * bar)
    plugin_files(mujoco_model(plant, "wrapped", 2.5e-4, plant.begin(start)), "a robot").save(tmp_path)
    model = load_mujoco(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = commands
    schedule = PressureSchedule(tuple((one,) for one in commands))
    run = simulate_robot(plant, schedule, start, duration=0.2, control_period=1e-3, substeps=4)
    found = []
    for _ in range(200):
        found.append(data.qpos[0])
        mujoco.mj_step(model, data, nstep=4)
    assert np.ptp(run["angle"][0]) > 4 * deg
    turned = run["angle"][0] < -1.2 * deg  # the path touches its surface within a step
    np.testing.assert_allclose(found, run["angle"][0], rtol=0, atol=1e-7)
    assert np.abs(found - run["angle"][0])[~turned].max() < 1e-9


@pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
@pytest.mark.slow
def test_its_controller_in_c_repeats_the_run(tmp_path):
    scenario = knee()
    assert scenario.run_once().metrics["angle_rmse"][0] < 0.5 * deg
    export(scenario, "c", tmp_path, name="robot")
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert float(done.stdout.split(",")[1].split()[0]) < 1e-11
