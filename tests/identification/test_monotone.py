"""`monotone`: the closest law with the right slopes."""

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset
from mckibben.identification import fit_law, smooth
from mckibben.identification.least_squares import FitProblem, grid_search, solve
from mckibben.identification.smooth import monotone
from mckibben.identification.summary import domain_of
from mckibben.muscle import ExponentialLaw, GaussianProcessLaw, SmoothLaw, forces
from mckibben.muscle.slopes import unphysical
from mckibben.units import bar

CONTRACTION, PRESSURE = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.12, 7), np.linspace(1, 6, 6) * bar))


def solved(force):
    points = IsobaricDataset.of(pressure=PRESSURE, contraction=CONTRACTION, force=force)
    problem = FitProblem.of(ExponentialLaw, points)
    return solve(problem, grid_search(problem)), domain_of(points)


def test_the_closest_force_that_does_not_rise_with_contraction_is_constant():
    solution, domain = solved(20 * PRESSURE / bar + 100 * CONTRACTION)
    found = monotone(solution, domain)
    assert found is not None
    law = found.problem.law(found.values)
    assert "rises with contraction" in unphysical(solution.problem.law(solution.values), domain)
    assert unphysical(law, domain) == ""
    expected = 20 * PRESSURE / bar + 100 * CONTRACTION.mean()
    # The terms are nearly dependent: by LAPACK, the force is constant to 0.02 or 0.12 N of its 20 N.
    np.testing.assert_allclose(forces(law, CONTRACTION, PRESSURE), expected, atol=0.2)
    assert found.cost == pytest.approx(np.sum((100 * (CONTRACTION - CONTRACTION.mean())) ** 2), rel=0.01)


def test_a_law_with_the_right_slopes_stays_as_it_is():
    solution, domain = solved(
        forces(ExponentialLaw(-40.0, 6e-4, -500.0, -3e-3, 30.0, 1e-4, decay=30.0), CONTRACTION, PRESSURE)
    )
    found = monotone(solution, domain)
    assert found is not None
    np.testing.assert_array_equal(found.values, solution.values)


def stiff_bladder_force(contraction, pressure):
    """Static force [N] of a braid whose threads stretch, on a bladder of Mooney-Rivlin rubber that it meets late."""
    shortening, initial, angle, wall = 1.12 * contraction, 0.18, 0.436, 7.2e-6
    thread = initial / np.cos(angle)
    turns = thread * np.sin(angle) / (np.pi * 0.010)
    length = initial * (1 - shortening)
    gap = thread**2 - length**2
    braid = (3 * length**2 - (thread * (1 + 2e-7 * pressure)) ** 2) / (4 * np.pi * turns**2)
    width = 0.6 * bar
    pressing = width * np.logaddexp(0, (pressure - 1.2 * bar - 4 * bar * shortening) / width)
    axial, hoop = length / initial, np.sqrt(gap / (thread**2 - initial**2))
    axial_slope, hoop_slope = 1 / initial, -hoop * length / gap
    radial = 1 / (axial * hoop)
    radial_slope = -radial * (axial_slope / axial + hoop_slope / hoop)
    stretches = ((axial, axial_slope), (hoop, hoop_slope), (radial, radial_slope))
    energy_slope = sum(2 * (1.3e5 * stretch - 2e4 / stretch**3) * slope for stretch, slope in stretches)
    return np.maximum(pressing * braid + wall * energy_slope, 0.0)


@pytest.mark.slow
def test_a_muscle_with_a_stiff_bladder_needs_the_constraints(monkeypatch):
    """Without them, the slopes of the Gaussian process are refused, and Eq. 2 remains."""
    eps, p = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.18, 5), np.linspace(0.5, 6, 14) * bar))
    force = stiff_bladder_force(eps, p) + np.random.default_rng(1).normal(0, 1.0, p.size)
    taut = force > 4
    points = IsobaricDataset.of(pressure=p[taut], contraction=eps[taut], force=force[taut])
    fit = fit_law(SmoothLaw, points)
    assert isinstance(fit.law, GaussianProcessLaw)
    assert unphysical(fit.law) == ""
    regression = fit.require_regression()
    refitted = regression.refit(np.arange(len(points)) >= 5)  # type: ignore[misc]
    assert refitted.problem.law_type is GaussianProcessLaw
    monkeypatch.setattr(smooth, "monotone", lambda solution, domain: None)
    assert fit.rmse < 0.5 * fit_law(SmoothLaw, points).rmse
