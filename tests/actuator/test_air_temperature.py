"""Air with a temperature: against SciPy with the equations written anew, closed forms, and accounts of mass."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.actuator import AirState, AirVolume, FlowValve, PressureRegulator, Tube
from mckibben.joint import SeriesSpring
from mckibben.numerics.calculus import rk4
from mckibben.numerics.compiled import jit, numeric
from mckibben.plant import JointPlant
from mckibben.units import bar, cm, ms

ATMOSPHERE, GAS, ROOM, DENSITY, KAPPA, INDEX = 101325.0, 288.0, 293.15, 1.185, 1.4, 1.2
C, THIN, SUPPLY, LAG, BAND, LEAK = 0.1e-8, 0.08e-8, 7 * bar, 20 * ms, 0.5 * bar, 0.002e-8
WALL, TUBE_VOLUME = 0.5, 6 * cm**3  # W/K
VOLUME, GROWTH = 23.8e-6, 7e-6  # of the muscle [m^3], [m^3/s]
VALVE = PressureRegulator(C, SUPPLY, time_constant=LAG, band=BAND, leak=LEAK, wall_conductance=WALL)
ACTUATORS = {
    "valve": VALVE,
    "adiabatic": dataclasses.replace(VALVE, wall_conductance=0.0, leak=None),
    "tube": Tube(VALVE, volume=TUBE_VOLUME, conductance=THIN),
}
advance = jit(lambda plant, state, commands, time: plant.advance(state, commands, time, 200))


def flow(conductance, inlet, outlet, temperature=ROOM, critical=0.3):
    """Mass flow by ISO 6358 [kg/s] between absolute pressures [Pa], from air at a temperature [K] if it returns."""
    if outlet > inlet:
        return -flow(conductance, outlet, inlet, critical=critical) * math.sqrt(ROOM / temperature)
    ratio = outlet / inlet
    share = math.sqrt(1 - max((min(ratio, 0.999) - critical) / (1 - critical), 0.0) ** 2)
    return conductance * DENSITY * inlet * share * min((1 - ratio) / 0.001, 1.0)


def independent(name, start, command, time):
    """Pressures of muscle and tube [Pa] and temperature [K] at a time [s], by SciPy."""
    wall, leak, has_tube = (
        (0.0 if name == "adiabatic" else WALL),
        (0.0 if name == "adiabatic" else LEAK),
        name == "tube",
    )

    def rate(t, y):
        muscle, temperature, held, tube = y
        outlet = tube if has_tube else muscle
        opening = min(max((held + ATMOSPHERE - outlet) / BAND, -1.0), 1.0)
        source = SUPPLY + ATMOSPHERE if opening > 0 else ATMOSPHERE
        valve = flow(C * abs(opening), source, outlet, ROOM if has_tube else temperature)
        through = flow(THIN, tube, muscle, temperature) if has_tube else valve
        leaked = flow(leak, ATMOSPHERE, muscle, temperature)
        volume = VOLUME + GROWTH * t
        energy = sum(one * (ROOM if one > 0 else temperature) for one in (through, leaked))
        heat = wall * (ROOM - temperature)
        slope = (KAPPA * (GAS * energy - muscle * GROWTH) + (KAPPA - 1) * heat) / volume
        mass = muscle * volume / (GAS * temperature)
        warming = temperature * (slope / muscle + GROWTH / volume - (through + leaked) / mass)
        return [slope, warming, (command - held) / LAG, INDEX * GAS * ROOM / TUBE_VOLUME * (valve - through)]

    first = [start + ATMOSPHERE, ROOM, start, start + ATMOSPHERE]
    found = solve_ivp(rate, (0, time), first, method="LSODA", rtol=1e-11, atol=1e-9, max_step=1e-4).y[:, -1]
    return found[0] - ATMOSPHERE, found[1], found[3] - ATMOSPHERE


def integrated(actuator, start, command, steps, step, growth=GROWTH, states=None):
    """Pressure [Pa] and state of the air in one muscle after steps [s] of Runge and Kutta."""

    def follow(number, carry):
        def rate(carry, t):
            (pressure,), air = carry
            volume = AirVolume(VOLUME + growth * t, jnp.asarray(growth))
            return actuator.rates((pressure,), air, (command,), lambda: (volume,))

        return rk4(rate, carry, step, tuple(((number + part) * step,) for part in (0.0, 0.5, 1.0)))

    pressures = (jnp.asarray(start),)
    begin = pressures, actuator.init_states(pressures) if states is None else states
    (pressure,), air = jax.jit(lambda: jax.lax.fori_loop(0, steps, follow, begin))()
    return pressure, air


@pytest.mark.parametrize("command", [1.0 * bar, 5.0 * bar])
@pytest.mark.parametrize("name", ACTUATORS)
@pytest.mark.slow
def test_pressure_and_temperature_are_those_of_an_independent_solver(name, command):
    pressure, air = integrated(ACTUATORS[name], 2.5 * bar, command, 5000, 1e-5)
    muscle, temperature, tube = independent(name, 2.5 * bar, command, 0.05)
    assert float(pressure) == pytest.approx(muscle, rel=1e-8)
    assert float(air.temperatures[0]) == pytest.approx(temperature, rel=1e-8)
    assert abs(temperature - ROOM) > 5
    if name == "tube":
        assert float(air.valves[0].pressure) == pytest.approx(tube, rel=1e-8)


def shut(wall, **parts):
    return FlowValve(1e-30, SUPPLY, wall_conductance=wall, **parts)


def test_filling_fast_to_5_5_bar_and_shutting_loses_a_bar_and_a_half_within_two_seconds():
    """And venting to 1 bar recovers 0.5 bar or more; a polytropic change of state stays."""
    opened = PressureRegulator(0.4e-8, 8 * bar, time_constant=1 * ms, band=0.1 * bar, wall_conductance=WALL)
    for start, end, low, high in ((0.0, 5.49 * bar, 4.0, 4.3), (5.49 * bar, 0.99 * bar, 1.5, 1.8)):
        filled, air = integrated(opened, start, end, 800, 1e-4, growth=0.0)
        closed = shut(WALL)
        held = closed.init_states((filled,))._replace(temperatures=air.temperatures)
        after, _ = integrated(closed, filled, 0.0, 1000, 2e-3, 0.0, held)
        assert low < float(after) / bar < high


def test_adiabatic_air_is_compressed_as_p_v_to_the_kappa_and_air_at_a_good_wall_as_isothermal_air():
    for wall, index, growth, tolerance in ((0.0, KAPPA, -1e-4, 1e-9), (500.0, 1.0, -1e-5, 1e-4)):
        pressure, _ = integrated(shut(wall), 3 * bar, 0.0, 2000, 2.5e-5, growth=growth)
        ratio = VOLUME / (VOLUME + growth * 0.05)
        assert float(pressure + ATMOSPHERE) == pytest.approx((3 * bar + ATMOSPHERE) * ratio**index, rel=tolerance)


@pytest.mark.slow
def test_behind_shut_valves_the_mass_of_the_air_is_constant_and_no_air_is_consumed(knee, load):
    joint = dataclasses.replace(knee, tendon=SeriesSpring(stiffness=2e4, preload=0.0, travel=0.03))
    plant = numeric(JointPlant(joint, load, shut(WALL, dead_volume=3 * cm**3)))
    start = plant.init_state(0.1, (3e5, 4e5))._replace(velocity=jnp.asarray(0.5))
    moved = advance(plant, start, (0.0, 0.0), 0.1)
    masses = []
    for state in (start, moved):
        air = zip(state.pressures, plant.air_volumes(state), state.air.temperatures, strict=True)
        masses.append(
            [float((pressure + ATMOSPHERE) * room.volume / temperature) for pressure, room, temperature in air]
        )
    assert masses[1] == pytest.approx(masses[0], rel=1e-8)
    assert abs(float(moved.air.temperatures[0]) - ROOM) > 0.5


@pytest.mark.parametrize("wall", [0.0, 0.5, 50.0])
def test_the_bound_on_the_rates_holds_and_is_near(wall):
    valve = PressureRegulator(0.4e-8, SUPPLY, time_constant=50 * ms, band=0.1 * bar, wall_conductance=wall)
    room = AirVolume(jnp.asarray(VOLUME), jnp.asarray(0.0))

    def rates(x, command):
        (rate,), moved = valve.air_rate((x[0],), AirState((x[1],), (), (x[2],)), (command,), (room,))
        return jnp.stack([rate, moved.valves[0], moved.temperatures[0]])

    errors = BAND * np.array([-1.5, -0.9, -0.1, -0.01, 0.01, 0.1, 0.9, 1.5])
    pressure, error, temperature = np.meshgrid(
        [20.0, 1e5, 4e5, SUPPLY - 20, SUPPLY + 20], errors, [210.0, ROOM, 400.0], indexing="ij"
    )
    points = np.stack([pressure, pressure + error, temperature], axis=-1).reshape(-1, 3)
    jacobians = jax.jit(jax.vmap(jax.jacfwd(rates)))(points, (pressure + error).ravel())
    fastest = np.abs(np.linalg.eigvals(np.asarray(jacobians))).max()
    assert fastest < valve.fastest_rate_in(VOLUME) < 3 * fastest


def test_the_flow_needed_for_a_rate_covers_isothermal_and_adiabatic_air():
    """With air at the temperature of the wall, the command for a rate of the pressure gives at least that rate."""
    valve = dataclasses.replace(VALVE, leak=None)
    for rate, growth in ((4 * bar, 3e-6), (-4 * bar, -3e-6), (4 * bar, -1e-4)):
        pressure, room = jnp.asarray(2.5 * bar), AirVolume(jnp.asarray(VOLUME), jnp.asarray(growth))
        needed = float(valve.needed_flow(pressure, rate, room))
        polytropic = [
            dataclasses.replace(valve, wall_conductance=None, polytropic_index=index) for index in (1.0, KAPPA)
        ]
        flows = [float(one.needed_flow(pressure, rate, room)) for one in polytropic]
        assert abs(needed) == max(map(abs, flows))
