"""Intervals calibrated on left-out pressures and contractions."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import identify
from mckibben.identification.calibration import IntervalCalibration
from mckibben.identification.regression import pressure_blocks
from mckibben.muscle import ExponentialLaw, forces
from mckibben.units import bar

BRAID = catalog.law("sarosi-dmsp-10")


def measured(seed, law=BRAID, deviation=8.0):
    """Taut points of a muscle of another law, with a deviation and noise of 1 N."""
    eps, p = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 0.2, 9), np.linspace(1, 6, 9) * bar))
    force = forces(law, eps, p) + deviation * np.sin(30 * eps) + np.random.default_rng(seed).standard_normal(eps.size)
    taut = force > 5
    return IsobaricDataset.of(pressure=p[taut], contraction=eps[taut], force=force[taut])


CONTRACTIONS, PRESSURES = np.array([0.0, 0.1, 0.2]), np.array([1.0, 2.0]) * bar


def calibration(pressure, contraction):
    return IntervalCalibration(pressure, contraction, PRESSURES, CONTRACTIONS, (0.0, np.inf))


@pytest.mark.parametrize("smaller", ["pressure", "contraction"])
def test_scores_are_those_of_what_is_new(smaller):
    scores = {"pressure": np.full(99, 4.0), "contraction": np.full(99, 4.0), smaller: np.full(99, 2.0)}
    found = calibration(**scores)
    eps = np.array([0.0, 0.1, 0.125, 0.15, 0.3, -0.05])
    at_level, between = (found.quantile(0.9, eps, np.full(6, one * bar), 1.7) for one in (2.0, 1.5))
    if smaller == "pressure":
        np.testing.assert_allclose([at_level, between], [[2, 2, 3, 4, 4, 4]] * 2)
    else:
        np.testing.assert_allclose([at_level, between], [[2] * 6, [4] * 6])
    np.testing.assert_allclose(found.quantile(0.9, eps[:1], np.array([9 * bar]), 1.7), [scores["pressure"][0]])


def test_where_no_pressure_is_repeated_every_pressure_is_a_new_one():
    """The blocks are then bands, whose edges are next to other points."""
    rng = np.random.default_rng(0)
    eps, p = np.tile(np.linspace(0, 0.15, 5), 24), rng.uniform(2, 6, 120) * bar
    points = IsobaricDataset.of(pressure=p, contraction=eps, force=forces(BRAID, eps, p) + rng.standard_normal(120))
    found = identify(ExponentialLaw, points).calibration
    assert len(np.unique(pressure_blocks(points)[0])) < 10
    width = found.quantile(0.95, eps, rng.uniform(2, 6, 120) * bar, 1.98)
    left_out = found.pressure[int(np.ceil(0.95 * (len(found.pressure) + 1))) - 1]
    assert np.isclose(width, left_out).mean() > 0.9  # all but those next to a measured one


def test_too_few_scores_for_the_level_give_students_t_or_the_largest_score():
    scores, eps, at = np.linspace(0.1, 2.0, 30), np.array([0.0, 0.05]), np.full(2, 1.5 * bar)
    found = calibration(scores, np.array([1.0]))
    np.testing.assert_allclose(found.quantile(0.99, eps, at, 2.8), [2.8, 2.8])
    np.testing.assert_allclose(found.quantile(0.99, eps, at, 1.5), [2.0, 2.0])
    np.testing.assert_allclose(found.quantile(0.9, eps, at, 2.1), [scores[27], 2.1])
    assert calibration(np.full(9, 2.0), np.empty(0)).quantile(0.9, eps, at, 1.7) is None


def test_a_quantile_holds_for_one_more_point():
    rng = np.random.default_rng(0)
    held = []
    for _ in range(400):
        scores = np.sort(np.abs(rng.standard_normal(39)))
        (width,) = calibration(scores, np.empty(0)).quantile(0.95, np.zeros(1), np.array([1.5 * bar]), 0.0)
        held.append(abs(rng.standard_normal()) <= width)
    assert 0.92 < np.mean(held) < 0.98


@pytest.mark.slow
def test_intervals_of_a_wrong_law_hold_at_left_out_pressures():
    held = {"t": [], "calibrated": []}
    for seed in range(2):
        points = measured(seed).taut
        for level in np.unique(pressure_blocks(points)[0]):
            out = points.levels == level
            fit = identify(ExponentialLaw, points.select(~out))
            given = points.contraction[out], points.pressure[out]
            for name, by in (("t", fit.robust.by), ("calibrated", None)):
                band = fit.force_intervals(*given, by=by).prediction
                held[name] += ((band.lower <= points.force[out]) & (points.force[out] <= band.upper)).tolist()
    assert np.mean(held["calibrated"]) > 0.93
    assert np.mean(held["calibrated"]) >= np.mean(held["t"])


@pytest.mark.slow
def test_confidence_intervals_contain_the_misfit_of_a_wrong_law_and_that_of_a_right_one_is_zero():
    data = measured(0)
    fit = identify(ExponentialLaw, data)
    assert fit.calibration.misfit[0] > 0
    eps, p = np.linspace(0.01, 0.15, 8)[:, None], np.linspace(2, 5.5, 8) * bar
    truth = forces(BRAID, eps, p) + 8 * np.sin(30 * eps)
    band = fit.force_intervals(eps, p).confidence
    t = fit.force_intervals(eps, p, by=fit.robust.by).confidence
    inside, before = (np.mean((one.lower <= truth) & (truth <= one.upper)) for one in (band, t))
    assert inside > 0.9 > before
    right = identify(ExponentialLaw, measured(0, catalog.law("lei-mas-10-180n"), deviation=0.0))
    assert right.calibration.misfit[0] == 0.0
