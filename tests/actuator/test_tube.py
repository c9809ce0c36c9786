"""Tube and regulator with hysteresis against SciPy with the equations written anew, and the tube as a model."""

import dataclasses
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.actuator import AirVolume, FlowValve, PressureRegulator, SwitchingValves, Tube
from mckibben.errors import RangeError
from mckibben.muscle.air import mass_flow, pressure_behind
from mckibben.numerics.calculus import rk4
from mckibben.scenario import Scenario, run_scenario
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


def test_no_air_is_lost_or_made_at_constant_temperature():
    """With n = 1 the masses in tube and muscle change by what the valve passes, less the leak."""
    valve = dataclasses.replace(VALVE, polytropic_index=1.0)
    tube, pressure, outlet = Tube(valve, volume=ROOM, conductance=THIN), jnp.asarray(2 * bar), jnp.asarray(3 * bar)
    state = tube.init(pressure)._replace(pressure=outlet)
    air = AirVolume(jnp.asarray(VOLUME), jnp.asarray(GROWTH))
    muscle_rate, rates, drawn = tube.muscle_rate(pressure, state, 5 * bar, air, SUPPLY + ATMOSPHERE)
    stored = (muscle_rate * VOLUME + (pressure + ATMOSPHERE) * GROWTH + rates.pressure * (ROOM + DEAD)) / ENERGY
    through = valve.flow(valve.opening(state.valve, 5 * bar, outlet), SUPPLY + ATMOSPHERE, outlet)
    assert float(stored) == pytest.approx(float(through - valve.leakage(pressure)), rel=1e-12)
    assert float(drawn) == max(float(through), 0.0)


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


def test_at_its_target_a_pressure_stays_and_can_be_left_both_ways():
    pressure, still = jnp.asarray(3 * bar), AirVolume(jnp.asarray(VOLUME), jnp.zeros(()))
    model = Tube(dataclasses.replace(VALVE, leak=None), volume=ROOM, conductance=THIN)
    state = model.init_model(pressure)
    command = model.command_toward(pressure, state, pressure, still, 8 * ms, PERIOD)
    following, state = model.predict(pressure, state, command, still, PERIOD)
    assert float(following) == pytest.approx(3 * bar, rel=1e-9)
    lowest, highest = model.attainable(pressure, state, (0.0, 6 * bar), still, PERIOD)(pressure)
    assert float(lowest) < 3 * bar < float(highest)


@pytest.mark.slow
@pytest.mark.parametrize("target", [2.3 * bar, 2.5 * bar, 2.8 * bar])
def test_the_command_leads_the_pressure_of_the_muscle_to_a_target(target):
    pressure = jnp.asarray(2.5 * bar)
    state, air = TUBE.init_model(pressure), AirVolume(jnp.asarray(VOLUME), jnp.asarray(GROWTH))
    for _ in range(80):
        command = TUBE.command_toward(pressure, state, target, air, 15 * ms, PERIOD)
        pressure, state = TUBE.predict(pressure, state, command, air, PERIOD)
    assert float(pressure) == pytest.approx(target, abs=0.02 * bar)


@pytest.mark.parametrize("width", [1, 3, 30])
def test_the_pressure_follows_a_target_with_the_lag_behind_narrow_and_wide_tubes(lag_of, width):
    model = Tube(dataclasses.replace(VALVE, leak=None, hysteresis=None), volume=ROOM, conductance=width * THIN)
    assert lag_of(model, VOLUME, 12 * ms, PERIOD) == pytest.approx(12 * ms, rel=0.05)


@pytest.mark.parametrize("rate", [4 * bar, -4 * bar])
def test_the_command_for_a_rate_gives_that_rate(rate):
    """Along a ramp, with the pressure at the outlet and the lagged command that belong to it."""
    pressure, air = jnp.asarray(2.5 * bar), AirVolume(jnp.asarray(VOLUME), jnp.asarray(GROWTH))
    command = float(TUBE.command_for(pressure, rate, air))
    held = command - LAG * rate - math.copysign(HYSTERESIS / 2, rate)
    needed = (rate * VOLUME / INDEX + (2.5 * bar + ATMOSPHERE) * GROWTH) / ENERGY + flow(
        LEAK, 2.5e5 + 101325, 101325, 0.3
    )
    outlet = pressure_behind(THIN, 0.25, 2.5 * bar + ATMOSPHERE, needed) - ATMOSPHERE
    state = TUBE.init(pressure)._replace(valve=jnp.asarray(held), pressure=outlet)
    found, moved, _ = TUBE.muscle_rate(pressure, state, command, air, SUPPLY + ATMOSPHERE)
    assert float(found) == pytest.approx(rate, rel=1e-9)
    assert (float(moved.pressure), float(moved.valve)) == (pytest.approx(rate, rel=1e-9), pytest.approx(rate, rel=1e-9))
    assert float(TUBE.command_for(pressure, 1e9, air)) == math.inf
    assert float(TUBE.command_for(pressure, -1e9, air)) == -math.inf


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


