"""Laws with smooth deviations from Eq. 2: inside and outside of their window."""

import numpy as np
from numpy.polynomial.polynomial import polyval

from mckibben import catalog
from mckibben.muscle import Domain, ExponentialLaw, SmoothLaw, forces

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
