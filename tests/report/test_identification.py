"""Figures of force bands."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import fit_law
from mckibben.muscle import ExponentialLaw
from mckibben.report.identification import force_bands
from mckibben.units import bar, percent


@pytest.fixture(scope="module")
def chart():
    return catalog.dataset("festo-tool-10mm")


@pytest.fixture(scope="module")
def fit(chart):
    return fit_law(ExponentialLaw, chart)


@pytest.mark.slow
def test_a_column_a_pressure_with_the_law_the_points_and_two_bands(chart, fit):
    figure = force_bands(chart, fit)
    assert len(figure.axes) == 12  # six of ten pressures, curve and residuals
    top, bottom = figure.axes[2], figure.axes[8]
    assert top.get_title("left").endswith("4 bar")
    curve = next(line for line in top.lines if line.get_label() == "fitted law")
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


@pytest.mark.slow
def test_directions_are_told_apart(chart):
    taut = chart.taut
    both = IsobaricDataset.of(
        pressure=taut.pressure,
        contraction=taut.contraction,
        force=taut.force,
        direction=np.where(np.arange(len(taut)) % 2, "loading", "unloading"),
    )
    figure = force_bands(both, fit_law(ExponentialLaw, both), level=0.9)
    names = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    assert set(names) == {"fitted law", "90 % confidence band", "90 % prediction band", "loading", "unloading"}
