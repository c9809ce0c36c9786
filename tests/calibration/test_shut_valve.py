"""Identification from tests with a shut valve, on data of an independent solver."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben import catalog
from mckibben.calibration import identify_air
from mckibben.dataset import Recording
from mckibben.errors import IdentificationError, RangeError
from mckibben.muscle import Specimen
from mckibben.units import bar, cm, kPa
from tests.air import ATMOSPHERE, GAS, KAPPA, ROOM, flow

pytestmark = pytest.mark.usefixtures("optimized")  # one program runs a thousand times
SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
WALL, LEAK, DEAD, NOISE, PERIOD = 0.12, 2e-12, 3 * cm**3, 0.5 * kPa, 1e-3


def wall_area(contraction):
    """Area 4 V/d [m^2] of a cylinder of the muscle's volume and length."""
    volume, length = float(SPECIMEN.volume(contraction)), SPECIMEN.initial_length * (1 - contraction)
    return 4 * volume / math.sqrt(4 * volume / (math.pi * length))


def two_lengths(seed=0, wall=WALL, **given):
    """Tests at 2 and 22 % with a wall that grows with its area and holds at 12 %."""
    return [
        shut_valve_test(at, wall=wall * wall_area(at) / wall_area(0.12), seed=seed + i, **given)
        for i, at in enumerate((0.02, 0.22))
    ]


def recorded(time, pressure, contraction=0.1):
    return Recording.of(time=time, pressure=pressure, force=0 * time, contraction=contraction)


def shut_valve_test(contraction, wall=WALL, leak=LEAK, dead=DEAD, watched=3.0, seed=0, noise=NOISE):
    """Recording of a muscle filled to 5.5 bar and shut, then vented to 1 bar and shut, by SciPy."""
    volume = float(SPECIMEN.volume(contraction)) + dead

    def rates(_, y, opening):
        pressure, temperature = y
        inflow = flow(2e-9, 8e5, pressure) if opening > 0 else 0.0
        opened = leak + (2e-9 if opening < 0 else 0.0)
        outflow = -min(flow(opened, ATMOSPHERE, pressure, temperature=temperature), 0.0)
        energy = GAS * (inflow * ROOM - outflow * temperature)
        slope = (KAPPA * energy + (KAPPA - 1) * wall * (ROOM - temperature)) / volume
        mass = pressure * volume / (GAS * temperature)
        return [slope, temperature * (slope / pressure - (inflow - outflow) / mass)]

    def until(_, y, opening):
        return opening * ((5.5 if opening > 0 else 1.0) * bar + ATMOSPHERE - y[0])

    until.terminal = True
    state, pressures = [ATMOSPHERE, ROOM], [np.full(200, ATMOSPHERE)]
    for opening, longest in ((1, 2.0), (0, watched), (-1, 2.0), (0, watched)):
        times = np.arange(0.0, longest, PERIOD)
        events = until if opening else None
        found = solve_ivp(
            rates, (0, longest), state, "LSODA", times, events=events, args=(opening,), rtol=1e-7, atol=1e-3
        )
        pressures.append(found.y[0])
        state = found.y_events[0][0] if opening else found.y[:, -1]
    gauge = np.concatenate(pressures) - ATMOSPHERE
    gauge = gauge + np.random.default_rng(seed).normal(0.0, noise, gauge.size)
    return recorded(PERIOD * np.arange(gauge.size), gauge, contraction)


@pytest.mark.slow
def test_wall_leak_and_dead_volume_are_found_from_two_lengths():
    found = identify_air(two_lengths(), SPECIMEN)
    assert len(found.phases) == 4
    assert found.contraction == pytest.approx(0.12)
    true = {"wall_conductance": WALL, "leak": LEAK, "dead_volume": DEAD}
    assert found.quantities.keys() == true.keys()
    for name, one in found.quantities.items():
        assert abs(one.value - true[name]) < 4 * one.deviation
        assert one.deviation < 0.15 * true[name]
    assert found.residual < 1.2 * found.noise


