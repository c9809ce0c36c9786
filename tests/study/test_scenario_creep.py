"""Creep in scenario files: it reads, writes, builds, varies, and says what does not go together."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.errors import ScenarioError
from mckibben.muscle import MaxwellCreep, NoCreep
from mckibben.scenario import Scenario, batched, find_parameter

BASE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
MUSCLE = "law: lei-mas-10-180n}"
CREEPING = BASE.replace(MUSCLE, "law: lei-mas-10-180n, creep: {stiffness: 0.5 N/mm, time_constant: 8 s}}")


def problem(text):
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(text)
    assert len(caught.value.problems) == 1, caught.value
    return caught.value.problems[0]


def test_it_builds_what_it_says_and_comes_back_from_its_text():
    scenario = Scenario.parse(CREEPING)
    joint = scenario.plant().joint
    assert joint.muscle1.creep == joint.muscle2.creep == MaxwellCreep(500.0, 8.0)
    start = scenario.initial(scenario.plant())
    assert [float(x) for muscle in start.muscles for x in muscle.creep] == [0.0, 0.0]
    written = scenario.dumps()
    assert Scenario.parse(written) == scenario and "creep: {stiffness: 0.5 N/mm, time_constant: 8 s}" in written


def test_creep_after_steps_of_the_pressure_comes_back_from_its_text():
    shared = "{stiffness: 0.5 N/mm, time_constant: 8 s, pressure_share: 6 %, pressure_time_constant: 3 s}"
    scenario = Scenario.parse(CREEPING.replace("{stiffness: 0.5 N/mm, time_constant: 8 s}", shared))
    creep = scenario.plant().joint.muscle1.creep
    assert creep == MaxwellCreep(500.0, 8.0, pressure_share=0.06, pressure_time_constant=3.0)
    assert Scenario.parse(scenario.dumps()) == scenario
    start = scenario.initial(scenario.plant())
    assert [float(muscle.creep[1]) for muscle in start.muscles] == [float(p) for p in start.pressures]
    alone = problem(CREEPING.replace("time_constant: 8 s", "time_constant: 8 s, pressure_time_constant: 3 s"))
    assert alone.field.endswith("creep.pressure_time_constant")
    assert find_parameter(scenario, "joint.muscle.creep.pressure_share").nominal == 0.06


def test_without_it_all_is_as_before():
    scenario = Scenario.parse(BASE)
    assert scenario.plant().joint.muscle1.creep == NoCreep() and "creep" not in scenario.dumps()


def test_its_numbers_can_be_varied():
    scenario = Scenario.parse(CREEPING)
    name = "joint.muscle.creep.time_constant"
    assert find_parameter(scenario, name).nominal == 8.0
    np.testing.assert_array_equal(
        batched(scenario, {name: [2.0, 8.0]}).plant().joint.muscle2.creep.time_constant, [2, 8]
    )


def test_what_does_not_go_together_is_said():
    spring = "connector_length: 208 mm}\n  tendon: {stiffness: 20 N/mm, preload: 50 N, travel: 18 mm}"
    found = problem(CREEPING.replace("connector_length: 208 mm}", spring))
    assert found.field == "joint" and "creep" in found.message
    assert "outside" in problem(CREEPING.replace("8 s}", "1 ms}")).message
    assert problem(CREEPING.replace(", time_constant: 8 s", "")).field.endswith("time_constant")
