"""Where laws end: no force beyond a pole, beyond straight threads, or where a formula was not made for."""

import jax
import numpy as np
import pytest

from mckibben import catalog
from mckibben.muscle import Domain, HuntLaw, MartensBoblanLaw, Muscle, PiecewiseLaw, TonduLopezVariableLaw, forces
from mckibben.units import bar, deg, mm


class TestHunt:
    LAWS = ((254.3e3, 1230.0, 192e3, 0.16), (254.3e3, 20.0, 20e3, 0.16), (300e3, 1000.0, 200e3, 0.22))

    @pytest.mark.parametrize("numbers", LAWS)
    @pytest.mark.slow
    def test_it_has_a_force_wherever_it_is_made_for(self, numbers):
        law = HuntLaw(*numbers)
        contraction, pressure = np.meshgrid(np.linspace(0, 0.25, 26), np.linspace(0, 6e5, 13))
        force = forces(law, contraction, pressure)
        assert np.isfinite(force).all()
        np.testing.assert_allclose(law.pressure_for(force, contraction), pressure, atol=1e-6)

    def test_beyond_its_pole_no_pressure_gives_a_force(self):
        law = HuntLaw(*self.LAWS[0])  # at 8 % there are at most 288 N
        pressures = law.pressure_for(np.array([200.0, 280.0, 290.0, 400.0]), 0.08)
        np.testing.assert_array_equal(np.isnan(pressures), [False, False, True, True])

    def test_uncontracted_it_has_no_pole_and_is_a_line(self):
        """Also beyond the force at which eps_max - c4 F changes its sign, 665 N."""
        p0, c1, c2, _ = self.LAWS[2]
        pressure = np.array([0.0, 3e5, 6e5, 12e5])
        line = (pressure - p0 + c2 * np.tan(2.0265 * 0.461)) / c1
        assert line[-1] > 0.22 / 3.31e-4
        np.testing.assert_allclose(forces(HuntLaw(*self.LAWS[2]), 0.0, pressure), line, rtol=1e-12)

    def test_a_muscle_of_it_may_not_be_stretched(self):
        muscle = Muscle(catalog.specimen("DMSP-10-250"), HuntLaw(*self.LAWS[0]))
        assert float(muscle.domain.contraction_min) == 0.0


def test_an_inverse_begins_at_no_pressure_where_the_force_does():
    law = TonduLopezVariableLaw(25 * deg, 10 * mm, 0.5, 1.25)
    wanted = np.array([0.0, 1.0, 3.0, 5.0])
    pressures = jax.jit(law.pressure_for)(wanted, 0.2)
    np.testing.assert_allclose(law.force(0.2, pressures), wanted, atol=1e-9)


def test_threads_cannot_be_stretched_beyond_straight():
    law = MartensBoblanLaw(300.0, 20.0, 25 * deg, 10 * mm)
    straight = 1 / np.cos(25 * deg) - 1
    assert np.isfinite(float(law.force(-0.99 * straight, 1e5)))
    assert np.isnan(float(law.force(-1.01 * straight, 1e5)))


def test_an_inverse_is_found_within_the_domain_though_the_force_falls_beyond_it():
    table = {"pressures": (1 * bar, 7 * bar, 12 * bar), "forces": (100.0, 700.0, 300.0), "springs": (500.0,) * 3}
    law = PiecewiseLaw(**table, domain=Domain(0.0, 0.2, 1 * bar, 6 * bar))
    contraction, pressure = np.array([[0.0], [0.1], [0.2]]), np.append(np.linspace(1 * bar, 6 * bar, 11), 12 * bar)
    force = np.asarray(jax.jit(law.force)(contraction, pressure))
    assert (np.diff(force[:, :-1]) > 0).all() and (force[:, -1] < force[:, -2]).all()
    found = jax.jit(law.pressure_for)(force[:, :-1], contraction)
    np.testing.assert_allclose(found, np.broadcast_to(pressure[:-1], found.shape), rtol=1e-9)
