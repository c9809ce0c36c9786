"""Pressures for a stiffness of the foot: against brute force, springs in closed form, and pushes in MuJoCo."""

import dataclasses
import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mckibben as mk
from mckibben.cli import app
from mckibben.component.schema import read_component
from mckibben.errors import RangeError, ScenarioError, UnreachableError
from mckibben.mechanism.point_stiffness import point_jacobian
from mckibben.muscle import Muscle
from mckibben.robot import (
    BodyPoint,
    Place,
    RobotPlant,
    RobotScenario,
    attainable_point_stiffness,
    attainable_statics,
    holding_torques,
    point_stiffness,
    pressures_for_joint_stiffness,
    pressures_for_point_stiffness,
    read_mjcf,
    read_robot,
    stiffness_matrix,
)
from mckibben.scenario.statics import solve_statics
from mckibben.statics.posture import HeldPostures, maps_at
from mckibben.units import bar, deg
from tests.robot.conftest import over_two, with_unit

POSTURES = {"lei-leg-planar": (0.02, -0.3), "lei-leg": (0.05, 0.02, -0.3)}


def with_rectus(name):
    """A robot with a muscle over hip and knee."""
    robot = read_robot(name)
    paths = mk.joint.Pulley(0.03, 0.08), mk.joint.Pulley(0.02, 0.08)
    rectus = over_two(robot.all_muscles[0], paths, ("hip", "knee"), ("shortens",) * 2, "rectus")
    return dataclasses.replace(robot, muscles=(*robot.muscles, rectus))


def map_at(robot, angles):
    return maps_at(robot, np.asarray(angles)[None])[0].posture(0)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(POSTURES))
def test_the_affine_map_is_the_derivative_of_the_torques(name):
    robot, angles = with_rectus(name), np.array(POSTURES[name])
    pressures = np.linspace(3.5e5, 4.5e5, len(robot.all_muscles))
    found = map_at(robot, angles)
    np.testing.assert_allclose(found.torque_at(pressures), robot.torques(angles, pressures), atol=1e-12)
    for joint in range(len(angles)):
        step = 1e-6 * np.eye(len(angles))[joint]
        change = np.subtract(robot.torques(angles + step, pressures), robot.torques(angles - step, pressures)) / 2e-6
        np.testing.assert_allclose(found.stiffness_at(pressures)[:, joint], -change, atol=1e-6)
    assert abs(found.stiffness_at(pressures)[-1, -2]) > 1  # coupling


@pytest.mark.slow
@pytest.mark.parametrize("name", ["lei-leg", "examples/robot/neck.yaml"])
def test_many_postures_are_those_one_by_one_and_the_closed_form_is_the_linear_program(name):
    robot, rng = read_robot(name), np.random.default_rng(0)
    angles = rng.uniform(-0.03, 0.03, (4, len(robot.joints)))
    torques = holding_torques(robot, angles)
    postures, forms = HeldPostures.of(robot, angles, torques), 0
    for index, row in enumerate(angles):
        np.testing.assert_allclose(torques[index], holding_torques(robot, row), rtol=1e-12)
        held = postures.posture(index)
        middle = (held.low + held.high) / 2 * bar
        np.testing.assert_allclose(held.affine.torque_at(middle), robot.torques(row, middle), rtol=1e-12)
        slopes = held.stiffness()[1]
        for joint, other in itertools.product(range(len(row)), (False, True)):
            rest = np.arange(len(row)) != joint
            turned = held._replace(equal=held.equal[rest], held=held.held[rest])
            setting, goal = (turned, held.equal[joint]) if other else (held, slopes[joint, joint])
            value, multipliers = setting._free_extreme(goal)
            if value is not None:
                forms += 1
                solved = setting.program(goal)
                assert value == pytest.approx(solved.fun, abs=1e-9)
                theirs = -(solved.lower.marginals + solved.upper.marginals)
                assert setting.limits(multipliers)[0] == setting.limits(theirs)[0]
    assert forms >= 4 * len(robot.joints)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(POSTURES))
