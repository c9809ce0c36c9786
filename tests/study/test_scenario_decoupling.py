"""Control by inversion in scenario files: what it takes from the plant, the estimate of the supply, and its gains."""

from pathlib import Path

import pytest

from mckibben.actuator import IdealValve
from mckibben.control import (
    DecouplingControl,
    ExtendedStateObserver,
    PolePlacement,
    PressureObserver,
)
from mckibben.scenario import Scenario
from mckibben.study.tune import gain_ranges
from mckibben.units import ms

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


def test_bandwidths_count_as_gains():
    assert "controller.feedback.bandwidth" in gain_ranges(scenario())
    assert "controller.feedback.reach" in gain_ranges(scenario(SLIDING))
