"""One muscle against a return spring: torque, stiffness, attainable set; files."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from mckibben import AntagonisticJoint, PairedPaths, Pulley, Scenario, catalog, return_spring
from mckibben.errors import RangeError, ScenarioError
from mckibben.units import N, bar, mm

MUSCLE = catalog.joint("knee-table-2").muscle1
PATHS = {1: Pulley(30 * mm, 150 * mm), 2: Pulley(25 * mm, 160 * mm)}
RATE, FREE_LENGTH = 4 * N / mm, 130 * mm
SPRING = return_spring(RATE, FREE_LENGTH)
JOINTS = {
    1: AntagonisticJoint(PairedPaths(PATHS[1], PATHS[2]), SPRING, MUSCLE),
    2: AntagonisticJoint(PairedPaths(PATHS[2], PATHS[1]), MUSCLE, SPRING),
}
FILE = Path(__file__).parents[2] / "examples" / "linear-axis.yaml"


@pytest.mark.parametrize("side", [1, 2])
def test_the_torque_is_that_of_muscle_and_spring(side):
    joint, pressures = JOINTS[side], (0.0, 3 * bar) if side == 1 else (3 * bar, 0.0)
    sign, angle = {1: -1, 2: 1}, np.array([-0.2, 0.0, 0.15])
    stretched = (150 * mm - sign[side] * 30 * mm * angle) - FREE_LENGTH
    tension = joint.tensions(angle, pressures)[2 - side]
    expected = sign[side] * 30 * mm * RATE * stretched + sign[3 - side] * 25 * mm * tension
    np.testing.assert_allclose(joint.torque(angle, pressures), expected, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, 2])
def test_a_torque_has_one_stiffness(side):
    joint, torque = JOINTS[side], 1.0 if side == 1 else -1.0
    pressures = joint.pressures_for(0.05, torque, None)
    assert float(pressures[side - 1]) == 0
    found, stiffness = joint.torque_and_stiffness(0.05, pressures)
    assert float(found) == pytest.approx(torque, abs=1e-9)
    np.testing.assert_allclose(joint.attainable_stiffness(0.05, torque), (stiffness, stiffness), rtol=1e-9)


def test_what_is_no_joint_is_refused():
    with pytest.raises(RangeError):
        AntagonisticJoint(PairedPaths(PATHS[1], PATHS[2]), SPRING, SPRING)
    with pytest.raises(RangeError):
        return_spring(-1.0, 0.1)
    text = FILE.read_text(encoding="utf-8")
    spring, muscle = (re.search(rf"  muscle{number}: (.*)", text)[1] for number in (1, 2))
    for old, new in ((muscle, spring), (muscle, "null"), ("muscle2:", "muscle:")):
        assert old in text
        with pytest.raises(ScenarioError):
            Scenario.parse(text.replace(old, new))


@pytest.mark.slow
def test_a_spring_of_another_rate_has_no_pressure_either():
    joint = dataclasses.replace(JOINTS[1], muscle1=dataclasses.replace(SPRING, strength=1.1))
    pressures = joint.pressures_for(0.05, 1.0, None)
    assert float(pressures[0]) == 0
    assert float(joint.torque(0.05, pressures)) == pytest.approx(1.0, abs=1e-9)
