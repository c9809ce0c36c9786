# ruff: noqa: E501 - tables of cases
"""Files of a robot, landing and jump studies, and the commands."""

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from mckibben import robot as robots
from mckibben.cli import app
from mckibben.codegen.templates import filled
from mckibben.errors import FileError, RangeError, ScenarioError
from mckibben.study import jumping as jump_search
from mckibben.study import landing as landings
from mckibben.study.landing import valve_with
from mckibben.study.robot_draws import drawn_plant, quantile_interval, with_mass
from tests.robot.conftest import FILE

HEAD = "name: x\nrobot:\n  from: lei-leg-planar\n"


TEMPLATE = filled("robot.yaml", {"file": "x.yaml", "name": "x"}, "mckibben.cli")


def test_the_template_is_a_robot():
    assert robots.RobotScenario.parse(TEMPLATE).plant().robot.muscle_names[-1] == "rectus"


@pytest.mark.parametrize(
    ("old", "new", "line_of", "field"),
    [
        ("joint: knee, action", "joint: ankle, action", "joint: knee", "robot.muscles[2].over[1].joint"),
        ("joint: knee, action", "joint: hip, action", "joint: knee", "robot.muscles[2].over[1].joint"),
        ("- name: knee", "- name: hip", "- name: knee", "robot.joints[1].name"),
        ("- name: rectus", "- name: knee1", "- name: rectus", "robot.muscles[2].name"),
        ("20 mm, rest_length: 80", "20 mm, rest_length: 300", "- name: rectus", "robot.muscles[2]"),
    ],
)
def test_a_mistake_in_a_part_of_a_robot_has_its_line(old, new, line_of, field):
    text = TEMPLATE
    with pytest.raises(ScenarioError) as caught:
        robots.RobotScenario.parse(text.replace(old, new))
    (problem,) = caught.value.problems
    near = text[: text.index(line_of)].count("\n") + 1
    assert problem.field is not None and problem.field.startswith(field) and problem.remedy
    assert problem.line is not None and abs(problem.line - near) <= 3


def test_changes_of_the_catalog_name_the_joint():
    read = robots.RobotScenario.parse(
        HEAD + "  bodies: {trunk: {mass: 2 kg}}\n  joints: {knee: {damping: 0.1 N*m*s/rad}}\n"
    )
    robot = read.robot
    assert robot.bodies[0].mass == 2.0 and robot.joints[1].damping == 0.1 and robot.joints[0].damping == 0.05


@pytest.mark.parametrize(
    ("text", "line", "word"),
    [
        (HEAD + "  muscles: {knee: {geometry: {connector_length: 190 mm}}}\n", 4, "too short"),
        (HEAD + "  joints: {knee: {lower: -80 deg}}\n", None, "too long"),
        (HEAD + "  joints: {ankle: {damping: 0.1 N*m*s/rad}}\n", 2, "ankle"),
        (HEAD + "  base: flying\n", 4, "flying"),
        (HEAD + "landing: {joint: kne}\n", 4, "kne"),
        (HEAD + "landing: {joint: knee, touchdown: {knee: 70 deg}, time_constants: []}\n", 4, "stops"),
        (HEAD + "  base: fixed\nlanding: {joint: knee, time_constants: []}\n", 5, "move"),
        (HEAD + "  joints: {knee: {locked: 5 deg}}\nlanding: {joint: knee, time_constants: []}\n", 5, "locked"),
        (HEAD + "  joints: {knee: {locked: 50 deg}}\n", 4, "locked"),
        (HEAD + "landing: {joint: knee, drop: [], time_constants: []}\n", 4, "drop"),
        (HEAD + "ground: {stiffness: 20 N/m}\n", 4, "ground"),
        (HEAD + "jump: {high: 9 bar}\n", 4, "rating"),
        (HEAD + "jump: {low: 3 bar, high: 2 bar}\n", 4, "low"),
        (HEAD + "jump: {latest: 1 s}\n", 4, "latest"),
        (HEAD + "valve: {time_constant: 20 ms, supply: 4 bar}\njump: {high: 6 bar}\n", 5, "supply"),
        (HEAD + "valve: {time_constant: 20 ms}\nlanding: {joint: knee}\n", None, "air"),
    ],
)
def test_bad_files_name_line_and_remedy(text, line, word):
    with pytest.raises(ScenarioError) as caught:
        robots.RobotScenario.parse(text)
    problem = caught.value.problems[0]
    assert word in str(problem) and problem.remedy
    assert line is None or problem.line == line


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("robot: {from: lei-leg-planar, bodies: null}\nlanding: {joint: knee, drop: [20 m], time_constants: ~}\n", ["robot.bodies", "landing.time_constants", "landing.drop[0]"]),
        ("robot: {from: lei-leg-planar, joints: {knee: {lower: null}}}\n", ["robot.joints.knee.lower"]),
        ("robot: null\n", ["robot"]),
        ("robot: lei-leg-planar\nlanding: {joint: knee, drop: [20 m, 3], time_constants: []}\n", ["landing.drop[0]", "landing.drop[1]"]),
        ("robot: lei-leg-planar\nlanding: {joint: knee, stiffness: [9 N*m/rad], time_constants: []}\n", ["landing.stiffness"]),
    ],
)  # fmt: skip
def test_what_follows_from_another_mistake_is_not_said(text, fields):
    with pytest.raises(ScenarioError) as caught:
        robots.RobotScenario.parse("name: x\n" + text)
    assert [problem.field for problem in caught.value.problems] == fields


