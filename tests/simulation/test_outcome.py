"""How a run ended: the worst that applies, one by one and by the thousand."""

import itertools

import numpy as np
import pytest

from mckibben.simulation.outcome import OUTCOMES, Outcome, outcomes
from mckibben.units import deg


def outcome(angle_max=0.01, left_domain=False, saturated=False, **more) -> Outcome:
    metrics = {"angle_max": angle_max, "time_outside_domain": 0.1 * left_domain, "time_saturated": 0.1 * saturated}
    return OUTCOMES[int(outcomes(metrics, **more))]


@pytest.mark.parametrize(("span", "limit"), [(0.0, 5.0), (4.0, 5.0), (16.0, 16.0), (60.0, 60.0)])
def test_an_end_further_off_than_the_reference_moves_has_diverged(span, limit):
    assert outcome(angle_at_end=(limit + 0.1) * deg, span=span * deg, saturated=True) is Outcome.LEFT_REFERENCE
    assert outcome(angle_at_end=(limit - 0.1) * deg, span=span * deg) is Outcome.COMPLETED


def test_the_worst_that_applies_wins():
    worst = [Outcome.NO_START, Outcome.DIVERGED, Outcome.SWUNG_OVER, Outcome.LEFT_DOMAIN, Outcome.SATURATED]
    for started, angle, left, saturated in itertools.product(
        (False, True), (np.nan, 2.0, 0.1), (True, False), (True, False)
    ):
        applies = [not started, np.isnan(angle), angle > 1.58, left, saturated]
        expected = next((o for o, so in zip(worst, applies, strict=True) if so), Outcome.COMPLETED)
        assert outcome(angle, left, saturated, started=started) is expected
