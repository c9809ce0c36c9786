"""The series spring, against SciPy's root finder on the paper's Eq. 3."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.optimize import brentq

from mckibben.joint import RigidTendon, SeriesSpring

SPRING = SeriesSpring(stiffness=2e4, preload=60.0, travel=0.01)
RIGID = eqx.tree_at(lambda spring: spring.stiffness, SPRING, 1e12)  # beyond the range of its field
L0 = 0.18


@pytest.fixture(scope="module")
def muscle(as_printed):
    return as_printed.muscle1


@pytest.fixture(scope="module")
def springy(as_printed):
    return dataclasses.replace(as_printed, tendon=SPRING)


@pytest.fixture(scope="module")
def torque_and_stiffness(springy):
    return jax.jit(springy.torque_and_stiffness)


def solved(paper, path, pressure, spring=SPRING):
    """The extension at which the paper's muscle and the spring pull alike."""

    def excess(x):
        return max(paper.eq3(1 - (path - x) / L0, pressure), 0.0) - spring.preload - spring.stiffness * x

    if excess(0.0) <= 0:
        return 0.0
    return spring.travel if excess(spring.travel) >= 0 else brentq(excess, 0, spring.travel, xtol=1e-15, rtol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize(
    "spring", [SeriesSpring(1e3, 0.0, 0.1), SeriesSpring(2e3, 0.0, 0.05), SeriesSpring(1e5, 10.0, 0.01)]
)
def test_soft_and_stiff_springs_give_as_scipy_finds(spring, muscle, paper):
    rng = np.random.default_rng(0)
    path, pressure = rng.uniform(0.14, 0.19 + spring.travel / 2, 300), rng.uniform(0.0, 6e5, 300)
    expected = [1 - (p - solved(paper, p, q, spring)) / L0 for p, q in zip(path, pressure, strict=True)]
    np.testing.assert_allclose(spring.contraction(muscle, path, pressure), expected, atol=1e-12)


def test_extension_is_preload_then_proportion_then_stop():
    tensions = np.array([0.0, 60.0, 80.0, 260.0, 1000.0])
    np.testing.assert_allclose(SPRING.extension(tensions), [0.0, 0.0, 0.001, 0.01, 0.01], atol=1e-15)
    assert float(RigidTendon().extension(500.0)) == 0.0


def test_pressure_for_inverts_tension(muscle):
    paths, pressures = np.array([0.178, 0.182, 0.19]), np.array([3e5, 2e5, 4e5])
    tension = jax.jit(lambda a, b: SPRING.tension(muscle, a, b))(paths, pressures)
    np.testing.assert_allclose(SPRING.pressure_for(muscle, paths, tension), pressures, rtol=1e-9)


@pytest.mark.slow
def test_stiffness_is_minus_the_slope_of_the_torque_in_all_regimes(springy, torque_and_stiffness):
    angle = np.radians([-12.0, -4.0, 0.5, 9.0])[:, None]
    held = (np.array([0.3e5, 1.5e5, 5e5]), np.array([0.2e5, 2e5, 4e5]))
    step = 1e-7
    slope = (torque_and_stiffness(angle + step, held)[0] - torque_and_stiffness(angle - step, held)[0]) / (2 * step)
    np.testing.assert_allclose(torque_and_stiffness(angle, held)[1], -slope, rtol=2e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("stiff", [RIGID, SeriesSpring(1e4, 1e6, 0.01), SeriesSpring(1e4, 0.0, 0.0)])
def test_a_spring_that_does_not_give_is_a_rigid_tendon(as_printed, stiff):
    held = (2e5, 3e5)
    rigid = as_printed.torque_and_stiffness(0.1, held)
    got = jax.jit(lambda t: dataclasses.replace(as_printed, tendon=t).torque_and_stiffness(0.1, held))(stiff)
    np.testing.assert_allclose(got, rigid, rtol=1e-6)


def test_permitted_tensions_put_the_muscle_at_the_ends_of_its_domain(muscle):
    path = muscle.specimen.length_at(muscle.domain.contraction_max) + 0.004  # the spring is extended by 4 mm there
    highest = float(SPRING.permitted(muscle, path)[1])
    assert highest == pytest.approx(60.0 + 2e4 * 0.004)
    assert float(SPRING.extension(highest)) == pytest.approx(0.004)
    path = muscle.specimen.length_at(muscle.domain.contraction_min) + 0.003
    lowest = float(SPRING.permitted(muscle, path)[0])
    assert lowest == pytest.approx(60.0 + 2e4 * 0.003)
    assert float(SPRING.extension(lowest)) == pytest.approx(0.003)
