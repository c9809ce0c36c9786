"""Tuning, comparison and legs of the pages: the numbers of the commands, within their budget."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("nicegui")

from mckibben import Scenario
from mckibben.errors import ParameterError, ScenarioError
from mckibben.joint import GeneralLoad, PendulumLoad
from mckibben.scenario import run_scenario
from mckibben.study.tune import parse_cost, tune
from mckibben.web import leg, studies, workbench

SHORT = workbench.START.replace("duration: 6 s", "duration: 0.6 s").replace("at: 3 s", "at: 0.2 s")


def silent(_step, _part):
    pass


@pytest.mark.slow
def test_gains_are_tuned_as_by_the_command_and_go_into_the_scenario(tmp_path):
    over = "controller.position.ki\ncontroller.position.kp"
    request = studies.TuningRequest(over=over, method="gradient", iterations=4)
    found = studies.tuned(SHORT, request, tmp_path, silent)
    scenario = Scenario.parse(SHORT)
    cost = parse_cost(request.cost, gain_margin=request.gain_margin)
    names = ["controller.position.ki", "controller.position.kp"]
    expected = tune(scenario, names, cost, method=request.method, starts=1, iterations=4)
    assert found.cost == expected.cost < found.cost_before
    assert found.scenario == expected.scenarios[0]
    assert [row[0] for row in found.parameters] == names
    before, after = found.metrics[0][1:]
    assert float(after) == pytest.approx(np.rad2deg(run_scenario(found.scenario).metrics["angle_rmse"]), rel=0.01)
    assert float(after) < float(before)
    margins = {name: float(now) for name, _, now in found.metrics if name.startswith("least ")}
    assert margins["least disk margin"] == pytest.approx(found.scenario.margins().disk.min(), rel=0.01)
    lost = margins["least disk margin"] < min(scenario.margins().disk.min(), 0.4)
    assert any("disk margin" in one for one in found.remarks) == lost
    best = studies.best_so_far([1e6, 3.0, 5.0, 2.0])
    np.testing.assert_array_equal(best, [np.nan, 3, 3, 2])


@pytest.mark.slow
def test_a_single_gain_is_tuned_by_the_default_method(tmp_path):
    found = studies.tuned(SHORT, studies.TuningRequest(over="controller.position.kp", iterations=2), tmp_path, silent)
    assert [row[0] for row in found.parameters] == ["controller.position.kp"]
    assert found.cost <= found.cost_before


@pytest.mark.slow
def test_controllers_are_compared_on_the_same_runs(tmp_path):
    kinds = ("model inversion (decoupling)",)
    request = studies.ComparisonRequest(("two PID loops", *kinds), "load.mass2=+-20 %", runs=8, generations=1)
    steps = []
    found = studies.compared(SHORT, request, tmp_path, lambda step, _: steps.append(step))
    assert any("(2 of 2): evaluation runs, the last part" in step for step in steps)
    assert {row[0] for row in found.rows} == set(found.errors) == set(found.scenarios) == {"two PID loops", *kinds}
    assert found.at_equal_air[0][0] == "two PID loops" and all(len(row) == 7 for row in found.at_equal_air)
    assert all(0 < median <= late for median, late in found.errors.values())
    for scenario in found.scenarios.values():
        assert Scenario.parse(scenario.dumps()).control() == scenario.control()


def test_a_study_that_nobody_can_wait_for_is_refused(tmp_path):
    long = workbench.START.replace("duration: 6 s", "duration: 600 s")
    with pytest.raises(ParameterError) as found:
        studies.tuned(long, studies.TuningRequest(method="gradient", iterations=60), tmp_path, silent)
    assert found.value.upper == studies.MOST_STEPS
    with pytest.raises(ParameterError) as found:
        request = studies.ComparisonRequest(conditions="load.mass2=+-30 %", runs=512, generations=30)
        studies.compared(long, request, tmp_path, silent)
    assert found.value.upper == studies.MOST_STEPS
    with pytest.raises(ParameterError):
        studies.compared(SHORT, studies.ComparisonRequest(("two PID loops",)), tmp_path, silent)
    with pytest.raises(ParameterError) as found:
        studies.tuned(SHORT, studies.TuningRequest(disk_margin="some"), tmp_path, silent)
    assert found.value.field == "disk_margin"
    with pytest.raises(ParameterError) as found:
        leg.parse(leg.STARTS["landing in space"].replace("draws: 20", "draws: 5000"), tmp_path)
    assert found.value.upper == leg.MOST_LANDINGS


def test_the_suggested_conditions_are_those_of_the_load_until_they_are_edited():
    knee, request = Scenario.parse(SHORT), studies.ComparisonRequest()
    request.suggest(knee)
    assert request.conditions == "load.mass2=+-30 %"
    pendulum = PendulumLoad(mass=0.3, length=0.25)
    request.suggest(knee.model_copy(update={"load": pendulum}))
    assert request.conditions == "load.mass=+-30 %"
    request.conditions = "load.length=+-10 %"
    request.suggest(knee.model_copy(update={"load": GeneralLoad(0.1, 2.0)}))
    assert (request.conditions, request.suggested) == ("load.length=+-10 %", "load.inertia=+-30 %")


def test_a_leg_has_a_study_and_names_no_file_of_another_folder(tmp_path):
    for text in leg.STARTS.values():
        assert leg.parse(text, tmp_path).leg.joints
    with pytest.raises(ParameterError):
        leg.parse("leg: lei-leg\nname: x\n", tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "leg.yaml").write_text("name: x\nleg: lei-leg\n", encoding="utf-8")
    with pytest.raises(ScenarioError) as found:
        leg.parse(leg.STARTS["landing in space"].replace("lei-leg", "../leg.yaml"), tmp_path / "mine")
    assert found.value.problems[0].field == "leg"


@pytest.mark.slow
def test_a_landing_is_drawn_where_the_leg_is(tmp_path):
    text = leg.STARTS["landing in space"].replace("drop: [20 mm, 50 mm]", "drop: [20 mm]\n  duration: 100 ms")
    text = text.replace("levels: 7", "levels: 3")
    found = leg.compute(leg.parse(text, tmp_path), silent)
    assert found.rows and len(found.films) == 2
    film = next(iter(found.films.values()))
    assert film.points.shape == (len(film.times), 5, 3)
    assert set(film.muscles) == {f"{joint}{number}" for joint in ("side", "hip", "knee") for number in (1, 2)}
    for muscle in film.muscles.values():
        ends = muscle.parts[muscle.place]
        between = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
        assert (muscle.length < between).all() and (muscle.filling <= 1).all()
    foot = film.points[:, -1] @ film.normal - film.foot_radius
    assert foot.min() < 0 < film.force[:, 2].max()  # it touches the ground, and is pushed only there
    assert np.abs(film.force[foot > 1e-4]).max(initial=0) < 1e-6


def test_the_kinds_of_a_scenario_are_those_of_its_fields():
    for name, section in workbench.CONTROLLERS.items():
        text = workbench.with_section(workbench.START, section, ("controller",))
        found = workbench.chosen_kinds(Scenario.parse(text))
        assert found == {"controller": name, "angle": "sine", "stiffness": "step"}
