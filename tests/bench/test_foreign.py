"""The simulated muscles against closed forms: energy of the wall, Mittag-Leffler response, Bouc-Wen loop."""

import numpy as np
import pytest
from scipy.special import gamma

from mckibben.bench.foreign import ForeignJoint, ForeignMuscle


def test_without_wall_ends_and_contact_the_braid_is_that_of_chou():
    muscle = ForeignMuscle(wall=0.0, thread=0.0, ends=1.0, contact=0.0, contact_slope=0.0, contact_width=1e-3)
    angle, pressure, contraction = muscle.braid_angle, 4e5, 0.1
    area = np.pi * muscle.diameter**2 / 4
    chou = pressure * area * (3 / np.tan(angle) ** 2 * (1 - contraction) ** 2 - 1 / np.sin(angle) ** 2)
    assert muscle.static_force(contraction, pressure) == pytest.approx(chou, rel=1e-9)


def test_the_force_of_the_wall_is_the_slope_of_its_energy():
    muscle = ForeignMuscle(ends=1.0)
    thread = muscle.length / np.cos(muscle.braid_angle)

    def energy(length):
        axial = length / muscle.length
        hoop = np.sqrt((thread**2 - length**2) / (thread**2 - muscle.length**2))
        squares = np.array([axial**2, hoop**2, 1 / (axial * hoop) ** 2])
        return muscle.wall * (muscle.first * (squares.sum() - 3) + muscle.second * ((1 / squares).sum() - 3))

    length, step, pressure = 0.9 * muscle.length, 1e-6, 5e5
    slope = (energy(length + step) - energy(length - step)) / (2 * step)
    rigid = ForeignMuscle(ends=1.0, first=0.0, second=0.0)
    wall = muscle.static_force(0.1, pressure) - rigid.static_force(0.1, pressure)
    assert wall == pytest.approx(slope, rel=1e-6)


def test_the_volume_is_the_integral_of_the_ideal_force():
    """Virtual work: the force per pressure is minus the derivative of the volume by the length."""
    muscle = ForeignMuscle(wall=0.0, thread=0.0, ends=1.0, contact=0.0, contact_slope=0.0, contact_width=1e-3)
    step = 1e-6
    slope = (muscle.volume(0.1 + step) - muscle.volume(0.1 - step)) / (2 * step * muscle.length)
    assert muscle.static_force(0.1, 4e5) == pytest.approx(4e5 * slope, rel=1e-6)


def test_creep_is_a_power_of_time_at_first():
    """A step of the static force: the delayed part grows as t^a / (T^a Gamma(1 + a))."""
    muscle = ForeignMuscle(creep=0.1, creep_time=50.0, creep_order=0.4)
    period = 0.002
    pressure = np.where(np.arange(2000) < 1, 2e5, 4e5)
    force = muscle.force(period, np.full(2000, 0.05), pressure)
    static = muscle.static_force(0.05, np.array([2e5, 4e5]))
    share = (force - static[0]) / np.diff(static)
    at = 1500
    grown = (share[at] - 0.9) / 0.1
    time = period * at
    expected = sum(
        (-1) ** (k + 1) * (time / 50.0) ** (0.4 * k) / gamma(1 + 0.4 * k) for k in range(1, 40)
    )  # 1 - Mittag-Leffler
    assert grown == pytest.approx(expected, rel=0.02)


def test_the_hysteresis_saturates_at_unequal_heights():
    muscle = ForeignMuscle()
    up = (1 + 2 * muscle.asymmetry) ** (-1 / 1.5)
    down = (1 - 2 * muscle.asymmetry) ** (-1 / 1.5)
    assert muscle.sliding_rate(up, 1.0) == pytest.approx(0, abs=1e-9)
    assert muscle.sliding_rate(-down, -1.0) == pytest.approx(0, abs=1e-9)


def test_a_valve_chokes_and_closes():
    joint = ForeignJoint()
    low, high = joint._flow(2e5, 1.0), joint._flow(4e5, 1.0)
    assert low == pytest.approx(high)  # both below the critical ratio to the supply
    upstream = joint.supply + 101325
    critical = np.sqrt(1.4 / (287.0 * 293.15)) * (2 / 2.4) ** (2.4 / 0.8)  # choked flow per area and pressure
    assert low == pytest.approx(joint.opening * upstream * critical, rel=1e-6)
    assert joint._flow(upstream, 1.0) == 0.0
    assert joint._flow(3e5, -0.5) < 0
