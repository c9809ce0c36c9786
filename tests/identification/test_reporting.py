"""Results of fits as plain data and text."""

import math

import numpy as np
import pytest

from mckibben import catalog
from mckibben.identification import identify
from mckibben.identification.reporting import fit_numbers
from mckibben.muscle import ExponentialLaw


def test_a_fit_is_shown_in_the_units_of_the_publication():
    data = catalog.dataset("dmsp-10-250-martens2017")
    fit = identify(ExponentialLaw, data)
    found = fit_numbers(fit)
    assert found["decay_per_percent"] == pytest.approx(float(fit.law.decay) / 100)
    parameters = found["parameters"]
    assert {name: p["unit"] for name, p in parameters.items()} == {
        "a1": "N",
        "a2": "N/bar",
        "b1": "N/percent",
        "b2": "N/(bar*percent)",
        "c1": "N",
        "c2": "N/bar",
        "decay": "1/percent",
    }
    p, eps = 4.5, 7.0  # bar, percent: the published form with these numbers is the law
    a1, a2, b1, b2, c1, c2, mu = (
        parameters[name]["estimate"] for name in ("a1", "a2", "b1", "b2", "c1", "c2", "decay")
    )
    published = (a1 + a2 * p) + (b1 + b2 * p) * eps + (c1 + c2 * p) * math.exp(-mu * eps)
    assert published == pytest.approx(float(fit.law.force(eps / 100, p * 1e5)), rel=1e-9)
    assert parameters["a2"]["standard_error"] == pytest.approx(fit.standard_errors["a2"] * 1e5)
    residuals = np.asarray(fit.law.force(data.taut.contraction, data.taut.pressure)) - data.taut.force
    assert found["rmse_N"] == pytest.approx(np.sqrt(np.mean(residuals**2)))
    assert found["max_N"] == pytest.approx(np.abs(residuals).max())
    assert (found["points_used"], found["points_slack"]) == (40, 45)
