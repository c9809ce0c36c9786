"""Figures of force bands and of profiles."""

import dataclasses

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import Interval, identify, profile
from mckibben.muscle import ExponentialLaw
from mckibben.report.identification import force_bands, profile_likelihood
from mckibben.units import bar, percent


@pytest.fixture(scope="module")
def chart():
    return catalog.dataset("festo-tool-10mm")


@pytest.fixture(scope="module")
def fit(chart):
    return identify(ExponentialLaw, chart)


@pytest.mark.slow
def test_a_column_a_pressure_with_the_law_the_points_and_two_bands(chart, fit):
    figure = force_bands(chart, fit)
    assert len(figure.axes) == 12  # six of ten pressures, curve and residuals
    top, bottom = figure.axes[2], figure.axes[8]
    assert top.get_title("left").endswith("4 bar")
    curve = next(line for line in top.lines if line.get_color() == "#222222")
    x, y = np.asarray(curve.get_xdata()), np.asarray(curve.get_ydata())
    np.testing.assert_allclose(y, np.asarray(fit.law.force(x * percent, 4 * bar)), rtol=1e-9)
    outer, inner = (collection.get_paths()[0].vertices[:, 1] for collection in bottom.collections)
    band = fit.force_intervals(x * percent, 4 * bar)
    assert outer.max() == pytest.approx((band.prediction.upper - band.confidence.value).max())
    assert inner.max() == pytest.approx((band.confidence.upper - band.confidence.value).max())
    at = chart.taut.at(4 * bar)
    points = next(line for line in bottom.lines if line.get_linestyle() == "None")
    expected = at.force - np.asarray(fit.law.force(at.contraction, at.pressure))
    np.testing.assert_allclose(points.get_ydata(), expected, atol=1e-9)
    names = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert "95 % confidence band" in names


def test_directions_are_told_apart(chart):
    taut = chart.taut
    both = IsobaricDataset.of(
        pressure=taut.pressure,
        contraction=taut.contraction,
        force=taut.force,
        direction=np.where(np.arange(len(taut)) % 2, "loading", "unloading"),
    )
    figure = force_bands(both, identify(ExponentialLaw, both), level=0.9)
    names = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert names == ["fitted law", "90 % confidence band", "90 % prediction band", "loading", "unloading"]


def test_a_profile_is_drawn_in_the_unit_of_publications(fit):
    found = profile(fit, "decay")
    axes = profile_likelihood(found, fit).axes[0]
    curve, line = (
        next(drawn for drawn in axes.lines if drawn.get_label() == name) for name in ("profile", "standard error")
    )
    np.testing.assert_allclose(curve.get_xdata(), found.values * percent)
    np.testing.assert_allclose(curve.get_ydata(), found.root)
    at = np.interp(found.wald.upper * percent, line.get_xdata(), line.get_ydata())
    assert at == pytest.approx(found.threshold)
    assert axes.get_xlabel().endswith("[1/percent]")
    assert axes.get_title("left") == "95 % interval 0.3239 .. 0.3563 1/percent"


def test_an_end_that_is_not_bounded_is_written(fit):
    found = profile(fit, "decay")
    open_end = dataclasses.replace(found, interval=Interval(found.interval.lower, np.inf))
    assert (
        profile_likelihood(open_end, fit).axes[0].get_title("left") == "95 % interval 0.3239 .. not bounded 1/percent"
    )