def test_at_one_length_the_dead_volume_is_assumed_and_the_ratio_is_found():
    recording = shut_valve_test(0.1)
    found = identify_air([recording], SPECIMEN, dead_volume=DEAD)
    assert "dead_volume" not in found.quantities and found.assumed == DEAD
    assert "dead_volume" in {remark.field for remark in found.remarks()}
    wall = found.quantities["wall_conductance"]
    low, high = wall.interval
    assert 0.95 * WALL < low < WALL < high < 1.05 * WALL
    without = identify_air([recording], SPECIMEN)
    volume = float(SPECIMEN.volume(0.1))
    expected = wall.value * volume / (volume + DEAD)
    assert without.quantities["wall_conductance"].value == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_intervals_of_95_percent_hold_the_truth():
    """Noise, wall, leak and dead volume differ; 24 tests of two lengths."""
    draw, held, count = np.random.default_rng(3), dict.fromkeys(("wall_conductance", "leak", "dead_volume"), 0), 24
    for seed in range(count):
        true = {"wall": draw.uniform(0.03, 0.3), "leak": draw.uniform(0, 1e-11), "dead": draw.uniform(0, 6) * cm**3}
        found = identify_air(two_lengths(2 * seed, **true), SPECIMEN)
        for name, value in zip(held, true.values(), strict=True):
            low, high = found.quantities[name].interval
            held[name] += low < value < high
    assert all(count * 0.85 <= one for one in held.values())


def test_what_cannot_be_identified_is_refused_with_a_remedy():
    time = np.arange(0.0, 4.0, PERIOD)
    held = np.where(time < 0.5, 0.0, 5 * bar) + np.random.default_rng(0).normal(0, 100.0, time.size)
    whole = shut_valve_test(0.1)
    pressure = whole.table["pressure"].to_numpy()
    regulated, moving = recorded(time, held), recorded(whole.time, pressure, 0.1 + 0.01 * whole.time)
    saturated = recorded(whole.time, np.minimum(pressure, 4.3 * bar))
    single, slow = recorded(whole.time[:1], pressure[:1]), recorded(whole.time[::20], pressure[::20])
    for recordings in ([], [regulated], [moving], [saturated], [slow], [single]):
        with pytest.raises(IdentificationError) as caught:
            identify_air(recordings, SPECIMEN)
        assert caught.value.remedy
    bare = recorded(whole.time, pressure, None)
    with pytest.raises(IdentificationError):
        identify_air([bare], SPECIMEN)
    assert identify_air([bare], SPECIMEN, contraction=0.1).phases
    with pytest.raises(RangeError):
        identify_air([whole], Specimen("unknown", 0.2))


def test_a_watch_that_is_too_short_is_remarked():
    found = identify_air([shut_valve_test(0.1, wall=0.02, watched=0.8)], SPECIMEN)
    assert "phases" in {remark.field for remark in found.remarks()}


def cooling(contraction, time_constant):
    """Recording of a muscle filled to 5 bar whose pressure falls to 4 bar."""
    time = np.arange(0.0, 4.0, PERIOD)
    shut = 4 * bar + 1 * bar * np.exp(-(time - 0.5) / time_constant)
    gauge = np.where(time < 0.5, np.interp(time, [0.4, 0.5], [0.0, 5 * bar]), shut)
    gauge = gauge + np.random.default_rng(0).normal(0.0, 200.0, time.size)
    return recorded(time, gauge, contraction)


@pytest.mark.parametrize("constants", [(0.7, 0.5), (0.3, 0.7)])
def test_time_constants_that_contradict_the_volumes_are_refused(constants):
    """The dead volume would be without bound, or below 0."""
    with pytest.raises(IdentificationError) as caught:
        identify_air([cooling(at, tau) for at, tau in zip((0.0, 0.2), constants, strict=True)], SPECIMEN)
    assert caught.value.remedy
    assert not caught.value.lower < caught.value.value + 1e-7 < caught.value.upper
