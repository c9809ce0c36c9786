"""Identification and attainable stiffness of the paper, against known numbers and plain NumPy."""

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset
from mckibben.identification import fit_law
from mckibben.identification.reporting import fit_numbers
from mckibben.muscle import ExponentialLaw
from mckibben.paper import identification as papers
from mckibben.units import deg

pytestmark = pytest.mark.slow
EQ3 = {"a1": -245.8, "a2": 109.0, "b1": 3.216, "b2": -3.442, "c1": 255.6, "c2": -13.18, "decay": 0.3}


def rms(x) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize(
    ("name", "decay", "rmse", "unseen", "used"),
    [(papers.MARTENS, 0.400, 1.07, 1.34, 40), (papers.FESTO, 0.340, 2.76, 3.42, 119)],
)
def test_measured_muscles_give_the_known_numbers(identification, name, decay, rmse, unseen, used):
    found = fit_numbers(identification.fits[name])
    assert round(found["decay_per_percent"], 3) == decay
    assert round(found["rmse_N"], 2) == rmse
    assert round(found["leave_one_pressure_out_rmse_N"], 2) == unseen
    assert found["points_used"] == used


@pytest.mark.parametrize("name", list(EQ3))
def test_the_rigs_fit_is_eq_3_within_three_standard_errors(identification, name):
    found = fit_numbers(identification.fits[papers.RIG])["parameters"][name]
    assert abs(found["estimate"] - EQ3[name]) < 3 * found["standard_error"]
    assert found["standard_error"] < 0.25 * abs(EQ3[name])  # which says something


def test_the_rigs_fit_reads_the_force_of_eq_3(identification, paper):
    """Parameters trade off against each other; what counts is the force, to 1 % of the largest."""
    law = identification.fits[papers.RIG].law
    eps, p = np.meshgrid(np.linspace(0, 0.2, 41), np.linspace(1e5, 6e5, 11))
    true = paper.eq3(eps, p)
    taut = true > 20
    assert np.abs(np.asarray(law.force(eps, p)) - true)[taut].max() < 6.0
    assert rms((np.asarray(law.force(eps, p)) - true)[taut]) < 2.0


def test_the_test_is_the_papers(identification):
    rig = identification.rig
    np.testing.assert_allclose(rig.test.pressures, np.arange(13) * 0.5e5)
    assert sorted(rig.test.directions) == ["loading", "unloading"]
    assert len(rig.test.repeats) == 2
    assert rig.samples == 1000 * len(rig.test)
    steps = np.diff(np.unique(np.round(rig.test.contraction * 180, 6)))
    np.testing.assert_allclose(steps, 1.0)  # mm
    np.testing.assert_allclose(rig.retest.pressures, papers.TEST_PRESSURES)
    assert len(rig.retest.repeats) == 1


@pytest.mark.parametrize("pressure", papers.TEST_PRESSURES)
def test_validation_is_the_error_over_the_points_of_the_retest(identification, pressure):
    taut = identification.rig.retest.taut
    here = np.isclose(taut.levels, pressure)
    assert here.sum() > 20
    for name in (papers.EXPERIMENTAL, papers.CHOU):
        if name == papers.CHOU:  # Eq. 1, by hand
            alpha, p, eps = np.radians(25), taut.pressure[here], taut.contraction[here]
            force = np.pi * 0.01**2 / 4 * p * (3 * (1 - eps) ** 2 / np.tan(alpha) ** 2 - 1 / np.sin(alpha) ** 2)
        else:
            force = np.asarray(identification.fits[papers.RIG].law.force(taut.contraction[here], taut.pressure[here]))
        expected = rms(force - taut.force[here])
        assert identification.retested.of(name, pressure=pressure).rmse == pytest.approx(expected, rel=1e-6)


def test_held_out_means_not_seen(identification):
    settled = identification.rig.settled
    for found, unseen in (
        (identification.held_out_pressures, np.isin(settled.levels, papers.TEST_PRESSURES)),
        (identification.held_out_repeat, settled.table["repeat"].to_numpy() == 1),
    ):
        law = fit_law(ExponentialLaw, settled.select(~unseen)).law
        taut = settled.select(unseen).taut
        error = np.asarray(law.force(taut.contraction, taut.pressure)) - taut.force
        assert found.of(papers.EXPERIMENTAL).rmse == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
        assert found.of(papers.EXPERIMENTAL).rmse < found.of(papers.CHOU).rmse
    assert {e.pressure for e in identification.held_out_pressures.errors} == {None, *papers.TEST_PRESSURES}


def test_eq_3_reads_64_n_too_high_on_another_muscle(identification):
    assert identification.measured[papers.MARTENS].of(papers.PUBLISHED).bias == pytest.approx(64, abs=1)
    for name in (papers.MARTENS, papers.FESTO):
        measured = identification.measured[name]
        assert measured.of(papers.EXPERIMENTAL).rmse == pytest.approx(identification.fits[name].rmse)
        assert measured.of(papers.CHOU_FITTED).rmse < measured.of(papers.CHOU).rmse


def test_the_gap_between_directions_on_points_made_by_hand():
    data = IsobaricDataset.of(
        pressure=[1e5] * 6 + [2e5] * 2,
        contraction=[0.0, 0.1, 0.0, 0.1, 0.2, 0.3, 0.0, 0.3],
        force=[100.0, 50.0, 80.0, 40.0, 30.0, 0.0, 200.0, 0.0],
        direction=["loading", "loading", "unloading", "unloading", "loading", "unloading", "loading", "unloading"],
    )
    gap, span = papers.direction_gap(data)
    assert gap == pytest.approx((20 + 10) / 2)  # the points of one direction alone, and slack ones, do not count
    assert span == 200.0


@pytest.fixture
def references(paper, paper_precontracted):
    return {"as_printed": paper, "pre_contracted": paper_precontracted}


@pytest.mark.parametrize(
    ("key", "band", "angles"),
    [("as_printed", (70.5, 73.4), (-10.3, 10.3)), ("pre_contracted", (10.0, 19.5), (-36.3, 38.3))],
)
def test_the_numbers_of_the_documentation(joint_maps, references, key, band, angles):
    found = joint_maps[key]
    assert found.at(0.0) == pytest.approx(band, abs=0.05)
    assert found.at(0.0) == pytest.approx(references[key].attainable(0.0), abs=2e-3)
    step = 80 / 120
    assert np.array([found.angle_min, found.angle_max]) / deg == pytest.approx(angles, abs=step)
