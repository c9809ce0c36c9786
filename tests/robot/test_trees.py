"""Robots that are trees, and muscles through points of bodies: an arm of 24 muscles, MuJoCo, and mistakes in files."""

import dataclasses
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import RangeError, ScenarioError
from mckibben.mechanism.articulated import accelerations
from mckibben.mechanism.dynamics import acceleration, at_rest, joint_equations, posture_of
from mckibben.mechanism.tree import MASSLESS, BodyInertia, Frame, TreeHinge, equations, frames_of, path_through
from mckibben.numerics.spatial import IDENTITY, ZERO, Tensor, Vector, X, Y, Z
from mckibben.robot import JointwiseControl, RobotScenario, RobotStart, simulate_robot

ARM = "examples/robot/umarm.yaml"
REFERENCE = json.loads(Path(__file__).with_name("umarm.json").read_text())


@pytest.fixture(scope="module")
def arm():
    return RobotScenario.read(ARM).robot


@pytest.mark.parametrize("case", REFERENCE["cases"])
@pytest.mark.slow
def test_an_arm_of_24_muscles_is_that_of_soromox(arm, case):
    """Muscles, mass matrix and accelerations of UMArm; there gravity acts along -x of the base."""
    angles, rates = np.array(case["angle_rad"]), np.array(case["velocity_rad_s"])
    pressures = case["pressure_Pa"]
    routed = arm.routed_muscles(tuple(angles))
    np.testing.assert_allclose([float(unit.path) for unit in routed], case["length_m"], rtol=1e-12)
    tensions = [float(u.tension(p)) for u, p in zip(routed, pressures, strict=True)]
    np.testing.assert_allclose(tensions, case["force_N"], rtol=1e-9)
    torques = np.array(arm.torques(tuple(angles), pressures))
    np.testing.assert_allclose(torques, case["torque_Nm"], atol=2e-8)
    made = joint_equations(arm, tuple(angles), tuple(rates), 0.0)
    diagonal = [float(row[i]) for i, row in enumerate(made.matrix)]
    np.testing.assert_allclose(diagonal, case["mass_matrix_diagonal_kgm2"], rtol=1e-12)
    turned = dataclasses.replace(arm, gravity=(-1.0, 0.0, 0.0))
    posture = posture_of(turned, tuple(angles))
    velocity = at_rest(posture)._replace(angles=tuple(map(jnp.asarray, rates)))
    applied = np.array(case["torque_Nm"]) - 2.25 * rates
    found = np.array(acceleration(turned, posture, velocity, tuple(applied), (), 9.81).angles)
    expected = np.array(case["acceleration_rad_s2"])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def random_tree(rng):
    """A tree of eight bodies of any shape, and paths through points of theirs."""
    hinges, bodies = [], [MASSLESS]
    for number in range(8):
        axis, place = rng.normal(size=3), rng.uniform(-0.3, 0.3, 3)
        root = rng.normal(0, 0.05, (3, 3))
        spread = root @ root.T + 1e-3 * np.eye(3)
        inertia = np.trace(spread) * np.eye(3) - spread
        parent, rotor = int(rng.integers(0, number + 1)), float(rng.uniform(0, 0.01))
        angle, rate = float(rng.uniform(-1, 1)), float(rng.uniform(-3, 3))
        hinges.append(TreeHinge(vector(axis / np.linalg.norm(axis)), vector(place), angle, rate, parent, True, rotor))
        tensor = Tensor(*(float(inertia[at]) for at in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))))
        bodies.append(BodyInertia(float(rng.uniform(0.2, 2)), vector(rng.uniform(-0.2, 0.2, 3)), tensor))
    paths = []
    for _ in range(5):
        chosen = rng.choice(9, size=3, replace=False)
        paths.append([(int(body), vector(rng.uniform(-0.2, 0.2, 3))) for body in chosen])
    return hinges, bodies, paths


def vector(numbers):
    return Vector(*map(float, numbers))


