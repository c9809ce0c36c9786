"""Position and stiffness of all joints of a robot at once, from a file."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import lsq_linear
from typer.testing import CliRunner

import mckibben as mk
from mckibben.cli import app
from mckibben.control.bounded_allocation import BoundedSolution, bounded_least_squares
from mckibben.errors import RangeError, ScenarioError, UnreachableError
from mckibben.export import export
from mckibben.export.mujoco import load_mujoco
from mckibben.mechanism.dynamics import joint_equations, joint_load
from mckibben.mechanism.point_stiffness import place_of, point_jacobian, point_of, stiffness_matrix
from mckibben.mechanism.terms import joint_terms
from mckibben.plant import PerfectSensors
from mckibben.result import Severity
from mckibben.robot import ComputedTorque, RobotScenario, pressures_for_joint_stiffness, read_robot
from mckibben.scenario import batched
from mckibben.statics.posture import HeldPosture
from mckibben.study.compare import compare
from mckibben.study.compare.robots import RobotSuite
from mckibben.study.compare.runs import started
from mckibben.study.compare.suite import EvaluationSettings, TuningSettings
from mckibben.units import bar, deg
from tests.robot.conftest import as_joint

ONE = Path(__file__).with_name("one-joint.yaml").read_text(encoding="utf-8")
LAG = "{time_constant: 20 ms}"
AIR = "{class: PressureRegulator, conductance: 0.5 L/(s*bar), supply: 7 bar, time_constant: 5 ms, dead_volume: 3 cm^3}"
PID = """
controllers:
  knee:
    position: {kp: 2 bar/rad, ki: 12 bar/(rad*s), kd: 0.05 bar*s/rad}
    stiffness: {kp: 0.08 bar/(N*m/rad), ki: 5 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad)}
"""
DECOUPLING = "\ncontrollers: {knee: {class: decoupling, feedback: {bandwidth: 40 rad/s}}}\n"
TORQUE = "\ncontroller: {feedback: {bandwidth: 40 rad/s}}\n"
THROUGH_THE_AXIS = """- name: on the axis
      through: [{body: thigh, place: [0 mm, 0 mm, 100 mm]}, {body: shank, place: [0 mm, 0 mm, -75 mm]}]"""
TWO = """
name: two joints
robot: {from: lei-leg-planar, base: fixed}
valve: {time_constant: 20 ms}
sensors: {encoder: 0.022 deg, pressure_noise: 2 kPa}
reference:
  hip: {angle: {class: sine, amplitude: 3 deg, frequency: 1.1 Hz}, stiffness: 15 N*m/rad}
  knee: {angle: {class: sine, amplitude: 8 deg, frequency: 0.9 Hz}, stiffness: 15 N*m/rad}
controllers:
  hip: {class: decoupling, feedback: {bandwidth: 40 rad/s}}
  knee: {class: decoupling, feedback: {bandwidth: 40 rad/s}}
