"""Tuning and comparison of the pages: the numbers of the commands."""

import io
import json
import zipfile

import pytest

pytest.importorskip("nicegui")

from mckibben import Scenario
from mckibben.errors import ParameterError
from mckibben.study.tune import parse_cost, tune
from mckibben.web import studies, workbench

SHORT = workbench.START.replace("duration: 6 s", "duration: 0.6 s").replace("at: 3 s", "at: 0.2 s")


def silent(_step, _part):
    pass


@pytest.mark.slow
def test_gains_are_tuned_as_by_the_command_and_go_into_the_scenario(tmp_path):
    over = "controller.position.ki\ncontroller.position.kp"
    request = studies.TuningRequest(over=over, method="local", iterations=4)
    presented, text, scenarios = studies.tuned(SHORT, request, tmp_path, silent)
    result, scenario = presented.result, Scenario.parse(SHORT)
    cost = parse_cost(request.cost, gain_margin=request.gain_margin)
    names = ["controller.position.ki", "controller.position.kp"]
    expected = tune(scenario, names, cost, method=request.method, iterations=4)
    assert text == SHORT
    assert result.cost == expected.cost < result.cost_before
    assert scenarios == {"tuned": expected.scenarios[0]}
    assert [row[0] for row in presented.listings[1].rows()] == names
    assert presented.picture.startswith(b"\x89PNG")
    with zipfile.ZipFile(io.BytesIO(presented.archive())) as archive:
        assert json.loads(archive.read("results.json"))["verdict"] == result.verdict()
        assert archive.read("figure.png") == presented.picture


@pytest.mark.slow
def test_controllers_are_compared_on_the_same_runs(tmp_path):
    kinds = ("model inversion (decoupling)",)
    request = studies.ComparisonRequest(("two PID loops", *kinds), "load.mass2=+-20 %", runs=8, generations=1)
    steps = []
    presented, _, scenarios = studies.compared(SHORT, request, tmp_path, lambda step, _: steps.append(step))
    assert any("(2 of 2): evaluation runs, the last part" in step for step in steps)
    errors, at_air, _ = (listing.rows() for listing in presented.listings)
    assert {row[0] for row in errors} == set(scenarios) == {"scenario", *kinds}
    assert at_air[0][0] == "scenario"
    assert all(0 < float(median) <= float(late) for _, median, late, *_ in errors)
    for scenario in scenarios.values():
        assert Scenario.parse(scenario.dumps()).control() == scenario.control()


def test_a_controller_is_not_compared_with_itself(tmp_path):
    with pytest.raises(ParameterError):
        studies.compared(SHORT, studies.ComparisonRequest(("two PID loops",)), tmp_path, silent)


def test_the_kinds_of_a_scenario_are_those_of_its_fields():
    for name, section in workbench.CONTROLLERS.items():
        text = workbench.with_section(workbench.START, section, ("controller",))
        found = workbench.chosen_kinds(Scenario.parse(text))
        assert found == {"controller": name, "angle": "sine", "stiffness": "step"}
