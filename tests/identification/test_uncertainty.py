"""Errors grouped by stroke or pressure, and bands, each against something written anew."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError, RangeError
from mckibben.identification import Fit, Grouping, fit_law
from mckibben.identification.estimator import ClusterRobustErrors
from mckibben.identification.grouping import group_labels
from mckibben.muscle import ExponentialLaw, ReynoldsLaw
from mckibben.units import bar

EQ_3 = catalog.law("lei-mas-10-180n")


@pytest.fixture(scope="module")
def map_of_martens():
    return catalog.dataset("dmsp-10-250-martens2017")


@pytest.fixture(scope="module")
def chart():
    """The maker's chart: 119 points at 10 pressures."""
    return catalog.dataset("festo-tool-10mm")


@pytest.fixture(scope="module")
def fit(chart):
    return fit_law(ExponentialLaw, chart)


def measured(law, levels, contractions, noise, seed=0, **columns):
    pressure, contraction = (a.ravel() for a in np.meshgrid(levels, contractions, indexing="ij"))
    force = np.asarray(law.force(contraction, pressure)) + noise * np.random.default_rng(seed).normal(
        size=pressure.shape
    )
    return IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force, **columns)


# --- groups -------------------------------------------------------------------------------------------------


# --- the sandwich -------------------------------------------------------------------------------------------


def textbook(jacobian, residuals, labels, gradient):
    """CR2 and the degrees of freedom of Bell and McCaffrey with matrices of all points."""
    bread = np.linalg.inv(jacobian.T @ jacobian)
    left = np.eye(len(residuals)) - jacobian @ bread @ jacobian.T
    variance, columns = 0.0, []
    for group in np.unique(labels):
        i = labels == group
        values, vectors = np.linalg.eigh(left[np.ix_(i, i)])
        adjustment = vectors @ np.diag(values**-0.5) @ vectors.T
        weights = adjustment @ jacobian[i] @ bread @ gradient
        variance += (residuals[i] @ weights) ** 2
        columns.append(left[:, i] @ weights)
    omega = np.array(columns) @ np.array(columns).T
    return variance, np.trace(omega) ** 2 / np.sum(omega**2)


def test_the_sandwich_is_the_textbooks():
    generator = np.random.default_rng(0)
    jacobian = generator.normal(size=(60, 4)) * [1.0, 1e5, 1e-3, 1.0]
    labels = generator.permutation(np.repeat(np.arange(9), [2, 3, 4, 5, 6, 8, 9, 11, 12]))
    residuals = generator.normal(size=60)
    gradients = generator.normal(size=(5, 4)) * [1.0, 1e5, 1e-3, 1.0]
    variance, freedom = ClusterRobustErrors.of(jacobian, residuals, labels).variance(gradients)
    for i, gradient in enumerate(gradients):
        expected = textbook(jacobian / [1, 1e5, 1e-3, 1], residuals, labels, gradient / [1, 1e5, 1e-3, 1])
        assert (variance[i], freedom[i]) == pytest.approx(expected, rel=1e-8)


def test_a_group_that_alone_determines_a_parameter_is_named():
    jacobian = np.array([[1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]])
    labels = np.array([0, 0, 1, 2, 2])
    assert ClusterRobustErrors.of(jacobian, np.zeros(5), labels).decisive == (2,)


def test_the_scatter_of_a_plateau_is_as_sure_as_there_are_errors():
    """Errors of one size: 100 of them, or 10 that ten points share."""
    jacobian, labels = np.ones((100, 1)), np.repeat(np.arange(10), 10)
    sides = np.tile([3.0, -3.0], 50)
    apart = ClusterRobustErrors.of(jacobian, sides, labels).residual_variance
    assert apart == pytest.approx((9.0, 99.0))
    together = ClusterRobustErrors.of(jacobian, np.repeat(sides[:10], 10), labels).residual_variance
    assert together[0] == pytest.approx(9.0 * (1 / 0.9))  # as s^2 of ten numbers
    assert together[1] == pytest.approx(10 * 0.99)


