"""Designs that give no force law are refused, whatever the law; those of ordinary tests are not."""

import functools

import numpy as np
import pytest

from mckibben.dataset import IsobaricDataset
from mckibben.errors import IdentificationError
from mckibben.identification import fit_law, rank
from mckibben.identification.design import check_design
from mckibben.muscle import ChouLaw, ExponentialLaw
from mckibben.units import bar, deg, mm

SWEEP = np.concatenate([np.linspace(1, 6, 30), np.linspace(6, 1, 30)]) * bar
MUSCLE = ChouLaw(24 * deg, 12 * mm)


@functools.cache
def contraction_at(load):
    """Contraction [-] at which the muscle carries a load [N]."""
    contraction = np.linspace(-0.1, 0.35, 4501)
    force = np.asarray(MUSCLE.force(contraction[:, None], SWEEP))
    return contraction[np.argmin(np.abs(force - load), axis=0)]


def one_load(seed, *, force_noise=0.0, friction=0.0):
    """Pressure up and down at a hanging weight; friction makes a loop of the contraction."""
    rng = np.random.default_rng(seed)
    up = np.arange(60) < 30
    contraction = np.where(
        up, contraction_at(60 + friction), contraction_at(60 - friction)
    ) + 1e-4 * rng.standard_normal(60)
    return SWEEP, contraction, 60 + force_noise * rng.standard_normal(60)


def spring(seed):
    """A spring in series, stretched by the muscle: force, contraction and pressure along one curve."""
    contraction = np.linspace(0.02, 0.2, 60)
    return np.linspace(1, 5, 60) ** 1.5 * bar, contraction, 500 * contraction


def one_length(seed):
    pressure = np.linspace(0.5, 6, 60) * bar
    noise = 1e-4 * np.random.default_rng(seed).standard_normal(60)
    return pressure, 0.1 + noise, np.asarray(MUSCLE.force(0.1, pressure))


def one_pressure(seed):
    contraction = np.linspace(0, 0.2, 60)
    return np.full(60, 4 * bar), contraction, np.asarray(MUSCLE.force(contraction, 4 * bar))


def two_lines(seed):
    """Pressures at one length, and contractions at one pressure."""
    noise = np.random.default_rng(seed).standard_normal(60)
    contraction = np.where(np.arange(60) < 30, 0.0, np.linspace(-0.2, 0.2, 60)) + 1e-4 * noise
    pressure = np.where(np.arange(60) < 30, np.linspace(1, 11, 60), 1) * bar + 300 * noise
    return pressure, contraction, np.asarray(MUSCLE.force(contraction, pressure))


@pytest.mark.parametrize("law", [ChouLaw, ExponentialLaw])
@pytest.mark.parametrize(
    ("test", "fields"),
    [
        (lambda seed: one_load(seed, force_noise=0.25), {"contraction", "force"}),
        (lambda seed: one_load(seed, force_noise=0.25, friction=6.0), {"contraction", "force"}),
        (spring, {"contraction"}),
        (one_length, {"contraction"}),
        (one_pressure, {"pressure"}),
        (two_lines, {"contraction"}),
    ],
)
def test_a_design_that_gives_no_law_is_refused(law, test, fields):
    pressure, contraction, force = test(1)
    data = IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force, slack_force=0.0)
    with pytest.raises(IdentificationError) as error:
        fit_law(law, data)
    assert error.value.field in fields
    assert error.value.remedy


@pytest.mark.slow
def test_one_load_is_never_taken_for_a_law():
    """By chance, slopes of pure noise have the right signs: their share of the variance tells them apart."""
    for seed in range(300):
        pressure, contraction, force = one_load(seed, force_noise=0.25, friction=3.0)
        data = IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force, slack_force=0.0)
        with pytest.raises(IdentificationError):
            check_design(data)


def test_a_ranking_refuses_before_the_fits():
    pressure, contraction, force = one_load(1)
    with pytest.raises(IdentificationError) as error:
        rank(IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force, slack_force=0.0))
    assert error.value.field == "contraction"


@pytest.mark.slow
def test_two_loads_give_a_law():
    loads = [30, 60]
    pressure = np.tile(SWEEP, len(loads))
    contraction = np.concatenate([contraction_at(load) for load in loads])
    force = np.repeat(np.array(loads, float), len(SWEEP))
    law = fit_law(
        ChouLaw, IsobaricDataset.of(pressure=pressure, contraction=contraction, force=force, slack_force=0.0)
    ).law
    assert law.braid_angle == pytest.approx(24 * deg, abs=0.1 * deg)
