"""Robots whose muscles have different valves."""

import shutil
import subprocess

import numpy as np
import pytest

import mckibben as mk
from mckibben.actuator import ValveGroup, ValvesByMuscle
from mckibben.codegen.native import compiler
from mckibben.errors import RangeError, ScenarioError
from mckibben.export import export
from mckibben.robot import RobotScenario
from mckibben.scenario import with_values
from tests.robot.test_control import DECOUPLING, ONE, TORQUE

PROPORTIONAL = "{class: regulator, conductance: 0.5 L/(s*bar), supply: 7 bar, time_constant: 5 ms, dead_volume: 3 cm^3}"
SWITCHING = "{from: festo-mh1, supply: 6.5 bar, period: 20 ms}"
GROUPS = f"""valve:
  class: by_muscle
  groups:
    - {{muscles: [knee1], valve: {PROPORTIONAL}}}
    - {{muscles: ["knee*"], valve: {SWITCHING}}}
"""
PAIR = f"valve: {{class: unequal, muscle1: {PROPORTIONAL}, muscle2: {SWITCHING}}}\n"
LEG = """
name: leg
robot: {from: lei-leg, base: fixed}
valve:
  class: by_muscle
  groups:
    - {muscles: ["hip*"], valve: {time_constant: 10 ms, supply: 5 bar}}
    - {muscles: ["knee?", "side?"], valve: {time_constant: 30 ms, supply: 4 bar}}
controllers:
  side: {class: decoupling, feedback: {bandwidth: 40 rad/s}}
  hip: {class: decoupling, feedback: {bandwidth: 40 rad/s}}
  knee: {class: decoupling, feedback: {bandwidth: 40 rad/s}}
reference:
  side: {angle: 0 deg, stiffness: 14 N*m/rad}
  hip: {angle: 0 deg, stiffness: 14 N*m/rad}
  knee: {angle: 0 deg, stiffness: 14 N*m/rad}
duration: 1 s
"""


def one(valve, controller=TORQUE):
    return RobotScenario.parse(ONE.replace("valve: {time_constant: 20 ms}\n", valve) + controller)


@pytest.mark.slow
@pytest.mark.parametrize("controller", [TORQUE, DECOUPLING], ids=["computed torque", "decoupling"])
def test_a_pair_by_names_is_a_pair(controller):
    named, pair = one(GROUPS, controller), one(PAIR, controller)
    run, again = named.run_once(), pair.run_once()
    np.testing.assert_array_equal(run["angle"], again["angle"])
    np.testing.assert_array_equal(run["command"], again["command"])
    np.testing.assert_array_equal(named.margins(3).disk, pair.margins(3).disk)


def test_a_file_with_a_valve_for_each_muscle_reads_back():
    scenario = one(GROUPS)
    again = RobotScenario.parse(scenario.dumps())
    assert again.valve == scenario.valve and again.valve.assigned == (0, 1)
    assert scenario.supply == 6.5e5  # which all muscles reach
    assert with_values(scenario, {"valve.groups.0.valve.supply": 6e5}).supply == 6e5


@pytest.mark.slow
def test_a_controller_of_a_joint_has_the_valves_of_its_muscles():
    scenario = RobotScenario.parse(LEG)
    lags = {name: [float(one.valve.for_muscle(i).lag) for i in (0, 1)] for name, one in scenario.controllers.items()}
    assert lags == {"side": [0.03, 0.03], "hip": [0.01, 0.01], "knee": [0.03, 0.03]}
    limits = scenario.plant().clip_commands((1e6,) * 6)
    assert [float(limit) for limit in limits] == [4e5, 4e5, 5e5, 5e5, 4e5, 4e5]


def test_a_muscle_without_a_valve_is_named():
    with pytest.raises(ScenarioError) as caught:
        one(GROUPS.replace("knee*", "ankle*"))
    (problem,) = caught.value.problems
    assert (problem.field, problem.value) == ("valve.groups", "knee2")
    with pytest.raises(ScenarioError) as caught:
        one(GROUPS.replace("[knee1]", '["*"]'))
    assert caught.value.problems[0].field == "valve.groups[1].muscles"
    with pytest.raises(RangeError) as refused:
        ValvesByMuscle((ValveGroup(("a",), mk.FirstOrderValve(0.01)), ValveGroup(("b",), mk.FlowValve(1e-9, 6e5))))
    assert refused.value.field == "groups.1.valve"


@pytest.mark.skipif(compiler() is None or shutil.which("make") is None, reason="there is no cc or make")
@pytest.mark.slow
def test_its_controller_in_c_repeats_the_run(tmp_path):
    export(one(GROUPS), "c", tmp_path, name="robot")
    subprocess.run(["make", "-s", "replay"], cwd=tmp_path, check=True)
    done = subprocess.run(["./replay", "replay.csv", "0"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert float(done.stdout.split(",")[1].split()[0]) < 1e-11
