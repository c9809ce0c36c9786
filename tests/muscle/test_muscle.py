import dataclasses
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.errors import DomainWarning, McKibbenWarning, RangeError
from mckibben.muscle import Domain, MaxwellCreep, MaxwellSlip, Muscle, Specimen, forces
from mckibben.muscle.air import inner_volume, volume_terms


@pytest.fixture(scope="module")
def muscle(specimen, law):
    return Muscle(specimen, law)


def test_a_muscle_pulls_as_its_law_says(muscle, law):
    assert float(muscle.force(0.1, 6e5)) == float(law.force(0.1, 6e5)) > 0


@pytest.mark.parametrize("point", [{"contraction": True, "pressure": 1e5}, {"contraction": 0.1, "pressure": "1 bar"}])
def test_forces_are_of_numbers(law, point):
    with pytest.raises(RangeError) as caught:
        forces(law, **point)
    assert caught.value.value in point.values()


def test_a_muscle_never_pushes(muscle, law):
    contraction, pressure = np.linspace(-0.08, 0.4, 40)[:, None], np.linspace(-1e5, 8e5, 10)
    force, fitted = muscle.tension(contraction, pressure), law.force(contraction, pressure)
    assert float(fitted.min()) < -100
    assert float(force.min()) == 0.0
    np.testing.assert_array_equal(force, np.maximum(fitted, 0))


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


def test_the_force_of_a_contraction_that_is_no_number_is_no_number(muscle):
    assert np.isnan(float(muscle.force(np.nan, 3e5)))


def test_pressure_for_brings_the_force_back(muscle):
    pressure = muscle.pressure_for(jnp.array([10.0, 100.0, 300.0]), 0.05)
    np.testing.assert_allclose(muscle.force(0.05, pressure), [10.0, 100.0, 300.0], rtol=1e-12)


def test_a_muscle_may_be_trusted_where_specimen_and_law_both_may(muscle):
    domain = muscle.domain  # the specimen takes 8 bar, Eq. 3 was identified up to 6
    assert (float(domain.contraction_min), float(domain.contraction_max)) == (-0.03, 0.25)
    assert (float(domain.pressure_min), float(domain.pressure_max)) == (0.0, 6e5)


def test_length_and_contraction_are_inverse(specimen):
    assert float(specimen.contraction_at(0.162)) == pytest.approx(0.1, abs=1e-15)
    assert float(specimen.length_at(0.1)) == pytest.approx(0.162, rel=1e-15)
    assert float(specimen.contraction_at(0.1854)) == pytest.approx(-0.03, abs=1e-15)


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


def test_a_domain_without_limits_contains_all():
    assert bool(Domain().contains(1e9, -1e9))


def test_an_intersection_is_the_shared_part_whatever_the_order():
    one, other = Domain(-0.03, 0.25, 0.0, 8e5), Domain(-0.05, 0.2, 1e5, 6e5)
    for shared in (one.intersection(other), other.intersection(one)):
        assert [float(x) for x in jax.tree.leaves(shared)] == [-0.03, 0.2, 1e5, 6e5]


def test_leaving_the_domain_is_said_as_the_house_says_it():
    domain = Domain(-0.03, 0.25, 0.0, 8e5)
    domain.check_contraction(0.25, owner="M")
    with pytest.raises(RangeError) as caught:
        domain.check_contraction(-0.065, owner="MAS-10-180N-AA-MC-O", remedy="give the joint a series spring")
    assert str(caught.value) == (
        "contraction -6.5 % is outside -3..25 % of MAS-10-180N-AA-MC-O; give the joint a series spring"
    )
    assert (caught.value.value, caught.value.lower, caught.value.upper) == (-0.065, -0.03, 0.25)
    with pytest.raises(RangeError, match=r"contraction 25\.0003 % is outside -3\.\.25 %"):
        domain.check_contraction(0.250003, owner="M")


def test_a_domain_prints_in_percent_and_bar():
    assert str(Domain(-0.03, 0.25, 0.0, 6e5)) == "contraction -3..25 %, pressure 0..6 bar"


def test_a_specimen_is_a_pytree_of_its_numbers():
    specimen = Specimen("X", 0.18, 0.01, 0.4, 630.0, Domain(-0.03, 0.25, 0.0, 8e5))
    assert len(jax.tree.leaves(specimen)) == 8
    with pytest.raises(AttributeError):
        specimen.initial_length = 0.2


def test_domains_that_do_not_overlap_are_refused(specimen, law):
    with pytest.raises(RangeError, match="do not overlap: contraction from 20 % to 30 %, and contraction to 10 %"):
        Domain(0.2, 0.3).intersection(Domain(contraction_max=0.1))
    with pytest.raises(RangeError, match="do not overlap"):
        Muscle(specimen, dataclasses.replace(law, domain=Domain(0.3, 0.4)))


def test_the_volume_is_known_by_the_braid_or_as_a_polynomial(specimen):
    unknown = {"initial_diameter": None, "braid_angle": None}
    for name in unknown:
        assert not dataclasses.replace(specimen, **{name: None}).has_volume
    assert specimen.has_volume and not dataclasses.replace(specimen, **unknown).has_volume
    assert dataclasses.replace(specimen, **unknown, volume_terms=(2e-5, 1e-4)).has_volume


@pytest.mark.parametrize(("diameter", "warned"), [(8e-3, False), (20e-3, False), (0.1, True), (1e-3, True)])
def test_a_volume_that_does_not_fit_the_force_is_warned_of(law, diameter, warned):
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        terms = volume_terms(law, 0.18, inner_volume(0.18, diameter))
    assert terms[0] == pytest.approx(inner_volume(0.18, diameter))
    assert [one.category for one in heard] == [McKibbenWarning] * warned


def test_friction_and_creep_are_known_by_their_parts(specimen, law):
    found = {}
    for name, part in (
        ("none", {}),
        ("friction", {"friction": MaxwellSlip(7.5, 5e-4)}),
        ("creep", {"creep": MaxwellCreep(1e3, 4.0)}),
    ):
        muscle = Muscle(specimen, law, **part)
        found[name] = muscle.has_friction, muscle.has_creep
    assert found == {"none": (False, False), "friction": (True, False), "creep": (False, True)}
