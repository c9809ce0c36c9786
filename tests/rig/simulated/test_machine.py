"""Muscle and air of the simulated rig, against closed forms."""

import itertools

import numpy as np
import pytest

from mckibben import catalog
from mckibben.muscle import MaxwellCreep, MaxwellSlip, Muscle, forces
from mckibben.muscle.air import ATMOSPHERE, DENSITY, ENERGY
from mckibben.rig.simulated import Regulator, SimulatedRig
from mckibben.units import bar, mm

SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
LAW = catalog.law("lei-mas-10-180n")
TIGHT = Regulator(leak=0.0, hysteresis=0.0, repeatability=0.0)
VOLUME = float(SPECIMEN.volume(0.1)) + 5e-6


def at_work(muscle, pressure, regulator=TIGHT):
    rig = SimulatedRig(muscle, mounted_at=0.1, regulator=regulator, patience=1e6)
    rig.open()
    rig.set_valves([pressure])
    return rig


def passed(rig, duration):
    """Times, forces and pressures of the knots within a duration."""
    times, values = rig._integrate(rig.now + duration)
    return np.array([times, *zip(*values, strict=True)])


def test_friction_along_a_way_is_that_of_the_muscle():
    """Moves back and forth at a pressure that changes."""
    friction = MaxwellSlip(12.0, 0.5e-3, growth=5e-6)
    rig, states = at_work(Muscle(SPECIMEN, LAW, friction), 3 * bar), []
    for distance in (-3, 0.5, -1.5, 5, -0.8, 0.5):
        rig.move(distance * mm, 1 * mm)
        while rig.moving:
            passed(rig, 0.01)
            states.append(rig.truth)
    contraction, pressure, force = (
        np.array([getattr(s, n) for s in states]) for n in ("contraction", "pressure", "force")
    )
    tension = forces(Muscle(SPECIMEN, LAW), contraction, pressure)
    expected = tension + friction.path_response(0.18 * (1 - contraction), tension, pressure)
    taut = np.flatnonzero(pressure > 2.9 * bar)[20:]
    np.testing.assert_allclose(force[taut], expected[taut], atol=0.05)


def test_creep_after_moves_is_that_of_the_muscle():
    creep = MaxwellCreep(1500.0, 2.0, arms=2)
    rig, stops, read = at_work(Muscle(SPECIMEN, LAW, creep=creep), 3 * bar), [0, 2 * mm, 1 * mm, 4 * mm], []
    passed(rig, 30.0)
    for before, after in itertools.pairwise(stops):
        rig.move(after - before, 2 * mm)
        passed(rig, abs(after - before) / (2 * mm))
        states = []
        for _ in range(12):
            passed(rig, 0.25)
            states.append(rig.truth)
        read.append([s.force - float(forces(Muscle(SPECIMEN, LAW), s.contraction, s.pressure)) for s in states])
    length = 0.162 + np.array(stops)
    tension, moves = (
        forces(Muscle(SPECIMEN, LAW), 1 - length / 0.18, 3 * bar),
        np.abs(np.diff(stops, prepend=0)) / (2 * mm),
    )
    expected = creep.path_response(
        length, tension, move_time=moves, hold_time=3.0, sample_times=0.25 * np.arange(1, 13)
    )
    np.testing.assert_allclose(read, expected[1:], atol=0.05)


def test_choked_exhaust_is_an_exponential():
    rig = at_work(Muscle(SPECIMEN, LAW), 8 * bar)
    passed(rig, 20.0)
    rig.vent()
    rig.now += TIGHT.exhaust_delay
    rig._settle()
    before = rig.truth.pressure + ATMOSPHERE
    time, _, pressure = passed(rig, 0.3)
    rate = TIGHT.exhaust * DENSITY * ENERGY / VOLUME
    choked = pressure + ATMOSPHERE > ATMOSPHERE / TIGHT.critical
    assert choked.sum() > 10
    expected = before * np.exp(-rate * (time - time[0]))
    np.testing.assert_allclose(pressure[choked] + ATMOSPHERE, expected[choked], rtol=1e-3)


def test_signals_from_above_and_below_differ_by_the_hysteresis():
    plain, ends = Regulator(leak=0.0, repeatability=0.0), []
    for first in (1.0, 5.0):
        rig = at_work(Muscle(SPECIMEN, LAW), first * bar, plain)
        passed(rig, 5.0)
        rig.set_valves([3 * bar])
        passed(rig, 5.0)
        ends.append(rig.truth.pressure)
    assert ends[1] - ends[0] == pytest.approx(plain.hysteresis, rel=0.01)
    assert sum(ends) / 2 == pytest.approx(3 * bar, rel=1e-4)
