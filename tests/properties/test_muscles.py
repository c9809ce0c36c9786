"""What holds for every law, muscle and pressure, whatever Hypothesis thinks of."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben import catalog
from mckibben.muscle import ChouLaw, ExponentialLaw, Muscle

SPECIMEN = catalog.specimen("MAS-10-180N-AA-MC-O")
LAWS = {"Eq. 1": ChouLaw.of(SPECIMEN), "Eq. 3": catalog.law("lei-mas-10-180n")}
MUSCLES = {name: Muscle(SPECIMEN, law) for name, law in LAWS.items()}

force = jax.jit(lambda law, c, p: law.force(c, p))
slope = jax.jit(lambda law, c, p: law.slope(c, p))
inverse = jax.jit(lambda law, f, c: law.pressure_for(f, c))
pull = jax.jit(lambda muscle, c, p: (muscle.force(c, p), muscle.law.force(c, p)))

names = st.sampled_from(sorted(LAWS))
contractions = st.floats(-0.03, 0.25)
pressures = st.floats(0.0, 6e5)


@given(names, contractions, pressures, pressures)
def test_more_pressure_is_more_force(name, contraction, one, other):
    low, high = sorted((one, other))
    difference = float(force(LAWS[name], contraction, high)) - float(force(LAWS[name], contraction, low))
    assert difference >= -1e-9
    if high - low > 1.0:
        assert difference > 0


@given(names, contractions, pressures)
def test_the_pressure_for_a_force_is_the_pressure_of_that_force(name, contraction, pressure):
    back = inverse(LAWS[name], force(LAWS[name], contraction, pressure), contraction)
    assert float(back) == pytest.approx(pressure, rel=1e-9, abs=1e-5)


@given(names, st.floats(-0.2, 0.5), st.floats(-1e5, 1e6))
def test_a_muscle_never_pushes_and_pulls_as_its_law_says(name, contraction, pressure):
    pulled, fitted = pull(MUSCLES[name], contraction, pressure)
    assert float(pulled) == max(float(fitted), 0.0)


@given(names, contractions, pressures)
def test_the_slope_is_that_of_finite_differences(name, contraction, pressure):
    law, step = LAWS[name], 1e-6
    numeric = float(force(law, contraction + step, pressure) - force(law, contraction - step, pressure)) / (2 * step)
    assert float(slope(law, contraction, pressure)) == pytest.approx(numeric, rel=1e-6, abs=1e-3)


coefficients = st.floats(-500, 500)


@given(st.lists(coefficients, min_size=6, max_size=6), st.floats(5, 100), contractions, st.floats(0, 8))
def test_equation_2_in_si_is_equation_2_in_bar_and_percent(printed, decay, contraction, bars):
    a1, a2, b1, b2, c1, c2 = printed
    eps, mu = contraction * 100, decay / 100
    expected = (a1 + a2 * bars) + (b1 + b2 * bars) * eps + (c1 + c2 * bars) * np.exp(-mu * eps)
    law = ExponentialLaw(a1, a2 / 1e5, b1 * 100, b2 * 1e-3, c1, c2 / 1e5, decay)
    size = sum(abs(x) for x in printed) * (1 + 25) * (1 + bars) * max(1, np.exp(-mu * eps))
    assert float(force(law, contraction, bars * 1e5)) == pytest.approx(expected, abs=1e-13 * size + 1e-12)
