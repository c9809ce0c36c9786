"""Predictive control in closed loop: the designed linear loop without limits, and its advantage at limits."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.control import AngleLimits
from mckibben.numerics.compiled import numeric
from mckibben.simulation import sampled
from mckibben.units import deg
from tests.control.conftest import PERIOD, SINE, off, rmse

SECONDS = 1.5


def predictive(knee, load, bandwidth=60.0, observed=200.0, **more):
    return mk.PredictiveControl(knee, load, mk.ExtendedStateObserver(observed), bandwidth=bandwidth, **more)


@pytest.fixture(scope="module")
def run(follow):
    return functools.partial(follow, SECONDS)


@jax.jit
def seen_from_outside(joint, record):
    """The joint's true stiffness [N*m/rad] and tensions [N]."""
    at = record.state.angle, record.state.pressures
    return joint.stiffness(*at), jnp.stack(joint.tensions(*at))


@pytest.fixture(scope="module")
def tracked(run, plant, knee, load):
    return run(plant, predictive(knee, load))


@pytest.mark.slow
def test_with_a_right_model_there_is_next_to_no_error(tracked, plant):
    record, _ = tracked
    assert rmse(tracked) < 0.01
    assert np.abs(seen_from_outside(numeric(plant.joint), record)[0] - 15.0)[100:].max() < 0.05


@pytest.mark.slow
def test_without_limits_the_loop_is_the_linear_one_that_was_designed(run, plant, knee, load):
    """With d = 3 all poles are at 60 rad/s, stages of 1 ms; the stiffness has its own pole, and both do not mix."""
    control = predictive(knee, load, damping=3.0, horizon=0.012, stiffness_bandwidth=40.0)
    record, setpoints = run(plant, control, mk.Step(0.0, 0.5 * deg, 0.1), mk.Step(15.0, 15.3, 0.1))
    wt = 60.0 * PERIOD * np.arange(300)
    np.testing.assert_allclose(-off((record, setpoints))[100:400], 0.5 * (1 + wt + wt**2 / 2) * np.exp(-wt), atol=0.02)
    softer = 15.3 - np.asarray(seen_from_outside(numeric(plant.joint), record)[0])[100:400]
    np.testing.assert_allclose(softer, 0.3 * np.exp(-wt * 40 / 60), atol=0.01)


def test_it_stands_still_where_it_stands(run, plant, knee, load):
    record, _ = run(plant, predictive(knee, load), 0.0, 15.0, start=15.0)
    np.testing.assert_allclose(record.state.angle, 0.0, atol=1e-9)
    np.testing.assert_allclose(record.commands[0], record.commands[0][0], atol=1.0)


def test_where_both_cannot_be_had_they_are_given_up_as_their_errors_weigh(run, plant, knee, load):
    setpoint = sampled(mk.Reference(angle=SINE, stiffness=15.0), SECONDS, PERIOD)[1]
    knee = numeric(knee)
    for wanted in (5.0, 25.0):
        record, _ = run(plant, predictive(knee, load, 80.0, 250.0), SINE, wanted)
        commands = np.stack([record.commands[0], record.commands[1]])
        assert commands.min() >= 0.0 and commands.max() <= 6e5
        assert np.asarray(record.telemetry["saturated"]).mean() > 0.9
        there, tensions = seen_from_outside(knee, record)
        assert 4.0 < tensions.min() and tensions.max() < 630.0
        assert rmse((record, setpoint)) < 0.01  # the torque first

        other, _ = run(plant, predictive(knee, load, 80.0, 250.0, angle_scale=1 * deg), SINE, wanted)
        assert rmse((other, setpoint)) > 1.0
        nearer, _ = seen_from_outside(knee, other)
        assert np.mean(np.abs(nearer - wanted)) < np.mean(np.abs(there - wanted)) - 0.2


def test_it_brakes_in_time_where_valves_are_slow(run, plant, knee, load):
    """A step of 20 deg with valves of 100 ms, known. Who looks 12 ms ahead cannot see a limit coming."""
    beyond = {}
    for far in (0.012, 0.06, 0.12):
        control = predictive(knee, load, 80.0, 250.0, valve=mk.FirstOrderValve(0.1), horizon=far)
        record, _ = run(mk.JointPlant(knee, load, mk.FirstOrderValve(0.1)), control, mk.Step(-10 * deg, 10 * deg, 0.1))
        angle = np.asarray(record.state.angle) / deg
        beyond[far] = angle.max() - 10.0
        assert angle[-1] == pytest.approx(10.0, abs=0.05)
    assert beyond[0.012] > 6.0
    assert beyond[0.06] < 0.4 * beyond[0.012]
    assert beyond[0.12] < 0.7 * beyond[0.06]


@pytest.mark.slow
def test_what_is_known_ahead_is_met_ahead(run, plant, knee, load):
    """A step and a limit that the reference would cross: both start to move before, and end where they should."""
    both = mk.PredictiveControl(knee, load), mk.DecouplingControl(knee, load, mk.PolePlacement())
    for control, known in zip(both, (True, 0.1), strict=True):
        without = rmse(run(plant, control, mk.Step(-5 * deg, 5 * deg, 0.7)))
        control = dataclasses.replace(control, preview=known).with_period(PERIOD)
        answer = run(plant, control, mk.Step(-5 * deg, 5 * deg, 0.7))
        assert rmse(answer) < 0.6 * without
        assert abs(off(answer)[-1]) < 0.01
        delayed = dataclasses.replace(plant, command_delay=8e-3).with_period(PERIOD)
        late = dataclasses.replace(control, command_delay=8e-3).with_period(PERIOD)
        assert rmse(run(delayed, late, mk.Step(-5 * deg, 5 * deg, 0.7))) < 1.1 * rmse(answer)
        assert rmse(run(plant, control)) < 0.01  # a sine, also at its end


@pytest.mark.slow
def test_a_cost_keeps_the_angle_within_soft_limits(run, plant, knee, load):
    control = predictive(knee, load, cost=AngleLimits(-8 * deg, 8 * deg))
    angle = np.asarray(run(plant, control)[0].state.angle)[100:] / deg  # a sine of 10 deg
    assert 8.0 < angle.max() < 8.5 and -8.5 < angle.min() < -8.0
