"""What holds for every law in `mckibben.muscle.LAWS`. A new law gets one entry in EXAMPLES and inherits all tests."""

import dataclasses
import math

import jax
import numpy as np
import pytest

from mckibben import catalog, muscle
from mckibben.errors import DomainWarning, RangeError
from mckibben.muscle import LAWS, ChouLaw, Domain, ForceLaw, PressureAffineLaw, adjusted_law

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
    "SmoothLaw": lambda: muscle.SmoothLaw(*EQ_3[:6], *S0, *S1, *S2, EQ_3[6], 0.11, 0.28, BOX),
}
EQ_3 = [getattr(catalog.law("lei-mas-10-180n"), p.name) for p in muscle.ExponentialLaw.parameters()]
S0, S1, S2 = np.array([[8.0, -20.0, 30.0, 10.0, -15.0, 5.0]]) * [[1.0], [0.3e-5], [0.05e-10]]
OWN = {name: law for name, law in LAWS.items() if law.__module__.startswith("mckibben.")}  # not those of other tests
ROWS, COLUMNS = 57, 13


def contractions(law) -> np.ndarray:
    """From end to end of a law's domain, a column."""
    return np.linspace(law.domain.contraction_min, law.domain.contraction_max, ROWS)[:, None]


def pressures(law) -> np.ndarray:
    return np.linspace(law.domain.pressure_min, law.domain.pressure_max, COLUMNS)


@jax.jit
def asked(law, contraction, pressure, force):
    """Force, slope and inverse on a grid: one program for each law, whatever its parameters."""
    return law.force(contraction, pressure), law.slope(contraction, pressure), law.pressure_for(force, contraction)


def answers(law, contraction=None, force=None):
    contraction = contractions(law) if contraction is None else contraction
    force = np.ones((ROWS, COLUMNS)) if force is None else force
    return tuple(map(np.asarray, asked(law, contraction, pressures(law), force)))


@pytest.fixture(scope="module", params=sorted(OWN))
def law(request) -> ForceLaw:
    assert request.param in EXAMPLES, f"give {request.param} an example here"
    return EXAMPLES[request.param]()


@pytest.fixture(scope="module")
def force(law):
    return answers(law)[0]


def test_a_direct_call_warns_of_impossible_points_and_refuses_texts(law):
    with pytest.warns(DomainWarning):
        law.force(10.0, 3e5)
    with pytest.raises(RangeError):
        law.force("0.1", 3e5)


def test_pressure_for_inverts_force(law, force):
    back = answers(law, force=force)[2]
    expected = np.broadcast_to(pressures(law), back.shape)
    np.testing.assert_allclose(back, expected, rtol=1e-11, atol=1e-11 * np.ptp(expected))


def test_force_rises_with_pressure_in_the_domain(force):
    assert np.all(np.diff(force, axis=1) > 0)


def test_the_force_of_a_taut_muscle_falls_with_contraction_in_the_domain(force):
    assert np.all(np.diff(force, axis=0)[force[:-1] > 0] < 0)


def test_the_slope_is_that_of_finite_differences(law):
    step = 1e-6
    above, below = (answers(law, contractions(law) + move)[0] for move in (step, -step))
    np.testing.assert_allclose(answers(law)[1], (above - below) / (2 * step), rtol=1e-7, atol=1e-4)


@pytest.mark.parametrize("name", [name for name, law in OWN.items() if issubclass(law, PressureAffineLaw)])
def test_an_affine_law_has_an_offset_and_a_gain(name):
    for law in (EXAMPLES[name](), adjusted_law(EXAMPLES[name](), strength=1.07)):
        offset, gain = jax.jit(type(law).pressure_terms)(law, contractions(law))
        assert offset.shape == gain.shape == contractions(law).shape
        np.testing.assert_allclose(offset + gain * pressures(law), answers(law)[0], rtol=1e-12, atol=1e-12)


def test_shape_parameters_have_a_finite_range_that_holds_the_example(law):
    for parameter in law.shape_parameters:
        assert math.isfinite(parameter.lower), parameter.name
        assert math.isfinite(parameter.upper), parameter.name
        assert parameter.lower < float(getattr(law, parameter.name)) < parameter.upper, parameter.name


@pytest.mark.parametrize("name", [name for name, law in OWN.items() if law.linear_parameters])
def test_the_force_is_affine_in_the_linear_parameters(name):
    law = EXAMPLES[name]()

    def at(values):
        return answers(dataclasses.replace(law, **values))[0]

    start = {p.name: float(getattr(law, p.name)) for p in law.linear_parameters}
    none = at(dict.fromkeys(start, 0.0))
    double = at({k: 2 * v for k, v in start.items()})
    np.testing.assert_allclose(double - none, 2 * (at(start) - none), rtol=1e-11, atol=1e-9)
    alone = sum(at({k: (v if k == name else 0.0) for k, v in start.items()}) - none for name in start)
    np.testing.assert_allclose(alone, at(start) - none, rtol=1e-11, atol=1e-9)


@pytest.mark.slow
def test_a_stronger_muscle_has_so_many_times_every_force(law):
    """Also as a muscle, whose domain stays; a law that is affine in pressure stays so."""
    strong = adjusted_law(law, strength=1.07)
    force, slope, _ = answers(law)
    strong_force, strong_slope, _ = answers(strong)
    np.testing.assert_allclose(strong_force, 1.07 * force, rtol=1e-12, atol=1e-10)
    np.testing.assert_allclose(strong_slope, 1.07 * slope, rtol=1e-10, atol=1e-8)
    back = answers(strong, force=strong_force)[2]
    np.testing.assert_allclose(back, np.broadcast_to(pressures(law), back.shape), rtol=1e-10, atol=1e-4)
    assert isinstance(strong, PressureAffineLaw) == isinstance(law, PressureAffineLaw)
    assert jax.tree.map(float, strong.domain) == jax.tree.map(float, law.domain.intersection(law.formula_domain))
