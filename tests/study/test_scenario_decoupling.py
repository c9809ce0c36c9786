"""Control by inversion in scenario files: it reads, writes, builds, can be varied and tuned, and says what is wrong."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.control import (
    DecouplingControl,
    ExtendedStateObserver,
    PolePlacement,
    PositionStiffnessControl,
    PressureObserver,
    SlidingMode,
    SupplyLimit,
    VelocityObserver,
)
from mckibben.errors import ParameterError, ScenarioError
from mckibben.scenario import Scenario, batched, find_parameter, list_parameters
from mckibben.study.tune import gain_ranges
from mckibben.units import bar, ms

TEXT = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
BEFORE, LOOPS = TEXT.split("controller:\n")
AFTER = LOOPS[LOOPS.index("reference:") :]
FULL = """\
  class: decoupling
  feedback: {class: sliding, slope: 30 1/s, reach: 50 rad/s^2}
  observer: {class: velocity, bandwidth: 300 rad/s}
  pressure_observer: {bandwidth: 150 rad/s}
  valve: {time_constant: 15 ms}
  minimum_tension: 8 N
  load: {from: knee-table-2, mass2: 0.6 kg}
"""


SHORT = "  class: decoupling\n  feedback: {bandwidth: 50 rad/s}\n"


def scenario(controller=SHORT):
    return Scenario.parse(f"{BEFORE}controller:\n{controller}{AFTER}")


def problem(controller):
    with pytest.raises(ScenarioError) as caught:
        scenario(controller)
    assert len(caught.value.problems) == 1, caught.value
    return caught.value.problems[0]


def test_what_is_left_out_is_that_of_the_plant_and_the_classes():
    short = scenario()
    control = short.control()
    assert isinstance(control, DecouplingControl)
    assert control.feedback == PolePlacement(50.0)
    assert control.observer == ExtendedStateObserver() and control.pressure_observer == PressureObserver()
    assert control.valve.time_constant == pytest.approx(20 * ms)
    assert control.load == short.plant().load
    assert control.minimum_tension == 5.0 and not control.friction_compensation
    ideal = Scenario.parse(short.dumps().replace(short.dumps().split("valve:")[1].split("controller:")[0], " ideal\n"))
    assert isinstance(ideal.control().valve, IdealValve)


def test_it_builds_what_it_says():
    control = scenario(FULL).control()
    assert control.feedback == SlidingMode(30.0, 50.0)
    assert control.observer == VelocityObserver(300.0) and control.pressure_observer == PressureObserver(150.0)
    assert (control.valve.time_constant, control.minimum_tension, control.load.mass2) == (15 * ms, 8.0, 0.6)
    assert scenario(FULL).plant().load.mass2 == 0.5


@pytest.mark.parametrize(
    "controller",
    [FULL, "  class: decoupling\n  feedback: {bandwidth: 50 rad/s, integral: true}\n  load: knee-table-2\n"],
)
def test_it_comes_back_from_its_text(controller):
    read = scenario(controller)
    assert Scenario.parse(read.dumps()) == read
    assert read.dumps().count("observer") == controller.count("observer")


def test_all_its_numbers_can_be_varied_and_have_a_value():
    for controller in (FULL, f"{SHORT}  observer: {{bandwidth: 90 rad/s}}\n"):
        read = scenario(controller)
        mine = [a for a in list_parameters(read) if a.name.startswith(("controller.feedback.", "controller.observer."))]
        assert len(mine) >= 3
        assert all(a.nominal is not None for a in mine), mine
    assert find_parameter(scenario(), "controller.minimum_tension").nominal == 5.0
    assert find_parameter(scenario(), "controller.feedback.damping").nominal == 3.0
    assert find_parameter(scenario(FULL), "controller.valve.time_constant").nominal == 0.015
    assert find_parameter(scenario(FULL), "controller.load.mass2").nominal == 0.6
    many = batched(scenario(FULL), {"controller.load.mass2": [0.4, 0.5], "load.mass2": [0.5, 0.5]})
    np.testing.assert_array_equal(many.control().load.mass2, [0.4, 0.5])
    with pytest.raises(ParameterError, match="follows the plant"):
        find_parameter(scenario(), "controller.load.mass2")
    with pytest.raises(ParameterError, match="outside above 0"):
        batched(scenario(), {"controller.feedback.bandwidth": [50.0, 0.0]})


def test_the_supply_may_be_estimated_around_any_controller():
    for controller in (SHORT, LOOPS[: LOOPS.index("reference:")]):
        inner = controller.replace("\n  ", "\n    ").removeprefix("  ")
        read = scenario(f"  class: supply_limit\n  recovery: 0.2 bar/s\n  controller:\n    {inner}")
        control = read.control()
        assert isinstance(control, SupplyLimit) and type(control.controller) is type(scenario(controller).control())
        assert (control.recovery, control.valve.time_constant) == (0.2 * bar, 20 * ms)
        assert Scenario.parse(read.dumps()) == read
        assert find_parameter(read, "controller.recovery").nominal == 0.2 * bar


def test_commands_on_their_way_are_no_lack_of_supply():
    """A step to the limit of the pressures, with enough supply, must not lower the estimate during the delay."""
    steps = "  angle: {class: step, before: 0 deg, after: 14 deg, at: 0.3 s}\n"
    steps += "  stiffness: {class: step, before: 10 N*m/rad, after: 18.5 N*m/rad, at: 0.2 s}\n"
    controller = "  class: supply_limit\n  controller:\n    class: decoupling\n    minimum_tension: 0 N\n"
    controller += "    feedback: {bandwidth: 25 rad/s}\n"
    text = f"{BEFORE}command_delay: 12 ms\ncontroller:\n{controller}reference:\n{steps}"
    text += "duration: 0.6 s\ncontrol_period: 1 ms\n"
    result = Scenario.parse(text).simulate()
    assert np.max(result["command1"]) == pytest.approx(6 * bar)
    assert np.min(result["supply_estimate"]) == pytest.approx(6 * bar)  # 5.7 bar without the delay


def test_bandwidths_count_as_gains():
    assert "controller.feedback.bandwidth" in gain_ranges(scenario())
    assert "controller.feedback.reach" in gain_ranges(scenario(FULL))


def test_what_does_not_go_together_is_said():
    missing = problem("  class: decoupling\n  minimum_tension: 5 N\n")
    assert (missing.field, missing.message) == ("controller.feedback", "is missing")
    found = problem("  decoupling: {poles: {bandwidth: 50 rad/s}}\n")
    assert found.field == "controller" and "`class: decoupling`" in found.remedy
    assert "unit" in problem(SHORT.replace("50 rad/s", "50 Hz*m")).message
    assert "outside" in problem(SHORT.replace("50 rad/s", "0 rad/s")).message
    assert "friction" in problem(f"{SHORT}  friction_compensation: true\n").message
    unknown = problem("  class: decuopling\n  feedback: {bandwidth: 50 rad/s}\n")
    assert unknown.field == "controller" and "did you mean 'decoupling'" in unknown.remedy


def test_a_controller_without_a_class_is_two_loops():
    with pytest.raises(ScenarioError) as caught:
        scenario("  model: {geometry: knee-table-2, muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}\n")
    found = [(one.field, one.message) for one in caught.value.problems]
    assert found == [("controller.position", "is missing"), ("controller.stiffness", "is missing")]
    assert isinstance(Scenario.parse(TEXT).control(), PositionStiffnessControl)
