"""A learned inverse and a minimum tension beside two loops in scenario files."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.control import InverseModelControl, PositionStiffnessControl
from mckibben.errors import ParameterError, ScenarioError
from mckibben.scenario import Scenario, batched, find_parameter, list_parameters
from mckibben.study.tune import gain_ranges

TEXT = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
BEFORE, AFTER = TEXT.split("reference:")
KEEPING = "    minimum_tension: 8 N\n"
FULL = """\
  learning_rate: 3 1/s
  hidden: 12
  valve: {time_constant: 15 ms}
  filter_bandwidth: 50 rad/s
  angle_scale: 10 deg
  velocity_scale: 2 rad/s
  acceleration_scale: 9 rad/s^2
  stiffness_scale: 4 N*m/rad
  pressure_scale: 0.5 bar
  seed: 7
  load: {from: knee-table-2, mass2: 0.6 kg}
"""
MUSCLE = "law: lei-mas-10-180n}"
RUBBING = "law: lei-mas-10-180n, friction: {half_width: 12 N, presliding_length: 0.5 mm}}"
ALONE = "  load: none\n"


def text_of(more, loops=""):
    plant, own = BEFORE.split("controller:\n")
    inner = "".join(f"  {line}\n" for line in own.splitlines() if line.strip())
    return f"{plant}controller:\n  class: inverse_model\n{more}  loops:\n{inner}{loops}\nreference:{AFTER}"


def scenario(more="  learning_rate: 5 1/s\n", loops=""):
    return Scenario.parse(text_of(more, loops))


def problem(more, loops=""):
    with pytest.raises(ScenarioError) as caught:
        scenario(more, loops)
    assert len(caught.value.problems) == 1, caught.value
    return caught.value.problems[0]


def test_it_builds_what_it_says():
    control = scenario(FULL, KEEPING).control()
    assert isinstance(control, InverseModelControl)
    assert (control.learning_rate, control.hidden, control.seed) == (3.0, 12, 7)
    assert (control.valve.time_constant, control.filter_bandwidth) == (0.015, 50.0)
    assert (control.velocity_scale, control.acceleration_scale, control.stiffness_scale) == (2.0, 9.0, 4.0)
    assert (control.angle_scale, control.pressure_scale) == pytest.approx((np.pi / 18, 0.5e5))
    assert control.load.mass2 == 0.6 and control.loops.minimum_tension == 8.0


def test_what_is_left_out_is_that_of_the_plant_and_the_class():
    short = scenario()
    control, plain = short.control(), Scenario.parse(TEXT).control()
    assert control == InverseModelControl(plain, short.plant().load, learning_rate=5.0, valve=FirstOrderValve(0.02))
    assert plain.minimum_tension is None
    assert scenario(ALONE).control().load is None
    kept = Scenario.parse(f"{BEFORE.rstrip()}\n  minimum_tension: 5 N\nreference:{AFTER}").control()
    assert isinstance(kept, PositionStiffnessControl) and kept.minimum_tension == 5.0


@pytest.mark.parametrize("more", [FULL, ALONE])
def test_it_comes_back_from_its_text(more):
    assert Scenario.parse(scenario(more).dumps()) == scenario(more)


def test_its_numbers_can_be_varied_and_have_a_value():
    for more in (FULL, "  learning_rate: 5 1/s\n"):
        mine = [a for a in list_parameters(scenario(more)) if a.name.count(".") == 1 and a.part == "controller"]
        assert len(mine) >= 8
        assert all(a.nominal is not None for a in mine), mine
    assert find_parameter(scenario(FULL), "controller.valve.time_constant").nominal == 0.015
    values = {"controller.learning_rate": [1.0, 2.0], "controller.loops.minimum_tension": [5.0, 6.0]}
    many = batched(scenario(FULL), values).control()
    np.testing.assert_array_equal(many.learning_rate, [1.0, 2.0])
    np.testing.assert_array_equal(many.loops.minimum_tension, [5.0, 6.0])
    many = batched(scenario(FULL), {"controller.load.mass2": [0.4, 0.5]})
    np.testing.assert_array_equal(many.control().load.mass2, [0.4, 0.5])
    with pytest.raises(ParameterError, match="follows the plant"):
        find_parameter(scenario(), "controller.load.mass2")
    with pytest.raises(ParameterError, match="outside above 0"):
        batched(scenario(FULL), {"controller.loops.minimum_tension": [5.0, 0.0]})


def test_only_the_loops_have_gains():
    """How fast it learns is none: no feedback goes faster with it."""
    assert all(name.split(".")[2] in ("position", "stiffness") for name in gain_ranges(scenario(FULL)))


def test_what_does_not_go_together_is_said():
    assert "outside" in problem("", "    minimum_tension: 0 N\n").message
    found = Scenario.parse(f"{BEFORE.rstrip()}\n  minimum_tension: 5 N\nreference:{AFTER}")
    assert isinstance(found.control(), PositionStiffnessControl)
    with pytest.raises(ScenarioError, match="class: inverse_model"):
        Scenario.parse(f"{BEFORE.rstrip()}\n  inverse_model: {{learning_rate: 5 1/s}}\n\nreference:{AFTER}")
