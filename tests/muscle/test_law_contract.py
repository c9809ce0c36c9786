"""What holds for every law in `mckibben.muscle.LAWS`. A new law gets one entry in EXAMPLES and inherits all tests."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben import catalog
from mckibben.muscle import LAWS, ChouLaw, Domain, ForceLaw, PressureAffineLaw
from mckibben.units import factor

BOX = Domain(-0.03, 0.25, 0.0, 6e5)
EXAMPLES = {
    "ChouLaw": lambda: ChouLaw(math.radians(25), 0.01, BOX),
    "ExponentialLaw": lambda: catalog.law("lei-mas-10-180n"),
}
CONTRACTION = np.linspace(-0.03, 0.25, 8)
PRESSURE = np.linspace(0.5e5, 6e5, 5)


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


def test_arrays_broadcast_elementwise(law):
    grid = law.force(CONTRACTION[:, None], PRESSURE)
    assert grid.shape == (8, 5)
    for i, j in ((0, 0), (3, 4), (7, 2)):
        assert float(grid[i, j]) == pytest.approx(float(law.force(CONTRACTION[i], PRESSURE[j])), rel=1e-13)
    assert law.force(CONTRACTION, 3e5).shape == (8,)
    assert law.force(0.1, PRESSURE).shape == (5,)
    assert law.slope(CONTRACTION[:, None], PRESSURE).shape == (8, 5)
    assert law.slope(0.1, PRESSURE).shape == (5,)
    assert law.pressure_for(np.array([10.0, 20.0]), CONTRACTION[:, None]).shape == (8, 2)


def test_the_same_question_gets_the_same_answer(law):
    np.testing.assert_array_equal(law.force(CONTRACTION, 3e5), law.force(CONTRACTION, 3e5))


def test_inputs_stay_as_they_were(law):
    contraction, pressure = CONTRACTION.copy(), PRESSURE.copy()
    law.force(contraction[:, None], pressure)
    law.slope(contraction[:, None], pressure)
    law.pressure_for(pressure / 1e4, contraction[:, None])
    np.testing.assert_array_equal(contraction, CONTRACTION)
    np.testing.assert_array_equal(pressure, PRESSURE)


def test_compiled_is_eager_to_rounding(law, force):
    np.testing.assert_allclose(
        force(CONTRACTION[:, None], PRESSURE), law.force(CONTRACTION[:, None], PRESSURE), rtol=1e-13, atol=1e-10
    )


def test_pressure_for_inverts_force(law):
    force = law.force(CONTRACTION[:, None], PRESSURE)
    back = law.pressure_for(force, CONTRACTION[:, None])
    np.testing.assert_allclose(back, np.broadcast_to(PRESSURE, back.shape), rtol=1e-11)


def test_force_rises_with_pressure_in_the_domain(law):
    pressure = np.linspace(law.domain.pressure_min, law.domain.pressure_max, 13)
    contraction = np.linspace(law.domain.contraction_min, law.domain.contraction_max, 29)
    assert np.all(np.diff(law.force(contraction[:, None], pressure), axis=1) > 0)


def test_the_force_of_a_taut_muscle_falls_with_contraction_in_the_domain(law, force):
    contraction = np.linspace(law.domain.contraction_min, law.domain.contraction_max, 57)
    forces = np.asarray(force(contraction[:, None], PRESSURE))
    assert np.all(np.diff(forces, axis=0)[forces[:-1] > 0] < 0)


def test_the_slope_is_that_of_finite_differences(law, force):
    step = 1e-6
    numeric = (force(CONTRACTION[:, None] + step, PRESSURE) - force(CONTRACTION[:, None] - step, PRESSURE)) / (2 * step)
    np.testing.assert_allclose(law.slope(CONTRACTION[:, None], PRESSURE), numeric, rtol=1e-7, atol=1e-4)


@pytest.mark.parametrize("name", [name for name, law in LAWS.items() if issubclass(law, PressureAffineLaw)])
def test_an_affine_law_has_an_offset_and_a_gain(name):
    law = EXAMPLES[name]()
    force = law.force
    offset, gain = law.pressure_terms(CONTRACTION)
    assert offset.shape == gain.shape == CONTRACTION.shape
    np.testing.assert_allclose(offset + gain * 4.2e5, force(CONTRACTION, 4.2e5), rtol=1e-12)
    np.testing.assert_allclose(force(CONTRACTION, 0.0), offset, rtol=1e-12, atol=1e-12)


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
def test_the_force_is_linear_in_the_linear_parameters(name):
    law = EXAMPLES[name]()

    def at(values):
        changed = dataclasses.replace(law, **values)
        return np.asarray(changed.force(CONTRACTION[:, None], PRESSURE))

    start = {p.name: float(getattr(law, p.name)) for p in law.linear_parameters}
    double = at({k: 2 * v for k, v in start.items()})
    np.testing.assert_allclose(double, 2 * at(start), rtol=1e-12, atol=1e-9)
    alone = sum(at({k: (v if k == name else 0.0) for k, v in start.items()}) for name in start)
    np.testing.assert_allclose(alone, at(start), rtol=1e-12, atol=1e-9)


def test_it_can_be_vmapped_over_its_parameters(law):
    many = jax.tree.map(lambda x: jnp.stack([jnp.asarray(x, float), 1.01 * jnp.asarray(x, float)]), law)
    forces = jax.vmap(lambda one: one.force(0.05, 3e5))(many)
    assert float(forces[0]) == pytest.approx(float(law.force(0.05, 3e5)), rel=1e-13)
    assert float(forces[1]) != float(forces[0])


def test_it_says_what_it_is_and_where_it_comes_from(law):
    assert law.equation.startswith("F = ")
    assert law.source
    assert type(law).__doc__
    assert LAWS[type(law).__name__] is type(law)
