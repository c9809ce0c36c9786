"""Robots from MJCF and URDF, and all examples against MuJoCo: lengths, moment arms, mass matrix and accelerations."""

import dataclasses
import os
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import mckibben as mk
from mckibben.cli import app
from mckibben.component.schema import read_component
from mckibben.errors import ParameterError, ScenarioError
from mckibben.export.mjcf import assembled
from mckibben.mechanism.dynamics import acceleration, at_rest, posture_of
from mckibben.muscle import Muscle
from mckibben.robot import RobotPlant, RobotScenario, read_robot
from mckibben.scenario.reading import read_mjcf, read_tendon_muscles

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
        np.testing.assert_allclose(np.reshape(own, arms.shape), arms, atol=1e-9)
        np.testing.assert_allclose([float(u.path) for u in routed], data.ten_length + offsets, atol=1e-9)
        data.qvel[order], data.qfrc_applied[order] = rates, torques
        mujoco.mj_forward(model, data)
        posture = posture_of(robot, tuple(angles))
        velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, rates)))
        damped = torques - np.array([joint.damping for joint in robot.joints]) * rates
        found = np.array(acceleration(robot, posture, velocity, tuple(damped), (), 9.81).angles)
        np.testing.assert_allclose(found, data.qacc[order], rtol=1e-9, atol=1e-9 * np.abs(found).max())


@pytest.mark.slow
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
<tendon><spatial name="rope"><site site="s"/><geom geom="wrap" sidesite="s"/><site site="t"/></spatial>
<fixed name="belt"><joint joint="j" coef="1"/></fixed></tendon>
<equality><weld body1="a" body2="b"/></equality><actuator><muscle name="drive" tendon="rope"/></actuator></mujoco>"""


def test_what_is_not_carried_over_is_named_with_its_line(tmp_path):
    path = tmp_path / "bad.xml"
    path.write_text(BAD)
    read = read_mjcf(path)
    assert read.robot.base == "floating"
    lines = {"rope": 4, "belt": 5, "equality weld": 6, "actuator drive": 6}
    for part, line in lines.items():
        (found,) = (text for text in read.left_out if part in text)
        assert f"line {line}" in found
    assert sum("contact of 3 geoms" in text for text in read.left_out) == 1
    assert float(read.robot.joints[0].spring) == 2


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('<joint name="j" range="-10 10" stiffness="2"/>', '<joint name="j" type="slide" range="0 1"/>', "hinge"),
        ("<freejoint/>", '<joint type="slide" axis="1 1 0"/>', "joint0"),
        ("<mujoco>", "<mojoco>", "mujoco"),
        ("mujoco>", "mujocoinclude>", "name the file that includes it"),
    ],
)
def test_what_we_do_not_have_is_refused(tmp_path, old, new, word):
    path = tmp_path / "bad.xml"
    path.write_text(BAD.replace(old, new))
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(path)
    (problem,) = caught.value.problems
    assert word in str(problem).lower() and problem.remedy
    assert problem.line is not None or "mojoco" in new


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


def written(folder, body, rest="", options="", name="robot.xml"):
    """A file of MJCF with bodies in the world."""
    path = folder / name
    path.write_text(f"<mujoco>{options}\n<worldbody>\n{body}\n</worldbody>\n{rest}</mujoco>")
    return path


INERTIAL = '<inertial mass="1" pos="0.1 0.02 -0.3" fullinertia="0.02 0.03 0.025 0.001 0.002 -0.001"/>'
LINK = f'<body name="link" pos="0.1 0 1">{{}}{INERTIAL}</body>'


def test_meshes_and_textures_are_not_needed_where_inertias_are_given(tmp_path):
    assets = """<asset><texture name="t" type="2d" file="t.png"/><material name="m" texture="t"/>
