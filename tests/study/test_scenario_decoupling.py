"""Control by inversion in scenario files: what it takes from the plant, the estimate of the supply, and its gains."""

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
    SupplyLimit,
)
from mckibben.errors import ScenarioError
from mckibben.scenario import Scenario, find_parameter
from mckibben.study.tune import gain_ranges
from mckibben.units import bar, ms

TEXT = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
BEFORE, LOOPS = TEXT.split("controller:\n")
AFTER = LOOPS[LOOPS.index("reference:") :]


SLIDING = "  class: decoupling\n  feedback: {class: sliding, slope: 30 1/s, reach: 50 rad/s^2}\n"
SHORT = "  class: decoupling\n  feedback: {bandwidth: 50 rad/s}\n"


def scenario(controller=SHORT):
    return Scenario.parse(f"{BEFORE}controller:\n{controller}{AFTER}")


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
    assert "controller.feedback.reach" in gain_ranges(scenario(SLIDING))


def test_a_controller_without_a_class_is_two_loops():
    with pytest.raises(ScenarioError) as caught:
        scenario("  model: {geometry: knee-table-2, muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}}\n")
    found = [(one.field, one.message) for one in caught.value.problems]
    assert found == [("controller.position", "is missing"), ("controller.stiffness", "is missing")]
    assert isinstance(Scenario.parse(TEXT).control(), PositionStiffnessControl)
