"""Control by inversion in scenario files: it reads, writes, builds, can be varied and tuned, and says what is wrong."""

from pathlib import Path

import numpy as np
import pytest

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
  valve_time_constant: 15 ms
  minimum_tension: 8 N
  load: {from: knee-table-2, mass2: 0.6 kg}
"""


def scenario(controller="  class: decoupling, feedback: {bandwidth: 50 rad/s}\n"):
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
    assert control.valve_time_constant == pytest.approx(20 * ms)
    assert control.load == short.plant().load
    assert control.minimum_tension == 5.0 and not control.friction_compensation
    ideal = Scenario.parse(short.dumps().replace(short.dumps().split("valve:")[1].split("controller:")[0], " ideal\n"))
    assert ideal.control().valve_time_constant == 0.0


def test_it_builds_what_it_says():
    control = scenario(FULL).control()
    assert control.feedback == SlidingMode(30.0, 50.0)
    assert control.observer == VelocityObserver(300.0) and control.pressure_observer == PressureObserver(150.0)
    assert (control.valve_time_constant, control.minimum_tension, control.load.mass2) == (15 * ms, 8.0, 0.6)
    assert scenario(FULL).plant().load.mass2 == 0.5


@pytest.mark.parametrize(
    "controller", [FULL, "  class: decoupling, feedback: {bandwidth: 50 rad/s, integral: true}, load: knee-table-2\n"]
)
def test_it_comes_back_from_its_text(controller):
    read = scenario(controller)
    assert Scenario.parse(read.dumps()) == read
    assert read.dumps().count("observer") == controller.count("observer")


def test_all_its_numbers_can_be_varied_and_have_a_value():
    for controller in (
        FULL,
        "  class: decoupling, feedback: {bandwidth: 50 rad/s}, observer: {bandwidth: 90 rad/s}\n",
    ):
        read = scenario(controller)
        mine = [a for a in list_parameters(read) if a.name.startswith("controller.decoupling.")]
        assert len(mine) >= 4
        assert all(a.nominal is not None for a in mine), mine
    assert find_parameter(scenario(), "controller.minimum_tension").nominal == 5.0
    assert find_parameter(scenario(), "controller.feedback.damping").nominal == 3.0
    assert find_parameter(scenario(), "controller.valve_time_constant").nominal == 0.02
    assert find_parameter(scenario(FULL), "controller.load.mass2").nominal == 0.6
    many = batched(scenario(FULL), {"controller.load.mass2": [0.4, 0.5], "load.mass2": [0.5, 0.5]})
    np.testing.assert_array_equal(many.control().load.mass2, [0.4, 0.5])
    with pytest.raises(ParameterError, match="the controller's load is that of the plant itself"):
        find_parameter(scenario(), "controller.load.mass2")
    with pytest.raises(ParameterError, match="outside above 0"):
        batched(scenario(), {"controller.feedback.bandwidth": [50.0, 0.0]})


def test_the_supply_may_be_estimated_around_any_controller():
    for controller in ("  class: decoupling, feedback: {bandwidth: 50 rad/s}\n", LOOPS[: LOOPS.index("reference:")]):
        read = scenario(f"{controller.rstrip()}\n  supply_limit: {{recovery: 0.2 bar/s}}\n")
        control = read.control()
        assert isinstance(control, SupplyLimit) and type(control.controller) is type(scenario(controller).control())
        assert (control.recovery, control.valve_time_constant) == (0.2 * bar, 20 * ms)
        assert Scenario.parse(read.dumps()) == read
        assert find_parameter(read, "controller.supply_limit.valve_time_constant").nominal == 0.02


def test_bandwidths_count_as_gains():
    assert list(gain_ranges(scenario())) == ["controller.feedback.bandwidth"]
    assert "controller.feedback.reach" in gain_ranges(scenario(FULL))


def test_what_does_not_go_together_is_said():
    assert "has no feedback" in problem("  class: decoupling, minimum_tension: 5 N\n").message
    both = "  class: decoupling, feedback: {bandwidth: 50 rad/s}, feedback: {class: sliding, slope: 30 1/s, reach: 50 rad/s^2}\n"
    assert "poles and sliding at once" in problem(both).message
    nine = "{bandwidth: 9 rad/s}"
    two = f"{{feedback: {nine}, observer: {class: velocity, nine}, observer: {nine}}}"
    assert "beside velocity_observer" in problem(f"  decoupling: {two}\n").message
    found = problem(LOOPS[: LOOPS.index("reference:")] + "  class: decoupling, feedback: {bandwidth: 50 rad/s}\n\n")
    assert found.field == "controller.decoupling" and "beside position and stiffness" in found.message
    assert "unit" in problem("  class: decoupling, feedback: {bandwidth: 50 Hz*m}\n").message
    assert "outside" in problem("  class: decoupling, feedback: {bandwidth: 0 rad/s}\n").message
    assert "friction" in problem("  class: decoupling, feedback: {bandwidth: 5 rad/s}\n  friction_compensation: true\n").message


def test_a_controller_needs_one_form_or_the_other():
    found = problem(
        "  model: {geometry: knee-table-2, muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}\n"
    )
    assert (found.field, found.message) == ("controller", "lacks position and stiffness")
    assert "decoupling" in found.remedy
    assert isinstance(Scenario.parse(TEXT).control(), PositionStiffnessControl)