@pytest.mark.parametrize("force", [None, (4.0, 20.0)])
def test_an_attainable_stiffness_is_exact(name, force):
    robot, angles = with_rectus(name), POSTURES[name]
    if force is not None and not robot.is_planar:
        force = (force[0], 1.0, force[1])
    pressures = np.full(len(robot.all_muscles), 4.0e5)
    pressures[::2] += 0.3e5
    affine = map_at(robot, angles)
    torques = affine.torque_at(pressures)
    target = point_stiffness(robot, angles, affine.stiffness_at(pressures), force=force)
    wanted = np.linalg.inv(target.compliance)
    found = pressures_for_point_stiffness(robot, angles, wanted, force=force, torques=torques)
    assert found.exact and not found.limits and found.least <= found.error
    np.testing.assert_allclose(found.stiffness.compliance, target.compliance, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(robot.torques(angles, found.pressures), torques, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("principal", "direction"),
    [((25.0, 800.0), -0.15), ((200.0, 300.0), 1.0), ((15.0, 3000.0), 0.3), ((60.0, 70.0), 0.0)],
)
def test_no_point_of_a_grid_is_nearer(principal, direction):
    """The two pairs at rest, over all their co-contractions, by the forward map alone."""
    robot, angles = read_robot("lei-leg-planar"), (0.0, -0.3)
    wanted = stiffness_matrix(principal, direction)
    found = pressures_for_point_stiffness(robot, angles, wanted, minimum_tension=0.0)
    values, vectors = np.linalg.eigh(wanted)
    root = vectors @ np.diag(values**-0.5) @ vectors.T

    def error(stiffness):
        own = np.linalg.inv(point_stiffness(robot, angles, stiffness).compliance)
        return float(np.linalg.norm(root @ own @ root - np.eye(2)))

    ranges = [np.linspace(*robot.pair(index).attainable_stiffness(at, 0.0), 13) for index, at in enumerate(angles)]
    best = min(error(one) for one in itertools.product(*ranges))
    assert found.least <= found.error <= best * (1 + 1e-6)
    assert found.error == pytest.approx(best, rel=0.01)
    assert found.least == pytest.approx(found.error, rel=1e-6)
    assert found.error == pytest.approx(error(tuple(np.diag(found.joint_stiffness))), rel=1e-9)


@pytest.mark.slow
def test_random_pressures_are_no_nearer_with_a_biarticular_muscle_in_space():
    robot, angles = with_rectus("lei-leg"), POSTURES["lei-leg"]
    wanted = stiffness_matrix((60.0, 400.0), -0.6, sideways=30.0)
    found = pressures_for_point_stiffness(robot, angles, wanted)
    affine = map_at(robot, angles)
    null = np.linalg.svd(affine.torque[1])[2][len(angles) :]
    rng = np.random.default_rng(1)
    tried = np.array(found.pressures) + rng.normal(0, 1e5, (4000, len(null))) @ null  # the same torques
    tensions = affine.tension[0] + affine.tension[1] * tried
    inside = ((tensions >= 1) & (tried >= 0) & (tried <= 6e5)).all(axis=1)
    values, vectors = np.linalg.eigh(wanted)
    root = vectors @ np.diag(values**-0.5) @ vectors.T
    compliances = [point_stiffness(robot, angles, affine.stiffness_at(one)).compliance for one in tried[inside]]
    errors = [np.linalg.norm(root @ np.linalg.inv(one) @ root - np.eye(3)) for one in compliances]
    assert len(errors) > 10
    assert min(errors) >= found.least - 1e-9
    assert found.error - found.least < 1e-6
    assert found.limits


@pytest.mark.parametrize("name", list(POSTURES))
def test_the_attainable_set_holds_what_random_pressures_attain(name):
    """With a biarticular muscle, in random directions of the joints' stiffness; torques are those of the pressures."""
    robot, angles = with_rectus(name), POSTURES[name]
    affine, rng = map_at(robot, angles), np.random.default_rng(2)
    middle = np.full(len(robot.all_muscles), 3.5e5)
    torques = affine.torque_at(middle)
    null = np.linalg.svd(affine.torque[1])[2][len(angles) :]
    tried = middle + rng.normal(0, 1e5, (20_000, len(null))) @ null
    tensions = affine.tension[0] + affine.tension[1] * tried
    highest = [float(one.domain.pressure_max) for one in robot.all_muscles]
    strongest = [float(one.specimen.force_limit) for one in robot.all_muscles]
    inside = tried[((tensions >= 1) & (tensions <= strongest) & (tried >= 0) & (tried <= highest)).all(axis=1)]
    assert len(inside) > 100
    moved, _ = point_jacobian(robot, angles)

    def joints(foot):
        return moved.T @ np.linalg.inv(foot) @ moved

    levels = 9 if robot.is_planar else 5
    found = np.array(
        [joints(one.compliance) for one in attainable_point_stiffness(robot, angles, torques, levels=levels)]
    )
    random = np.array([affine.stiffness_at(one) for one in inside])
    assert np.ptp(found[:, -1, -2]) > 1  # the coupling varies
    for direction in rng.normal(size=(20, *found.shape[1:])):
        ours, theirs = (np.einsum("nij,ij->n", one, direction) for one in (found, random))
        slack = 0.02 * np.ptp(ours)
        assert ours.min() - slack <= theirs.min() and theirs.max() <= ours.max() + slack


def test_a_limit_that_is_relaxed_reduces_the_error():
    """The supply limits the stiffness of stiff joints: with more of it the error falls."""
    robot, angles = with_rectus("lei-leg-planar"), POSTURES["lei-leg-planar"]
    wanted = 1.5 * np.linalg.inv(point_stiffness(robot, angles, (18.0, 17.0)).compliance)
    low, high = (pressures_for_point_stiffness(robot, angles, wanted, supply=one) for one in (4.5 * bar, 5.5 * bar))
    assert low.limits
    limiting = dict(low.limits)
    assert set(limiting.values()) <= {"lowest pressure", "highest pressure", "slack", "rated force"}
    assert high.error <= low.error
    for name, limit in limiting.items():
        place = robot.muscle_names.index(name)
        if limit == "highest pressure":
            assert low.pressures[place] == pytest.approx(4.5 * bar)
        if limit == "slack":
            assert low.tensions[place] == pytest.approx(1.0)


def test_what_is_not_possible_is_refused():
    robot, angles = read_robot("lei-leg-planar"), POSTURES["lei-leg-planar"]
    wanted = stiffness_matrix((30.0, 800.0), -0.2)
    locked = dataclasses.replace(robot, joints=(robot.joints[0], dataclasses.replace(robot.joints[1], locked=-0.3)))
    spring = mk.SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    for call, kind, field in (
        (lambda: pressures_for_point_stiffness(robot, angles, -wanted), RangeError, "wanted"),
        (lambda: pressures_for_point_stiffness(robot, angles, np.eye(3)), RangeError, "wanted"),
        (lambda: pressures_for_point_stiffness(robot, (0.0, 30 * deg), wanted), RangeError, "angles"),
        (lambda: pressures_for_point_stiffness(robot, (0.0, -1.0), wanted), RangeError, "angles.knee"),
        (lambda: pressures_for_point_stiffness(locked, angles, wanted), RangeError, "angles"),
        (
            lambda: pressures_for_point_stiffness(with_unit(robot, 0, tendon=spring), angles, wanted),
            RangeError,
            "muscle",
        ),
        (lambda: pressures_for_point_stiffness(robot, angles, wanted, force=(1.0, 2.0, 3.0)), RangeError, "force"),
        (lambda: pressures_for_point_stiffness(robot, angles, wanted, force=(0.0, 500.0)), UnreachableError, ""),
    ):
        with pytest.raises(kind) as caught:
            call()
        assert caught.value.field == field or not field
        assert caught.value.remedy


@pytest.mark.slow
def test_a_slack_return_spring_cannot_hold_a_torque():
    robot, angles = read_robot("lei-leg-planar"), (0.0, -0.3)
    path = float(robot.routed_muscles(angles)[3].path)
    for longer, kind in ((-0.02, None), (0.005, UnreachableError)):
        spring = mk.muscle.return_spring(5000.0, path + longer)
        one = with_unit(robot, 1, muscle2=spring)
        if kind is None:
            assert pressures_for_point_stiffness(one, angles, stiffness_matrix((20.0, 900.0), -0.15)).tensions[3] > 0
            continue
        with pytest.raises(kind) as caught:
            pressures_for_point_stiffness(one, angles, stiffness_matrix((20.0, 900.0), -0.15))
        assert caught.value.value < caught.value.lower and caught.value.remedy


def test_the_direction_is_that_in_the_plane_where_the_foot_is_softest_to_the_side():
    space = point_stiffness(read_robot("lei-leg"), (0.0, 0.0, 0.0), (15.0, 20.0, 15.0))
    plane = point_stiffness(read_robot("lei-leg-planar"), (0.0, 0.0), (20.0, 15.0))
    assert space.direction == pytest.approx(plane.direction, abs=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="the plugin needs a C compiler")
@pytest.mark.parametrize("name", list(POSTURES))
def test_a_pushed_foot_in_mujoco_yields_as_computed(name, tmp_path):
    import mujoco

    from mckibben.export.mjcf import mujoco_model
    from mckibben.export.mujoco import load_mujoco
    from mckibben.export.muscle_plugin import plugin_files

    robot, angles = with_rectus(name), POSTURES[name]
    wanted = stiffness_matrix((30.0, 700.0), -0.25, None if robot.is_planar else 30.0)
    found = pressures_for_point_stiffness(robot, angles, wanted)
    joints = tuple(dataclasses.replace(one, damping=2.0) for one in robot.joints)
    plant = RobotPlant(dataclasses.replace(robot, base="fixed", joints=joints), mk.FirstOrderValve(0.02), gravity=0.0)
    start = plant.init_state(angles, found.pressures, clearance=0.5)
    plugin_files(mujoco_model(plant, name.replace("-", "_"), start=start), name).save(tmp_path)
    model = load_mujoco(tmp_path)
    rows = [0, 2] if robot.is_planar else [0, 1, 2]

    def place(push):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[:] = found.pressures
        body = model.geom("foot").bodyid[0]
        for _ in range(40):
            mujoco.mj_forward(model, data)
            moment = np.cross(data.geom("foot").xpos - data.xipos[body], push)
            data.xfrc_applied[body] = [*push, *moment]
            mujoco.mj_step(model, data, nstep=200)
        assert np.abs(data.qvel).max() < 1e-4
        return data.geom("foot").xpos[rows].copy()

    for direction in np.eye(3)[rows]:
        size = 0.02
        moved = (place(size * direction) - place(-size * direction)) / (2 * size)
        expected = found.stiffness.compliance @ direction[rows]
        np.testing.assert_allclose(moved, expected, atol=0.01 * np.abs(expected).max())


TEXT = """name: x
robot: lei-leg-planar
stiffness:
  posture: {knee: -17 deg}
  principal: [25 N/m, 800 N/m]
  direction: -9 deg
"""


@pytest.mark.slow
def test_the_command_prints_and_keeps_the_pressures(tmp_path):
    file, out = tmp_path / "robot.yaml", tmp_path / "out"
    file.write_text(TEXT)
    result = CliRunner().invoke(app, ["robot", "pressures", str(file), "--json", "--out", str(out)])
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    found = pressures_for_point_stiffness(
        read_robot("lei-leg-planar"), (0.0, -17 * deg), stiffness_matrix((25, 800), -9 * deg)
    )
    assert numbers["scalars"]["error"]["value"] == pytest.approx(found.error)
    columns = {name: entry["values"] for name, entry in numbers["columns"].items()}
    assert columns["pressures"] == pytest.approx(found.pressures)
    assert dict(zip(columns["muscles"], columns["limited_by"], strict=True)) == {
        name: dict(found.limits).get(name, "") for name in found.muscles
    }
    np.testing.assert_allclose(columns["attained"], np.linalg.inv(found.stiffness.compliance), rtol=1e-9)
    np.testing.assert_allclose(columns["wanted"], found.wanted, rtol=1e-9)
    assert numbers["tables"][0]["columns"]["joint"]["values"] == ["hip", "knee"]
    assert json.loads((out / "results.json").read_text()) == numbers
    assert (out / "point_stiffness.svg").stat().st_size > 1000
    shown = CliRunner().invoke(app, ["robot", "pressures", str(file)])
    assert shown.exit_code == 0 and "knee2" in shown.output


@pytest.mark.parametrize(
    ("before", "after", "line"),
    [
        ("knee: -17", "ankle: -17", 4),
        ("knee: -17", "knee: -77", 4),
        ("25 N/m,", "-25 N/m,", 5),
        ("direction: -9 deg", "sideways: 30 N/m", 3),
        ("direction: -9 deg", "force: [1 N, 2 N, 3 N]", 6),
        ("direction: -9 deg", "point: {body: thigh, place: [0 mm, 0 mm, -100 mm]}", 3),  # singular
    ],
)
def test_mistakes_in_a_file_have_lines(before, after, line):
    with pytest.raises(ScenarioError) as caught:
        RobotScenario.parse(TEXT.replace(before, after))
    assert caught.value.problems[0].line in (line, 3) and caught.value.problems[0].remedy


def neck_along_its_line(count=4001):
    """A neck of two joints and three muscles, and all pressures of taut muscles that hold its head, on one line."""
    robot, angles = RobotScenario.read("examples/robot/neck.yaml").robot, (0.05, -0.03)
    torques = holding_torques(robot, angles)
    affine = map_at(robot, angles)
    null = np.linalg.svd(affine.torque[1])[2][-1]
    base = np.linalg.lstsq(affine.torque[1], torques - affine.torque[0], rcond=None)[0]
    tried = base + np.linspace(-3e6, 3e6, count)[:, None] * null
    tensions = affine.tension[0] + affine.tension[1] * tried
    inside = tried[((tensions >= 1) & (tensions <= 630) & (tried >= 0) & (tried <= 6e5)).all(axis=1)]
    return robot, angles, torques, inside, np.array([affine.stiffness_at(one).diagonal() for one in inside])


def test_what_a_neck_attains_is_what_its_line_of_pressures_has():
    robot, angles, torques, inside, stiffness = neck_along_its_line()
    assert len(inside) > 100
    found = attainable_statics(robot, angles, torques=torques, supply=6e5)
    for column, row in zip(stiffness.T, found.values(), strict=True):
        np.testing.assert_allclose(row.stiffness, (column.min(), column.max()), rtol=2e-3)
        assert row.torque[0] < 0 < row.torque[1] and all(row.limits)
    np.testing.assert_allclose(robot.torques(angles, inside[0]), torques, atol=1e-6)


@pytest.mark.parametrize("wanted", [(8.0, 8.0), (None, 9.0), (20.0, 3.0)])
def test_no_pressures_of_a_neck_are_nearer_to_a_stiffness_of_its_joints(wanted):
    robot, angles, torques, _, stiffness = neck_along_its_line()
    columns = [i for i, number in enumerate(wanted) if number is not None]
    errors = np.linalg.norm([stiffness[:, i] / wanted[i] - 1 for i in columns], axis=0)
    found = pressures_for_joint_stiffness(robot, angles, wanted, torques=torques, supply=6e5)
    assert found.least <= found.error <= errors.min() * (1 + 1e-9) + 1e-9
    assert found.error == pytest.approx(errors.min(), rel=0.01, abs=2e-3)
    assert found.least == pytest.approx(found.error, rel=1e-5, abs=1e-6)
    np.testing.assert_allclose(robot.torques(angles, found.pressures), torques, atol=1e-6)


@pytest.mark.slow
def test_a_hand_that_more_joints_move_than_it_has_directions_gets_its_stiffness():
    """The wanted stiffness is that of some pressures; a push on the arm at those that are found yields as wanted."""
    from scipy.optimize import fsolve

    muscle = read_component(Muscle, Path("examples/robot/arm-muscle.yaml"))
    robot, angles = read_mjcf(Path("examples/robot/arm.xml"), muscle).robot, np.array([0.1, -0.1, 0.1, 0.2])
    hand = BodyPoint("hand", Place(0.03, 0.0, -0.08))
    pressures = np.array([3.0, 3.4, 3.2, 3.0, 2.5, 3.0, 3.0, 3.5]) * bar
    torques, joints = map_at(robot, angles).torque_at(pressures), map_at(robot, angles).stiffness_at(pressures)
    compliance = point_stiffness(robot, angles, joints, point=hand).compliance
    found = pressures_for_point_stiffness(robot, angles, np.linalg.inv(compliance), point=hand, torques=torques)
    assert found.error < 1e-5 and found.least == 0.0
    jacobian, _ = point_jacobian(robot, angles, point=hand)
    push = np.array([0.02, -0.03, 0.01]) / 20

    def unbalanced(at):
        pull = point_jacobian(robot, at, point=hand)[0].T @ push
        return np.array(robot.torques(at, found.pressures), float) - torques + pull

    moved = jacobian @ (fsolve(unbalanced, angles, xtol=1e-12) - angles)
    np.testing.assert_allclose(moved, compliance @ push, rtol=2e-3, atol=1e-7)


def test_a_file_asks_for_the_stiffness_of_joints_with_the_weight_held():
    text = Path("examples/robot/neck.yaml").read_text()
    wish = "stiffness: {posture: {nod: 2 deg}, joints: {side: 25 N*m/rad}, gravity: true}\n"
    scenario = RobotScenario.parse(text + wish, folder=Path("examples/robot"))
    attainable, found = solve_statics(scenario)
    low, high = attainable["side"].stiffness
    assert low < 25.0 < high and found.exact
    assert solve_statics(RobotScenario.parse(text, folder=Path("examples/robot")))[1] is None
    for change, field in (("side: 25", "neck: 25"), ("joints:", "principal: [1 N/m, 2 N/m], joints:")):
        with pytest.raises(ScenarioError) as caught:
            RobotScenario.parse(text + wish.replace(change, field), folder=Path("examples/robot"))
        assert "joints" in str(caught.value.problems[0].field)
