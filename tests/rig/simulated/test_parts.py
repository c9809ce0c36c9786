"""Flow and pressure, against closed forms and an integrator that knows nothing of ours."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.actuator import PressureRegulator
from mckibben.muscle.air import ATMOSPHERE, DENSITY, ENERGY, FLOATS, L_PER_S_BAR, mass_flow
from mckibben.rig.simulated.parts import Chamber, Regulator
from mckibben.units import bar
from tests.air import flow, follow

VOLUME = 20e-6
TIGHT = Regulator(leak=0.0, hysteresis=0.0, repeatability=0.0)


def filled(chamber, duration, volume=lambda time: VOLUME, times=None):
    """Pressures [Pa, gauge] at the end of each step, and the times."""
    now, kept = 0.0, [(0.0, chamber.pressure, chamber.mass, chamber.flow)]
    while now < duration - 1e-12:
        now += chamber.step(min(duration - now, 0.1), lambda time, now=now: volume(now + time))
        kept.append((now, chamber.pressure, chamber.mass, chamber.flow))
    return np.array(kept).T


def at_work(regulator=TIGHT, pressure=0.0):
    chamber = Chamber(regulator, VOLUME)
    chamber.exhausting = False
    chamber.set_signal(pressure, 0.0)
    return chamber


def test_choked_exhaust_is_an_exponential():
    chamber = at_work()
    chamber.stuck = 1.0
    filled(chamber, 5.0)
    chamber.exhausting = True
    before = chamber.pressure + ATMOSPHERE
    assert before == pytest.approx(TIGHT.supply + ATMOSPHERE, rel=1e-3)
    time, pressure, *_ = filled(chamber, 0.3)
    rate = TIGHT.exhaust * DENSITY * ENERGY / (VOLUME + TIGHT.dead_volume)
    choked = pressure + ATMOSPHERE > ATMOSPHERE / TIGHT.critical
    assert choked.sum() > 20
    # Each step is the exponential of its own middle: 3e-4 remain.
    np.testing.assert_allclose(pressure[choked] + ATMOSPHERE, before * np.exp(-rate * time[choked]), rtol=1e-3)


@pytest.mark.parametrize("target", [0.5 * bar, 3 * bar, 6 * bar])
def test_filling_is_that_of_an_independent_integrator(target):
    """A step of the signal, the chamber growing by half within a second, with a leak."""
    leaky = Regulator(hysteresis=0.0, repeatability=0.0, leak=2e-4 * L_PER_S_BAR)

    regulator = PressureRegulator(9.1e-11, 8 * bar, time_constant=0.03, band=1e4, leak=2e-12, polytropic_index=1.0)
    time, pressure, *_ = filled(at_work(leaky, target), 1.0, lambda time: VOLUME * (1 + 0.5 * time))
    expected, *_ = follow([regulator], [0.0], [target], time, [VOLUME + 5e-6], 0.5 * VOLUME)
    assert np.abs(pressure - expected).max() < 0.0025 * bar


def test_warm_air_is_that_of_an_independent_integrator():
    """Filled, shut, vented in part and shut, while the chamber grows: masses and energies, with a leak and a wall."""
    leaky = Regulator(conductance=0.1 * L_PER_S_BAR, leak=2e-4 * L_PER_S_BAR, wall_conductance=0.15)

    def volume(time):
        return VOLUME * (1 + 0.2 * time)

    def rates(time, state, opening):
        mass, energy = state  # kg, J
        temperature = energy / (mass * 720)
        pressure = mass * 288 * temperature / (volume(time) + 5e-6)
        inflow = flow(1e-9, 9.01325e5, pressure) if opening > 0 else 0.0
        outflow = -flow(2e-12 + (1e-9 if opening < 0 else 0.0), 101325, pressure, temperature=temperature)
        heat = 0.15 * (293.15 - temperature) - pressure * 0.2 * VOLUME
        return [inflow - outflow, 1008 * (293.15 * inflow - temperature * outflow) + heat]

    chamber, now = at_work(leaky), 0.0
    state = np.array([1.0, 720 * 293.15]) * 101325 * 25e-6 / (288 * 293.15)
    for opening, duration in ((1.0, 0.12), (0.0, 1.5), (-1.0, 0.1), (0.0, 1.0)):
        chamber.stuck, chamber.shut = opening, opening == 0.0
        exact = solve_ivp(
            rates, (now, now + duration), state, method="LSODA", rtol=1e-9, atol=1e-12, max_step=1e-3, args=(opening,)
        )
        time, pressure, *_ = filled(chamber, duration, lambda t, now=now: volume(now + t))
        there = 0.4 * exact.y[1] / (volume(exact.t) + 5e-6) - 101325
        assert np.abs(np.interp(now + time, exact.t, there) - pressure).max() < 0.001 * bar
        state, now = exact.y[:, -1], now + duration
        assert chamber.temperature == pytest.approx(state[1] / (state[0] * 720), abs=0.3)


def test_air_is_neither_made_nor_lost():
    """What flowed in is what is there, and what is there has its pressure."""
    chamber = at_work(Regulator(), 4 * bar)
    time, pressure, mass, flow = filled(chamber, 2.0, lambda t: VOLUME * (1 + 0.2 * np.sin(3 * t)))
    np.testing.assert_allclose(mass[1:] - mass[0], np.cumsum(flow[1:] * np.diff(time)), rtol=1e-9)
    volume = VOLUME * (1 + 0.2 * np.sin(3 * time)) + 5e-6
    np.testing.assert_allclose(pressure + ATMOSPHERE, mass * 288 * 293.15 / volume, rtol=1e-9)


def test_pressure_settles_where_the_regulator_covers_the_leak():
    leaky = Regulator(hysteresis=0.0, leak=1e-3 * L_PER_S_BAR)
    chamber = at_work(leaky, 5 * bar)
    filled(chamber, 5.0)
    gone = 1e-11 * 1.185 * (chamber.pressure + ATMOSPHERE)  # choked
    pressures = leaky.supply + ATMOSPHERE, chamber.pressure + ATMOSPHERE
    came = mass_flow(leaky.conductance * chamber.opening, 0.3, *pressures, FLOATS)
    assert came == pytest.approx(gone, rel=5e-3) and abs(chamber.flow) < 5e-3 * gone
    assert 5 * bar - chamber.pressure == pytest.approx(0.0859 * 0.1 * bar, rel=0.01)  # by hand


def test_signals_from_above_and_below_differ_by_the_hysteresis():
    plain = Regulator(leak=0.0, repeatability=0.0)
    ends = []
    for first in (1.0, 5.0):
        chamber = at_work(plain, first * bar)
        filled(chamber, 5.0)
        chamber.set_signal(3 * bar, 0.0)
        filled(chamber, 5.0)
        ends.append(chamber.pressure)
    assert ends[1] - ends[0] == pytest.approx(plain.hysteresis, rel=0.01)
    assert sum(ends) / 2 == pytest.approx(3 * bar, rel=1e-4)
