# ruff: noqa: E501 - tables of cases
"""Friction of a muscle, against play operators in plain Python, and properties for any path."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mckibben.errors import RangeError
from mckibben.muscle import Domain, MaxwellSlip, Muscle, NoFriction, ReynoldsLaw, Specimen
from mckibben.muscle.friction import play_response, smooth_limit
from mckibben.units import bar, mm

FRICTION = MaxwellSlip(12.0, 0.5 * mm, growth=1 / bar, reference_pressure=3 * bar)
PLAIN = MaxwellSlip(12.0, 0.5 * mm)
FAR = 1e9  # N: a tension at which nothing fades


@st.composite
def paths(draw, closed=False):
    """Independent lengths [m], tensions [N] and pressures [Pa]."""
    count = draw(st.integers(2, 30))
    length = 0.2 + 1e-3 * np.array(draw(st.lists(st.floats(-5, 5), min_size=count, max_size=count)))
    tension = np.array(draw(st.lists(st.floats(0, 600), min_size=count, max_size=count)))
    pressure = bar * np.array(draw(st.lists(st.floats(-1, 8), min_size=count, max_size=count)))
    if closed:
        length, tension, pressure = (np.append(column, column[0]) for column in (length, tension, pressure))
    return length, tension, pressure


def reference_force(path, friction):
    """The force along a path at a constant band: each element is the length minus that of its play operator."""
    forces = []
    plays = [path[0]] * friction.elements
    for x in path:
        total = 0.0
        for i, (k, w) in enumerate(zip(friction.stiffnesses, friction.shares, strict=True)):
            r = w * friction.half_width / k
            plays[i] = max(x - r, min(x + r, plays[i]))
            total += k * (x - plays[i])
        forces.append(total)
    return forces


@given(st.lists(st.floats(-5, 5), min_size=2, max_size=40), st.integers(1, 8))
def test_it_is_a_sum_of_stops(millimetres, elements):
    friction = MaxwellSlip(12.0, 0.5 * mm, elements=elements)
    path = 0.2 + 1e-3 * np.array(millimetres)
    expected = reference_force(path.tolist(), friction)
    np.testing.assert_allclose(friction.path_response(path, FAR, 0.0), expected, atol=1e-9)


def test_what_is_simulated_is_what_the_rig_feels():
    generator = np.random.default_rng(1)
    length = 0.2 + np.cumsum(generator.normal(0, 0.4e-3, 60))
    tension, pressure = generator.uniform(0, 100, 60), generator.uniform(0, 6 * bar, 60)

    @jax.jit
    def step(state, at):
        force = FRICTION.force(state, *at)
        state = FRICTION.project(state, *at)
        return state, (force, FRICTION.force(state, *at))

    start = FRICTION.initial(length[0])
    _, (before, after) = jax.lax.scan(step, start, tuple(map(jnp.asarray, (length, tension, pressure))))
    np.testing.assert_allclose(before, FRICTION.path_response(length, tension, pressure), atol=1e-9)
    np.testing.assert_allclose(after, before, atol=1e-9)  # a projection changes no force


@given(paths(closed=True))
def test_energy_is_only_lost_whatever_length_tension_and_pressure_do(path):
    length, tension, pressure = path
    limit = smooth_limit(np.maximum(12 + (pressure - 3 * bar) / bar, 0), tension, np)
    travel = np.diff(length, prepend=length[:1])
    stiffness = FRICTION.stiffnesses
    deflection = play_response(travel, limit, stiffness, FRICTION.shares)
    np.testing.assert_allclose(deflection @ stiffness, FRICTION.path_response(*path), atol=1e-12)
    stored = (deflection**2 / 2) @ stiffness
    put_in = (deflection @ stiffness) * travel
    assert np.all(put_in[1:] >= np.diff(stored) - 1e-12)  # at each move: what is not stored is lost
    assert put_in.sum() >= -1e-12  # and so over the closed path


@given(paths())
def test_the_muscle_never_pushes_and_stays_in_its_band(path):
    _, tension, pressure = path
    force = FRICTION.path_response(*path, side=1.0)
    band = smooth_limit(12 + (pressure - 3 * bar) / bar, tension, np)
    assert np.all(np.abs(force) <= band * (1 + 1e-9) + 1e-12)
    assert np.all(band <= tension + 1e-12)
    assert np.all(force[tension == 0] == 0)


@pytest.mark.parametrize(("elements", "off"), [(3, 0.037), (4, 0.023), (6, 0.0113), (8, 0.0068)])
def test_the_virgin_curve_is_next_to_an_exponential(elements, off):
    friction = MaxwellSlip(12.0, 0.5 * mm, elements=elements)
    path = np.linspace(0, 3e-3, 3001)
    deviation = friction.path_response(0.2 + path, FAR, 0.0) / 12 - (1 - np.exp(-2 * path / 0.5e-3))
    assert np.abs(deviation).max() == pytest.approx(off, rel=0.05)
    assert friction.shares.sum() == pytest.approx(1) and np.all(friction.stiffnesses > 0)


@pytest.mark.slow
def test_the_band_grows_with_pressure_and_ends_at_none():
    np.testing.assert_allclose(FRICTION.half_width_at(FAR, np.array([0, 3, 6]) * bar), [9, 12, 15])
    shrinking = MaxwellSlip(2.0, 1e-3, growth=-1 / bar)
    assert float(shrinking.half_width_at(100.0, 5 * bar)) < 1e-8
    assert float(FRICTION.half_width_at(0.0, 3 * bar)) == 0.0
    growing = dataclasses.replace(FRICTION, tension_growth=0.02, reference_tension=200.0)
    np.testing.assert_allclose(growing.half_width_at([100.0, 300.0], 3 * bar), [10, 14], rtol=1e-3)
    assert float(FRICTION.half_width_at(48.0, 3 * bar)) == pytest.approx(12 * np.tanh(4))


def test_viscous_friction_is_linear_until_the_muscle_would_push():
    friction = dataclasses.replace(PLAIN, viscous=3083.0)
    assert float(friction.viscous_force(0.2, 447.0, 3e5, -0.1)) == pytest.approx(-308.3)  # Reynolds et al. 2003
    rates = np.linspace(-100, 100, 41)
    for tension in (0.0, 1e-12, 3.0, 400.0):
        force = np.asarray(friction.viscous_force(0.2, tension, 3e5, rates))
        limit = tension - float(friction.half_width_at(tension, 3e5))
        np.testing.assert_allclose(force, np.clip(3083.0 * rates, -limit, limit), rtol=1e-12)
    assert float(PLAIN.viscous_force(0.2, 400.0, 3e5, 0.1)) == 0.0


@pytest.mark.slow
def test_a_lifted_mass_follows_the_three_element_model():
    """D. B. Reynolds et al., Annals of Biomedical Engineering 31 (2003): 20 kg at 300 kPa, from 10 mm at rest."""
    domain = Domain(pressure_max=7 * bar)
    law = ReynoldsLaw(f0=179.2, f1=139 / bar, k0=1427.5, k1=767.5 / bar, domain=domain)
    friction = MaxwellSlip(1e-3, 0.5e-3, viscous=1010.0, viscous_growth=691 / bar)
    muscle = Muscle(Specimen("bicycle tube", 0.25), law, friction=friction)

    def motion(_, y):
        tension = muscle.tension(y[0] / 0.25, 3 * bar)
        force = tension + friction.viscous_force(0.25 - y[0], tension, 3 * bar, -y[1])
        return [y[1], float(force) / 20.0 - 196.133 / 20.0]

    found = solve_ivp(motion, [0, 0.2], [0.01, 0.0], t_eval=[0.02, 0.05, 0.1, 0.2], rtol=1e-5, atol=1e-8).y[0]
    np.testing.assert_allclose(found, [11.10e-3, 13.27e-3, 16.26e-3, 20.42e-3], atol=2e-5)


RATES = {"viscous_growth": 40 / bar, "viscous_length_growth": 4e3, "reference_length": 0.16}


def test_damping_depends_on_pressure_and_length():
    friction = dataclasses.replace(PLAIN, viscous=100.0, reference_pressure=3 * bar, **RATES)
    for length, pressure, damping in ((0.16, 3, 100.0), (0.16, 5, 180.0), (0.17, 3, 140.0), (0.16, 0, 0.0)):
        found = float(friction.viscous_force(length, 1e6, pressure * bar, 0.01))
        assert found == pytest.approx(0.01 * damping, rel=1e-9)
        assert float(friction.steepest_damping(length, 1e6, pressure * bar)) == pytest.approx(damping)
    assert friction.follows_rate and not PLAIN.follows_rate and not NoFriction().follows_rate


def test_damping_depends_on_the_direction():
    friction = dataclasses.replace(PLAIN, viscous=300.0, viscous_asymmetry=0.5)
    force = np.asarray(friction.viscous_force(0.2, 1e6, 3 * bar, np.array([-0.1, 0.0, 0.1])))
    np.testing.assert_allclose(force, [-15.0, 0.0, 45.0], rtol=1e-12)
    assert float(friction.steepest_damping(0.2, 1e6, 3 * bar)) == pytest.approx(450.0)


def test_the_width_of_steady_motion_grows_with_the_rate_to_a_limit():
    friction = dataclasses.replace(PLAIN, rate_growth=0.5, rate_speed=0.01)
    width = float(friction.half_width_at(1e5, 3 * bar))
    rates = np.array([-1.0, -0.01, 0.0, 0.01, 1.0])
    force = np.asarray(friction.viscous_force(0.2, 1e5, 3 * bar, rates))
    np.testing.assert_allclose(force, width * 0.5 * np.array([-1, -np.tanh(1), 0, np.tanh(1), 1]), rtol=1e-6)
    slope = float(jax.grad(lambda rate: friction.viscous_force(0.2, 1e5, 3 * bar, rate))(0.0))
    assert slope == pytest.approx(float(friction.steepest_damping(0.2, 1e5, 3 * bar)), rel=1e-6)


@given(tension=st.floats(0, 500), pressure=st.floats(0, 6e5), length=st.floats(0.1, 0.2), rate=st.floats(-1, 1))
def test_rate_dependent_friction_is_dissipative_and_the_muscle_never_pushes(tension, pressure, length, rate):
    friction = dataclasses.replace(PLAIN, viscous=50.0, rate_growth=2.0, rate_speed=0.01, **RATES)
    force = float(friction.viscous_force(length, tension, pressure, rate))
    band = float(friction.half_width_at(tension, pressure))
    assert force * rate >= 0 and abs(force) + band <= tension * (1 + 1e-12) + 1e-12  # rounding of the width, some N


@pytest.mark.parametrize(("given", "missing"), [({"rate_growth": 0.5}, "rate_speed"), ({"rate_speed": 0.01}, "rate_growth"), ({"viscous_length_growth": 4e3}, "reference_length")])  # fmt: skip
def test_parameters_that_go_together_are_given_together(given, missing):
    with pytest.raises(RangeError) as refused:
        dataclasses.replace(PLAIN, **given)
    assert refused.value.field == missing
