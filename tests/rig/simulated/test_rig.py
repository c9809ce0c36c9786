"""What a host sees of the twin, and what is true."""

import dataclasses
import math

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError, RigError
from mckibben.muscle import MaxwellCreep, MaxwellSlip, Muscle, forces
from mckibben.rig.simulated import FORCE_SENSOR, PRESSURE_SENSOR, Regulator, SimulatedRig
from mckibben.units import bar, kPa, mm

SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
PLAIN = Muscle(SPECIMEN, catalog.law("lei-mas-10-180n"))
REAL = Muscle(SPECIMEN, PLAIN.law, MaxwellSlip(12.0, 0.5 * mm), MaxwellCreep(500.0, 5.0, arms=2))
QUIET = {
    "force_sensor": dataclasses.replace(FORCE_SENSOR, noise=0.0, resolution=0.0),
    "pressure_sensor": dataclasses.replace(PRESSURE_SENSOR, noise=0.0, resolution=0.0),
    "regulator": Regulator(hysteresis=0.0, repeatability=0.0, leak=0.0),
}
SAFE = 0.2 * bar


def opened(muscle=PLAIN, **settings):
    rig = SimulatedRig(muscle, **settings)
    rig.open()
    return rig


def press(rig, pressure):
    rig.set_valves([pressure])


def blocks(rig, duration, count=100):
    """Read for so long, beating."""
    kept = []
    for _ in range(round(duration * rig.rate / count)):
        kept.append(rig.read(count))
        rig.heartbeat()
    return kept


def columns(rig, kept):
    """Times, force [N], pressure [Pa], position [m]."""
    si = np.concatenate([block.values for block in kept]).T
    return np.concatenate([block.time for block in kept]), *si, np.concatenate([block.position for block in kept])


def test_sensors_tell_the_truth_of_the_law():
    rig = opened(**QUIET)
    press(rig, 4 * bar)
    rig.move(-9 * mm, 1 * mm)
    _, force, pressure, position = columns(rig, blocks(rig, 15.0))
    truth = rig.truth
    assert truth.contraction == pytest.approx(0.05) and position[-1] == pytest.approx(-9 * mm)
    assert pressure[-1] == pytest.approx(truth.pressure, abs=1) and truth.pressure == pytest.approx(4 * bar, rel=1e-4)
    assert force[-1] == pytest.approx(float(forces(PLAIN, 0.05, truth.pressure)), abs=1e-3)
    # On the way, too: the force of each sample is that of the law at its position and its pressure.
    along = forces(PLAIN, -np.arange(0, 1) / 0.18, 0.0)
    assert force[0] == pytest.approx(along[0], abs=1e-3)
    middle = slice(2000, 9000, 500)
    contraction = -position[middle] / 0.18
    np.testing.assert_allclose(force[middle], forces(PLAIN, contraction, pressure[middle]), atol=0.3)


def test_noise_and_steps_are_those_of_the_sensors():
    rig = opened()
    _, force, pressure, _ = columns(rig, blocks(rig, 20.0))
    assert np.std(force) == pytest.approx(0.5, rel=0.03)
    assert np.std(pressure) == pytest.approx(0.5 * kPa, rel=0.03)
    steps = force / (4000 / 2**18)
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-6)
    assert abs(np.mean(pressure)) < 25


def test_same_seed_same_samples_however_they_are_read():
    def run(seed, count):
        rig = opened(REAL, seed=seed)
        press(rig, 5 * bar)
        rig.move(-1 * mm, 0.2 * mm)
        return rig, columns(rig, blocks(rig, 8.0, count))

    (one, first), (_, again), (_, other), (two, split) = run(1, 100), run(1, 100), run(2, 100), run(1, 250)
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a, b)
    assert (first[1] != other[1]).any()
    np.testing.assert_array_equal(first[3], split[3])
    assert np.abs(first[2] - split[2]).max() < 0.005 * bar  # the noise is the same, the steps differ
    assert one.truth.force == pytest.approx(two.truth.force, abs=0.2)


def test_motor_moves_in_time():
    rig = opened()
    rig.move(0.1 * mm, 0.2 * mm)
    assert rig.moving
    with pytest.raises(RigError, match="still moving"):
        rig.move(1 * mm, 0.2 * mm)
    block = rig.read(600)
    np.testing.assert_allclose(block.position, np.minimum(np.arange(600) * 2e-7, 0.1 * mm), atol=1e-12)
    assert not rig.moving and rig.truth.stretch == pytest.approx(0.1 * mm)
    rig.heartbeat()
    rig.move(-0.1 * mm, 0.2 * mm)
    rig.read(250)
    rig.stop()
    np.testing.assert_allclose(rig.read(10).position, 0.05 * mm)
    with pytest.raises(RigError, match="m/s at most"):
        rig.move(1 * mm, 5.1 * mm)


