"""One muscle against a return spring: torque, stiffness, attainable set; a linear axis; files."""

import numpy as np
import pytest

from mckibben import (
    AntagonisticJoint,
    PairedPaths,
    Pulley,
    Scenario,
    catalog,
    return_spring,
)
from mckibben.config.document import to_text
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
PID = {
    "position": {"kp": "2 bar/rad", "ki": "60 bar/(rad*s)", "kd": "0.4 bar*s/rad"},
    "stiffness": {"kp": "0 bar/(N*m/rad)", "ki": "0 bar/(N*m*s/rad)", "kd": "0 bar*s/(N*m/rad)"},
}


def scenario(side=1, **joint):
    muscle = {"specimen": "MAS-10-180N-AA-MC-O", "law": "lei-mas-10-180n"}
    spring = {"class": "return_spring", "rate": "4 N/mm", "free_length": "130 mm"}
    path = {"class": "Pulley", "radius": "30 mm", "rest_length": "155 mm"}
    return {
        "name": "return spring",
        "joint": {
            "geometry": {"class": "PairedPaths", "path1": path, "path2": path},
            f"muscle{side}": spring,
            f"muscle{3 - side}": muscle,
            **joint,
        },
        "load": "knee-table-2",
        "valve": {"time_constant": "20 ms"},
        "controller": PID,
        "reference": {
            "angle": {"class": "sine", "amplitude": "5 deg", "frequency": "0.5 Hz"},
            "stiffness": "10 N*m/rad",
        },
        "start": {"angle": "0 deg"},
        "duration": "2 s",
        "control_period": "1 ms",
    }


def read(**changes):
    return Scenario.parse(to_text(scenario(**changes)))


@pytest.mark.parametrize("side", [1, 2])
def test_the_torque_is_that_of_muscle_and_spring(side):
    joint, pressures = JOINTS[side], (0.0, 3 * bar) if side == 1 else (3 * bar, 0.0)
    sign, angle = {1: -1, 2: 1}, np.array([-0.2, 0.0, 0.15])
    stretched = (150 * mm - sign[side] * 30 * mm * angle) - FREE_LENGTH
    tension = joint.tensions(angle, pressures)[2 - side]
    expected = sign[side] * 30 * mm * RATE * stretched + sign[3 - side] * 25 * mm * tension
    np.testing.assert_allclose(joint.torque(angle, pressures), expected, atol=1e-9)


@pytest.mark.parametrize("side", [1, 2])
def test_a_torque_has_one_stiffness(side):
    joint, torque = JOINTS[side], 1.0 if side == 1 else -1.0
    pressures = joint.pressures_for(0.05, torque, None)
    assert float(pressures[side - 1]) == 0
    found, stiffness = joint.torque_and_stiffness(0.05, pressures)
    assert float(found) == pytest.approx(torque, abs=1e-9)
    np.testing.assert_allclose(joint.attainable_stiffness(0.05, torque), (stiffness, stiffness), rtol=1e-9)


def test_a_linear_axis_is_a_pulley_of_1_m():
    """Metres for radians, newtons for newton metres, kilograms for kg*m^2."""
    joint = AntagonisticJoint(PairedPaths(Pulley(1.0, 150 * mm), Pulley(1.0, 155 * mm)), SPRING, MUSCLE)
    pressures = joint.pressures_for(0.0, 0.0, None)
    extension = 150 * mm - FREE_LENGTH
    assert float(joint.tensions(0.0, pressures)[1]) == pytest.approx(RATE * extension)
    muscle = MUSCLE.slope(MUSCLE.specimen.contraction_at(155 * mm), pressures[1]) / MUSCLE.specimen.initial_length
    assert float(joint.stiffness(0.0, pressures)) == pytest.approx(RATE - float(muscle))


def test_what_is_no_joint_is_refused():
    with pytest.raises(RangeError):
        AntagonisticJoint(PairedPaths(PATHS[1], PATHS[2]), SPRING, SPRING)
    with pytest.raises(RangeError):
        return_spring(-1.0, 0.1)
    spring, muscle = (scenario()["joint"][name] for name in ("muscle1", "muscle2"))
    for joint in ({"muscle2": spring}, {"muscle2": None}, {"muscle": muscle}):
        with pytest.raises(ScenarioError):
            read(**joint)