def test_the_degrees_of_freedom_of_the_scatter_are_what_its_own_scatter_says():
    """60 points in 20 groups: 2 E^2/Var of the mean square over many draws."""
    generator, labels, agreement = np.random.default_rng(0), np.repeat(np.arange(20), 3), 0.6
    found = []
    for _ in range(1000):
        errors = generator.normal(size=20)[labels] * np.sqrt(agreement)
        errors += generator.normal(size=60) * np.sqrt(1 - agreement)
        found.append(ClusterRobustErrors.of(np.ones((60, 1)), errors - errors.mean(), labels).residual_variance)
    squares, freedom = np.array(found).T
    assert np.all(freedom <= 59 * (1 + 1e-12))
    assert np.median(freedom) == pytest.approx(2 * squares.mean() ** 2 / squares.var(), rel=0.15)


def test_intervals_contain_the_misfit_of_a_wrong_law():
    """A law straight in the contraction, of a bent muscle: it misses it alike at every pressure."""
    pressure, contraction = (a.ravel() for a in np.meshgrid(np.arange(1, 7) * bar, np.linspace(0, 0.2, 10)))
    noise = np.random.default_rng(0).normal(0, 0.5, len(pressure))
    force = 20 + pressure * 1.2e-3 * (1 - contraction / 0.3) ** 2 + noise
    wrong = fit_law(ReynoldsLaw, IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force))
    truth = 20 + 360 * (2 / 3) ** 2
    without = dataclasses.replace(wrong, leave_one_pressure_out=None).force_intervals(0.1, 3 * bar).confidence
    assert not without.contains(truth)
    band = wrong.force_intervals(0.1, 3 * bar)
    assert band.confidence.contains(truth) and band.prediction.contains(truth)


@pytest.mark.slow
def test_left_out_lowest_and_highest_pressures_are_covered_at_no_more_than_some_three_times_the_error():
    inside, ratios = [], []
    for name in catalog.names("datasets"):
        points = catalog.dataset(name).taut
        for level in (points.levels.min(), points.levels.max()):
            out = points.levels == level
            rest, new = fit_law(ExponentialLaw, points.select(~out), robust=False), points.select(out)
            band = rest.force_intervals(new.contraction, new.pressure).prediction
            inside += band.contains(new.force).tolist()
            ratios.append(np.median(band.upper - band.value) / np.sqrt(np.mean((new.force - band.value) ** 2)))
    assert np.mean(inside) >= 0.9 and np.median(ratios) < 3


def test_beyond_the_pressures_the_misfit_grows_with_the_distance(fit):
    pressure = np.array([8, 8.5, 9, 11]) * bar  # measured up to 8 bar
    band = fit.force_intervals(0.1, pressure).prediction
    assert (np.diff(band.upper - band.lower) > 0).all()
    domain = fit.law.domain
    distance = (pressure - domain.pressure_max) / (domain.pressure_max - domain.pressure_min)
    square, freedom = fit.leave_one_pressure_out.misfit(distance, 1)
    assert square[3] / square[2] == pytest.approx(9) and freedom.tolist() == [np.inf, freedom[1], 5, 5]


# --- the rule -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_rule_looks_at_where_was_measured(map_of_martens, chart, fit):
    assert (fit.robust.by, fit.robust.groups) == (Grouping.PRESSURE, 10)
    assert fit_law(ExponentialLaw, map_of_martens).robust.groups == 16
    both = IsobaricDataset.of(
        pressure=chart.pressure,
        contraction=chart.contraction,
        force=chart.force,
        direction=np.where(np.arange(len(chart)) % 2, "loading", "unloading"),
    )
    by_stroke = fit_law(ExponentialLaw, both)
    assert (by_stroke.robust.by, by_stroke.robust.groups) == (Grouping.STROKE, 20)
    scattered = chart.pressure + np.linspace(0, 500, len(chart))
    alone = fit_law(
        ExponentialLaw, IsobaricDataset.of(pressure=scattered, contraction=chart.contraction, force=chart.force)
    )
    assert alone.robust is None
    assert any("independent points: the 119 points are at 119 pressures, hardly two" in n.text for n in alone.notes)
    few = fit_law(ExponentialLaw, measured(EQ_3, np.array([3, 4, 5, 6]) * bar, np.linspace(0, 0.1, 9), 1.0))
    assert few.robust is None
    assert any("independent points: 4 pressures are too few" in note.text for note in few.notes)


