import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import fit_law, validate
from mckibben.identification.regression import pressure_blocks
from mckibben.muscle import ChouLaw, ExponentialLaw
from mckibben.units import bar, percent

EQ_3 = catalog.law("lei-mas-10-180n")
CHOU = ChouLaw.of(catalog.specimen("MAS-10-180N-AA-MC-O"))


@pytest.fixture(scope="module")
def campaign() -> IsobaricDataset:
    """Eq. 3 at 13 pressures, in both directions +-6 N, in 3 repeats."""
    pressure, contraction, sign, repeat = (
        a.ravel()
        for a in np.meshgrid(
            np.arange(13) * 0.5 * bar, np.linspace(-3, 20, 24) * percent, [1, -1], [0, 1, 2], indexing="ij"
        )
    )
    noise = np.random.default_rng(3).normal(size=pressure.shape)
    force = np.asarray(EQ_3.force(contraction, pressure)) + 6.0 * sign + noise
    return IsobaricDataset.of(
        pressure=pressure,
        contraction=contraction,
        force=np.maximum(force, 0),
        direction=np.where(sign > 0, "loading", "unloading"),
        repeat=repeat,
        specimen="MAS-10",
    )


def test_errors_are_what_they_say(campaign):
    validation = validate([EQ_3, CHOU], campaign)
    assert validation.laws == ("ExponentialLaw", "ChouLaw")
    points = campaign.taut.at(3 * bar)
    error = np.asarray(CHOU.force(points.contraction, points.pressure)) - points.force
    found = validation.of("ChouLaw", pressure=3 * bar)
    assert found.points == len(points)
    assert found.rmse == pytest.approx(np.sqrt(np.mean(error**2)))
    assert found.max_error == pytest.approx(np.abs(error).max())
    assert found.bias == pytest.approx(error.mean())
    assert validation.slack == np.count_nonzero(campaign.slack)


def test_directions_are_told_apart(campaign):
    validation = validate({"Eq. 3": EQ_3}, campaign)
    at = {d: validation.of("Eq. 3", pressure=6 * bar, direction=d) for d in ("loading", "unloading")}
    assert at["loading"].bias == pytest.approx(-6, abs=0.5)
    assert at["unloading"].bias == pytest.approx(6, abs=0.5)
    both = validation.of("Eq. 3", pressure=6 * bar)
    assert both.points == sum(e.points for e in at.values())
    assert validation.of("Eq. 3", direction="loading").points < validation.of("Eq. 3").points


def test_points_outside_the_domain_are_counted(campaign):
    low = campaign.select(campaign.levels <= 4 * bar)
    fit = fit_law(ExponentialLaw, low)
    validation = validate([fit.law], campaign)
    assert validation.of("ExponentialLaw", pressure=4 * bar).outside == 0
    at_6_bar = validation.of("ExponentialLaw", pressure=6 * bar)
    assert at_6_bar.outside == at_6_bar.points
    assert "outside the domain" in validation.to_dict()["tables"][0]["columns"]["outside"]["title"]


def test_levels_with_two_points_each_are_blocks_however_close_they_are():
    levels = np.repeat([1e5, 1.001e5, 2e5], 2)
    points = IsobaricDataset.of(pressure=levels, contraction=np.tile([0.0, 0.1], 3), force=np.arange(6.0))
    np.testing.assert_array_equal(pressure_blocks(points)[0], levels)