def test_switching_valves_measure_the_pressure_at_their_outlet():
    tube = Tube(SwitchingValves(C, SUPPLY, period=10 * ms), volume=ROOM, conductance=THIN)
    state = tube.init(jnp.asarray(2 * bar))._replace(pressure=jnp.asarray(3 * bar))
    before = tube.before_step(state, 3 * bar, 2 * bar, 1 * ms)
    assert tube.switches and float(before.valve.duty) == 0.0  # the outlet has the pressure of the command
    assert float(tube.signals(before, 3 * bar, 2 * bar)["outlet"]) == 3 * bar


@pytest.mark.parametrize(("command", "side"), [(8 * bar, 1), (0.0, 0)])
@pytest.mark.slow
def test_the_attainable_pressures_are_those_of_the_flow_that_lasts(command, side):
    """With the valve fully open, after the tube has followed; conductances in series are an approximation."""
    start, time = 2.5 * bar, np.array([0.03, 0.031])
    muscle, tube, *_ = independent(start, lambda t: command, time)
    state = TUBE.init_model(jnp.asarray(muscle[0]))._replace(pressure=jnp.asarray(tube[0]))
    air = AirVolume(jnp.asarray(VOLUME + 0.03 * GROWTH), jnp.asarray(GROWTH))
    reach = TUBE.attainable(jnp.asarray(muscle[0]), state, (0.0, 8 * bar), air, 1 * ms)(muscle[0])
    assert float(reach[side]) - muscle[0] == pytest.approx(muscle[1] - muscle[0], rel=0.2)


REGULATOR = Path(__file__).parents[2] / "examples" / "valves" / "regulator-decoupling.yaml"


@pytest.mark.slow
def test_a_controller_that_knows_the_tube_has_less_than_half_of_the_error():
    """At 6 deg and 1 Hz, against one that takes the tube for a dead volume; a tube of 0.03 L/(s*bar)."""
    text = REGULATOR.read_text(encoding="utf-8").replace("amplitude: 3 deg, frequency: 0.5 Hz", "amplitude: 6 deg")
    text = text.replace("start: {angle: 3 deg}", "start: {angle: 6 deg}").replace("duration: 4 s", "duration: 2 s")
    scenario = Scenario.parse(text.replace("amplitude: 6 deg", "amplitude: 6 deg, frequency: 1 Hz"))
    valve = dataclasses.replace(scenario.valve, dead_volume=1 * cm**3)
    tube = Tube(valve, volume=5 * cm**3, conductance=0.03e-8)
    errors = []
    for model in (tube, dataclasses.replace(valve, dead_volume=6 * cm**3)):
        controller = dataclasses.replace(scenario.controller, valve=model)
        changed = {"valve": tube, "controller": controller, "substeps": 12}
        errors.append(run_scenario(scenario.model_copy(update=changed)).metrics["angle_rmse"])
    assert errors[0] < 0.5 * errors[1]


def test_its_time_constant_is_that_of_a_compiled_step():
    """Controllers compute it in each step."""
    tube = Tube(PressureRegulator(1e-9, 7e5, time_constant=0.02), volume=6e-6, conductance=0.8e-9)
    compiled = jax.jit(lambda valve: valve.time_constant_at(3e5, 2e-5))(tube)
    assert float(compiled) == pytest.approx(float(tube.time_constant_at(3e5, 2e-5)), rel=1e-12)


def test_a_predicted_step_errs_with_the_third_power_of_its_length():
    """Against 64 steps of the same time, while the valve is at rest: terms of first and second order are exact."""
    start, still = jnp.asarray(2.5 * bar), AirVolume(jnp.asarray(VOLUME), jnp.zeros(()))
    tube = dataclasses.replace(TUBE, valve=dataclasses.replace(VALVE, hysteresis=None, leak=None))
    predict = jax.jit(lambda pressure, state, step: tube.predict(pressure, state, start, still, step))

    def moved(time, steps):
        pressure, state = start, tube.init_model(start)._replace(pressure=start + 0.1 * bar)
        for _ in range(steps):
            pressure, state = predict(pressure, state, time / steps)
        return np.array([pressure, state.pressure])

    longer, shorter = (moved(time, 1) - moved(time, 64) for time in (0.5 * ms, 0.25 * ms))
    assert ((longer / shorter > 6) & (longer / shorter < 12)).all()


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
