"""Torque and stiffness of a joint with their uncertainty."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben import catalog
from mckibben.dataset import IsobaricDataset
from mckibben.identification import fit_law
from mckibben.joint import SeriesSpring
from mckibben.muscle import ExponentialLaw
from mckibben.study.uncertainty import joint_bands
from mckibben.units import bar

ANGLES = np.array([0.0, 0.15])
PRESSURES = (3.5 * bar, 4 * bar)


def independent(name):
    """Fit to points whose pressures all differ, so that no two share an error."""
    table = catalog.dataset(name).taut.table
    pressure = table["pressure"] + np.linspace(0, 500, table.sizes["point"])
    return fit_law(
        ExponentialLaw, IsobaricDataset(table.assign(pressure=pressure).drop_vars("set_pressure", errors="ignore"))
    )


@pytest.fixture(scope="module")
def fit():
    return independent("festo-tool-10mm")


@pytest.fixture(scope="module")
def other():
    return independent("dmsp-10-250-martens2017")


def drawn(fit, count=4000, seed=0):
    """Parameters as the classical covariance has them, shape (count, 7)."""
    normal = np.random.default_rng(seed).normal(size=(count, 7))
    errors = np.array(list(fit.standard_errors.values()))
    return np.array(list(fit.estimates.values())) + (normal @ np.linalg.cholesky(fit.correlations).T) * errors


def spread(joint, draws1, draws2):
    """Standard deviation of torque and stiffness over draws, shape (2, angles)."""

    @jax.jit
    @jax.vmap
    def both(values1, values2):
        laws = ExponentialLaw(*values1), ExponentialLaw(*values2)
        changed = eqx.tree_at(lambda j: (j.muscle1.law, j.muscle2.law), joint, laws)
        return jnp.stack(changed.torque_and_stiffness(ANGLES, PRESSURES))

    return np.std(both(draws1, draws2), axis=0)


@pytest.mark.parametrize("tendon", [None, SeriesSpring(stiffness=4e4, preload=10.0, travel=0.02)])
@pytest.mark.slow
def test_one_fit_for_both_muscles_against_draws(knee, fit, tendon):
    joint = knee if tendon is None else eqx.tree_at(lambda j: j.tendon, knee, tendon)
    bands = joint_bands(joint, fit, ANGLES, PRESSURES)
    expected = spread(joint, drawn(fit), drawn(fit))
    np.testing.assert_allclose(bands.torque.standard_error, expected[0], rtol=0.06)
    np.testing.assert_allclose(bands.stiffness.standard_error, expected[1], rtol=0.06)
    assert not bands.may_be_slack.any()


@pytest.mark.slow
def test_two_fits_are_independent(knee, fit, other):
    bands = joint_bands(knee, (fit, other), ANGLES, PRESSURES)
    expected = spread(knee, drawn(fit), drawn(other, seed=1))
    np.testing.assert_allclose(bands.torque.standard_error, expected[0], rtol=0.06)
    np.testing.assert_allclose(bands.stiffness.standard_error, expected[1], rtol=0.06)
    swapped = joint_bands(knee, (other, fit), ANGLES, PRESSURES)
    assert np.all(np.abs(swapped.torque.value - bands.torque.value) > 0.01)


def test_what_two_muscles_share_cancels_in_the_torque_and_adds_up_in_the_stiffness(knee, fit):
    same = joint_bands(knee, fit, 0.0, (4 * bar, 4 * bar))
    apart = joint_bands(knee, (fit, fit), 0.0, (4 * bar, 4 * bar))
    assert float(same.torque.standard_error) < 1e-9
    assert float(same.stiffness.standard_error) == pytest.approx(np.sqrt(2) * float(apart.stiffness.standard_error))
    assert float(apart.torque.standard_error) > 0.01
    # Satterthwaite: two equal variances double the degrees of freedom.
    assert float(apart.stiffness.degrees_of_freedom) == pytest.approx(2 * float(same.stiffness.degrees_of_freedom))


def test_a_band_that_reaches_the_slack_is_named(knee, fit):
    zero = knee.muscle1.specimen.contraction_at(knee.geometry.path_lengths(0.0)[0])
    low = float(fit.law.pressure_for(0.3, zero))  # a pull of 0.3 N
    bands = joint_bands(knee, fit, np.zeros(2), (np.array([low, 5 * bar]), 5 * bar))
    assert bands.may_be_slack.tolist() == [True, False]
