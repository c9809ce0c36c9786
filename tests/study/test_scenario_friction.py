"""Friction in scenario files: it reads, writes, builds, runs through a study, and says what does not go together."""

from pathlib import Path

import jax
import numpy as np
import pytest

from mckibben.control import DecouplingControl, PositionStiffnessControl
from mckibben.errors import RangeError, ScenarioError
from mckibben.muscle import MaxwellSlip, NoFriction
from mckibben.reachability.envelope import envelope
from mckibben.scenario import Scenario, batched, find_parameter
from mckibben.study.sweep.feasibility import feasibility
from mckibben.units import bar, deg, mm

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


def compensated(text):
    plant, rest = text.split("controller:\n")
    _, others = rest.split("\nreference:")
    control = "class: decoupling\n  friction_compensation: true\n  feedback: {bandwidth: 80 rad/s}"
    return f"{plant}controller:\n  {control}\n\nreference:{others}"


COMPENSATED = compensated(with_friction())


def problem(text):
    with pytest.raises(ScenarioError) as caught:
        Scenario.parse(text)
    assert len(caught.value.problems) == 1, caught.value
    return caught.value.problems[0]


def test_it_builds_what_it_says():
    scenario = Scenario.parse(COMPENSATED)
    expected = MaxwellSlip(12.0, 0.5 * mm, growth=1 / bar, reference_pressure=3 * bar, viscous=20.0)
    joint = scenario.plant().joint
    assert joint.muscle1.friction == joint.muscle2.friction == expected
    control = scenario.control()
    assert isinstance(control, DecouplingControl) and control.friction_compensation
    assert control.model.muscle1.friction == expected
    assert len(scenario.initial(scenario.plant()).muscles[0].friction) == 6


def test_without_it_all_is_as_before():
    scenario = Scenario.parse(BASE)
    assert scenario.plant().joint.muscle1.friction == NoFriction()
    assert isinstance(scenario.control(), PositionStiffnessControl)
    assert "friction" not in scenario.dumps()


@pytest.mark.parametrize(
    "text", [COMPENSATED, with_friction((", growth: 1 N/bar, reference_pressure: 3 bar, viscous: 20 N*s/m", ""))]
)
def test_it_comes_back_from_its_text(text):
    scenario = Scenario.parse(text)
    written = scenario.dumps()
    assert Scenario.parse(written) == scenario
    assert ("viscous" in written) == ("viscous" in text)


def test_its_numbers_can_be_varied():
    scenario = Scenario.parse(COMPENSATED)
    name = "joint.muscle.friction.half_width"
    assert find_parameter(scenario, name).nominal == 12.0
    many = batched(scenario, {name: [8.0, 12.0]}, model_follows=[name])
    np.testing.assert_array_equal(many.plant().joint.muscle1.friction.half_width, [8.0, 12.0])
    assert np.ndim(jax.tree.leaves(many.control().model.muscle2.friction)[0]) == 1


def test_the_model_may_have_another_friction_or_none():
    own = BASE.replace(
        LOOP, f"  model: {{geometry: {{from: knee-table-2, connector_length: 208 mm}}, {MUSCLE}}}\n{LOOP}"
    )
    scenario = Scenario.parse(own.replace(f"\n  {MUSCLE}", f"\n  {RUBBING}", 1))
    assert scenario.plant().joint.muscle1.friction != NoFriction()
    assert scenario.control().model.muscle1.friction == NoFriction()


def test_what_does_not_go_together_is_said():
    found = problem(compensated(BASE))
    assert found.field == "controller" and "no muscle of its model has friction" in found.message
    spring = with_friction(
        (
            "connector_length: 208 mm}",
            "connector_length: 208 mm}\n  tendon: {stiffness: 20 N/mm, preload: 50 N, travel: 18 mm}",
        )
    )
    assert "viscous" in problem(spring).message
    assert "outside" in problem(with_friction(("half_width: 12 N", "half_width: 0 N"))).message
    assert "unit" in problem(with_friction(("growth: 1 N/bar", "growth: 1 N"))).message


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
def test_a_sweep_takes_it_into_the_attainable_stiffness():
    scenario = Scenario.parse(with_friction((LOOP, f"  stiffness_amplitude: 1 deg\n{LOOP}")))
    table = {"controller.stiffness_amplitude": np.array([0.3, 30.0]) * deg}
    short = feasibility(scenario, table, 2)["shortfall_max"]
    assert short[0] > short[1] + 20  # 13 to 17 N*m/rad are out of reach for small motion


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
