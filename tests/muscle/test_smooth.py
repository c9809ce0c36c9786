"""Laws with smooth deviations from Eq. 2: inside and outside of their window."""

import numpy as np
from numpy.polynomial.chebyshev import chebval2d
from numpy.polynomial.polynomial import polyval

from mckibben import catalog
from mckibben.muscle import Domain, ExponentialLaw, GaussianProcessLaw, SmoothLaw, forces

EQ_3 = catalog.law("lei-mas-10-180n")
TERMS = [getattr(EQ_3, one.name) for one in ExponentialLaw.parameters()]  # six linear ones and the decay
S0, S1, S2 = ((8.0, -20.0, 30.0, 10.0, -15.0, 5.0), (3e-5, -2e-5, 0.0, 1e-5, 0.0, 0.0), (4e-12, *[0.0] * 5))
WINDOW = (0.11, 0.04, Domain(-0.03, 0.25, 0.0, 6e5))


def test_a_deviation_is_its_polynomial_within_the_window_and_none_outside():
    """Of the position v, by NumPy, times (1 - v^2)^3."""
    law = SmoothLaw(*TERMS[:6], *S0, *S1, *S2, TERMS[6], *WINDOW)
    contraction, pressure = np.array([-0.02, 0.06, 0.09, 0.11, 0.125, 0.16, 0.2]), 4e5
    v = (contraction - 0.11) / 0.04
    series = polyval(v, S0) + pressure * polyval(v, S1) + pressure**2 * polyval(v, S2)
    added = forces(law, contraction, pressure) - forces(EQ_3, contraction, pressure)
    np.testing.assert_allclose(added, series * np.maximum(1 - v**2, 0) ** 3, rtol=1e-9, atol=1e-10)


def test_a_gaussian_process_is_a_series_of_chebyshev_polynomials_that_levels_off_outside_of_its_window():
    coefficients = np.random.default_rng(0).normal(0, 5, (6, 6))
    law = GaussianProcessLaw(*TERMS[:6], *coefficients.ravel(), TERMS[6], 0.11, 0.2, 3e5, 4e5)
    for contraction, pressure in ((0.05, 2e5), (0.2, 6e5), (0.11, 3e5)):
        v, w = (contraction - 0.11) / 0.2, (pressure - 3e5) / 4e5
        expected = chebval2d((3 * v - v**3) / 2, (3 * w - w**3) / 2, coefficients)
        found = forces(law, contraction, pressure) - forces(EQ_3, contraction, pressure)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    beyond = [forces(law, 0.32, pressure) - forces(EQ_3, 0.32, pressure) for pressure in (7.5e5, 9e5)]
    np.testing.assert_allclose(beyond[0], beyond[1], rtol=1e-9)
    inside, outside = (law.slope(0.31 + step, 4e5) for step in (-1e-9, 1e-9))
    np.testing.assert_allclose(inside, outside, rtol=1e-4)
