import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.errors import DomainWarning
from mckibben.muscle import Domain, Muscle


@pytest.fixture(scope="module")
def muscle(specimen, law):
    return Muscle(specimen, law)


def test_a_muscle_never_pushes(muscle, law):
    contraction, pressure = np.linspace(-0.08, 0.4, 40)[:, None], np.linspace(-1e5, 8e5, 10)
    force, fitted = muscle.tension(contraction, pressure), law.force(contraction, pressure)
    assert float(fitted.min()) < -100
    assert float(force.min()) == 0.0
    np.testing.assert_array_equal(force, np.maximum(fitted, 0))


@pytest.mark.slow
def test_a_slack_muscle_has_no_slope_and_a_taut_one_that_of_its_law(muscle, law):
    assert float(muscle.slope(0.05, 0.0)) == 0.0
    assert float(muscle.slope(0.05, 5e5)) == pytest.approx(float(law.slope(0.05, 5e5)), rel=1e-14)
    assert np.isfinite(float(jax.grad(lambda c: muscle.force(c, 0.0))(0.05)))


@pytest.mark.parametrize("method", ["force", "slope"])
def test_outside_its_domain_a_muscle_says_so(muscle, method):
    asked = getattr(muscle, method)
    with pytest.warns(
        DomainWarning, match=r"^muscle 'MAS-10\S+: contraction -8 % and pressure 6 bar are outside contr"
    ) as said:
        asked(-0.08, 6e5)
    assert "from -3 % to 25 %, pressure from 0 bar to 6 bar" in str(said[0].message)
    assert len(said) == 1 and said[0].filename == __file__
    with pytest.warns(DomainWarning) as said:  # a force is that of the law, which warns of what no muscle can be
        asked(10, 6e5)
    assert "contraction 1000 % and pressure 6 bar" in str(said[0].message)
    several = np.array([[0.1], [0.3]]), np.array([3e5, 7e5, 8e5])
    with pytest.warns(DomainWarning, match=r"5 of 6 points, the first at contraction 10 % and pressure 7 bar") as said:
        asked(*several)
    assert len(said) == 1


@pytest.mark.slow
def test_inside_its_domain_and_where_numbers_are_traced_a_muscle_does_not_warn(muscle):
    muscle.force(np.array([-0.03, 0.25]), np.array([[0.0], [6e5]]))  # the edges; a warning is an error in these tests
    outside = jax.jit(muscle.force)(-0.08, 6e5)
    assert float(jax.jit(lambda m: m.force(-0.08, 6e5))(muscle)) == pytest.approx(float(outside), rel=1e-12)
    np.testing.assert_allclose(jax.vmap(lambda p: muscle.force(-0.08, p))(jnp.array([6e5])), [outside], rtol=1e-12)
    assert float(muscle.tension(-0.08, 6e5)) == pytest.approx(float(outside), rel=1e-12)


def test_a_muscle_may_be_trusted_where_specimen_and_law_both_may(muscle):
    domain = muscle.domain  # the specimen takes 8 bar, Eq. 3 was identified up to 6
    assert (float(domain.contraction_min), float(domain.contraction_max)) == (-0.03, 0.25)
    assert (float(domain.pressure_min), float(domain.pressure_max)) == (0.0, 6e5)


def test_a_domain_contains_its_edges_and_nothing_beyond():
    domain = Domain(-0.03, 0.25, 0.0, 6e5)
    contraction = np.array([-0.031, -0.03, 0.1, 0.25, 0.251])
    np.testing.assert_array_equal(domain.contains(contraction, 3e5), [False, True, True, True, False])
    np.testing.assert_array_equal(domain.contains_contraction(contraction), [False, True, True, True, False])
    np.testing.assert_array_equal(
        domain.contains(0.1, np.array([-1.0, 0.0, 6e5, 6.00001e5])), [False, True, True, False]
    )
    assert domain.contains(contraction[:, None], np.zeros(3)).shape == (5, 3)
    assert not bool(domain.contains(np.nan, 3e5))


def test_the_volume_is_known_by_the_braid_or_as_a_polynomial(specimen):
    unknown = {"initial_diameter": None, "braid_angle": None}
    for name in unknown:
        assert not dataclasses.replace(specimen, **{name: None}).has_volume
    assert specimen.has_volume and not dataclasses.replace(specimen, **unknown).has_volume
    assert dataclasses.replace(specimen, **unknown, volume_terms=(2e-5, 1e-4)).has_volume
