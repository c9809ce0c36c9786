"""Tube and regulator with hysteresis against SciPy with the equations written anew, and the tube as a model."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.actuator import AirVolume, FlowValve, PressureRegulator, Tube
from mckibben.errors import RangeError
from mckibben.muscle.air import mass_flow, pressure_behind
from mckibben.numerics.calculus import rk4
from mckibben.units import bar, cm, ms

ATMOSPHERE, ENERGY, DENSITY, INDEX = 101325.0, 288.0 * 293.15, 1.185, 1.2
C, THIN, SUPPLY, LAG, BAND = 0.1e-8, 0.08e-8, 8 * bar, 20 * ms, 0.5 * bar
HYSTERESIS, LEAK, ROOM, DEAD = 0.2 * bar, 0.002e-8, 6 * cm**3, 1 * cm**3
VALVE = PressureRegulator(
    C,
    SUPPLY,
    time_constant=LAG,
    band=BAND,
    exhaust_conductance=1.5 * C,
    leak=LEAK,
    dead_volume=DEAD,
    hysteresis=HYSTERESIS,
)
TUBE = Tube(VALVE, volume=ROOM, conductance=THIN, critical_ratio=0.25)
VOLUME, GROWTH = 20e-6, 7e-6  # of the muscle [m^3], [m^3/s]
PERIOD = 1 * ms


def flow(conductance, inlet, outlet, critical):
    """Mass flow by ISO 6358 [kg/s] between absolute pressures [Pa], written anew."""
    if outlet > inlet:
        return -flow(conductance, outlet, inlet, critical)
    ratio = outlet / inlet
    if ratio > 0.999:
        share = math.sqrt(1 - ((0.999 - critical) / (1 - critical)) ** 2) * (1 - ratio) / 0.001
    else:
        share = math.sqrt(1 - (max(ratio - critical, 0.0) / (1 - critical)) ** 2)
    return conductance * DENSITY * inlet * share


def independent(start, command_at, time, reservoir=None):
    """Pressures of muscle, tube and lagged command at times [s], by SciPy; last the mass that the valve passed [kg]."""

    def rate(t, y):
        muscle, tube, held, _ = y
        muscle, tube = muscle + ATMOSPHERE, tube + ATMOSPHERE
        lagging = command_at(t) - held
        lagging = math.copysign(max(abs(lagging) - HYSTERESIS / 2, 0.0), lagging)
        opening = min(max((held + ATMOSPHERE - tube) / BAND, -1.0), 1.0)
        if opening > 0:
            valve = flow(C * opening, SUPPLY + ATMOSPHERE, tube, 0.3)
        else:
            valve = -flow(1.5 * C * -opening, tube, ATMOSPHERE, 0.3)
        through, leaked = flow(THIN, tube, muscle, 0.25), flow(LEAK, muscle, ATMOSPHERE, 0.3)
        volume = VOLUME + GROWTH * t
        return [
            INDEX / volume * (ENERGY * (through - leaked) - muscle * GROWTH),
            INDEX / (ROOM + DEAD) * ENERGY * (valve - through),
            lagging / LAG,
            valve - leaked,
        ]

    return solve_ivp(
        rate,
        (0, time[-1]),
        [start, start, start, 0.0],
        method="LSODA",
        t_eval=time,
        rtol=1e-10,
        atol=1e-7,
        max_step=1e-4,
    ).y


def integrated(tube, start, command, steps, step):
    """Pressure [Pa] and state after steps [s] of Runge and Kutta."""

    def follow(number, carry):
        def rate(carry, t):
            pressure, state = carry
            air = AirVolume(VOLUME + GROWTH * t, jnp.asarray(GROWTH))
            found, moved, _ = tube.muscle_rate(pressure, state, command, air, tube.supply + ATMOSPHERE)
            return found, moved

        times = tuple(((number + part) * step,) for part in (0.0, 0.5, 1.0))
        return rk4(rate, carry, step, times)

    begin = jnp.asarray(start), tube.init(jnp.asarray(start))
    return jax.jit(lambda: jax.lax.fori_loop(0, steps, follow, begin))()


@pytest.mark.parametrize("command", [1.0 * bar, 2.56 * bar, 4.0 * bar])
def test_muscle_and_tube_fill_and_vent_as_an_independent_solver_says(command):
    time = np.array([0.05])
    pressure, state = integrated(TUBE, 2.5 * bar, command, 5000, 1e-5)
    muscle, tube, held, _ = independent(2.5 * bar, lambda t: command, time)[:, -1]
    assert float(pressure) == pytest.approx(muscle, rel=1e-8)
    assert float(state.pressure) == pytest.approx(tube, rel=1e-8)
    assert float(state.valve) == pytest.approx(held, rel=1e-8)


def test_a_command_that_rose_and_one_that_fell_to_a_value_differ_by_the_hysteresis():
    """Both slower than the lag; without the tube, in steady state."""
    valve = dataclasses.replace(VALVE, leak=None)
    held = {}
    for begin in (1 * bar, 5 * bar):
        z = jnp.asarray(begin)
        for _ in range(400):
            z = valve.follow(z, 3 * bar, 1 * ms)
        held[begin] = float(z)
    assert held[5 * bar] - held[1 * bar] == pytest.approx(HYSTERESIS, rel=1e-6)
    without = dataclasses.replace(valve, hysteresis=None)
    assert float(without.rate(jnp.asarray(2 * bar), 3 * bar, 0.0)) == pytest.approx(1 * bar / LAG)
    assert float(valve.rate(jnp.asarray(2 * bar), 3 * bar, 0.0)) == pytest.approx(0.9 * bar / LAG)
    assert float(valve.rate(jnp.asarray(2.95 * bar), 3 * bar, 0.0)) == 0.0


@pytest.mark.parametrize("critical", [0.1, 0.3, 0.5, 0.7])
def test_the_pressure_behind_a_restriction_is_that_of_its_flow(critical):
    pressure = 3e5
    beyond = np.array([0.9, 1.5, 2.5, 2.95, 2.9995, 3.0, 3.0005, 3.05, 4.0, 9.0, 20.0]) * 1e5
    flows = mass_flow(1e-8, critical, beyond, pressure)
    found = pressure_behind(1e-8, critical, pressure, flows)
    np.testing.assert_allclose(found, np.maximum(beyond, critical * pressure), rtol=1e-7)  # below it flow is choked


@pytest.mark.parametrize("command", [1.0 * bar, 2.7 * bar, 5.0 * bar])
def test_a_tube_is_predicted_in_steps_of_a_control_period(command):
    start, model = 2.5 * bar, dataclasses.replace(TUBE, volume=ROOM)
    pressure, state = jnp.asarray(start), model.init_model(jnp.asarray(start))
    true = independent(start, lambda t: command, np.arange(41) * PERIOD)
    for k in range(40):
        air = AirVolume(jnp.asarray(VOLUME + GROWTH * (k + 0.5) * PERIOD), jnp.asarray(GROWTH))
        pressure, state = model.predict(pressure, state, command, air, PERIOD)
        assert float(pressure) == pytest.approx(true[0, k + 1], abs=0.02 * abs(command - start))
        assert float(state.pressure) == pytest.approx(true[1, k + 1], abs=0.05 * abs(command - start))


@pytest.mark.parametrize("width", [1, 3, 30])
def test_the_pressure_follows_a_target_with_the_lag_behind_narrow_and_wide_tubes(lag_of, width):
    model = Tube(dataclasses.replace(VALVE, leak=None, hysteresis=None), volume=ROOM, conductance=width * THIN)
    assert lag_of(model, VOLUME, 12 * ms, PERIOD) == pytest.approx(12 * ms, rel=0.05)


def test_what_no_tube_can_be_is_refused():
    for wrong, field in (
        ({"volume": 0.0}, "volume"),
        ({"conductance": -1e-9}, "conductance"),
        ({"valve": FlowValve(C, SUPPLY, direct=True)}, "valve"),
        ({"valve": TUBE}, "valve"),
    ):
        with pytest.raises(RangeError) as caught:
            Tube(**({"valve": VALVE, "volume": ROOM, "conductance": THIN} | wrong))
        assert caught.value.field == field


def test_valve_and_tube_in_series_have_one_conductance():
    """1 / C^2 is the sum of both: what a tube attains is what a valve of C / sqrt(2) does, with one dead volume."""
    equal = PressureRegulator(C, SUPPLY, band=BAND, time_constant=LAG, critical_ratio=0.3)
    tube = Tube(equal, volume=ROOM, conductance=C, critical_ratio=0.3)
    alone = dataclasses.replace(equal, conductance=C / math.sqrt(2))
    pressure, still = jnp.asarray(2.5 * bar), AirVolume(jnp.asarray(VOLUME), jnp.zeros(()))
    whole = AirVolume(jnp.asarray(VOLUME + ROOM), jnp.zeros(()))
    found = tube.attainable(pressure, tube.init_model(pressure), (0.0, 6 * bar), still, PERIOD)(pressure)
    expected = alone.attainable(pressure, alone.init_model(pressure), (0.0, 6 * bar), whole, PERIOD)(pressure)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
