"""Friction in scenario files: stiffness of a motion, its envelope and feasibility, and oscillation after sticking."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.errors import RangeError
from mckibben.reachability.envelope import envelope
from mckibben.scenario import Scenario, find_parameter
from mckibben.units import deg

BASE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
MUSCLE = "muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}"
RUBBING = (
    "muscle:\n    specimen: MAS-10-180N-AA-MC-O\n    law: lei-mas-10-180n\n"
    "    friction: {half_width: 12 N, presliding_length: 0.5 mm, growth: 1 N/bar, reference_pressure: 3 bar, "
    "viscous: 20 N*s/m}"
)
LOOP = "  stiffness: {kp:"


def with_friction(*changes):
    text = BASE.replace(MUSCLE, RUBBING)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_the_stiffness_of_a_motion_is_controlled_by_any_controller():
    loops = BASE[BASE.index("  position: {kp:") : BASE.index("  # model:")]
    decoupling = "  class: decoupling\n  feedback: {bandwidth: 80 rad/s}\n"
    for part in ("", decoupling, "  class: predictive\n  bandwidth: 80 rad/s\n"):
        text = with_friction((LOOP, f"  stiffness_amplitude: 1 deg\n{LOOP}"))
        text = (
            text.replace(
                loops.replace(LOOP, f"  stiffness_amplitude: 1 deg\n{LOOP}"), f"  stiffness_amplitude: 1 deg\n{part}"
            )
            if part
            else text
        )
        scenario = Scenario.parse(text)
        assert Scenario.parse(scenario.dumps()) == scenario
        assert scenario.control().stiffness_amplitude == pytest.approx(1 * deg)
        assert find_parameter(scenario, "controller.stiffness_amplitude").unit == "rad"
    assert Scenario.parse(BASE).control().stiffness_amplitude is None


def test_an_envelope_of_the_isobaric_stiffness_refuses_another():
    scenario = Scenario.parse(with_friction((LOOP, f"  stiffness_amplitude: 1 deg\n{LOOP}")))
    with pytest.raises(RangeError) as refused:
        envelope(scenario)
    assert refused.value.field == "controller.stiffness_amplitude"


@pytest.mark.slow
def test_a_loop_that_is_unstable_while_the_joint_sticks_oscillates_after_a_push():
    text = BASE[: BASE.index("reference:")] + "reference: {angle: 5 deg, stiffness: 15 N*m/rad}\n"
    text += "start: {angle: 0 deg, stiffness: 12 N*m/rad}\nduration: 30 s\ncontrol_period: 1 ms\n"
    text += "friction: {torque: 1.5 N*m}\n"
    push = "disturbance: {height: 0.02 N*m, width: 50 ms, interval: 200 s, start: 10 s}\n"
    assert Scenario.parse(text).margins(2).radius[0] > 1
    quiet, pushed = (Scenario.parse(one).simulate() for one in (text, text + push))
    assert np.ptp(quiet["angle"][-2000:]) < 1e-6 * deg
    assert 0.1 * deg < np.ptp(pushed["angle"][-2000:]) < 0.5 * deg
