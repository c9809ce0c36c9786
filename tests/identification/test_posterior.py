"""The posterior against what is known in closed form."""

import importlib.util

import numpy as np
import pytest
from scipy.optimize import curve_fit

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, ParameterError, RangeError
from mckibben.identification import Grouping, Noise, identify, posterior
from mckibben.muscle import Domain, ExponentialLaw, Parameter, PressureAffineLaw
from mckibben.units import bar, percent


class PlaneLaw(PressureAffineLaw):
    """F = a + b p + c eps."""

    a: float
    b: float
    c: float
    domain: Domain = Domain()

    equation = "F = a + b p + c eps"
    source = "these tests"
    linear_parameters = (
        Parameter("a", "N", "N", "constant"),
        Parameter("b", "N/Pa", "N/bar", "per pressure"),
        Parameter("c", "N", "N/percent", "per contraction"),
    )

    def pressure_terms(self, contraction):
        return self.a + self.c * contraction, self.b + 0 * contraction


def plane(offsets, noise):
    """12 points at each of 8 pressures, with an error common to each."""
    generator = np.random.default_rng(4)
    pressure, contraction = (
        a.ravel() for a in np.meshgrid(np.arange(1, 9) * bar, np.linspace(0, 0.2, 12), indexing="ij")
    )
    force = 300 + 5e-4 * pressure - 900 * contraction + noise * generator.normal(size=96)
    force += np.repeat(offsets * generator.normal(size=8), 12)
    return IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force)


@pytest.mark.slow
def test_with_gaussian_errors_and_a_linear_law_it_is_the_classical_t():
    fit = identify(PlaneLaw, plane(offsets=0.0, noise=2.0))
    found = posterior(fit, draws=800, warmup=200, chains=1, seed=1)
    assert found.warnings == ()
    assert found.draws.shape == (800, 3)
    for name, classical in fit.intervals(by=Grouping.POINT).items():
        width = classical.upper - classical.lower
        assert found.intervals()[name] == pytest.approx(classical, abs=0.1 * width), name
    assert found.noise["sigma"].mean() == pytest.approx(2.0, rel=0.15)


@pytest.mark.slow
def test_errors_common_to_a_group_are_found_and_widen_what_they_blur():
    """On the chart, whose law misses whole pressures by some 3 N."""
    fit = identify(ExponentialLaw, catalog.dataset("festo-tool-10mm"))
    found = posterior(fit, by=Grouping.PRESSURE, draws=400, warmup=300, chains=1, seed=1)
    assert found.warnings == ()
    tau, sigma = float(np.median(found.noise["tau"])), float(np.median(found.noise["sigma"]))
    assert 2.0 < tau < 6.0
    # Generalised least squares with that covariance, by SciPy in bar and percent.
    taut = fit.regression.points
    covariance = sigma**2 * np.eye(len(taut)) + tau**2 * (taut.levels[:, None] == taut.levels)
    where = taut.contraction / percent, taut.pressure / bar
    start = [-122, 78, -1.8, -2.3, 127, 0.4, 0.34]
    values, scatter = curve_fit(exponential, where, taut.force, p0=start, sigma=covariance, absolute_sigma=True)
    assert found.draws[:, 6].mean() * percent == pytest.approx(values[6], abs=0.4 * np.sqrt(scatter[6, 6]))
    deviations = np.std(found.draws, axis=0, ddof=1)
    scales = np.array([1, bar, percent, bar * percent, 1, bar, percent])
    np.testing.assert_allclose(deviations * scales, np.sqrt(np.diag(scatter)), rtol=0.3)
    assert deviations[1] > 1.3 * fit.standard_errors["a2"]


def exponential(x, a1, a2, b1, b2, c1, c2, decay):
    """Eq. 2 in bar and percent."""
    eps, p = x
    return a1 + a2 * p + (b1 + b2 * p) * eps + (c1 + c2 * p) * np.exp(-decay * eps)


@pytest.mark.slow
def test_student_noise_lets_an_outlier_be():
    data = plane(offsets=0.0, noise=2.0)
    force = data.force.copy()
    force[[0, 12, 24]] += 60
    points = IsobaricDataset.of(pressure=data.pressure, contraction=data.contraction, force=force)
    fit = identify(PlaneLaw, points, robust=False)  # otherwise the outliers are left out
    found = posterior(fit, noise=Noise.STUDENT, draws=300, warmup=200, chains=1, seed=1)
    assert abs(fit.law.c + 900) > 25
    assert abs(found.draws[:, 2].mean() + 900) < 12
    assert np.median(found.noise["freedom"]) < 5


def test_without_the_package_the_extra_is_named(monkeypatch):
    fit = identify(PlaneLaw, plane(offsets=0.0, noise=2.0))
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "numpyro" else find(name, *rest)
    )
    with pytest.raises(ParameterError, match=r"needs the package numpyro; pip install 'mckibben\[bayes\]'"):
        posterior(fit)


def test_what_cannot_be_drawn_is_said(monkeypatch):
    fit = identify(PlaneLaw, plane(offsets=0.0, noise=2.0))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: name)  # all of it is said before anything is drawn
    with pytest.raises(RangeError, match="draws = 5 is too few; give 100 or more"):
        posterior(fit, draws=5)
    with pytest.raises(IdentificationError, match="record a column 'repeat'"):
        posterior(fit, by=Grouping.REPEAT)
    slow = ExponentialLaw(100.0, 1e-3, 200.0, -2e-3, 4e4, 1e-2, decay=0.6)
    pressure, contraction = (a.ravel() for a in np.meshgrid(np.arange(1, 7) * bar, np.linspace(0, 0.2, 9)))
    force = np.asarray(slow.force(contraction, pressure))
    at_bound = identify(ExponentialLaw, IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force))
    with pytest.raises(IdentificationError, match="decay of ExponentialLaw is at its bound"):
        posterior(at_bound)
