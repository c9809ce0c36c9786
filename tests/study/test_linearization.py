"""The linear system of a scenario: closed forms of joint and valve, the closed loop, and python-control."""

from pathlib import Path

import numpy as np
import pytest

import mckibben as mk
from mckibben.control import ExtendedStateObserver
from mckibben.errors import ParameterError
from mckibben.scenario import with_values
from mckibben.simulation import margins

pytestmark = pytest.mark.slow

PERIOD, TIME = 1e-3, 0.25


@pytest.fixture(scope="module")
def scenario():
    text = mk.Scenario.read("examples/pre-contracted-step-pid.yaml").dumps()
    short = text.replace("10 s", "0.5 s").replace("at: 5 s", "at: 0.4 s")
    return mk.Scenario.parse(short).model_copy(update={"duration": 0.5})


@pytest.fixture(scope="module")
def opened(scenario):
    return mk.linearize(scenario, TIME)


@pytest.mark.parametrize("time", [-5.0, 100.0, np.nan])
def test_a_time_outside_the_run_is_refused(scenario, time):
    with pytest.raises(ParameterError) as caught:
        mk.linearize(scenario, time)
    assert (caught.value.field, caught.value.lower, caught.value.upper) == ("time", 0.0, scenario.duration)


def entry(system, row, column):
    return system.a[system.states.index(row), system.states.index(column)]


def test_the_valve_is_a_lag_of_20_ms(opened):
    left = np.exp(-PERIOD / 20e-3)
    for number in (0, 1):
        name = f"plant.pressures[{number}]"
        assert entry(opened, name, name) == pytest.approx(left, rel=1e-6)
        column = opened.b[opened.states.index(name)]
        assert column[number] == pytest.approx(1 - left, rel=1e-6) and column[1 - number] == 0.0


def test_the_joint_turns_by_its_stiffness_and_that_of_gravity(scenario, opened):
    """To first order in the period: d(velocity)/d(angle) = -h (K + K_gravity) / I."""
    result = scenario.simulate()
    at = int(np.argmin(np.abs(result.times - TIME)))
    angle = float(result["angle"][at])
    pressures = tuple(float(result[name][at]) for name in ("pressure1", "pressure2"))
    load = scenario.load
    stiffness = float(scenario.joint.stiffness(angle, pressures)) + float(load.gravity_stiffness(angle))
    expected = -PERIOD * stiffness / float(load.total_inertia)
    assert entry(opened, "plant.velocity", "plant.angle") == pytest.approx(expected, rel=0.03)
    assert entry(opened, "plant.angle", "plant.velocity") == pytest.approx(PERIOD, rel=0.02)


def test_closing_the_loop_gives_the_poles_of_the_margins(scenario, opened):
    closed = mk.linearize(scenario, TIME, closed=True)
    np.testing.assert_allclose(opened.a + opened.b @ opened.c[:2], closed.a, atol=1e-9 * np.abs(closed.a).max())
    plant = scenario.plant()
    given = {"duration": 0.5, "control_period": PERIOD, "substeps": scenario.needed_substeps(), "points": 3}
    found = margins(plant, scenario.control(), scenario.reference(), scenario.initial(plant), **given)
    last = mk.linearize(scenario, float(found.time[-1]), closed=True)
    moving = [abs(pole) for pole in last.poles() if abs(pole - 1) > 1e-6]
    assert max(moving) == pytest.approx(found.radius[-1], rel=1e-9)


POLES, OBSERVED, PRESSURE, LAG = 60.0, 160.0, 100.0, 0.02
CONTROLLER = f"""controller:
  class: decoupling
  feedback: {{bandwidth: {POLES} rad/s}}
  observer: {{bandwidth: {OBSERVED} rad/s}}
  pressure_observer: {{bandwidth: {PRESSURE} rad/s}}
reference:
  angle: {{class: step, before: 0 deg, after: 0.2 deg, at: 50 ms}}
  stiffness: 13 N*m/rad
start: {{angle: 0 deg, stiffness: 13 N*m/rad}}
duration: 3 s
control_period: 1 ms
"""


def largest_pole(slower, stiffness, damping):
    """Spectral radius of the loop by hand with valves that many times slower than modelled; per inertia."""
    first, second, third = (float(gain) for gain in ExtendedStateObserver(OBSERVED).gains(PERIOD))
    model, trust = 1 - np.exp(-PERIOD / LAG), 1 - np.exp(-PRESSURE * PERIOD)
    lead = (1 - np.exp(-3 * POLES * PERIOD)) / model

    def period(angle, velocity, torque, angle_, velocity_, disturbance, known, torque_, command):
        torque_ += model * (command - torque_)
        torque_ += trust * (torque - torque_)
        now = torque_ - stiffness * angle - damping * velocity_
        acceleration = (known + now) / 2 + disturbance
        angle_ += PERIOD * (velocity_ + PERIOD / 2 * acceleration)
        innovation = angle - angle_
        angle_ += first * innovation
        velocity_ += PERIOD * acceleration + second * innovation
        disturbance += third * innovation
        ahead = angle_ + velocity_ / (3 * POLES)
        wanted = -POLES * velocity_ - POLES**2 / 3 * angle - disturbance + stiffness * ahead + damping * velocity_
        command = torque_ + lead * (wanted - torque_)
        for _ in range(100):
            step = PERIOD / 100
            velocity += step * (torque - stiffness * angle - damping * velocity)
            angle += step * velocity
            torque = command + (torque - command) * np.exp(-step / (slower * LAG))
        return angle, velocity, torque, angle_, velocity_, disturbance, now, torque_, command

    return np.abs(np.linalg.eigvals(np.array([period(*unit) for unit in np.eye(9)]).T)).max()


@pytest.mark.parametrize("slower", [1.0, 2.0, 4.0])
def test_the_largest_pole_with_an_unmodelled_lag_is_that_of_the_loop_written_by_hand(slower):
    text = Path("examples/pre-contracted-step-pid.yaml").read_text(encoding="utf-8")
    scenario = mk.Scenario.parse(text.split("controller:\n")[0] + CONTROLLER)
    plant = scenario.plant()
    state, inertia = plant.equilibrium(0.0, stiffness=13.0), float(plant.load.total_inertia)
    joint = float(plant.stiffness(0.0, state.pressures)) / inertia, float(plant.load.damping) / inertia
    late = with_values(scenario, {"valve.time_constant": slower * LAG}, model_follows=())
    poles = mk.linearize(late, 0.0, closed=True).poles()
    moving = max(abs(pole) for pole in poles if abs(pole - 1) > 1e-6)
    assert moving == pytest.approx(largest_pole(slower, *joint), abs=1e-6)


def test_python_control_has_the_same_system(opened):
    control = pytest.importorskip("control")
    system = opened.to_control()
    assert system.dt == PERIOD and system.state_labels == list(opened.states)
    z = np.exp(1j * 2 * np.pi * 3.0 * PERIOD)
    by_hand = opened.c @ np.linalg.solve(z * np.eye(len(opened.states)) - opened.a, opened.b) + opened.d
    np.testing.assert_allclose(control.evalfr(system, z), by_hand, rtol=1e-6)
