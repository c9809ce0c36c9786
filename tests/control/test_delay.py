"""Prediction over the delay of the commands, against integrals of the commands and of the equation of motion."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mckibben as mk
from mckibben.control import Measurement, Setpoint
from mckibben.control.model_based import mean_commands
from mckibben.errors import ParameterError, RangeError
from mckibben.units import ms

PERIOD, DELAY, LAG = 1 * ms, 8 * ms, 20 * ms
ANGLE, PRESSURES = 0.05, (2.5e5, 3.1e5)


@pytest.fixture(scope="module")
def control(knee, load):
    inner = mk.PositionStiffnessControl(mk.PID(3e5, 4e6, 5e4), mk.PID(3e4, 1.1e6, 0.0), model=knee)
    return mk.DelayCompensation(knee, load, valve=mk.FirstOrderValve(LAG), controller=inner, command_delay=DELAY)


@pytest.mark.parametrize(("newest", "oldest"), [(0.0, 1.0), (1.0, 2.0), (0.25, 0.75), (0.5, 2.25), (1.9, 3.0)])
def test_the_mean_of_commands_between_two_ages_is_that_of_their_steps(newest, oldest):
    sent = tuple((jnp.asarray(x), jnp.asarray(-2 * x)) for x in (1.0, 5.0, 2.0))
    ages = newest + (np.arange(40_000) + 0.5) / 40_000 * (oldest - newest)
    expected = np.array([1.0, 5.0, 2.0])[np.floor(ages).astype(int)].mean()
    np.testing.assert_allclose(mean_commands(sent, newest, oldest), (expected, -2 * expected), rtol=1e-4)


@pytest.mark.slow
def test_it_predicts_motion_and_pressures_of_the_commands_on_their_way(control, knee, load):
    prepared = control.with_period(PERIOD)
    estimates = prepared.init_estimates((ANGLE,), PRESSURES)
    estimates = estimates._replace(motion=(estimates.motion[0]._replace(velocity=jnp.asarray(2.0)),))
    commands = np.array([[2e5, 4e5]] * 3 + [[3.5e5, 1e5]] * 4 + [[1e5, 5e5]] * 2)  # the last sent first
    estimates = estimates._replace(sent=tuple(map(tuple, jnp.asarray(commands))))
    expected = prepared._predicted(estimates, PERIOD)

    def rates(time, state, arriving):
        angle, velocity, *pressures = state
        torque = float(knee.torque(angle, pressures))
        return [velocity, float(load.acceleration(angle, velocity, torque)), *((arriving - pressures) / LAG)]

    state = np.array([ANGLE, 2.0, *PRESSURES])
    for arriving in commands[-2::-1]:  # each for a period, the oldest first; the last has acted already
        state = solve_ivp(rates, (0, PERIOD), state, args=(arriving,), rtol=1e-8).y[:, -1]
    np.testing.assert_allclose(expected.pressures, state[2:], rtol=1e-3)  # in steps of 4 ms
    assert float(expected.motion[0].angle) - ANGLE == pytest.approx(state[0] - ANGLE, rel=5e-3)


@pytest.mark.slow
def test_over_a_long_delay_it_knows_what_fast_valves_have_done(control, knee):
    """The pressures lag behind commands that rise steadily by the lag of the valves, but for a part of a step."""
    late = dataclasses.replace(control, command_delay=30 * ms, valve=mk.FirstOrderValve(1 * ms)).with_period(PERIOD)
    estimates = late.init_estimates((ANGLE,), PRESSURES)
    rise = 1e3  # Pa in a period
    sent = tuple((jnp.asarray(3e5 - rise * age), jnp.asarray(2e5 + rise * age)) for age in range(31))
    pressure1, pressure2 = late._predicted(estimates._replace(sent=sent), PERIOD).pressures
    assert float(pressure1) == pytest.approx(3e5, abs=2 * rise)
    assert float(pressure2) == pytest.approx(2e5, abs=2 * rise)


def test_without_a_delay_the_estimates_are_passed_on_and_without_a_period_it_is_refused(control, knee):
    now = Measurement(jnp.asarray(ANGLE), tuple(map(jnp.asarray, PRESSURES)))
    with pytest.raises(ParameterError):
        control.init(now)
    assert len(control.with_period(PERIOD).init(now).estimates.sent) == 9
    prompt = dataclasses.replace(control, command_delay=0.0).with_period(PERIOD)
    estimates = prompt.init(now).estimates
    assert len(estimates.sent) == 1
    moving = estimates._replace(motion=(estimates.motion[0]._replace(velocity=jnp.asarray(2.0)),))
    setpoint = Setpoint(now.angle, jnp.asarray(15.0))
    following, expected = prompt.update(moving, (setpoint,), (now.angle,), now.pressures, PERIOD)
    assert expected.angles == (now.angle,) and expected.setpoints == (setpoint,)
    assert expected.estimates.motion is following.motion


def test_a_controller_that_predicts_itself_is_refused(knee, load):
    inner = mk.DecouplingControl(knee, load, mk.PolePlacement(40.0), valve=mk.FirstOrderValve(LAG))
    with pytest.raises(RangeError) as caught:
        mk.DelayCompensation(knee, load, valve=mk.FirstOrderValve(LAG), controller=inner, command_delay=DELAY)
    assert caught.value.field == "controller"
