"""Unequal valves with tubes and a shared reservoir, against SciPy with the equations written anew."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben import leg
from mckibben.actuator import (
    AirVolume,
    FirstOrderValve,
    FlowValve,
    IdealValve,
    PressureRegulator,
    Tube,
    UnequalValves,
)
from mckibben.errors import RangeError
from mckibben.numerics.calculus import rk4
from mckibben.plant import JointPlant
from mckibben.units import bar, cm, ms

ATMOSPHERE, ENERGY, DENSITY, INDEX, SUPPLY = 101325.0, 288.0 * 293.15, 1.185, 1.2, 7 * bar
CONDUCTANCES, LAGS, TUBES = (0.1e-8, 0.06e-8), (20 * ms, 30 * ms), (0.08e-8, 0.12e-8)
STORE, LINE, ROOM, BAND = 100 * cm**3, 0.05e-8, 6 * cm**3, 0.5 * bar
VOLUMES = (20e-6, 15e-6)
VALVES = [
    Tube(PressureRegulator(c, SUPPLY, time_constant=lag, band=BAND), volume=ROOM, conductance=tube)
    for c, lag, tube in zip(CONDUCTANCES, LAGS, TUBES, strict=True)
]
PAIR = UnequalValves(*VALVES, reservoir_volume=STORE, line_conductance=LINE)
LAGGING = UnequalValves(FirstOrderValve(20 * ms), FirstOrderValve(30 * ms, supply=4 * bar))


def flow(conductance, inlet, outlet):
    if outlet > inlet:
        return -flow(conductance, outlet, inlet)
    ratio = outlet / inlet
    share = math.sqrt(1 - (max(min(ratio, 0.999) - 0.3, 0.0) / 0.7) ** 2) * min((1 - ratio) / 0.001, 1.0)
    return conductance * DENSITY * inlet * share


def independent(start, commands, time):
    """Pressures of muscles, tubes, lagged commands, and of the reservoir [Pa gauge], by SciPy."""

    def rate(_, y):
        muscles, tubes, held, store = y[:2], y[2:4], y[4:6], y[6]
        changes, drawn = np.zeros(7), 0.0
        for i in (0, 1):
            opening = min(max((held[i] - tubes[i]) / BAND, -1.0), 1.0)
            if opening > 0:
                valve = flow(CONDUCTANCES[i] * opening, store + ATMOSPHERE, tubes[i] + ATMOSPHERE)
                drawn += valve
            else:
                valve = -flow(CONDUCTANCES[i] * -opening, tubes[i] + ATMOSPHERE, ATMOSPHERE)
            through = flow(TUBES[i], tubes[i] + ATMOSPHERE, muscles[i] + ATMOSPHERE)
            changes[i] = INDEX * ENERGY * through / VOLUMES[i]
            changes[2 + i] = INDEX * ENERGY * (valve - through) / ROOM
            changes[4 + i] = (commands[i] - held[i]) / LAGS[i]
        line = flow(LINE, SUPPLY + ATMOSPHERE, store + ATMOSPHERE)
        changes[6] = INDEX * ENERGY * (line - drawn) / STORE
        return changes

    first = [*start, *start, *start, SUPPLY]
    return solve_ivp(rate, (0, time), first, method="LSODA", rtol=1e-10, atol=1e-6, max_step=1e-4).y[:, -1]


@pytest.mark.slow
def test_both_fill_from_one_supply_that_sags_as_an_independent_solver_says():
    start, commands = (1 * bar, 1.5 * bar), (5 * bar, 6 * bar)
    volumes = [AirVolume(jnp.asarray(volume), jnp.zeros(())) for volume in VOLUMES]

    def follow(_, carry):
        return rk4(lambda carry: PAIR.air_rate(*carry, commands, volumes), carry, 1e-5)

    begin = tuple(map(jnp.asarray, start))
    pressures, air = jax.jit(lambda: jax.lax.fori_loop(0, 5000, follow, (begin, PAIR.init_states(begin))))()
    muscle1, muscle2, tube1, tube2, held1, held2, store = independent(start, commands, 0.05)
    got = [*pressures, *(one.pressure for one in air.valves), *(one.valve for one in air.valves), air.reservoir]
    np.testing.assert_allclose(got, [muscle1, muscle2, tube1, tube2, held1, held2, store], rtol=1e-8)
    assert store < 6.5 * bar  # it sagged
    told = PAIR.telemetry(air, commands, pressures)
    assert set(told) == {"opening1", "outlet1", "opening2", "outlet2", "reservoir"}
    assert float(told["outlet2"]) == float(air.valves[1].pressure)


def test_each_muscle_has_its_own_response_and_limit(knee, load):
    plant = JointPlant(knee, load, LAGGING)
    state = plant.init_state(0.0, (2 * bar, 2 * bar))
    (first, second), _ = LAGGING.all_after(state.pressures, state.air, (3 * bar, 3 * bar), 10 * ms)
    assert float(first) == pytest.approx(3 * bar - bar * math.exp(-0.5), rel=1e-12)
    assert float(second) == pytest.approx(3 * bar - bar * math.exp(-1 / 3), rel=1e-12)
    assert [float(one) for one in plant.clip_commands((5 * bar, 5 * bar))] == [5 * bar, 4 * bar]
    rated = plant.supplied_joint
    assert (float(rated.muscle1.domain.pressure_max), float(rated.muscle2.domain.pressure_max)) == (6 * bar, 4 * bar)
    assert float(LAGGING.lag) == pytest.approx(25 * ms)
    commands = plant.commands_for(state, (bar, bar))
    assert [float(one) for one in commands] == [pytest.approx(2.02 * bar), pytest.approx(2.03 * bar)]


def test_what_no_pair_can_be_is_refused():
    flow_valve = FlowValve(1e-9, SUPPLY)
    stored = dataclasses.replace(flow_valve, reservoir_volume=1e-3, line_conductance=1e-9)
    for wrong, field in (
        ({"muscle2": FirstOrderValve(20 * ms)}, "muscle2"),
        ({"muscle2": IdealValve()}, "muscle2"),
        ({"muscle2": FlowValve(1e-9, SUPPLY, direct=True)}, "muscle2"),
        ({"muscle1": stored}, "muscle1"),
        ({"muscle2": PAIR}, "muscle2"),
        ({"reservoir_volume": 1e-3}, "line_conductance"),
    ):
        with pytest.raises(RangeError) as caught:
            UnequalValves(**({"muscle1": flow_valve, "muscle2": flow_valve} | wrong))
        assert caught.value.field == field
    with pytest.raises(RangeError) as caught:
        UnequalValves(FirstOrderValve(0.1), FirstOrderValve(0.1), reservoir_volume=1e-3, line_conductance=1e-9)
    assert caught.value.field == "reservoir_volume"
    with pytest.raises(RangeError) as caught:
        leg.LegPlant(leg.read_leg("lei-leg-planar"), LAGGING)
    assert caught.value.field == "valve"