def test_stiffness_that_is_not_attainable(scenario):
    beyond = scenario.landing.model_copy(update={"stiffness": (40.0,)})
    with pytest.raises(ScenarioError) as caught:
        robots.study_landing(scenario.model_copy(update={"landing": beyond}))
    assert "knee" in str(caught.value) and "attainable" in str(caught.value)


def test_step_that_is_too_long(scenario):
    for study in (robots.study_landing, robots.study_jump):
        with pytest.raises(ScenarioError) as caught:
            study(scenario.model_copy(update={"control_period": 2e-3, "substeps": 1}))
        assert caught.value.problems[0].field == "control_period" and caught.value.problems[0].remedy


def test_supply_that_is_too_low(scenario):
    weak = scenario.model_copy(update={"valve": dataclasses.replace(scenario.valve, supply=1e5)})
    with pytest.raises(ScenarioError) as caught:
        robots.study_landing(weak)
    assert "supply" in str(caught.value)


@pytest.fixture(scope="module")
def study(scenario):
    """In six blocks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(landings.Landings, "block_size", lambda self: 42)
        return robots.study_landing(scenario)


@pytest.mark.slow
def test_landing_study(scenario, study):
    assert study.table["peak_force"].shape == (3, 1, 4, 21)
    forces = study.table["peak_trunk_force"].to_numpy()
    best = study.best()
    assert best.shape == (3, 1, 21)
    for v in range(3):  # no softer one has so little force
        at = best[v, 0, 0]
        assert forces[v, 0, at, 0] <= forces[v, 0, :, 0].min() * 1.02
        assert (forces[v, 0, :at, 0] > forces[v, 0, :, 0].min() * 1.02).all()
    deflection = study.table["deflection"].to_numpy()[:, 0, -1, 0]
    assert deflection[2] < deflection[1] < deflection[0]  # closed valves are the stiffest
    assert len(next(study.listings()).rows()) == 3
    assert study.table["substeps"].shape == study.table["chaotic"].shape == forces.shape
    integration = study.integration()
    assert integration["substeps"] == study.table["substeps"].max() >= 1
    errors = study.table["error_estimate"].to_numpy()
    assert scenario.accuracy >= integration["error_estimate_rad"] == np.nanmax(errors) > 0
    assert integration["runs_chaotic"] == study.table["chaotic"].sum()
    coarse = robots.study_landing(scenario.model_copy(update={"substeps": 1}))
    assert coarse.integration() == {"substeps": 1, "error_estimate_rad": None, "runs_chaotic": 0}


@pytest.mark.slow
def test_the_robust_stiffness_is_chosen_on_the_draws_and_judged_by_fresh_ones(scenario, study):
    quantile = np.percentile(study.trunk_weights()[..., 1:], 95, axis=-1)
    columns = {name: values for name, (_, values) in study.declared().items()}
    fresh, nominal = study.table["fresh_trunk_weights"].to_numpy(), study.best()[..., 0]
    for row, (v, d) in enumerate(np.ndindex(quantile.shape[:2])):
        for choice, (name, at) in enumerate((("robust", quantile[v, d].argmin()), ("best", nominal[v, d]))):
            assert columns[f"{name}_stiffness"][row] == study.table["stiffness"][at]
            assert columns[f"{name}_force"][row] == np.percentile(fresh[v, d, choice], 95)
            stopped = study.table["fresh_stop_torque"].to_numpy()[v, d, choice] > 0
            assert columns[f"{name}_share"][row] == stopped.mean()
            assert columns[f"{name}_force_low"][row] <= columns[f"{name}_force"][row]
            assert columns[f"{name}_force_high"][row] == np.inf  # of 20 draws none is surely above 95 %
            assert not np.isin(fresh[v, d, choice], study.trunk_weights()[v, d, at]).any()
    other = scenario.model_copy(update={"uncertainty": scenario.uncertainty.model_copy(update={"seed": 1})})
    masses = [np.asarray(drawn_plant(x, fresh=f).robot.bodies[0].mass) for x in (scenario, other) for f in (0, 1)]
    assert len({tuple(mass[1:]) for mass in masses}) == 4 and len({mass[0] for mass in masses}) == 1


def test_the_interval_of_a_quantile_contains_it_in_95_of_100_studies():
    draws = np.random.default_rng(3).gumbel(size=(4000, 400))
    low, high = quantile_interval(draws, 95)
    true = -np.log(-np.log(0.95))
    assert 0.945 < np.mean((low <= true) & (true <= high)) < 0.975
    assert (low < np.percentile(draws, 95, axis=-1)).all() and (high > low).all()


@pytest.mark.slow
def test_a_best_stiffness_that_bottoms_out_is_said(study):
    at = int(study.best()[0, 0, 0])
    torque = study.table["stop_torque"] * 0.0
    torque[0, 0, at], torque[1] = 1.0, 1.0
    said = dataclasses.replace(study, table=study.table.assign(stop_torque=torque))
    marked = ["bottoms out" in row[-1] or "stop" in row[-1] for row in next(said.listings()).rows()]
    assert marked == [True, True, False]


def test_an_interval_needs_as_many_draws_as_its_percentiles(scenario):
    text = scenario.dumps().replace("draws: 20", "draws: 19")
    with pytest.raises(ScenarioError) as caught:
        robots.RobotScenario.parse(text)
    (problem,) = caught.value.problems
    assert (problem.field, problem.value, problem.lower) == ("uncertainty.draws", 19, 20)


def test_time_constant_of_the_valve(scenario):
    plant = scenario.plant()
    muscle = plant.robot.all_muscles[0]
    volume = float(muscle.specimen.volume((muscle.domain.contraction_min + muscle.domain.contraction_max) / 2))
    middle = (muscle.domain.pressure_min + muscle.domain.pressure_max) / 2
    for wanted in (0.01, 0.05):
        valve = valve_with(plant.valve, plant, wanted)
        assert float(valve.time_constant_at(middle, volume)) == pytest.approx(wanted, rel=1e-12)
    with pytest.raises(RangeError):
        valve_with(plant.valve, plant, 0.001)


def test_draws_scatter_about_the_nominal_robot(scenario):
    many = scenario.model_copy(update={"uncertainty": scenario.uncertainty.model_copy(update={"draws": 2000})})
    plant = drawn_plant(many)
    strength = np.asarray(plant.robot.all_muscles[3].strength)
    assert strength[0] == 1.0 and strength[1:].std() == pytest.approx(0.05, rel=0.1)
    mass = np.asarray(plant.robot.bodies[0].mass)
    assert mass[0] == 1.5 and mass[1:].std() == pytest.approx(0.03 * 1.5, rel=0.1)


def test_draws_of_the_mass_scale_every_inertia():
    factors = np.array([1.0, 1.2])
    for inertia in ((0.03, 0.02, 0.012), (0.009, 0.0004), (0.03, 0.02, 0.012, 0.001, 0.0, -0.001)):
        body = with_mass(robots.Body("x", 2.0, inertia=inertia), factors)
        np.testing.assert_allclose(body.mass, 2.0 * factors)
        np.testing.assert_allclose(body.inertia, np.outer(inertia, factors))


@pytest.mark.slow
def test_standing_is_the_highest_posture(scenario):
    plant, drawn = scenario.plant(), drawn_plant(scenario)
    standing = jump_search._standing_heights(plant, drawn)
    assert standing.shape == (21,) and standing[0] == pytest.approx(0.727, abs=2e-3)
    assert np.ptp(standing) > 0


@pytest.fixture(scope="module")
def short_searches():
    with pytest.MonkeyPatch.context() as patch:
        for name in ("_GENERATIONS", "_POPULATION"):
            patch.setattr(jump_search, name, 2)
        yield


@pytest.fixture(scope="module")
def jumps(scenario, short_searches):
    return robots.study_jump(scenario)


@pytest.mark.slow
def test_timed_jump_is_no_lower_than_the_constant_one(scenario, jumps):
    assert jumps.timed.heights[0] >= jumps.constant.heights[0] - 1e-9 > 0
    assert 0 < jumps.timed.work < 20 and jumps.timed.air > 0
    assert jumps.constant.run.engine == "native"
    for jump in (jumps.constant, jumps.timed):
        assert jump.run.resolution.error < scenario.accuracy and jump.substeps >= 1
    record = jumps.to_dict()
    heights = record["columns"]["heights"]["values"]
    assert sum(gain for gain, _ in jumps.gains().values()) == pytest.approx(heights[-1] - heights[0])
    assert len(heights) == 2 + (jumps.deeper is not None)
    assert len(record["tables"][1]["columns"]["command"]["values"]) == len(heights) * len(jumps.timed.run.muscles)


@pytest.mark.slow
def test_the_jump_is_that_of_its_generation_which_most_draws_reach(scenario, jumps, short_searches):
    """The quantile of a jump over fresh draws, from single runs of the drawn plants; it is chosen on others."""
    plant, drawn = scenario.plant(), drawn_plant(scenario, fresh=True)
    variables = jump_search.ScheduleVariables((1e5,) * len(plant.muscles), 0.0, 6e5, 0.15, False)
    start = robots.RobotStart(
        plant.robot.posture_angles(scenario.jump.squat), tuple(jumps.constant.run["pressure"][:, 0].tolist())
    )
    steps = 0.5, scenario.control_period, jumps.constant.substeps
    runs = jump_search.JumpRuns(plant, drawn, scenario.uncertainty.draws, start, variables, *steps)
    columns = np.random.default_rng(0).uniform(size=(variables.size, 3))
    columns[:, 0] = np.array(jumps.constant.controller.levels)[:, 0] / 6e5
    sure = runs.sure_heights(columns)
    apex = jumps.constant.heights[1:] + jump_search._standing_heights(plant, drawn)[1:]
    assert sure[0] == pytest.approx(np.percentile(apex, 5), abs=1e-6)
    assert sure[0] > sure[1:].max()


@pytest.mark.slow
def test_a_search_that_was_broken_off_goes_on(scenario, jumps, tmp_path, monkeypatch):
    computed, run = [], jump_search.JumpRuns.heights

    def counted(self, variables):
        computed.append(1)
        if len(computed) == 3:
            raise KeyboardInterrupt
        return run(self, variables)

    monkeypatch.setattr(jump_search.JumpRuns, "heights", counted)
    with pytest.raises(KeyboardInterrupt):
        robots.study_jump(scenario, out=tmp_path)
    with pytest.raises(FileError):  # it exists
        robots.study_jump(scenario, out=tmp_path)
    again = robots.study_jump(scenario, out=tmp_path, resume=True)
    np.testing.assert_array_equal(again.timed.heights, jumps.timed.heights)
    before = len(computed)
    assert robots.study_jump(scenario, out=tmp_path, resume=True).to_dict() == jumps.to_dict()
    assert len(computed) == before
    with pytest.raises(FileError):
        robots.study_jump(scenario.model_copy(update={"control_period": 0.2e-3}), out=tmp_path, resume=True)


@pytest.mark.slow
def test_commands_write_their_results(scenario, tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text(scenario.dumps(), encoding="utf-8")
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["robot", "land", str(file), "--out", str(out), "--json"])
    assert done.exit_code == 0
    numbers = json.loads(done.stdout)
    assert numbers == json.loads((out / "results.json").read_text())
    assert any(path.suffix == ".png" for path in out.iterdir())
    assert robots.RobotScenario.read(out / "robot.yaml") == scenario
    resumed = CliRunner().invoke(app, ["robot", "land", str(file), "--out", str(out), "--json", "--resume"])
    assert resumed.exit_code == 0
    assert json.loads(resumed.stdout) == numbers
    again = CliRunner().invoke(app, ["robot", "land", str(file), "--out", str(out)])
    assert again.exit_code != 0  # results are not replaced


@pytest.mark.parametrize("command", ["land", "jump"])
def test_there_is_no_study_to_continue(command, tmp_path, monkeypatch):
    monkeypatch.setattr(robots.RobotScenario, "plant", lambda self: pytest.fail("work before the check"))
    done = CliRunner().invoke(app, ["robot", command, FILE, "--out", str(tmp_path), "--resume"])
    assert isinstance(done.exception, FileError)
    problem = done.exception.problems[0]
    assert "no study" in problem.message and "--resume" in problem.remedy


def test_file_without_a_study(tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text(HEAD, encoding="utf-8")
    for command in ("land", "jump"):
        done = CliRunner().invoke(app, ["robot", command, str(file)])
        assert isinstance(done.exception, ScenarioError)
    assert robots.RobotScenario.read(FILE).name