# Vented


@pytest.mark.parametrize("contraction", [-0.03, 0.1, 0.25])
def test_vented_muscle_has_no_pressure_within_a_second(contraction):
    rig = opened(mounted_at=contraction, patience=1e9)
    press(rig, 8 * bar)
    rig.read(8000)
    assert rig.truth.pressure > 7.5 * bar and not rig.truth.vented
    rig.vent()
    rig.pass_time(1.0)
    assert rig.truth.vented and rig.truth.pressure < SAFE
    press(rig, 0.0)
    rig.pass_time(1.0)
    assert rig.truth.vented
    press(rig, 2 * bar)
    rig.pass_time(3.0)
    assert rig.truth.pressure == pytest.approx(2 * bar, abs=0.1 * bar)


def test_missed_beat_vents_in_time_and_holds_until_opened_anew():
    rig = opened(patience=0.3)
    press(rig, 6 * bar)
    rig.move(-2 * mm, 0.2 * mm)
    blocks(rig, 2.0)
    position = rig.read(600).position  # the beat was at 2.0 s
    assert position[299] > position[301] and np.ptp(position[301:]) == 0
    rig.heartbeat()
    with pytest.raises(RigError, match="reopen it"):
        press(rig, 1 * bar)
    rig.close()
    rig.open()
    press(rig, 1 * bar)
    assert rig.clock() == 0 and rig.read(10).position[0] == 0 and not rig.truth.vented
    rig.move(0.1 * mm, 0.2 * mm)
    assert rig.read(200).position[-1] == pytest.approx(199 * 2e-7)


def test_host_that_is_away_for_too_long_loses_samples_and_is_told():
    rig = opened(patience=1e9)
    rig.pass_time(10.0)
    assert rig.read(100).first == 0
    rig.pass_time(11.0)
    with pytest.raises(RigError, match="overwritten"):
        rig.read(100)


# Wrong use


def test_wrong_use_is_refused():
    rig = SimulatedRig(PLAIN)
    for what in (lambda: rig.read(1), lambda: rig.set_valves([1.0]), lambda: rig.move(1 * mm, 0.2 * mm)):
        with pytest.raises(RigError, match="not open"):
            what()
    rig.open()
    for what in (
        lambda: rig.open(),
        lambda: rig.set_valves([11 * bar]),
        lambda: rig.set_valves([math.nan]),
        lambda: rig.set_valves([]),
    ):
        with pytest.raises(RigError):
            what()
    for what in (lambda: rig.read(0), lambda: SimulatedRig(PLAIN, rate=0.0), lambda: Regulator(band=0.0)):
        with pytest.raises(RangeError):
            what()


# In real time


class Wall:
    """A clock that goes on when one sleeps."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now

    def sleep(self, span):
        assert span > 0
        self.now += span


def test_paced_rig_waits_for_the_wall():
    wall = Wall()
    rig = SimulatedRig(PLAIN, paced=True, wall=wall, sleep=wall.sleep)
    rig.open()
    for k in range(5):
        assert rig.read(100).first == 100 * k
        rig.heartbeat()
        assert rig.clock() == pytest.approx(0.1 * (k + 1))
    wall.now += 0.25  # the host was busy
    assert rig.read(100).first == 500 and rig.clock() == pytest.approx(0.75)
    assert rig.read(100).first == 600 and rig.clock() == pytest.approx(0.75)
    assert rig.read(100).first == 700 and rig.clock() == pytest.approx(0.8)


def test_paced_rig_vents_while_the_host_is_away():
    wall = Wall()
    rig = SimulatedRig(PLAIN, paced=True, wall=wall, sleep=wall.sleep)
    rig.open()
    press(rig, 6 * bar)
    for _ in range(30):
        rig.read(100)
        rig.heartbeat()
    assert rig.truth.pressure > 5 * bar
    wall.now += 2.5
    assert not rig.moving and rig.truth.pressure < SAFE
    with pytest.raises(RigError, match="without a heartbeat"):
        rig.set_valves([1.0])


@pytest.mark.parametrize("wrong", [{"mounted_at": 5.0}, {"mounted_at": np.nan}, {"seed": -1}])
def test_a_rig_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(RangeError) as refused:
        SimulatedRig(REAL, **wrong)
    assert refused.value.field == next(iter(wrong))