start: {clearance: 0.5 m}
duration: 0.4 s
control_period: 2 ms
"""
ROOT = Path(__file__).parents[2]
FULL = "examples/robot/lei-leg-control.yaml"
KEPT = ("angle", "pressure", "command", "stiffness")


@pytest.mark.slow
def test_a_file_may_name_computed_torque_where_nothing_else_was_imported():
    code = f"from mckibben.scenario import Scenario; Scenario.read({FULL!r})"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True).returncode == 0


@pytest.mark.parametrize("stiffness", ["0 N*m/rad", "{class: step, before: 14 N*m/rad, after: 0 N*m/rad, at: 0.2 s}"])
def test_a_stiffness_of_0_is_refused(stiffness):
    text = re.sub(r"stiffness: \{class: step.*\}", f"stiffness: {stiffness}", ONE)
    with pytest.raises(ScenarioError) as caught:
        RobotScenario.parse(text + TORQUE).run_once()
    (problem,) = caught.value.problems
    assert problem.field.endswith("stiffness") and (problem.value, problem.lower) == (0, 0)
    with pytest.raises(RangeError):
        pressures_for_joint_stiffness(RobotScenario.parse(ONE + TORQUE).robot, (0.0,), (0.0,))


@pytest.mark.slow
def test_a_robot_of_one_joint_moves_as_the_joint():
    scenario = RobotScenario.parse(ONE.replace(LAG, AIR) + DECOUPLING)
    run, margins = scenario.run_once(), scenario.margins(3)
    joint = as_joint(scenario)
    own, alone = joint.margins(3), joint.simulate()
    for name in ("radius", "gain", "phase", "delay", "disk", "alone"):
        np.testing.assert_allclose(getattr(margins, name), getattr(own, name), rtol=1e-4)
    assert set(margins.loop) <= {"knee1", "knee2"}
    np.testing.assert_allclose(run["angle"][0], alone["angle"], atol=1e-11)
    np.testing.assert_allclose(run["stiffness"][0], alone["stiffness"], rtol=1e-9)
    np.testing.assert_allclose(run["pressure"], [alone["pressure1"], alone["pressure2"]], atol=1e-2)
    for name in ("angle_rmse", "stiffness_rmse"):
        assert run.metrics[name][0] == pytest.approx(alone.metrics[name], rel=1e-9)


def test_a_file_of_a_controlled_robot_reads_back():
    scenario = RobotScenario.parse(ONE + PID)
    again = RobotScenario.parse(scenario.dumps())
    assert again.dumps() == scenario.dumps()
    assert again.control() == scenario.control()
    assert again.controllers["knee"].model is not again.robot.pair(0)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        (ONE, None),
        ("name: a\nrobot: {from: lei-leg-planar}\nduration: 1 s", None),
        (ONE + PID + TORQUE, None),
        (ONE + TORQUE.replace("feedback", "feedbck"), "controller.feedbck"),
        (ONE + PID.replace("kp: 2 bar/rad", "kp: 2 kg"), "controllers.knee.position.kp"),
        (ONE + PID.replace("knee", "kne"), "controllers.kne"),
        (ONE.replace("duration: 0.4 s", "") + PID, None),
        (
            "name: a\nrobot: {from: lei-leg-planar}\nreference: {position: [0 mm, 0 mm], principle: 3 N/m}",
            "reference.principle",
        ),
        (ONE.replace("  knee:", "  hip:") + TORQUE, "reference.hip"),
        (re.sub(r"- over.*\n.*geometry.*", THROUGH_THE_AXIS, ONE) + TORQUE, "robot.joints[0]"),
    ],
)
def test_mistakes_are_named(text, field):
    with pytest.raises(ScenarioError) as caught:
        RobotScenario.parse(text)
    assert (caught.value.problems[0].field or None) == field
    assert caught.value.problems[0].remedy


SINE = "{class: sine, amplitude: 5 deg, frequency: 0.5 Hz}"
EXTRA = """    - name: extra
      through: [{body: thigh, place: [0 mm, 0 mm, 180 mm]}, POINTS]
      muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
