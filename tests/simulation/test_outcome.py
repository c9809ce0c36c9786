"""How a run ended: the worst that applies, one by one and by the thousand."""

import itertools

import numpy as np
import pytest

from mckibben.simulation.outcome import OUTCOMES, Outcome, outcomes
from mckibben.units import deg


def outcome(angle_max=0.01, left_domain=False, saturated=False, **more) -> Outcome:
    return OUTCOMES[int(outcomes(angle_max=angle_max, left_domain=left_domain, saturated=saturated, **more))]


def test_each_alone():
    assert outcome(saturated=True) is Outcome.SATURATED
    assert outcome(left_domain=True) is Outcome.LEFT_DOMAIN
    assert outcome(angle_max=90.1 * deg) is Outcome.SWUNG_OVER
    assert outcome(started=False) is Outcome.NO_START


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


def test_arrays_broadcast_and_give_codes():
    code = outcomes(
        angle_max=np.array([0.0, np.nan, 2.0, 0.0, 0.0, np.nan]),
        left_domain=np.array([0, 0, 0, 1, 0, 0]),
        saturated=True,
        started=np.array([True, True, True, True, True, False]),
    )
    assert code.dtype == np.int8
    assert [OUTCOMES[c].name for c in code] == [
        "SATURATED",
        "DIVERGED",
        "SWUNG_OVER",
        "LEFT_DOMAIN",
        "SATURATED",
        "NO_START",
    ]
