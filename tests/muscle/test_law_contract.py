"""What holds for every law in `mckibben.muscle.LAWS`. A new law gets one entry in EXAMPLES and inherits all tests."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben import catalog, muscle
from mckibben.muscle import LAWS, ChouLaw, Domain, ForceLaw, PressureAffineLaw, scaled_law
from mckibben.units import factor

BOX = Domain(-0.03, 0.25, 0.0, 6e5)
ANGLE, DIAMETER = math.radians(25), 0.01
EXAMPLES = {
    "ChouLaw": lambda: ChouLaw(ANGLE, DIAMETER, BOX),
    "TonduLopezLaw": lambda: muscle.TonduLopezLaw(ANGLE, DIAMETER, 1.25, BOX),
    "TonduLopezVariableLaw": lambda: muscle.TonduLopezVariableLaw(ANGLE, DIAMETER, 0.2, 1.2, BOX),
    "TsagarakisCaldwellLaw": lambda: muscle.TsagarakisCaldwellLaw(2e4, ANGLE, DIAMETER, 5e-4, 0.1, BOX),
    "MartensBoblanLaw": lambda: muscle.MartensBoblanLaw(300.0, 20.0, ANGLE, DIAMETER, BOX),
    "ReppergerLaw": lambda: muscle.ReppergerLaw(200.0, 3e-3, 0.28, BOX),
    "ReynoldsLaw": lambda: muscle.ReynoldsLaw(100.0, 1.4e-3, 1400.0, 3e-3, BOX),
    "HuntLaw": lambda: muscle.HuntLaw(254.3e3, 1230.0, 192e3, 0.22, Domain(0.0, 0.2, 0.0, 5e5)),
    "SarosiLaw": lambda: catalog.law("sarosi-dmsp-10"),
    "ExponentialLaw": lambda: catalog.law("lei-mas-10-180n"),
    "TripleExponentialLaw": lambda: muscle.TripleExponentialLaw(
        -154.4, 8.196e-4, -2.557e-3, -4.87e-11, 116.2, 38.1, 5.0, 11.63, BOX
    ),
}
PRESSURE = np.linspace(0.5e5, 5e5, 5)


def contractions(law, count=8) -> np.ndarray:
    """From end to end of a law's domain."""
    return np.linspace(law.domain.contraction_min, law.domain.contraction_max, count)


@pytest.fixture(scope="module", params=sorted(LAWS))
def law(request) -> ForceLaw:
    assert request.param in EXAMPLES, f"give {request.param} an example here"
    return EXAMPLES[request.param]()


@pytest.fixture(scope="module")
def force(law):
    return jax.jit(law.force)


def test_scalars_give_scalars(law):
    for answer in (law.force(0.1, 3e5), law.slope(0.1, 3e5), law.pressure_for(100.0, 0.1)):
        assert answer.shape == ()
        assert answer.dtype == jnp.float64


def test_arrays_broadcast_elementwise(law, force):
    grid = force(contractions(law)[:, None], PRESSURE)
    assert grid.shape == (8, 5)
    for i, j in ((0, 0), (3, 4), (7, 2)):
        assert float(grid[i, j]) == pytest.approx(float(force(contractions(law)[i], PRESSURE[j])), rel=1e-12)

    def shape(function, *arguments):
        return jax.eval_shape(function, *arguments).shape

    assert shape(law.force, contractions(law), 3e5) == (8,)
    assert shape(law.force, 0.1, PRESSURE) == (5,)
    assert shape(law.slope, contractions(law)[:, None], PRESSURE) == (8, 5)
    assert shape(law.slope, 0.1, PRESSURE) == (5,)
    assert shape(law.pressure_for, np.array([10.0, 20.0]), contractions(law)[:, None]) == (8, 2)


def test_the_same_question_gets_the_same_answer(law):
    np.testing.assert_array_equal(law.force(contractions(law), 3e5), law.force(contractions(law), 3e5))


def test_inputs_stay_as_they_were(law):
    contraction, pressure = contractions(law), PRESSURE.copy()
    law.force(contraction[:, None], pressure)
    law.slope(contraction[:, None], pressure)
    law.pressure_for(pressure / 1e4, contraction[:, None])
    np.testing.assert_array_equal(contraction, contractions(law))
    np.testing.assert_array_equal(pressure, PRESSURE)


def test_compiled_is_eager_to_rounding(law, force):
    np.testing.assert_allclose(
        force(contractions(law)[:, None], PRESSURE),
        law.force(contractions(law)[:, None], PRESSURE),
        rtol=1e-13,
        atol=1e-10,
    )


def test_pressure_for_inverts_force(law):
    force = law.force(contractions(law)[:, None], PRESSURE)
    back = law.pressure_for(force, contractions(law)[:, None])
    np.testing.assert_allclose(back, np.broadcast_to(PRESSURE, back.shape), rtol=1e-11)