def mjcf(hinges, bodies, paths):
    """The tree in MJCF, with the paths as spatial tendons."""
    sites = [
        (body, f'<site name="p{i}_{k}" pos="{numbers(place)}"/>')
        for i, path in enumerate(paths)
        for k, (body, place) in enumerate(path)
    ]

    def content(parent):
        inside = [site for body, site in sites if body == parent]
        for number, hinge in enumerate(hinges, 1):
            if hinge.parent == parent:
                body = bodies[number]
                xx, xy, xz, yy, yz, zz = body.inertia
                inside.append(
                    f'<body pos="{numbers(hinge.place)}">'
                    f'<joint axis="{numbers(hinge.axis)}" armature="{hinge.rotor!r}"/>'
                    f'<inertial pos="{numbers(body.centre)}" mass="{body.mass!r}" '
                    f'fullinertia="{numbers((xx, yy, zz, xy, xz, yz))}"/>{content(number)}</body>'
                )
        return "".join(inside)

    through = ["".join(f'<site site="p{i}_{k}"/>' for k in range(len(path))) for i, path in enumerate(paths)]
    tendons = "".join(f"<spatial>{names}</spatial>" for names in through)
    world = f"<worldbody>{content(0)}</worldbody><tendon>{tendons}</tendon>"
    return f'<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/>{world}</mujoco>'


def numbers(values):
    return " ".join(repr(float(value)) for value in values)


@pytest.mark.parametrize("seed", range(4))
def test_random_trees_with_paths_are_those_of_mujoco(seed):
    mujoco = pytest.importorskip("mujoco")
    rng = np.random.default_rng(seed)
    hinges, bodies, paths = random_tree(rng)
    model = mujoco.MjModel.from_xml_string(mjcf(hinges, bodies, paths))
    data = mujoco.MjData(model)
    order = [int(model.jnt_bodyid[k]) for k in range(8)]  # MuJoCo numbers bodies by depth
    ours = depth_first(hinges)
    assert order == list(range(1, 9))
    data.qpos[:] = [hinges[number - 1].angle for number in ours]
    data.qvel[:] = [hinges[number - 1].rate for number in ours]
    torques = rng.normal(size=8)
    data.qfrc_applied[:] = [torques[number - 1] for number in ours]
    mujoco.mj_forward(model, data)
    frames = frames_of(Frame(IDENTITY, ZERO, ZERO, ZERO), hinges)
    moved = [], hinges, bodies, frames, Vector(0.0, 0.0, 9.81)
    for found in (equations(*moved).accelerations(torques.tolist()), accelerations(*moved, torques.tolist())):
        expected = [float(found[number - 1]) for number in ours]
        np.testing.assert_allclose(expected, data.qacc, rtol=1e-9, atol=1e-9)
    lengths, arms = np.array(data.ten_length), np.zeros((len(paths), 8))
    for k in range(8):
        data.qvel[:] = np.eye(8)[k]
        mujoco.mj_forward(model, data)
        arms[:, k] = data.ten_velocity
    for path, length, own in zip(paths, lengths, arms, strict=True):
        span, slopes, _ = path_through(path, hinges, frames)
        assert float(span) == pytest.approx(length, rel=1e-12)
        np.testing.assert_allclose([float(slopes.get(number, 0.0)) for number in ours], own, atol=1e-12)


def depth_first(hinges, parent=0):
    found = []
    for number, hinge in enumerate(hinges, 1):
        if hinge.parent == parent:
            found += [number, *depth_first(hinges, number)]
    return found


MUSCLE = "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"
FORK = f"""name: x
robot:
  bodies:
    - {{name: base, mass: 1 kg}}
    - {{name: arm, mass: 0.5 kg, centre: [0 mm, 0 mm, -150 mm], inertia: [0.009 kg*m^2, 0 kg*m^2]}}
    - {{name: left, mass: 0.2 kg, centre: [0 mm, 0 mm, -150 mm], inertia: [0.003 kg*m^2, 0 kg*m^2]}}
    - {{name: right, mass: 0.2 kg, centre: [0 mm, 0 mm, -150 mm], inertia: [0.003 kg*m^2, 0 kg*m^2]}}
  joints:
    - {{name: a, axis: [0, -1, 0], lower: -10 deg, upper: 10 deg, body: arm}}
    - {{name: l, axis: [0, -1, 0], lower: -10 deg, upper: 10 deg, body: left, parent: arm, place: [0 mm, 50 mm, -300 mm]}}
    - {{name: r, axis: [0, -1, 0], lower: -10 deg, upper: 10 deg, body: right, parent: arm, place: [0 mm, -50 mm, -300 mm]}}
  muscles:
    - name: across
      connector_length: 15 mm
      through: [{{body: base, place: [30 mm, 0 mm, -200 mm]}}, {{body: right, place: [30 mm, 0 mm, -70 mm]}}]
      muscle: {MUSCLE}
"""  # noqa: E501


