"""Published coefficients come back from data that they made, within the intervals that the fit states."""

import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import fit_law
from mckibben.muscle import forces
from mckibben.units import bar

LEVEL = 0.999  # of all coefficients at once rather than 95 % of each


@pytest.mark.parametrize("name", ["sarosi-dmsp-10", "lei-mas-10-180n"])
def test_published_coefficients_come_back(name):
    law = catalog.law(name)
    pressure, contraction = (
        values.ravel() for values in np.meshgrid(np.arange(0.5, 6.1, 0.5) * bar, np.linspace(-0.03, 0.24, 28))
    )
    exact = forces(law, contraction, pressure)
    noise = 0.5 * np.random.default_rng(5).standard_normal(len(exact))
    data = IsobaricDataset.of(pressure=pressure, contraction=contraction, force=exact + noise, slack_force=3.0)
    fit = fit_law(type(law), data)
    intervals = fit.intervals(level=LEVEL)
    for parameter in law.parameters():
        truth, found = float(getattr(law, parameter.name)), intervals[parameter.name]
        assert found.lower < truth < found.upper, parameter.name
        assert (found.upper - found.lower) < 0.25 * abs(truth), parameter.name
    clean = fit_law(type(law), IsobaricDataset.of(pressure=pressure, contraction=contraction, force=exact))
    for parameter in law.parameters():
        assert clean.estimates[parameter.name] == pytest.approx(float(getattr(law, parameter.name)), rel=1e-8)
