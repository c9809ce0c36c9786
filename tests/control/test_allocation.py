"""Pressures for torque and stiffness, against brute force."""

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control.allocation import linearise, pressure_range, prioritise_differential, prioritise_torque
from mckibben.joint import AffineMap, SeriesSpring, TorqueStiffnessMap

torque_and_stiffness = jax.jit(lambda joint, angle, pressures: joint.torque_and_stiffness(angle, pressures))


@pytest.fixture(scope="module")
def setpoints():
    """Angles, torques, stiffnesses and windows of pressure, many of them out of reach."""
    rng = np.random.default_rng(2)
    lower = rng.uniform(3e5, 4e5, (2, 300))  # taut: of slack muscles the map says nothing
    return rng.uniform(-0.15, 0.15, 300), rng.uniform(-5, 5, 300), rng.uniform(9, 20, 300), lower, lower + 2e5


@pytest.fixture(scope="module")
def answers(knee, setpoints):
    def one(angle, torque, stiffness, lower, upper):
        return prioritise_torque(knee.affine_map(angle), torque, stiffness, (lower[0], lower[1]), (upper[0], upper[1]))

    return jax.jit(jax.vmap(one, in_axes=(0, 0, 0, 1, 1)))(*map(jnp.asarray, setpoints))


@pytest.mark.slow
def test_no_pressure_within_the_window_does_better(knee, setpoints, answers):
    angle, torque, stiffness, lower, _ = setpoints
    grid = lower[:, None, None, :] + 2e5 * np.stack(np.meshgrid(*[np.linspace(0, 1, 41)] * 2))[..., None]
    torques, stiffnesses = (np.asarray(x) for x in torque_and_stiffness(knee, angle, (grid[0], grid[1])))
    got, got_stiffness = (np.asarray(x) for x in torque_and_stiffness(knee, angle, answers.pressures))
    np.testing.assert_allclose(got, answers.torque, atol=1e-9)
    off = np.abs(torques - torque)
    assert np.all(np.abs(got - torque) <= off.min((0, 1)) + 1e-9)
    as_near = off <= np.abs(got - torque) + 1e-3  # along the same torque no other stiffness is nearer
    missed = np.where(as_near, np.abs(stiffnesses - stiffness), np.inf).min((0, 1))
    assert np.all(np.abs(got_stiffness - stiffness) <= missed + 0.01)
    assert np.isfinite(missed).sum() > 50


@pytest.mark.slow
def test_it_stays_within_the_window_and_says_when_it_had_to(knee, setpoints, answers):
    angle, torque, stiffness, lower, upper = setpoints
    pressures = np.asarray(answers.pressures)
    assert np.min(np.asarray(knee.tensions(angle, tuple(lower)))) > 0
    assert np.all((pressures >= lower - 1e-6) & (pressures <= upper + 1e-6))
    got = np.asarray(torque_and_stiffness(knee, angle, answers.pressures))
    met = np.all(np.abs(got - [torque, stiffness]) < 1e-6, axis=0)
    np.testing.assert_array_equal(met, ~np.asarray(answers.saturated))
    assert 20 < met.sum() < 280


@pytest.mark.slow
def test_where_no_pressure_moves_the_stiffness_the_torque_is_had_all_the_same(knee):
    flat = knee.affine_map(0.1)
    flat = flat._replace(stiffness=flat.stiffness._replace(slope1=jnp.asarray(0.0), slope2=jnp.asarray(0.0)))
    pressures, torque, _ = prioritise_torque(flat, 1.0, 15.0, (1e5, 0.2e5), (3e5, 5e5))
    assert float(flat.torque(pressures)) == pytest.approx(1.0, abs=1e-9) == float(torque)
    assert float(pressures[0]) == pytest.approx(2e5)  # the middle of its limits, if the other pressure allows it


def test_with_a_return_spring_the_muscle_alone_gives_the_torque_within_its_limits():
    planes = TorqueStiffnessMap(AffineMap(0.5, -2e-5, 3e-5), AffineMap(10.0, 1e-5, 3e-5))
    for springs, pressure in (((True, False), (2.0 - 0.5) / 3e-5), ((False, True), (-2.0 - 0.5) / -2e-5)):
        muscle, torque = springs.index(False), 2.0 if springs[0] else -2.0
        found = prioritise_torque(planes, torque, 15.0, (0.0, 0.0), (3e5, 3e5), springs)
        assert float(found.pressures[muscle]) == pytest.approx(pressure)
        assert (float(found.torque), bool(found.saturated)) == (pytest.approx(torque), False)
        beyond = prioritise_torque(planes, 20 * torque, 15.0, (0.0, 0.0), (3e5, 3e5), springs)
        assert float(beyond.pressures[muscle]) == 3e5 and bool(beyond.saturated)
        assert float(beyond.torque) == pytest.approx(0.5 + (-6.0, 9.0)[muscle])


def test_a_differential_pressure_comes_before_the_cocontraction():
    """Against all pairs of pressures on a grid, in windows that differ."""
    lower, upper, grid = (1e5, 0.5e5), (4e5, 6e5), np.linspace(0.5e5, 6e5, 111)
    first, second = np.meshgrid(grid, grid)
    inside = (first >= lower[0]) & (first <= upper[0]) & (second >= lower[1])
    for differential, cocontraction in itertools.product((-2.5e5, -1e5, 0.0, 1e5, 2.5e5, 4e5), (0.5e5, 3e5, 6e5)):
        found, saturated = prioritise_differential(differential, cocontraction, lower, upper)
        miss = np.where(inside, np.abs((second - first) / 2 - differential), np.inf)
        nearest = miss <= miss.min() + 1.0
        off = np.where(nearest, np.abs((first + second) / 2 - cocontraction), np.inf)
        one, other = (float(x) for x in found)
        assert abs((other - one) / 2 - differential) == pytest.approx(miss.min(), abs=1.0)
        assert abs((one + other) / 2 - cocontraction) == pytest.approx(off.min(), abs=2.6e3)  # half a step of the grid
        assert bool(saturated) == (miss.min() > 1.0 or off.min() > 2.6e3)


@pytest.mark.slow
def test_the_map_of_other_joints_is_that_of_small_changes(as_printed):
    springy = dataclasses.replace(as_printed, tendon=SeriesSpring(2e4, 20.0, 0.02))
    pressures = (jnp.asarray(1.5e5), jnp.asarray(2e5))
    nearby = (jnp.asarray(1.54e5), jnp.asarray(2.03e5))
    found = jax.jit(lambda joint: linearise(joint, 0.05, pressures))(springy)
    exact = [torque_and_stiffness(springy, 0.05, p) for p in (pressures, nearby)]
    for here, there, affine in zip(*exact, found, strict=True):
        assert float(affine(pressures)) == pytest.approx(float(here), rel=1e-12)
        assert float(affine(nearby)) == pytest.approx(float(there), abs=0.03 * abs(float(there - here)))


@pytest.mark.slow
def test_pressures_keep_a_tension_and_the_rating(as_printed, knee):
    lowest, highest = pressure_range(knee, 0.2, 20.0)
    slackest, tightest = knee.tensions(0.2, lowest), knee.tensions(0.2, highest)
    assert float(slackest[0]) >= 20.0 - 1e-9 and float(slackest[1]) == pytest.approx(20.0)
    assert float(highest[0]) == float(highest[1]) == 6e5  # the domain of the law
    rated = as_printed.muscle1.specimen.rated_force
    stretched = pressure_range(as_printed, 0.17, 20.0)[1]
    assert max(map(float, as_printed.tensions(0.17, stretched))) == pytest.approx(rated)
    assert float(tightest[0]) < rated