def test_intervals_are_t_intervals(fit):
    name = "decay"
    error, freedom = fit.robust.standard_errors[name], fit.robust.degrees_of_freedom[name]
    reach = stats.t.ppf(0.95, freedom) * error
    assert fit.intervals(0.9)[name] == pytest.approx((fit.law.decay - reach, fit.law.decay + reach))
    reach = stats.t.ppf(0.975, 119 - 7) * fit.standard_errors[name]
    classical = dataclasses.replace(fit, robust=None)
    assert classical.intervals()[name] == pytest.approx((fit.law.decay - reach, fit.law.decay + reach))
    model = ClusterRobustErrors.of(
        fit.regression.solution.jacobian, fit.residuals, group_labels(fit.regression.points, Grouping.PRESSURE)
    )
    assert error == pytest.approx(np.sqrt(model.variance(np.eye(7)[6:])[0][0]))
    with pytest.raises(RangeError, match=r"a level of 95 is not a probability; write 0\.95 for 95 %"):
        fit.intervals(95)


def test_a_parameter_at_its_bound_has_no_interval():
    law = ExponentialLaw(100.0, 1e-3, 200.0, -2e-3, 4e4, 1e-2, decay=0.6)
    fit = fit_law(ExponentialLaw, measured(law, np.arange(1, 7) * bar, np.linspace(0, 0.2, 9), 0.5))
    assert np.all(np.isnan(fit.intervals()["decay"]))
    assert np.all(np.isfinite(fit.intervals()["a1"]))
    assert np.all(np.isfinite(fit.force_intervals(0.1, 3 * bar).confidence.standard_error))


def test_a_fit_from_a_file_without_points_keeps_its_intervals_and_says_what_it_lacks(fit, tmp_path):
    dataclasses.replace(fit, regression=None).to_yaml(tmp_path / "fit.yaml")
    again = Fit.from_yaml(tmp_path / "fit.yaml")
    for name, interval in fit.intervals(0.9).items():
        assert again.intervals(0.9)[name] == pytest.approx(interval, rel=1e-3)
    with pytest.raises(IdentificationError, match="read from a file"):
        again.force_intervals(0.1, 3 * bar)


# --- bands --------------------------------------------------------------------------------------------------


def test_a_force_band_is_what_draws_of_the_parameters_give(chart):
    """Of points that share no error, without the misfit."""
    scattered = chart.pressure + np.linspace(0, 500, len(chart))
    data = IsobaricDataset.of(pressure=scattered, contraction=chart.contraction, force=chart.force)
    fit = dataclasses.replace(fit_law(ExponentialLaw, data), leave_one_pressure_out=None)
    generator = np.random.default_rng(0)
    errors = np.array(list(fit.standard_errors.values()))
    draws = np.linalg.cholesky(fit.correlations) @ generator.normal(size=(7, 20000)) * errors[:, None]
    a1, a2, b1, b2, c1, c2, decay = np.array(list(fit.estimates.values()))[:, None] + draws
    for eps, p in ((0.05, 4 * bar), (0.18, 6 * bar)):
        forces = (a1 + a2 * p) + (b1 + b2 * p) * eps + (c1 + c2 * p) * np.exp(-decay * eps)
        band = fit.force_intervals(eps, p)
        assert float(band.confidence.standard_error) == pytest.approx(forces.std(), rel=0.03)
        assert float(band.confidence.value) == pytest.approx(float(fit.law.force(eps, p)))
        total = band.confidence.standard_error**2 + fit.rmse**2 * 119 / 112
        assert float(band.prediction.standard_error) == pytest.approx(np.sqrt(total))


def test_bands_broadcast_and_a_further_measurement_is_less_sure(fit):
    band = fit.force_intervals(np.linspace(0, 0.2, 5)[:, None], np.array([3, 6]) * bar, level=0.9)
    assert band.confidence.value.shape == band.prediction.upper.shape == (5, 2)
    assert np.all(band.prediction.upper >= band.confidence.upper)
    single = fit.force_intervals(0.05, 3 * bar, level=0.9)
    assert single.confidence.value.shape == ()
    assert float(single.confidence.upper) == pytest.approx(
        fit.force_intervals([0.05], [3 * bar], level=0.9).confidence.upper[0]
    )
