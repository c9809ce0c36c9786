"""Coverage of 95 % intervals over hundreds of synthetic data sets: see the benchmark."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from mckibben.identification import Grouping

_SPEC = importlib.util.spec_from_file_location("coverage", Path(__file__).parents[2] / "benchmarks" / "coverage.py")
coverage = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(coverage)
SETS = 300  # the standard error of a coverage of 95 % is 1.3 %


@pytest.fixture(scope="module")
def points():
    return coverage.design(coverage.LEVELS)


@pytest.mark.slow
def test_noise_of_a_plateau_counts_once_and_its_mean_is_covered(points):
    found = coverage.shares(points, SETS, common=False)
    for by, (share, half, score) in found.items():
        assert np.median(half) < 1.5 * score.mean() / 2 and (score >= 2 * half - 1e-9).all()
        assert np.all(share >= 0.92), (by, share)
        assert np.all(share <= 0.98), (by, share)


@pytest.mark.slow
def test_an_error_common_to_a_stroke_is_covered_where_strokes_are_the_groups(points):
    assert coverage.stroke_labels(points).max() + 1 == 18
    found = coverage.shares(points, SETS, common=True)
    share, half, score = found[Grouping.STROKE]
    assert np.all(share >= 0.92), share
    assert np.all(share <= 0.98), share
    classical, narrow, _ = found[Grouping.POINT]
    assert np.median(narrow) < np.median(half) and score.mean() < 2 * 1.3 * np.median(half)
    assert classical[7] < 0.75  # of the force
    assert np.all(classical[[2, 3]] < 0.9)  # b1, b2