valve:"""
ON_THE_AXIS = "{body: shank, place: [0 mm, 0 mm, 0 mm]}"
TWICE = "{body: thigh, place: [0 mm, 0 mm, 0 mm]}, {body: shank}, {body: shank, place: [30 mm, 0 mm, 0 mm]}"


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        (f"angle: {SINE}", "angle: 30 deg", "reference.knee"),
        ("40 rad/s", "4000 rad/s", "controller.feedback.bandwidth"),
        ("valve:", EXTRA.replace("POINTS", ON_THE_AXIS), "robot.muscles[1]"),
        ("valve:", EXTRA.replace("POINTS", TWICE), "robot.muscles[1]"),
    ],
    ids=["beyond a stop", "above the Nyquist frequency", "without an arm", "points that coincide"],
)
def test_what_no_run_can_have_is_named_with_its_line(old, new, field, tmp_path):
    (tmp_path / "one.yaml").write_text((ONE + TORQUE).replace(old, new))
    with pytest.raises(ScenarioError) as caught:
        RobotScenario.read(tmp_path / "one.yaml").run_once(source=str(tmp_path / "one.yaml"))
    (problem,) = caught.value.problems
    assert problem.field == field and problem.line is not None and problem.remedy


@pytest.mark.slow
def test_a_reference_that_leaves_the_stops_later_is_not_attainable():
    text = ONE.replace("amplitude: 5 deg", "amplitude: 25 deg")
    (remark,) = RobotScenario.parse(text + TORQUE).run_once().unattained
    assert (remark.field, remark.severity) == ("reference", Severity.SEVERE)


def test_a_run_of_a_robot_without_a_controller_asks_for_one():
    scenario = RobotScenario.read("examples/robot/neck.yaml")
    with pytest.raises(ScenarioError) as caught:
        scenario.run_once(source="examples/robot/neck.yaml")
    (problem,) = caught.value.problems
    assert (problem.field, problem.line) == ("controller", None) and problem.remedy


@pytest.mark.slow
def test_all_joints_follow_position_and_stiffness_while_the_others_move():
    scenario = RobotScenario.read(FULL)
    run = scenario.run_once()
    late = run["time"] > 0.3
    error = np.abs(run["angle"] - run["desired_angle"])[:, late].max(axis=1) / deg
    np.testing.assert_array_less(error, [0.1, 0.2, 0.6])
    steady = late & (run["time"] % 1 > 0.2)  # a joint has a step at 1, 2 and 3 s
    assert np.abs(run["stiffness"] - run["desired_stiffness"])[:, steady].max() < 0.1
    assert run.notes() == [] and run.engine == "native"  # an operation that C lacks would run ten times as long


@pytest.mark.slow
def test_a_controller_that_knows_the_delay_of_its_commands_follows_better():
    text = ONE.replace("command_delay: 3 ms", "command_delay: 8 ms") + TORQUE.replace("40 rad/s", "60 rad/s")
    aware = RobotScenario.parse(text).replace(duration=1.5)
    blind = aware.replace(controller=dataclasses.replace(aware.controller, command_delay=None))
    errors = [
        (run["angle"] - run["desired_angle"])[0, run["time"] > 0.5] for run in (aware.run_once(), blind.run_once())
    ]
    assert np.std(errors[0]) < 0.2 * np.std(errors[1])


@pytest.mark.slow
def test_a_robot_is_tuned_with_its_disk_margin(tmp_path):
    scenario = RobotScenario.parse(ONE + TORQUE.replace("40 rad/s", "15 rad/s"))  # too slow: the search finds better
    scenario.to_yaml(tmp_path / "one.yaml")
    options = ["--over", "controller.feedback.bandwidth=5..40 rad/s log", "--method", "local", "--iterations", "3"]
    done = CliRunner().invoke(app, ["tune", str(tmp_path / "one.yaml"), *options, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    results = json.loads((tmp_path / "out" / "results.json").read_text())["scalars"]
    assert results["cost"]["value"] < results["cost_before"]["value"] and results["least_disk"]["value"] > 0.2
    tuned = RobotScenario.read(tmp_path / "out" / "one-tuned.yaml")
    assert tuned.controller.feedback.bandwidth != 15


POINT = """
name: the foot presses on soft ground
robot: {from: lei-leg-planar, base: fixed}
valve: {time_constant: 20 ms, supply: 7 bar}
reference:
  position: [-90 mm, {class: ramp, before: -696 mm, after: -705 mm, start: 0.2 s, duration: 0.5 s}]
  principal: [22.7 N/m, 835 N/m]
  direction: -11.77 deg
