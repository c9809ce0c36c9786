"""Robots from MJCF and URDF, and all examples against MuJoCo: lengths, moment arms, mass matrix and accelerations."""

import dataclasses
import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.component.schema import read_component
from mckibben.errors import ParameterError, ScenarioError
from mckibben.export.mjcf import assembled
from mckibben.mechanism.dynamics import acceleration, at_rest, posture_of
from mckibben.muscle import Muscle
from mckibben.robot import RobotPlant, RobotScenario, read_robot
from mckibben.scenario.reading import read_mjcf

mujoco = pytest.importorskip("mujoco")
FOLDER = Path("examples/robot")
ARM, MUSCLE = FOLDER / "arm.xml", FOLDER / "arm-muscle.yaml"


def arm():
    return read_mjcf(ARM, read_component(Muscle, MUSCLE))


def model_of(robot):
    """The robot in MuJoCo by our export, and what each path is longer than its tendon."""
    plant = RobotPlant(robot, mk.FirstOrderValve(0.02))
    made = assembled(plant)
    model = mujoco.MjModel.from_xml_string(made.mjcf("robot", 1e-3))
    return model, [float(drive.path(plant, jnp.zeros(()))) for drive in made.drives]


def check(robot, model, offsets):
    """Compare a robot with a fixed base in random postures and motions within its ranges."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    model.opt.disableflags = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    order = [int(model.joint(joint.name).qposadr[0]) for joint in robot.joints]
    for _ in range(3):
        angles = rng.uniform([joint.lower for joint in robot.joints], [joint.upper for joint in robot.joints])
        rates, torques = rng.normal(size=(2, angles.size))
        routed = robot.routed_muscles(tuple(angles))
        arms = np.zeros((len(routed), angles.size))
        for k in range(angles.size):
            data.qpos[order], data.qvel[:] = angles, 0.0
            data.qvel[order[k]] = 1.0
            mujoco.mj_forward(model, data)
            arms[:, k] = data.ten_velocity
        own = [[float(unit.slopes.get(k, 0.0)) for k in range(angles.size)] for unit in routed]
        np.testing.assert_allclose(own, arms, atol=1e-9)
        np.testing.assert_allclose([float(u.path) for u in routed], data.ten_length + offsets, atol=1e-9)
        data.qvel[order], data.qfrc_applied[order] = rates, torques
        mujoco.mj_forward(model, data)
        posture = posture_of(robot, tuple(angles))
        velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, rates)))
        damped = torques - np.array([joint.damping for joint in robot.joints]) * rates
        found = np.array(acceleration(robot, posture, velocity, tuple(damped), (), 9.81).angles)
        np.testing.assert_allclose(found, data.qacc[order], rtol=1e-9, atol=1e-9 * np.abs(found).max())


@pytest.mark.parametrize("name", ["arm", "neck", "platform", "umarm", "lei-leg"])
def test_each_example_is_that_of_mujoco(name):
    if name == "arm":
        robot = arm().robot
    elif name == "lei-leg":
        robot = RobotScenario.parse("name: x\nrobot: {from: lei-leg, base: fixed}\n").robot
    else:
        robot = RobotScenario.read(FOLDER / f"{name}.yaml").robot
    assert len(robot.all_muscles) == {"arm": 8, "neck": 3, "platform": 6, "umarm": 24, "lei-leg": 6}[name]
    check(robot, *model_of(robot))


def test_an_arm_is_read_as_mujoco_reads_it(tmp_path):
    read = arm()
    assert not read.left_out
    model = mujoco.MjModel.from_xml_path(str(ARM))
    check(read.robot, model, [-float(unit.connector_length) for unit in read.robot.muscles])
    names = [set(unit.slopes) for unit in read.robot.routed_muscles((0.1,) * 4)]
    assert names[4] == names[5] == {0, 1, 2}  # biceps and triceps
    read.save(tmp_path)
    assert RobotScenario.read(tmp_path / "robot.yaml").robot == read.robot


@pytest.mark.parametrize("base", ["vertical", "free", "spatial"])
def test_what_we_write_reads_back(base, tmp_path):
    leg = dataclasses.replace(read_robot("lei-leg-planar" if base == "free" else "lei-leg"), base=base)
    (tmp_path / "leg.xml").write_text(assembled(RobotPlant(leg, mk.FirstOrderValve(0.02))).mjcf("robot", 1e-3))
    read = read_mjcf(tmp_path / "leg.xml").robot
    assert (read.base, read.is_planar, read.foot.radius) == (base, leg.is_planar, 0.02)
    for angles in ((0.1, 0.05, -0.3), (-0.1, -0.05, 0.2)):
        angles = angles[-len(leg.joints) :]
        posture, again = posture_of(leg, angles), posture_of(read, angles)
        torques = (1.0, 2.0, 3.0)[: len(angles)]
        moved = acceleration(leg, posture, at_rest(posture), torques, (), 9.81)
        found = acceleration(read, again, at_rest(again), torques, (), 9.81)
        np.testing.assert_allclose(found.angles, moved.angles, rtol=1e-9)


BAD = """<mujoco><worldbody><body name="a"><freejoint/><geom size="0.1"/>
<body name="b"><joint name="j" range="-10 10" stiffness="2"/><geom size="0.1"/><site name="s"/>
<geom name="wrap" type="sphere" size="0.1"/></body><site name="t"/></body></worldbody>
<tendon><spatial name="rope"><site site="s"/><geom geom="wrap"/><site site="t"/></spatial>
<fixed name="belt"><joint joint="j" coef="1"/></fixed></tendon>
<equality><weld body1="a" body2="b"/></equality><actuator><muscle name="drive" tendon="rope"/></actuator></mujoco>"""


def test_what_is_not_carried_over_is_named_with_its_line(tmp_path):
    path = tmp_path / "bad.xml"
    path.write_text(BAD)
    read = read_mjcf(path)
    assert read.robot.base == "floating"
    lines = {"stiffness of joint j": 2, "rope": 4, "belt": 5, "equality weld": 6, "actuator drive": 6}
    for part, line in (lines | {"contact of 3 geoms": 1}).items():
        (found,) = (text for text in read.left_out if part in text)
        assert f"line {line}" in found


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('<joint name="j" range="-10 10" stiffness="2"/>', '<joint name="j"/>', "range"),
        ('<joint name="j" range="-10 10" stiffness="2"/>', '<joint name="j" type="slide" range="0 1"/>', "hinge"),
        ("<freejoint/>", '<joint type="ball"/>', "joint0"),
        ("<mujoco>", "<mojoco>", "mujoco"),
    ],
)
def test_what_we_do_not_have_is_refused(tmp_path, old, new, word):
    path = tmp_path / "bad.xml"
    path.write_text(BAD.replace(old, new))
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(path)
    (problem,) = caught.value.problems
    assert word in str(problem).lower() and problem.remedy


def test_urdf_is_read_and_the_muscles_of_tendons_are_asked_for(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text("""<robot name="two"><link name="base"/><link name="link"><inertial><origin xyz="0 0 0.1"/>
<mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="link"/><origin xyz="0.1 0 0.2"/>
<axis xyz="0 1 0"/><limit lower="-0.5" upper="0.6" effort="1" velocity="1"/></joint></robot>""")
    (joint,) = read_mjcf(path).robot.joints
    assert (joint.axis, joint.lower, joint.upper) == ((0.0, 1.0, 0.0), -0.5, 0.6)
    assert (joint.place.x, joint.place.z) == (0.1, 0.2)
    with pytest.raises(ParameterError) as caught:
        read_mjcf(ARM).scenario()
    assert caught.value.field == "muscle"


OUTSIDE = """<mujoco><worldbody><body name="b"><joint name="hinge" range="-10 10"/><geom size="0.1" mass="1"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    "named",
    [
        '<include file="{}/other.xml"/>',
        "<include\n file = '{}/other.xml' />",
        '<include file="../other.xml"/>',
        '<include file="inner.xml"/>',
        '<asset><mesh name="m" file="{}/m.stl"/></asset>',
        '<asset><texture name="t" type="cube" fileright="../t.png"/></asset>',
        '<compiler meshdir="{}"/><asset><mesh name="m" file="m.stl"/></asset>',
        '<compiler assetdir="link"/><asset><mesh name="m" file="m.stl"/></asset>',
        '<a name="<!--"/><include file="../other.xml"/><a name="-->"/>',
    ],
)
def test_a_confined_file_names_none_of_another_folder(tmp_path, named):
    mine = tmp_path / "mine"
    mine.mkdir()
    (tmp_path / "other.xml").write_text(OUTSIDE)
    (mine / "inner.xml").write_text('<mujoco>\n<include file="../other.xml"/></mujoco>')
    (mine / "link").symlink_to(tmp_path)
    (mine / "robot.xml").write_text("<mujoco>\n" + named.format(tmp_path) + "</mujoco>")
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(mine / "robot.xml", confined=True)
    problem = caught.value.problems[0]
    assert "another folder" in problem.message and problem.line in (2, 3) and "command line" in problem.remedy