def test_force_rises_with_pressure_in_the_domain(law, force):
    pressure = np.linspace(law.domain.pressure_min, law.domain.pressure_max, 13)
    contraction = np.linspace(law.domain.contraction_min, law.domain.contraction_max, 29)
    assert np.all(np.diff(force(contraction[:, None], pressure), axis=1) > 0)


def test_the_force_of_a_taut_muscle_falls_with_contraction_in_the_domain(law, force):
    contraction = np.linspace(law.domain.contraction_min, law.domain.contraction_max, 57)
    forces = np.asarray(force(contraction[:, None], PRESSURE))
    assert np.all(np.diff(forces, axis=0)[forces[:-1] > 0] < 0)


def test_the_slope_is_that_of_finite_differences(law, force):
    step = 1e-6
    numeric = (
        force(contractions(law)[:, None] + step, PRESSURE) - force(contractions(law)[:, None] - step, PRESSURE)
    ) / (2 * step)
    np.testing.assert_allclose(law.slope(contractions(law)[:, None], PRESSURE), numeric, rtol=1e-7, atol=1e-4)


@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if issubclass(law, PressureAffineLaw)])
def test_an_affine_law_has_an_offset_and_a_gain(name):
    law = EXAMPLES[name]()
    force = law.force
    offset, gain = law.pressure_terms(contractions(law))
    assert offset.shape == gain.shape == contractions(law).shape
    np.testing.assert_allclose(offset + gain * 4.2e5, force(contractions(law), 4.2e5), rtol=1e-12)
    np.testing.assert_allclose(force(contractions(law), 0.0), offset, rtol=1e-12, atol=1e-12)


def test_the_parameters_are_the_fields(law):
    fields = {f.name for f in dataclasses.fields(law)} - {"domain"}
    parameters = law.parameters()
    assert {p.name for p in parameters} == fields
    assert len(parameters) == len(fields)
    assert all(p.meaning for p in parameters)


def test_the_units_of_the_parameters_are_si_and_of_the_kind_that_is_shown(law):
    for parameter in law.parameters():
        assert factor(parameter.unit) == pytest.approx(1.0), parameter.name
        assert factor(parameter.shown, parameter.unit) > 0, parameter.name


def test_shape_parameters_have_a_finite_range_that_holds_the_example(law):
    for parameter in law.shape_parameters:
        assert math.isfinite(parameter.lower), parameter.name
        assert math.isfinite(parameter.upper), parameter.name
        assert parameter.lower < float(getattr(law, parameter.name)) < parameter.upper, parameter.name


@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if law.linear_parameters])
def test_the_force_is_affine_in_the_linear_parameters(name):
    law = EXAMPLES[name]()

    def at(values):
        changed = dataclasses.replace(law, **values)
        return np.asarray(changed.force(contractions(law)[:, None], PRESSURE))

    start = {p.name: float(getattr(law, p.name)) for p in law.linear_parameters}
    none = at(dict.fromkeys(start, 0.0))
    double = at({k: 2 * v for k, v in start.items()})
    np.testing.assert_allclose(double - none, 2 * (at(start) - none), rtol=1e-11, atol=1e-9)
    alone = sum(at({k: (v if k == name else 0.0) for k, v in start.items()}) - none for name in start)
    np.testing.assert_allclose(alone, at(start) - none, rtol=1e-11, atol=1e-9)


def test_it_can_be_vmapped_over_its_parameters(law):
    many = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x, float), 1.01 * jnp.asarray(x, float)]), law)
    forces = jax.vmap(lambda one: one.force(0.05, 3e5))(many)
    assert float(forces[0]) == pytest.approx(float(law.force(0.05, 3e5)), rel=1e-13)
    assert float(forces[1]) != float(forces[0])


def test_a_stronger_muscle_has_so_many_times_every_force(law, force):
    """Also as a muscle, whose domain stays; a law that is affine in pressure stays so."""
    strong = scaled_law(law, 1.07)
    at = contractions(law)[:, None], PRESSURE
    found = strong.force(*at)
    np.testing.assert_allclose(found, 1.07 * force(*at), rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(strong.slope(*at), 1.07 * law.slope(*at), rtol=1e-10, atol=1e-8)
    back = strong.pressure_for(found, at[0])
    np.testing.assert_allclose(back, np.broadcast_to(PRESSURE, back.shape), rtol=1e-10)
    assert isinstance(strong, PressureAffineLaw) == isinstance(law, PressureAffineLaw)
    assert jax.tree.map(float, strong.domain) == jax.tree.map(float, law.domain.intersection(law.formula_domain))


def test_it_says_what_it_is_and_where_it_comes_from(law):
    assert law.equation.startswith("F = ")
    assert law.source
    assert type(law).__doc__
    assert LAWS[type(law).__name__] is type(law)
