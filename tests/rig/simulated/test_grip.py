"""The muscle as the twin has it, against the muscle as the rest of the package has it."""

import itertools

import jax
import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RangeError
from mckibben.muscle import ChouLaw, ExponentialLaw, HuntLaw, MaxwellCreep, MaxwellSlip, Muscle, forces
from mckibben.rig.simulated.machine import Grip, force_table
from mckibben.units import bar, percent

SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
LAW = catalog.law("lei-mas-10-180n")


@pytest.mark.parametrize(
    "law", [LAW, ChouLaw.of(SPECIMEN), catalog.law("sarosi-dmsp-10")], ids=lambda law: type(law).__name__
)
def test_table_is_its_law(law):
    muscle = Muscle(SPECIMEN, law)
    table = force_table(muscle)
    random = np.random.default_rng(1)
    contraction, pressure = random.uniform(-0.03, 0.25, 300), random.uniform(0, 8 * bar, 300)
    told = [table.force(*point) for point in zip(contraction.tolist(), pressure.tolist(), strict=True)]
    np.testing.assert_allclose(told, np.maximum(forces(law, contraction, pressure), 0), atol=1e-4)
    assert table.error < 1e-4
    assert table.force(-0.5, 6 * bar) == table.force(table.contraction[0], 6 * bar)  # of its edge
    assert table.force(0.249, 0.0) == pytest.approx(0, abs=1e-9)


def test_law_that_is_too_rough_or_has_no_number_is_refused():
    rough = ExponentialLaw(0.0, 0.0, 0.0, 0.0, 1e-6, 0.0, decay=300.0)  # e-fold within 3 of the table's cells
    assert force_table(Muscle(SPECIMEN, rough)).error < 0.5
    for law, text in (
        (ExponentialLaw(0.0, 0.0, 0.0, 0.0, 10.0, 0.0, decay=300.0), "not smooth enough"),
        (HuntLaw(254.3e3, 1230.0, 192e3, 0.16), "no finite force"),
    ):
        with pytest.raises(RangeError, match=text):
            force_table(Muscle(SPECIMEN, law))


def test_volume_is_that_of_the_specimen():
    grip = Grip(Muscle(SPECIMEN, LAW), 0.1)
    for contraction in (-0.03, 0.0, 0.13, 0.25):
        stretch = (0.1 - contraction) * 0.18
        assert grip.volume(stretch) == pytest.approx(float(SPECIMEN.volume(contraction)), rel=1e-12)


def test_friction_along_a_way_is_that_of_the_muscle():
    """Moves back and forth in many short ones, at a pressure that changes."""
    friction = MaxwellSlip(12.0, 0.5e-3, growth=5e-6)
    stops = np.array([0, -3, -2.5, -4, 1, 0.2, 0.7, 0.1, -6, 2]) * 1e-3
    stretch = np.concatenate([np.linspace(*ends, 11)[1:] for ends in itertools.pairwise(stops)])
    pressure = np.linspace(1 * bar, 5 * bar, len(stretch))
    grip = Grip(Muscle(SPECIMEN, LAW, friction), 0.1)
    told = [grip.force(*point, 0.1) for point in zip(stretch.tolist(), pressure.tolist(), strict=True)]
    length = 0.18 * 0.9 + np.append(0.0, stretch)
    tension = forces(Muscle(SPECIMEN, LAW), 1 - length / 0.18, np.append(pressure[0], pressure))
    expected = tension + friction.path_response(length, tension, np.append(pressure[0], pressure))
    np.testing.assert_allclose(told, expected[1:], atol=1e-4)


@pytest.mark.parametrize("more", [{}, {"viscous_growth": 1e-3, "rate_growth": 0.5, "rate_speed": 0.05}])
def test_viscous_friction_is_that_of_the_muscle(more):
    more = {**more, "viscous_length_growth": 5e3, "reference_length": 0.17} if more else more
    friction = MaxwellSlip(12.0, 0.5e-3, viscous=300.0, **more)
    slow, quick = Grip(Muscle(SPECIMEN, LAW, friction), 0.1), Grip(Muscle(SPECIMEN, LAW, friction), 0.1)
    added = quick.force(1e-3, 3 * bar, 0.01) - slow.force(1e-3, 3 * bar, 1e9)
    tension = slow.table.force(0.1 - 1e-3 / 0.18, 3 * bar)
    with jax.disable_jit():
        assert added == pytest.approx(float(friction.viscous_force(0.163, tension, 3 * bar, 0.1)), rel=1e-6)


def test_creep_after_moves_is_that_of_the_muscle():
    creep = MaxwellCreep(1500.0, 2.0, arms=2)
    grip = Grip(Muscle(SPECIMEN, LAW, creep=creep), 0.1)
    stops, told = np.array([0.0, 2, 1, 4, -9]) * 1e-3, []
    for before, after in itertools.pairwise(stops):
        for stretch in np.linspace(before, after, 21)[1:]:
            grip.force(stretch, 3 * bar, 0.05)
        told.append([grip.force(after, 3 * bar, 0.25) for _ in range(12)])
    length = 0.162 + stops
    tension = forces(Muscle(SPECIMEN, LAW), 1 - length / 0.18, 3 * bar)
    read = 0.25 * np.arange(1, 13)
    expected = creep.path_response(length, tension, move_time=1.0, hold_time=3.0, sample_times=read) + tension[:, None]
    np.testing.assert_allclose(told, expected[1:], atol=1e-4)


def test_creep_after_steps_of_the_pressure_is_that_of_the_muscle():
    """The delayed pressure in closed form after steps up and down, at a fixed length."""
    muscle = Muscle(SPECIMEN, LAW, creep=MaxwellCreep(0.0, 5.0, arms=2, pressure_share=0.1, pressure_time_constant=2.0))
    plain, grip, delayed = Muscle(SPECIMEN, LAW), Grip(muscle, 0.03), np.zeros(2)
    for pressure in (3 * bar, 5 * bar, 4 * bar):
        grip.force(0.0, pressure, 0.0)
        told = [grip.force(0.0, pressure, 0.25) for _ in range(20)]
        decays = np.exp(-0.25 * np.arange(1, 21)[:, None] / np.array(muscle.creep.pressure_time_constants))
        lagging = pressure - (pressure - delayed) * decays
        law = forces(plain, 0.03, pressure)
        expected = law + 0.05 * (forces(plain, 0.03, lagging) - law).sum(axis=1)
        np.testing.assert_allclose(told, expected, atol=1e-4)
        assert abs(told[0] - law) > 3
        delayed = lagging[-1]
    assert grip.force(0.0, 4 * bar, 1e9) == pytest.approx(float(forces(plain, 0.03, 4 * bar)), abs=1e-4)


def test_muscle_out_of_its_clamp_pulls_at_nothing_and_is_at_its_shortest():
    grip = Grip(Muscle(SPECIMEN, LAW), 0.0)
    grip.held = False
    assert grip.force(1e-3, 6 * bar, 0.1) == 0
    assert grip.contraction(1e-3) == pytest.approx(25 * percent)
    assert grip.volume(0.0) == pytest.approx(float(SPECIMEN.volume(0.25)))
