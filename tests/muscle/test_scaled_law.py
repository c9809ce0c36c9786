"""Muscles that are weaker or stronger than their law; what holds for each law is in test_law_contract."""

import numpy as np
import pytest

from mckibben.errors import RangeError
from mckibben.muscle import ForceCorrection, adjusted_law


@pytest.mark.parametrize("strength", [0.0, -0.5, np.nan, np.inf, np.array([1.0, -1.0])])
def test_a_factor_that_makes_no_sense_is_refused(law, strength):
    with pytest.raises(RangeError, match="strength is"):
        adjusted_law(law, strength=strength)


def test_a_correction_is_constant_beyond_the_contractions_of_its_calibration():
    """A polynomial in the contraction relative to the window, (eps - 0.1)/0.05."""
    correction = ForceCorrection((-20.0, 5.0, 3.0), (1e-5, -2e-5, 0.0), 0.1, 0.05)
    for contraction, v in ((0.06, -0.8), (0.1, 0.0), (0.13, 0.6), (0.15, 1.0), (0.2, 1.0), (0.05, -1.0), (-0.02, -1.0)):
        offset, gain = correction.terms(contraction)
        assert float(offset) == pytest.approx(-20.0 + 5.0 * v + 3.0 * v**2)
        assert float(gain) == pytest.approx(1e-5 - 2e-5 * v)