<mesh name="shell" file="none.stl"/></asset>"""
    shape = '<joint name="j" range="-10 10"/><geom type="mesh" mesh="shell" material="m"/>'
    table = '<body name="table"><geom type="mesh" mesh="shell"/></body>'
    (joint,) = read_mjcf(written(tmp_path, LINK.format(shape) + table, options=assets)).robot.joints
    assert joint.name == "j"
    bare = f'<body name="bare">{shape}</body>'
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(written(tmp_path, "\n" + bare, options=assets))
    (problem,) = caught.value.problems
    assert "shell" in problem.message and problem.line == 5 and "inertial" in problem.remedy


MOVED = """<body name="box" pos="0 0 3"><freejoint name="f"/>{0}</body>
<body name="trunk" pos="0 0 2"><freejoint/>{0}
<body name="thigh"><joint name="hip" range="-30 30" axis="0 1 0"/>{0}</body></body>"""


def test_tables_and_objects_beside_a_robot_are_left_out_by_name(tmp_path):
    read = read_mjcf(written(tmp_path, MOVED.format(INERTIAL)))
    assert (read.robot.base, read.robot.joint_names, read.robot.bodies[0].name) == ("floating", ("hip",), "trunk")
    assert [part.split()[:2] for part in read.left_out] == [["body", "box"]]


def test_the_root_of_several_robots_is_asked_for(tmp_path):
    path = written(tmp_path, MOVED.format(INERTIAL) + LINK.format('<joint name="door" range="0 90"/>'))
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(path)
    (problem,) = caught.value.problems
    assert problem.line == 4 and "--root" in problem.remedy and "link" in problem.remedy
    for root, base, joints in (
        ("trunk", "floating", ("hip",)),
        ("link", "fixed", ("door",)),
        ("thigh", "fixed", ("hip",)),
    ):
        read = read_mjcf(path, root=root)
        assert (read.robot.base, read.robot.joint_names) == (base, joints)
        assert not [part for part in read.left_out if "different" in part]
    with pytest.raises(ParameterError) as unknown:
        read_mjcf(path, root="trnk")
    assert unknown.value.field == "root" and "trunk" in unknown.value.remedy


BALL = """<body name="arm" pos="0.1 0 1" euler="20 30 40"><joint name="shoulder" type="ball"/>{0}
<body name="fore" pos="0 0.1 -0.4"><joint name="elbow" axis="1 2 0"/>{0}</body></body>"""


def test_balls_become_three_hinges_and_hinges_without_a_range_get_one(tmp_path):
    read = read_mjcf(written(tmp_path, BALL.format(INERTIAL)), angles=(-2.0, 1.0))
    assert read.robot.joint_names == ("shoulder x", "shoulder y", "shoulder z", "elbow")
    assert not read.left_out
    assert (read.robot.joints[3].lower, read.robot.joints[3].upper) == (-2.0, 1.0)
    assert any("elbow" in part and "--range" in part for part in read.assumed)
    assert sum("shoulder" in part for part in read.assumed) >= 3
    damped = BALL.format(INERTIAL).replace('type="ball"', 'type="ball" damping="1" stiffness="2"')
    kinds = [part for part in read_mjcf(written(tmp_path, damped)).left_out if "shoulder" in part]
    assert ["springs" in part or "dampers" in part for part in kinds] == [True, True]


@pytest.mark.parametrize(
    ("options", "gravity"),
    [
        ('<option gravity="-9.81 0 0"/>', (-1.0, 0.0, 0.0)),
        ('<option gravity="1 2 -1.62"/>', (1 / 9.81, 2 / 9.81, -1.62 / 9.81)),
        ('<option><flag gravity="disable"/></option>', (0.0, 0.0, 0.0)),
    ],
)
def test_direction_and_size_of_gravity_are_carried(tmp_path, options, gravity):
    path = written(tmp_path, LINK.format('<joint name="j" range="-90 90" axis="0 1 0.5"/>'), options=options)
    read = read_mjcf(path)
    np.testing.assert_allclose(read.robot.gravity, gravity, rtol=1e-11)
    assert not read.left_out
    again = RobotScenario.parse(read.scenario().dumps()).robot
    assert again.gravity == read.robot.gravity
    exported = mujoco.MjModel.from_xml_string(assembled(RobotPlant(again, mk.FirstOrderValve(0.02))).mjcf("r", 1e-3))
    np.testing.assert_allclose(exported.opt.gravity, 9.81 * np.array(gravity), atol=1e-12)


def test_a_spring_of_a_joint_is_a_load_of_the_file_and_of_the_export(tmp_path):
    spring = '<joint name="j" range="-90 90" axis="0 1 0.5" stiffness="3" springref="20" damping="0.1"/>'
    read = read_mjcf(written(tmp_path, LINK.format(spring)))
    assert not read.left_out
    assert read.robot.joints[0].spring_angle == pytest.approx(np.deg2rad(20))
    check(read.robot, *model_of(read.robot))


@pytest.mark.parametrize(
    ("joint", "body", "options", "words"),
    [
        ('damping="0.1 0.5"', "", "", "dampers of j"),
        ('stiffness="1 2"', "", "", "springs of j"),
        ("", 'gravcomp="1"', "", "compensation of gravity of j"),
        ("", "", '<option density="1000" viscosity="1"/>', "fluid of j"),
        ('stiffness="3" damping="1"', "", '<option><flag spring="disable" damper="disable"/></option>', ""),
    ],
)
def test_forces_that_are_not_carried_are_found_by_comparison(tmp_path, joint, body, options, words):
    link = LINK.format(f'<joint name="j" range="-90 90" axis="0 1 0.5" {joint}/>')
    left_out = read_mjcf(written(tmp_path, link.replace("<body", f"<body {body}"), options=options)).left_out
    assert [words in part for part in left_out] == ([True] if words else [])


CHAIN = 16


@pytest.fixture
def chain(tmp_path):
    """Tendons over many hinges."""
    body = '<site name="a" pos="0.02 0 0.05"/>' + "".join(
        f'<body name="b{i}" pos="0 0 -0.05"><joint name="j{i}" axis="0 1 0" range="-10 10"/>{INERTIAL}'
        f'<site name="s{i}" pos="{0.02 * (-1) ** i} 0 -0.02"/>'
        for i in range(CHAIN)
    )
    sites = '<site site="a"/>' + "".join(f'<site site="s{i}"/>' for i in range(CHAIN))
    tendons = f"""<tendon>
