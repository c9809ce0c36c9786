"""Predictive control in scenario files: it reads, writes, builds, can be varied and tuned, and says what is wrong."""

from pathlib import Path

import pytest

from mckibben.control import ExtendedStateObserver, LawAdaptation, PredictiveControl, PressureObserver, VelocityObserver
from mckibben.errors import ParameterError, ScenarioError
from mckibben.scenario import Scenario, batched, find_parameter, list_parameters
from mckibben.study.tune import gain_ranges
from mckibben.units import deg, ms

TEXT = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
BEFORE, LOOPS = TEXT.split("controller:\n")
AFTER = LOOPS[LOOPS.index("reference:") :]
SHORT = "  class: predictive\n  bandwidth: 70 rad/s\n"
FULL = """\
  class: predictive
  bandwidth: 70 rad/s
  stiffness_bandwidth: 90 rad/s
  damping: 2.5
  angle_scale: 0.2 deg
  stiffness_scale: 0.4 N*m/rad
  horizon: 80 ms
  stages: 16
  iterations: 2
  observer: {class: velocity, bandwidth: 300 rad/s}
  pressure_observer: {bandwidth: 150 rad/s}
  valve: {time_constant: 15 ms}
  minimum_tension: 8 N
  load: {from: knee-table-2, mass2: 0.6 kg}
  adaptation: {strength_spread: 0.05, torque_error: 0.04 N*m, bandwidth: 25 rad/s, drift_time: 20 s}
"""


def scenario(controller=SHORT):
    return Scenario.parse(f"{BEFORE}controller:\n{controller}{AFTER}")


def problems(controller):
    with pytest.raises(ScenarioError) as caught:
        scenario(controller)
    return caught.value.problems


def problem(controller):
    (found,) = problems(controller)
    return found


def test_what_is_left_out_is_that_of_the_plant_and_the_classes():
    short = scenario()
    control = short.control()
    assert isinstance(control, PredictiveControl)
    assert control.observer == ExtendedStateObserver() and control.pressure_observer == PressureObserver()
    assert control.load == short.plant().load
    assert control.valve.time_constant == pytest.approx(20 * ms)
    plain = PredictiveControl(control.model, control.load, bandwidth=70.0)
    for name in ("stiffness_bandwidth", "damping", "angle_scale", "stiffness_scale", "horizon", "stages", "iterations"):
        assert getattr(control, name) == getattr(plain, name)


def test_it_builds_what_it_says():
    control = scenario(FULL).control()
    assert (control.bandwidth, control.stiffness_bandwidth, control.damping) == (70.0, 90.0, 2.5)
    assert (control.angle_scale, control.stiffness_scale) == (pytest.approx(0.2 * deg), 0.4)
    assert (control.horizon, control.stages, control.iterations) == (pytest.approx(80 * ms), 16, 2)
    assert control.observer == VelocityObserver(300.0) and control.pressure_observer == PressureObserver(150.0)
    assert (control.valve.time_constant, control.minimum_tension, control.load.mass2) == (15 * ms, 8.0, 0.6)
    assert control.adaptation == LawAdaptation(0.05, torque_error=0.04, bandwidth=25.0, drift_time=20.0)
    assert scenario().control().adaptation is None


@pytest.mark.parametrize("controller", [SHORT, FULL])
def test_it_comes_back_from_its_text(controller):
    read = scenario(controller)
    assert Scenario.parse(read.dumps()) == read


def test_its_numbers_can_be_varied_and_have_a_value():
    for controller, count in ((SHORT, 8), (FULL, 18)):
        mine = [
            a
            for a in list_parameters(scenario(controller))
            if a.name.startswith("controller.") and not a.name.endswith("_amplitude")
        ]
        assert len(mine) >= count
        unset = [a.name for a in mine if a.nominal is None]
        assert set(unset) <= {f"controller.{each}" for each in ("adaptation.drift_time", "valve.rate", "valve.supply")}
    many = batched(scenario(), {"controller.damping": [2.0, 3.0]}).control()
    assert many.damping.tolist() == [2.0, 3.0]
    assert find_parameter(scenario(FULL), "controller.adaptation.mass_spread").nominal == 0.0
    assert find_parameter(scenario(), "controller.horizon").nominal == pytest.approx(60 * ms)
    for name in ("stages", "iterations"):
        with pytest.raises(ParameterError, match="size of what is compiled"):
            find_parameter(scenario(FULL), f"controller.{name}")
    with pytest.raises(ParameterError, match="follows the plant"):
        find_parameter(scenario(), "controller.load.mass2")
    with pytest.raises(ParameterError, match="outside 2"):
        batched(scenario(), {"controller.damping": [2.0, 3.5]})


def test_its_bandwidths_count_as_gains():
    both = {"controller.bandwidth", "controller.stiffness_bandwidth"}
    assert both <= set(gain_ranges(scenario()))
    found = {name.removeprefix("controller.") for name in gain_ranges(scenario(FULL))}
    others = {"observer.bandwidth", "pressure_observer.bandwidth"}
    assert found == {"bandwidth", "stiffness_bandwidth"} | others


def test_what_does_not_go_together_is_said():
    found = problem("  predictive: {bandwidth: 9 rad/s}\n")
    assert found.field == "controller" and "`class: predictive`" in found.remedy
    loops = [one.field for one in problems(LOOPS[: LOOPS.index("reference:")].rstrip() + f"\n{SHORT}")]
    assert loops == ["controller.position", "controller.stiffness"], "it has no loops"
    assert "outside" in problem(f"{SHORT}  stages: 0\n").message
    assert "outside" in problem(f"{SHORT}  damping: 1\n").message
    assert "friction" in problem(f"{SHORT}  friction_compensation: true\n").message
