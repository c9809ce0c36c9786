"""Pressure threshold of a law: found with its interval, absent where there is none, and wrong forms noticed."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification import identify_threshold
from mckibben.muscle import ExponentialLaw, SmoothLaw, ThresholdLaw
from mckibben.units import bar

LAW = catalog.law("lei-mas-10-180n")
LEVELS = np.array([0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.75, 1, 1.5, 2, 3, 4, 5]) * bar


def points(force, *, seed=0, offset=0.02 * bar):
    """Plateaus at 13 pressures, each off by a random amount, with noise of 0.5 N."""
    random = np.random.default_rng(seed)
    set_pressure, contraction = map(np.ravel, np.meshgrid(LEVELS, np.linspace(-0.03, 0.12, 11), indexing="ij"))
    pressure = np.maximum(set_pressure + np.repeat(random.uniform(-offset, offset, len(LEVELS)), 11), 0)
    measured = np.asarray(force(contraction, pressure)) + random.normal(0, 0.5, len(pressure))
    return IsobaricDataset.of(
        pressure=pressure,
        contraction=contraction,
        force=np.maximum(measured, 0),
        set_pressure=set_pressure,
        slack_force=2.0,
        initial_length=0.18,
    )


@pytest.mark.slow
def test_threshold_and_law_are_found_with_their_intervals():
    found = identify_threshold(ExponentialLaw, points(ThresholdLaw(law=LAW, threshold=0.3 * bar).force))
    assert found.is_significant and not found.notes
    assert found.interval[0] < 0.3 * bar < found.interval[1] < found.interval[0] + 0.06 * bar
    assert isinstance(found.law, ThresholdLaw) and found.law.threshold == found.threshold
    at = np.linspace(0, 0.1, 5)
    np.testing.assert_allclose(found.law.force(at, 4e5), ThresholdLaw(law=LAW, threshold=3e4).force(at, 4e5), atol=1.5)
    assert found.residual < 0.75 < 2 < found.residual_without
    assert found.law.domain.pressure_max == pytest.approx(5 * bar, rel=0.01)
    assert "interval" in found.verdict()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_without_a_threshold_none_is_found(seed):
    found = identify_threshold(ExponentialLaw, points(LAW.force, seed=seed))
    assert not found.is_significant and type(found.law) is ExponentialLaw
    assert found.interval[0] == 0 and found.p_value > 0.01 and found.fit.law == found.law


def test_deviations_that_absorb_a_threshold_are_refused():
    with pytest.raises(IdentificationError) as refused:
        identify_threshold(SmoothLaw, points(LAW.force))
    assert refused.value.remedy