def test_a_confined_file_may_name_those_beside_it_which_are_confined_as_well(tmp_path):
    (tmp_path / "other.xml").write_text(OUTSIDE)
    (tmp_path / "robot.xml").write_text('<mujoco><include file="other.xml"/></mujoco>')
    assert read_mjcf(tmp_path / "robot.xml", confined=True).robot.joints[0].name == "hinge"
    (tmp_path / "other.xml").write_text(OUTSIDE + " " * 300_000)
    with pytest.raises(ScenarioError, match=r"other\.xml is longer"):
        read_mjcf(tmp_path / "robot.xml", confined=True)
    assert read_mjcf(tmp_path / "robot.xml").robot.joints[0].name == "hinge"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
@pytest.mark.parametrize("confined", [True, False])
@pytest.mark.parametrize("element", ['<include file="{}"/>', '<asset><mesh name="m" file="{}"/></asset>'])
def test_a_named_pipe_is_refused_without_waiting(tmp_path, confined, element):
    os.mkfifo(tmp_path / "pipe.xml")
    (tmp_path / "robot.xml").write_text(f"<mujoco>{element.format('pipe.xml')}</mujoco>")
    with pytest.raises(ScenarioError, match="pipe"):
        read_mjcf(tmp_path / "robot.xml", confined=confined)
