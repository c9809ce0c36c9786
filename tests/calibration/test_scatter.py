"""Scatter of the estimates between recordings: about 1 for the right model, named for a wrong one."""

import numpy as np
import pytest

from mckibben.calibration.fitting import scatter_between


def fitted(rng, between, recordings=6):
    """Linear least squares with a unit prior, one parameter differing between recordings by `between`."""
    slopes = [rng.normal(0, 1, (3, 200)) for _ in range(recordings)]
    errors = [rng.normal(0, 1, 200) - rng.normal(0, between) * one[1] for one in slopes]
    covariance = np.linalg.inv(np.eye(3) + sum(one @ one.T for one in slopes))
    z = covariance @ sum(one @ error for one, error in zip(slopes, errors, strict=True))
    residuals = [error - one.T @ z for one, error in zip(slopes, errors, strict=True)]
    parts = [(one @ residual, one @ one.T) for one, residual in zip(slopes, residuals, strict=True)]
    return scatter_between(covariance, parts)


def test_recordings_of_the_model_scatter_as_expected():
    rng = np.random.default_rng(7)
    found = [fitted(rng, 0.0) for _ in range(400)]
    ratios, p_values = np.array([one.ratio for one in found]), np.array([one.p_value for one in found])
    assert ratios.mean() == pytest.approx(1.0, abs=0.05)
    assert np.mean(p_values < 0.05) == pytest.approx(0.05, abs=0.02)


def test_only_the_parameter_that_differs_is_named():
    found = fitted(np.random.default_rng(8), 1.0)
    assert found.p_value[1] < 1e-6 < found.p_value[[0, 2]].min()
    assert found.ratio[1] > 5


def test_two_recordings_do_not_tell():
    found = fitted(np.random.default_rng(9), 1.0, recordings=2)
    assert found.ratio.tolist() == found.p_value.tolist() == [1.0] * 3