ground: {friction: 0.9, slip_speed: 1 mm/s, stiffness: 3000 N/m}
start: {angles: {knee: -17 deg}, clearance: 4 mm}
controller: {feedback: {bandwidth: 60 rad/s}, impedance: true}
duration: 1.5 s
control_period: 2 ms
"""


@pytest.mark.slow
def test_a_point_is_a_spring_of_its_stiffness_about_its_reference():
    scenario = RobotScenario.parse(POINT)
    run = scenario.run_once()
    robot, point = scenario.robot, point_of(scenario.robot, None)
    at, reference = (
        np.array(place_of(robot, point, jnp.asarray(run[name][:, -1]))) for name in ("angle", "desired_angle")
    )
    np.testing.assert_allclose(reference, [-0.09, -0.705], atol=1e-8)
    pressed = np.array([run["ground_forward"][-1], run["ground_up"][-1]])
    wanted = stiffness_matrix((22.7, 835.0), np.radians(-11.77))
    assert at[1] - reference[1] > 1e-3 and pressed[1] > 1
    np.testing.assert_allclose(pressed, wanted @ (at - reference), rtol=0.05)
    grounds = (re.sub("ground: {.*}", f"ground: {{{text}}}", POINT) for text in ("", "slip_speed: 1 mm/s"))
    default, sticking = (RobotScenario.parse(text).margins(4).disk[-1] for text in grounds)
    assert sticking < 0.2 < default
    jacobian, _ = point_jacobian(robot, run["angle"][:, -1])
    springs = run["desired_stiffness"][:, -1] * (run["angle"] - run["desired_angle"])[:, -1]
    np.testing.assert_allclose(jacobian.T @ pressed, springs, atol=0.02)


@pytest.mark.slow
def test_positions_out_of_reach_are_named_before_the_run():
    with pytest.raises(UnreachableError) as caught:
        RobotScenario.parse(POINT.replace("-705 mm", "-830 mm")).references()
    assert caught.value.field == "reference" and caught.value.remedy
    scenario = RobotScenario.parse(POINT)
    assert RobotScenario.parse(scenario.dumps()).dumps() == scenario.dumps()
    nominal, short = scenario.references(), scenario.model_copy(update={"duration": 0.5})
    assert scenario.model_copy(update={"controller": None}).references() is nominal
    assert short.references()["knee"].angle.times.size == 250
    assert batched(scenario, {"robot.bodies.1.mass": [0.5, 0.6]}).references() is nominal


@pytest.mark.slow
def test_controllers_of_a_robot_are_compared_on_runs_of_its_scenarios(tmp_path):
    heavy = "robot.bodies.1.mass=0.4 kg..40 kg"  # the heaviest cannot be held
    scenario = RobotScenario.parse(ONE.replace("lower: -20 deg", "offset: 20 deg, lower: -20 deg") + TORQUE)
    names = "scenario", "PID", "PID with feedforward", "decoupling"
    suite = RobotSuite.of(scenario, conditions=(heavy,), tuning=TuningSettings(untuned=names))
    suite.to_yaml(tmp_path / "suite.yaml")
    again = RobotSuite.read(tmp_path / "suite.yaml")
    assert again == suite and tuple(again.controllers) == names
    pid = {"PID": again.controllers["PID"]}
    result = compare(again.model_copy(update={"controllers": pid, "evaluation": EvaluationSettings(runs=8, seed=3)}))
    batch = result.batches["PID"]
    held = started(batch)
    assert 0 < held.sum() < 8 and np.isnan(batch["angle_rmse"][0, ~held]).all()
    first, other = np.flatnonzero(held)[0], np.flatnonzero(~held)[0]
    alone = result.runs.scenario("PID", int(first)).run_once()
    for metric in ("angle_rmse", "stiffness_rmse", "air"):
        values = np.atleast_2d(batch.metrics[metric])[:, first]
        np.testing.assert_allclose(values, np.ravel(alone.metrics[metric]), rtol=1e-9)
    with pytest.raises(UnreachableError):
        result.runs.scenario("PID", int(other)).check_start()
    assert result.metric("PID", "angle_rmse").shape == (result.started.sum(),) and "PID" in result.margins
    assert "payload +50 %" in result.changed["PID"].changes
    with pytest.raises(ScenarioError) as caught:
        RobotSuite.parse(suite.dumps().replace("kp: ", "kpp: ", 1))
    assert caught.value.problems[0].field.startswith("controllers.PID.controllers.knee.position")


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [(15.0, 15.0, 15.0), (9.0, 16.0, 30.0)])
def test_pressures_in_the_loop_are_those_of_the_statics(stiffness):
    robot, angles, torques = read_robot("lei-leg"), (0.02, -0.03, -0.2), (0.5, -0.8, 0.3)
    wanted = pressures_for_joint_stiffness(robot, angles, stiffness, torques=torques, minimum_tension=5.0)
    limits = HeldPosture.of(robot, angles, torques, np.inf, 5.0)
    terms = joint_terms(robot, tuple(map(jnp.asarray, angles)))
    low, high = (tuple(map(jnp.asarray, side)) for side in (limits.low, limits.high))
    zero = jnp.zeros(())
    start = BoundedSolution(tuple((a + b) / 2 for a, b in zip(low, high, strict=True)), (zero,) * 6, zero)
    errors = terms.errors(torques, stiffness, 30.0, 1e-3, [a * bar for a in low], [a * bar for a in high])
    found = bounded_least_squares(*errors, low, high, start)
    np.testing.assert_allclose(found.values, np.array(wanted.pressures) / bar, atol=2e-4)
    assert abs(float(found.gap)) < 1e-9


@pytest.mark.parametrize("steps", [1, 3, None])
@pytest.mark.slow
def test_the_certificate_bounds_what_few_steps_leave(steps):
    size, zero = 7, jnp.zeros(())
    start = BoundedSolution((zero,) * size, (zero,) * size, zero)
    solve = jax.jit(lambda rows, *problem: bounded_least_squares(rows, *problem, start, steps))
    for seed in range(3):
        rng = np.random.default_rng(seed)
        factors, right = rng.normal(size=(9, size)), rng.normal(size=9)
        low, high = -rng.uniform(0, 0.3, size), rng.uniform(0, 0.3, size)
        found = solve([dict(enumerate(row)) for row in factors], right, tuple(low), tuple(high))
        total = float(np.sum((factors @ np.array(found.values, float) - right) ** 2))
        left = total - 2 * lsq_linear(factors, right, (low, high), tol=1e-14).cost
        assert left <= float(found.gap) + 1e-9
        assert steps is not None or left == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
def test_stiffness_of_a_spatial_robot_is_the_slope_of_its_torques():
    robot = RobotScenario.read("examples/robot/platform.yaml").robot
    angles, pressures = np.array([0.05, -0.04, 0.08]), np.linspace(4e5, 6e5, 6)
    steps = 1e-6 * np.eye(3)
    pushed = [
        -(np.array(robot.torques(angles + h, pressures)) - np.array(robot.torques(angles - h, pressures))) / 2e-6
        for h in steps
    ]
    np.testing.assert_allclose(robot.stiffness(tuple(angles), pressures), np.diag(pushed), rtol=1e-6)
    terms = joint_terms(robot, tuple(map(jnp.asarray, angles)))
    coupling = [
        sum(float(a + b * pressures[m]) for m, (a, b) in terms.stiffness[pair].items()) for pair in ((0, 1), (1, 2))
    ]
    np.testing.assert_allclose(coupling, [pushed[1][0], pushed[2][1]], rtol=1e-6)


def test_the_load_of_a_joint_has_its_gravity():
    robot = read_robot("lei-leg")
    load = joint_load(robot, (0.0, 0.0, -0.1), 2, 9.81)
    needed = joint_equations(robot, (0.0, 0.0, 0.2), (0.0,) * 3, 9.81).bias[2]
    assert float(load.required_torque(0.2, 0.0, 0.0)) == pytest.approx(float(needed), rel=1e-9)


@pytest.mark.slow
def test_the_arm_of_the_documentation_reaches(tmp_path):
    pytest.importorskip("mujoco")
    page = (ROOT / "docs" / "robot.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```yaml\n(name: reach.*?)^```", page, re.DOTALL | re.MULTILINE)
    read = re.search(r"^mckibben (robot read .*) --out arm$", page, re.MULTILINE)[1]
    assert CliRunner().invoke(app, [*read.split(), "--out", str(tmp_path)]).exit_code == 0
    run = RobotScenario.parse(text, folder=tmp_path).run_once()
    assert run.metrics["angle_rmse"].max() < 0.1 * deg


@pytest.mark.slow
def test_mujoco_holds_the_start_and_moves_alike(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    scenario = RobotScenario.read(FULL)
    export(scenario, "mjcf", tmp_path, name="controlled")
    model = load_mujoco(tmp_path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert np.abs(data.qacc).max() < 1e-9
    start, plant = scenario.starts(), dataclasses.replace(scenario.plant(), sensors=PerfectSensors())
    data.ctrl[:] = commands = np.array(start.pressures) + 3e4 * np.eye(6)[4]
    mujoco.mj_step(model, data, round(0.3 / model.opt.timestep))
    end = jax.jit(lambda state: plant.advance(state, tuple(commands), 0.3, 600))(plant.begin(start))
    np.testing.assert_allclose(data.qpos, end.angle, atol=1e-6)


def test_a_locked_joint_is_refused():
    robot = read_robot("lei-leg")
    first, *others = robot.joints
    locked = dataclasses.replace(robot, joints=(dataclasses.replace(first, locked=0.0), *others))
    with pytest.raises(RangeError) as caught:
        ComputedTorque(mk.PolePlacement(30.0), robot=locked, valve=mk.FirstOrderValve(0.02))
    assert caught.value.field == "robot" and caught.value.remedy


@pytest.mark.slow
def test_a_scenario_of_a_robot_has_the_methods_of_one_of_a_joint(tmp_path):
    path = tmp_path / "one.yaml"
    path.write_text(ONE + PID, encoding="utf-8")
    scenario = mk.Scenario.read(path)
    assert {"simulate", "margins", "tune", "compare", "export"} <= set(dir(scenario))
    run = scenario.simulate(duration=0.1)
    assert run.duration == pytest.approx(0.1) and run.plot().axes
    np.testing.assert_array_equal(run["angle"], scenario.replace(duration=0.1).run_once()["angle"])
    scenario.export("c", tmp_path / "c")
    assert list((tmp_path / "c").glob("*.c"))


def test_pressures_of_more_muscles_than_a_compiler_takes_are_refused(monkeypatch):
    monkeypatch.setattr("mckibben.control.computed_torque.MOST_MUSCLES", 3)
    platform = RobotScenario.read("examples/robot/platform.yaml")
    with pytest.raises(RangeError) as caught:
        ComputedTorque(mk.PolePlacement(30.0), robot=platform.robot, valve=platform.valve)
    assert (caught.value.field, caught.value.value, caught.value.upper) == ("robot", 6, 3)
    assert "controllers" in caught.value.remedy