<spatial name="long">{sites}</spatial>
<spatial name="biceps"><site site="a"/><site site="s0"/></spatial>
<spatial name="spring" stiffness="500" springlength="0 0.05"><site site="a"/><site site="s0"/></spatial></tendon>"""
    return written(tmp_path, body + "</body>" * CHAIN, tendons)


@pytest.mark.slow
def test_a_tendon_over_many_hinges_has_the_range_of_their_corners(chain):
    read = read_mjcf(chain)
    shortest, longest = read.paths["long"]
    sampled = []
    for _ in range(200):
        angles = np.random.default_rng(len(sampled)).uniform(-1, 1, CHAIN) * np.deg2rad(10)
        sampled.append(float(read.robot.path_along(read.tendons["long"], tuple(np.sign(angles) * np.deg2rad(10)))[0]))
    assert shortest <= min(sampled) + 1e-9 < max(sampled) - 1e-9 <= longest


def test_muscles_by_tendon_and_springs_that_stay(chain, tmp_path):
    muscle = (Path.cwd() / MUSCLE).read_text()
    short = muscle.replace("300 mm", "90 mm")
    (tmp_path / "short.yaml").write_text(short)
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(chain, {"bi*": read_component(Muscle, tmp_path / "short.yaml")})
    (problem,) = caught.value.problems
    assert "long" in problem.message and problem.line and "muscles" in problem.remedy
    with pytest.raises(ScenarioError) as long:
        read_mjcf(chain, {"*": arm().robot.all_muscles[0]})
    assert any("biceps" in str(one) and "initial_length" in one.remedy for one in long.value.problems)


def test_a_muscle_that_shortens_less_than_its_path_has_the_line_of_the_tendon():
    muscle = read_component(Muscle, MUSCLE)
    domain = dataclasses.replace(muscle.specimen.domain, contraction_max=0.01)
    short = dataclasses.replace(muscle, specimen=dataclasses.replace(muscle.specimen, domain=domain))
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(ARM, short)
    (problem,) = caught.value.problems
    assert problem.upper == 0.01
    name = problem.message.split(":")[0]
    assert f'<spatial name="{name}"' in ARM.read_text().splitlines()[problem.line - 1]


def test_a_file_of_muscles_by_pattern(tmp_path):
    section = (Path.cwd() / MUSCLE).read_text().split("\n", 1)[1].replace("\n", "\n    ")
    (tmp_path / "map.yaml").write_text(f"muscles:\n  '*iceps':\n    {section}\n  '*':\n    {section}\n")
    read = read_mjcf(ARM, read_tendon_muscles(tmp_path / "map.yaml"))
    assert read.robot == arm().robot
    assert isinstance(read_tendon_muscles(MUSCLE), Muscle)


def test_a_passive_tendon_is_a_spring(tmp_path):
    body = '<site name="a" pos="0.05 0 1.2"/>' + LINK.format(
        '<joint name="j" range="-20 20" axis="0 1 0"/><site name="b" pos="0.05 0 -0.2"/>'
    )
    spring = '<tendon><spatial name="spring" {}><site site="a"/><site site="b"/></spatial></tendon>'
    pulls = read_mjcf(written(tmp_path, body, spring.format('stiffness="500" springlength="0 0.3"')))
    assert pulls.robot.muscle_names == ("spring",) and not pulls.left_out
    assert RobotScenario.parse(pulls.scenario().dumps()).robot == pulls.robot
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(written(tmp_path, body, spring.format('stiffness="1e10"')))
    assert [(problem.line, problem.value) for problem in caught.value.problems] == [(5, 1e10)]
    pushes = read_mjcf(written(tmp_path, body, spring.format('stiffness="500" springlength="0.9"')))
    assert ["springs of j" in part for part in pushes.left_out] == [True]


def test_an_inertia_of_no_body_becomes_the_nearest_and_is_named(tmp_path):
    link = LINK.format('<joint name="j" range="-20 20"/>').replace(
        'fullinertia="0.02 0.03 0.025 0.001 0.002 -0.001"', 'diaginertia="0.01 0.01 0.03"'
    )
    read = read_mjcf(written(tmp_path, link))
    (part,) = (part for part in read.assumed if "inertia" in part)
    assert "link" in part and "line 3" in part
    xx, _, _, yy, _, zz = map(float, read.robot.bodies[1].tensor)
    assert xx == yy and zz <= xx + yy and zz == pytest.approx(0.0267, abs=0.004)


def test_slides_are_refused_together_and_held_if_asked(tmp_path):
    finger = f'<body name="f{{0}}"><joint name="s{{0}}" type="slide" axis="0 1 0"/>{INERTIAL}</body>'
    link = LINK.format('<joint name="j" range="-20 20"/>' + "\n".join(finger.format(i) for i in range(2)))
    rest = '<equality><joint joint1="s0" joint2="s1"/></equality><actuator><motor name="m" joint="s0"/></actuator>'
    path = written(tmp_path, link, rest)
    with pytest.raises(ScenarioError) as caught:
        read_mjcf(path)
    assert [problem.line for problem in caught.value.problems] == [3, 4]
    assert all("--hold-slides" in problem.remedy for problem in caught.value.problems)
    read = read_mjcf(path, hold_slides=True)
    assert float(read.robot.bodies[1].mass) == pytest.approx(3)
    assert {part.split()[0] for part in read.left_out} == {"held", "equality", "actuator"}


def test_the_command_reads_with_root_range_and_slides_held(tmp_path):
    link = LINK.format('<joint name="j"/>' + f'<body name="f"><joint type="slide"/>{INERTIAL}</body>')
    path = written(tmp_path, MOVED.format(INERTIAL) + link)
    arguments = ["robot", "read", str(path), "--root", "link", "--range", "-20..30 deg", "--hold-slides"]
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    (joint,) = RobotScenario.read(tmp_path / "out" / "robot.yaml").robot.joints
    assert np.rad2deg([joint.lower, joint.upper]) == pytest.approx([-20, 30])