def test_a_fork_is_read_and_a_muscle_turns_the_joints_that_it_passes():
    scenario = RobotScenario.parse(FORK)
    assert RobotScenario.parse(scenario.dumps()) == scenario
    robot = scenario.robot
    assert (robot.parents, robot.muscle_names) == ((0, 1, 1), ("across",))
    (unit,) = robot.routed_muscles((0.0, 0.0, 0.0))
    assert set(unit.slopes) == {0, 2}
    assert float(unit.path) == pytest.approx(np.hypot(0.170, 0.05) - 0.015)
    for joint, slope in unit.slopes.items():
        step = [1e-6 * (joint == k) for k in range(3)]
        paths = [float(robot.routed_muscles(tuple(sign * x for x in step))[0].path) for sign in (1, -1)]
        assert float(slope) == pytest.approx((paths[0] - paths[1]) / 2e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "line", "field"),
    [
        ("body: right, place: [30", "body: wrong, place: [30", 15, "robot.muscles[0].through[1].body"),
        ("body: right, place: [30", "body: base, place: [30", 15, "robot.muscles[0]"),
        ("parent: arm, place: [0 mm, 50 mm", "parent: right, place: [0 mm, 50 mm", 10, "robot.joints[1].parent"),
        ("place: [0 mm, 50 mm, -300 mm]", "place: [0 mm, 50 mm]", 10, "robot.joints[1].place"),
        ("body: left", "body: base", 10, "robot.joints[1].body"),
        ("-200 mm]", "200 mm]", 15, "robot.muscles[0]"),
    ],
)
def test_a_mistake_in_a_tree_has_its_line(old, new, line, field):
    assert old in FORK
    with pytest.raises(ScenarioError) as caught:
        RobotScenario.parse(FORK.replace(old, new))
    (problem,) = caught.value.problems
    assert problem.field is not None and problem.field.startswith(field)
    assert problem.line is not None and abs(problem.line - line) <= 2 and problem.remedy


def test_a_controller_of_pairs_is_refused_without_pairs():
    plant = RobotScenario.read(ARM).plant()
    control = JointwiseControl((mk.PID(1.0, 1.0, 0.0),) * 12)
    with pytest.raises(RangeError) as caught:
        simulate_robot(plant, control, RobotStart((0.0,) * 12, (1e5,) * 24, 0.2), duration=0.01)
    assert caught.value.field == "controllers"


@pytest.mark.parametrize("slides", [[X, Z], [X, Y, Z]])
def test_a_base_that_slides_and_held_hinges_have_the_accelerations_of_the_whole_matrix(slides):
    rng = np.random.default_rng(7)
    hinges, bodies, _ = random_tree(rng)
    hinges = [hinge._replace(rotor=rng.uniform(0.0, 0.1), free=number != 3) for number, hinge in enumerate(hinges)]
    moved = slides, hinges, bodies, frames_of(Frame(IDENTITY, ZERO, ZERO, ZERO), hinges), Vector(0.0, 0.0, 9.81)
    forces, driving = [(4, Vector(1.0, 2.0, 3.0), Vector(0.1, 0.2, -0.3))], rng.normal(size=7 + len(slides)).tolist()
    found, expected = accelerations(*moved, driving, forces), equations(*moved, forces).accelerations(driving)
    np.testing.assert_allclose(np.array(found, float), np.array(expected, float), rtol=1e-9)
