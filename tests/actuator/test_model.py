"""Actuators as the model of a controller: attainable pressures and commands; predictions are in test_air."""

import dataclasses

import jax.numpy as jnp
import pytest

import mckibben as mk
from mckibben.actuator import AirState, AirVolume, SecondOrderValve
from mckibben.actuator.base import Point
from mckibben.units import bar, ms

C, SUPPLY, LAG, BAND, INDEX = 0.05e-8, 8 * bar, 20 * ms, 0.5 * bar, 1.2
REGULATOR = mk.PressureRegulator(C, SUPPLY, time_constant=LAG, band=BAND, polytropic_index=INDEX)
LEAKING = dataclasses.replace(REGULATOR, leak=0.1 * C, dead_zone=0.1 * bar)
VOLUME, GROWTH = 20e-6, 7e-6  # m^3, m^3/s
AIR = AirVolume(jnp.asarray(VOLUME), jnp.asarray(GROWTH))
LIMITS = (0.0, 6 * bar)
PERIOD = 1 * ms


@pytest.mark.parametrize(("pressure", "rate"), [(2.5 * bar, 8 * bar), (2.5 * bar, -9 * bar), (5 * bar, 7 * bar)])
def test_the_command_for_a_rate_gives_that_rate(pressure, rate):
    """Where the error is above the dead zone."""
    command = float(LEAKING.command_for(pressure, rate, AIR))
    lagged = command - LAG * rate  # that of a ramp
    state = AirState((jnp.asarray(lagged),), ())
    ((found,), _) = LEAKING.rates((jnp.asarray(pressure),), state, (command,), lambda: (AIR,))
    assert float(found) == pytest.approx(rate, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("period", [1 * ms, 2 * ms])
@pytest.mark.parametrize("conductance", [0.2 * C, C, 20 * C])
def test_the_pressure_follows_a_target_with_the_lag_of_narrow_and_wide_valves(lag_of, conductance, period):
    valve = mk.PressureRegulator(conductance, SUPPLY, time_constant=LAG, band=BAND)
    assert lag_of(valve, AIR.volume, 12 * ms, period) == pytest.approx(12 * ms, rel=0.1)


def test_a_limited_rate_limits_what_is_attainable():
    valve, pressure = mk.FirstOrderValve(20 * ms, rate=10 * bar), jnp.asarray(2 * bar)
    lowest, highest = valve.attainable(Point(pressure), LIMITS, PERIOD)(pressure)
    assert (float(lowest), float(highest)) == (pytest.approx(1.99 * bar), pytest.approx(2.01 * bar))
    assert float(valve.predict(Point(pressure), 6 * bar, PERIOD)[0]) == pytest.approx(2.01 * bar)


@pytest.mark.parametrize(
    ("command", "rate"), [(2.1 * bar, 5 * bar), (6 * bar, 10 * bar), (0.0, -10 * bar), (2 * bar, 0)]
)
def test_a_limited_rate_is_that_of_the_lag_where_it_is_slower(command, rate):
    valve = mk.FirstOrderValve(20 * ms, rate=10 * bar)
    ((first, second), _) = valve.rates((jnp.asarray(2 * bar),) * 2, (), (command,) * 2, tuple)
    assert float(first) == float(second) == pytest.approx(rate, rel=1e-9)


@pytest.mark.parametrize(
    "valve",
    [
        mk.IdealValve(),
        mk.FirstOrderValve(20 * ms),
        SecondOrderValve(60.0),
        REGULATOR,
        mk.FlowValve(C, SUPPLY),
        mk.SwitchingValves(C, SUPPLY, period=10 * ms),
        mk.Tube(REGULATOR, volume=6e-6, conductance=C),
    ],
    ids=lambda valve: type(valve).__name__,
)
def test_at_its_target_a_pressure_stays(valve):
    pressure, still = jnp.asarray(3 * bar), AirVolume(AIR.volume, jnp.zeros(()))
    at = Point(pressure, valve.init_model(pressure), still)
    following, state = valve.predict(at, valve.command_toward(at, pressure, 8 * ms, PERIOD), PERIOD)
    assert float(following) == pytest.approx(3 * bar, rel=1e-9)
    lowest, highest = valve.attainable(Point(pressure, state, still), LIMITS, PERIOD)(pressure)
    assert float(lowest) < 3 * bar < float(highest)
