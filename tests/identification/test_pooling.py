"""Pooled specimens of one make: dead length and strengths are found if they are there, and predict another length."""

import numpy as np
import pytest

from mckibben import ExponentialLaw, IsobaricDataset, catalog
from mckibben.errors import IdentificationError
from mckibben.identification import identify_pooled
from mckibben.muscle import forces
from mckibben.units import bar, mm

LAW = catalog.law("lei-mas-10-180n")


def specimens(dead=0.0, scatter=0.0, lengths=(100, 200, 400), seed=0, noise=0.5):
    """Points of specimens at four lengths and six pressures, with noise [N], a dead length [m], strengths."""
    rng, found = np.random.default_rng(seed), []
    for length in np.array(lengths) * mm:
        contraction, pressure = (each.ravel() for each in np.meshgrid([0.0, 0.05, 0.1, 0.15], np.arange(1, 7) * bar))
        contraction = contraction + rng.uniform(-0.01, 0.01)
        force = np.maximum(forces(LAW, contraction * length / (length - dead), pressure), 0)
        force = force * (1 + scatter * rng.standard_normal()) + noise * rng.standard_normal(len(force))
        columns = {"pressure": pressure, "contraction": contraction, "force": force}
        found.append(IsobaricDataset.of(**columns, initial_length=length, slack_force=3.0, specimen=f"{length:g}"))
    return found


@pytest.mark.slow
def test_equal_specimens_have_one_law_and_each_can_be_left_out():
    pool = identify_pooled(ExponentialLaw, specimens())
    assert pool.dead_length == 0.0 and np.isnan(pool.dead_length_error)
    np.testing.assert_allclose(pool.strengths, 1.0, atol=0.005)
    assert all(specimen.rmse < 1.0 for specimen in pool.left_out)


@pytest.mark.slow
def test_dead_length_and_strengths_are_found_and_predict_another_length():
    pool = identify_pooled(ExponentialLaw, specimens(15 * mm, 0.03))
    assert pool.dead_length == pytest.approx(15 * mm, abs=0.5 * mm)
    assert pool.scatter < 1.0 and 0.005 < np.ptp(pool.strengths) < 0.2
    (new,) = specimens(15 * mm, lengths=(250,), seed=5)
    new = new.taut
    force, lower, upper = pool.predict(new.contraction, new.pressure, 0.25)
    assert np.mean((lower <= new.force) & (new.force <= upper)) > 0.9
    active = pool.specimen(0.25)
    assert float(active.initial_length) == pytest.approx(0.25 - pool.dead_length)
    length = 0.25 * (1 - new.contraction) - pool.dead_length
    np.testing.assert_allclose(forces(pool.law, active.contraction_at(length), new.pressure), force, rtol=1e-9)


def test_a_pool_needs_three_specimens_with_their_lengths():
    data = specimens()
    with pytest.raises(IdentificationError) as refused:
        identify_pooled(ExponentialLaw, data[:2])
    assert (refused.value.value, refused.value.lower) == (2, 3)
    unknown = IsobaricDataset.of(pressure=data[0].pressure, contraction=data[0].contraction, force=data[0].force)
    with pytest.raises(IdentificationError) as refused:
        identify_pooled(ExponentialLaw, [*data[:2], unknown])
    assert "3" in str(refused.value)
