"""Laws with smooth deviations: Eq. 2 outside of their window, and Eq. 2 with the first coefficients at its centre."""

import numpy as np
import pytest
from numpy.polynomial.polynomial import polyval

from mckibben import catalog
from mckibben.muscle import Domain, ExponentialLaw, SmoothAffineLaw, SmoothLaw, forces

EQ_3 = catalog.law("lei-mas-10-180n")
TERMS = [getattr(EQ_3, one.name) for one in ExponentialLaw.parameters()]  # six linear ones and the decay
S0, S1, S2 = ((8.0, -20.0, 30.0, 10.0, -15.0, 5.0), (3e-5, -2e-5, 0.0, 1e-5, 0.0, 0.0), (4e-12, *[0.0] * 5))
WINDOW = (0.11, 0.04, Domain(-0.03, 0.25, 0.0, 6e5))
LAWS = {
    "affine": SmoothAffineLaw(*TERMS[:6], *S0, *S1, TERMS[6], *WINDOW),
    "quadratic": SmoothLaw(*TERMS[:6], *S0, *S1, TERMS[6], *WINDOW[:2], *S2, WINDOW[2]),
}


@pytest.mark.parametrize("name", LAWS)
def test_outside_of_the_window_it_is_eq_2_and_at_its_centre_the_first_coefficients_add(name):
    law, pressure = LAWS[name], 4e5
    outside = np.array([-0.02, 0.0, 0.06, 0.16, 0.2])
    np.testing.assert_allclose(forces(law, outside, pressure), forces(EQ_3, outside, pressure), rtol=1e-12)
    added = S0[0] + pressure * S1[0] + (pressure**2 * S2[0] if name == "quadratic" else 0.0)
    np.testing.assert_allclose(forces(law, 0.11, pressure) - forces(EQ_3, 0.11, pressure), added, rtol=1e-9)


def test_a_deviation_is_its_polynomial_within_the_window():
    """Of the position v, by NumPy, times (1 - v^2)^3."""
    law, contraction, pressure = LAWS["affine"], 0.125, 4e5
    v = (contraction - 0.11) / float(law.half_width)
    expected = (polyval(v, S0) + pressure * polyval(v, S1)) * (1 - v**2) ** 3
    added = forces(law, contraction, pressure) - forces(EQ_3, contraction, pressure)
    assert float(added) == pytest.approx(expected, rel=1e-9)
