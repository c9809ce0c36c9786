"""Envelopes of robots: a knee as that of a joint, linear programs against closed forms, and what is refused."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import ParameterError, RangeError
from mckibben.reachability import envelope, static_envelope
from mckibben.reachability.envelope import _band_of_coupled
from mckibben.reachability.static import angles_within, coupled_envelope, pair_envelope
from mckibben.robot import RobotScenario
from mckibben.scenario.robot import read_robot
from mckibben.statics.posture import holding_torques
from mckibben.units import bar, deg
from tests.robot.conftest import as_joint

ROOT = Path(__file__).parents[2]
ONE = (ROOT / "tests/robot/one-joint.yaml").read_text(encoding="utf-8")
TORQUE = "\ncontroller: {feedback: {bandwidth: 40 rad/s}}\n"
NECK = """
reference:
  side: {angle: {class: sine, amplitude: 5 deg, frequency: 1 Hz}, stiffness: 30 N*m/rad}
  nod: {angle: 0 deg, stiffness: KNOD}
controller: {feedback: {bandwidth: 40 rad/s}}
duration: 1 s
control_period: 2 ms
"""


def neck(stiffness: str) -> RobotScenario:
    text = (ROOT / "examples/robot/neck.yaml").read_text(encoding="utf-8")
    return RobotScenario.parse(text + NECK.replace("KNOD", stiffness))


@pytest.mark.parametrize("stiffness", [15.0, 17.3])
@pytest.mark.slow
def test_a_knee_as_a_robot_has_the_envelope_of_the_joint(stiffness):
    """With a supply below the rating; the second stiffness is feasible with less amplitude alone."""
    text = ONE.replace("amplitude: 5 deg", "amplitude: 12 deg").replace("20 ms}", "20 ms, supply: 5.5 bar}")
    text = re.sub(r"stiffness: \{class: step.*\}", f"stiffness: {stiffness} N*m/rad", text)
    robot = RobotScenario.parse(text + "\ncontrollers: {knee: {class: decoupling, feedback: {bandwidth: 40 rad/s}}}\n")
    scenario = as_joint(robot)
    joint, knee = scenario.envelope(), robot.envelope()
    ours = knee.joints["knee"]
    theirs = static_envelope(scenario.plant(), angles=ours.static.angles)
    for name in ("torque", "torque_range", "stiffness", "pressures_at_lowest", "pressures_at_highest"):
        np.testing.assert_allclose(
            getattr(ours.static, name), getattr(theirs, name), rtol=1e-6, atol=1e-6, err_msg=name
        )
    for name in ("times", "desired_angle", "desired_stiffness", "lowest", "highest"):
        np.testing.assert_allclose(getattr(ours.reference, name), getattr(joint.reference, name), rtol=1e-6, atol=1e-9)
    assert knee.amplitude == joint.amplitude and knee.ok == joint.ok
    assert (knee.amplitude == 1.0) == (stiffness == 15.0)
    assert ours.stiffness == pytest.approx(joint.stiffness, rel=1e-6)
    assert ours.limits[1] == joint.only.limits[1]
    assert np.nanmax(ours.static.pressures_at_highest) == pytest.approx(5.5 * bar)
    with pytest.raises(ParameterError):
        knee.static  # noqa: B018


@pytest.mark.slow
def test_linear_programs_agree_with_the_closed_form_of_pairs():
    robot, posture, supply = read_robot("lei-leg"), [0.02, 0.01, -0.2], 5 * bar
    for index in range(3):
        programs = coupled_envelope(robot, index, posture, supply)

        def torque(angles, index=index):
            rows = np.tile(posture, (angles.size, 1))
            rows[:, index] = angles
            return holding_torques(robot, rows)[:, index]

        pair = robot.pair(index)
        rated = [dataclasses.replace(m.specimen.domain, pressure_max=supply) for m in pair.muscles]
        limited = [
            dataclasses.replace(m, specimen=dataclasses.replace(m.specimen, domain=d))
            for m, d in zip(pair.muscles, rated, strict=True)
        ]
        pair = dataclasses.replace(pair, muscle1=limited[0], muscle2=limited[1])
        closed = pair_envelope(pair, torque, angles=programs.angles)
        for name in ("torque_range", "stiffness"):
            np.testing.assert_allclose(getattr(programs, name), getattr(closed, name), rtol=1e-6, atol=1e-6)
        assert {limit.split(" at ")[1] for limit in programs.limits[1]} == {"highest pressure"}


@pytest.mark.slow
def test_a_neck_attains_its_references_together_or_not():
    """Two joints and three muscles: one stiffness determines the other."""
    scenario = neck("30 N*m/rad")
    angles = np.zeros((2, 1))
    low = _band_of_coupled(scenario, angles, np.full((2, 1), 30.0))
    fraction = (30.0 - low.lowest[0, 0]) / (low.highest[0, 0] - low.lowest[0, 0])
    nod = low.lowest[1, 0] + fraction * (low.highest[1, 0] - low.lowest[1, 0])  # on the line of co-contraction
    assert _band_of_coupled(scenario, angles, np.array([[30.0], [nod]])).together
    assert not _band_of_coupled(scenario, angles, np.array([[30.0], [nod + 1.0]])).together
    found = scenario.envelope()
    assert found.joints["side"].reference.times.size == 25
    assert not found.together and np.isnan(found.amplitude)
    assert found.joints["side"].static.limits[0][0].split(" at ")[0] in scenario.muscle_names


@pytest.mark.slow
def test_a_stiffness_out_of_range_has_a_remark_with_what_would_be_feasible():
    found = RobotScenario.parse(ONE.replace("after: 16 N*m/rad", "after: 30 N*m/rad") + TORQUE).envelope()
    assert not found.joints["knee"].feasible and "knee" in found.verdict()
    assert next(iter(found.remarks())).field == "reference"
    low, high = found.joints["knee"].stiffness
    assert 9 < low < high < 30


def test_coupled_muscles_need_laws_that_are_affine_in_pressure():
    scenario = neck("30 N*m/rad")
    unit = dataclasses.replace(
        scenario.robot.muscles[0], tendon=mk.SeriesSpring(stiffness=2e4, preload=50.0, travel=0.018)
    )
    robot = dataclasses.replace(scenario.robot, muscles=(unit, *scenario.robot.muscles[1:]))
    with pytest.raises(RangeError) as caught:
        envelope(scenario.model_copy(update={"robot": robot}))
    assert caught.value.field == "muscle" and caught.value.remedy


def test_whole_steps_of_angles():
    for low, high in ((-25 * deg, 30 * deg), (-3.3 * deg, 4 * deg), (0.0, 90 * deg)):
        angles = angles_within(low, high, 24)
        assert (angles[0], angles[-1]) == pytest.approx((low, high)) and 14 <= angles.size <= 40
        assert np.all(np.diff(angles) > 0)


@pytest.mark.slow
def test_the_command_shows_a_robot_without_a_reference(tmp_path):
    from typer.testing import CliRunner

    from mckibben.cli import app

    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["envelope", str(ROOT / "examples/robot/neck.yaml"), "--json", "--out", str(out)])
    assert result.exit_code == 0, result.output
    numbers = json.loads(result.stdout)
    assert numbers["columns"]["joint"]["values"] == ["side", "nod"] and "amplitude" not in numbers["scalars"]
    low, high = (numbers["columns"][f"{end}_stiffness"]["values"][0] for end in ("lowest", "highest"))
    assert 15 < low < high < 40
    assert (out / "envelope.svg").stat().st_size > 1000
