"""What a push feels, against the closed form of a joint at constant pressures, and the joint as a robot."""

import re

import numpy as np
import pytest

from mckibben.errors import RangeError
from mckibben.report.joint import felt_stiffness as drawn
from mckibben.robot import RobotScenario
from mckibben.scenario import Scenario
from mckibben.study.felt import Felt, felt_stiffness
from mckibben.study.stiffness import FeltStiffness
from tests.joint.test_slide import AXIS
from tests.reachability.test_robots import ONE
from tests.robot.conftest import as_joint

HELD = """
name: knee at constant pressures
joint:
  geometry: {from: knee-table-2, connector_length: 208 mm}
  muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
load: {from: knee-table-2, damping: 0.6 N*m*s/rad}
valve: ideal
controller: {class: open_loop, pressure1: 3 bar, pressure2: 3 bar}
reference: {angle: 0 deg, stiffness: 10.4 N*m/rad}
duration: 1 s
control_period: 1 ms
"""


@pytest.mark.slow
def test_a_push_of_a_slide_is_a_force_and_feels_its_mass():
    axis = AXIS.replace("friction: {force: 2 N, presliding: 0.1 mm}\n", "")
    axis = re.sub("controller: .*", "controller: {class: open_loop, pressure1: 0 bar, pressure2: 4 bar}", axis)
    scenario = Scenario.parse(axis.replace("valve: {time_constant: 20 ms}", "valve: ideal"))
    felt = felt_stiffness(scenario, torque=0.5, frequencies=(0.5, 3.0))[""]
    rate = 2 * np.pi * felt.frequency
    np.testing.assert_allclose(felt.impedance, felt.isobaric - 2 * rate**2 + 100j * rate, rtol=1e-4)
    tables = [listing.columns for listing in FeltStiffness(scenario, {"": felt}).listings()]
    assert {table["isobaric"][0].shown_unit for table in tables if "isobaric" in table} == {"N/mm"}


@pytest.mark.slow
def test_at_constant_pressures_a_push_feels_stiffness_gravity_damping_and_inertia():
    scenario = Scenario.parse(HELD)
    felt, load = felt_stiffness(scenario, torque=0.01, frequencies=(0.5, 1.0, 3.0))[""], scenario.load
    rate = 2 * np.pi * felt.frequency
    still = felt.isobaric + float(load.gravity_stiffness(felt.angle))
    expected = still - float(load.total_inertia) * rate**2 + 1j * float(load.damping) * rate
    np.testing.assert_allclose(felt.impedance, expected, rtol=1e-5)
    assert felt.settled.all()
    assert felt.small_motion == pytest.approx(felt.isobaric, rel=1e-5)  # no friction
    np.testing.assert_allclose(felt.pushed, felt.isobaric, rtol=1e-4)


@pytest.mark.slow
def test_a_joint_as_a_robot_feels_the_same_and_the_position_loop_adds_to_the_stiffness():
    text = ONE.replace("sensors: {encoder: 0.022 deg, pressure_noise: 2 kPa}\n", "")
    text += "controllers: {knee: {class: decoupling, feedback: {bandwidth: 30 rad/s}}}\n"
    robot = RobotScenario.parse(text)
    ours, theirs = (felt_stiffness(scenario, frequencies=(1.0, 5.0)) for scenario in (robot, as_joint(robot)))
    knee, alone = ours["knee"], theirs[""]
    assert knee.torque == alone.torque == 0.7 and knee.setpoint == alone.setpoint == 14.0
    np.testing.assert_allclose(knee.impedance, alone.impedance, rtol=1e-4)
    np.testing.assert_allclose(knee.pushed, alone.pushed, rtol=1e-4)
    assert knee.isobaric == pytest.approx(alone.isobaric, rel=1e-6)
    assert knee.isobaric == pytest.approx(14.0, rel=0.01)
    assert knee.small_motion == pytest.approx(alone.small_motion, rel=1e-6)
    assert knee.magnitude[0] > 2 * knee.setpoint
    assert drawn(FeltStiffness(robot, ours)).axes[0].lines


def felt(pushed: float, *, settled: bool = True) -> Felt:
    impedance = np.array([100.0 + 0j, 0 + 40j])
    return Felt(
        0.0, 8.0, 8.0, 9.0, 0.5, np.array([0.1, 10.0]), impedance, np.array([8.0, pushed]), np.array([True, settled])
    )


@pytest.mark.parametrize(
    ("pushed", "settled", "fields"), [(8.1, True, []), (11.0, True, ["pushed"]), (8.0, False, ["felt"])]
)
def test_a_push_that_pumps_the_stiffness_gives_a_remark(pushed, settled, fields):
    found = FeltStiffness(Scenario.parse(HELD), {"knee": felt(pushed, settled=settled)})
    assert [remark.field for remark in found.remarks()] == fields
    table = next(iter(found.listings())).columns
    assert table["felt at 10 Hz"][1] == [pytest.approx(40.0)] and table["joint"][1] == ["knee"]
    assert felt(8.0).deflection == pytest.approx([0.005, 0.0125])


def test_a_push_has_a_torque_and_a_frequency():
    scenario = Scenario.parse(HELD)
    for wrong in ({"torque": 0.0}, {"frequencies": (1.0, -1.0)}):
        with pytest.raises(RangeError):
            felt_stiffness(scenario, **wrong)
