"""Creep of a muscle, against closed forms and small steps in plain Python."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.muscle import MaxwellCreep, MaxwellSlip, Muscle, MuscleState
from mckibben.muscle.creep import retained_fraction
from mckibben.units import bar, mm

CREEP = MaxwellCreep(800.0, 4.0)
DECADES = MaxwellCreep(900.0, 1.0, arms=3)
FAR = 1e9  # N: a tension that bounds nothing


def constant(_):
    """Tension over the pressure; without a share of the pressure nothing asks for it."""
    raise AssertionError


def test_a_step_relaxes_as_an_exponential():
    times = np.array([0.0, 2.0, 4.0, 40.0])
    force = CREEP.path_response([0.18, 0.19], FAR, move_time=0.0, hold_time=99.0, sample_times=times)[1]
    np.testing.assert_allclose(force, 800 * 0.01 * np.exp(-times / 4), rtol=1e-12)


def test_a_ramp_comes_to_stiffness_times_speed_times_time_constant():
    speed, time = 2e-3, 6.0
    force = CREEP.path_response([0.18, 0.18 + speed * time], FAR, move_time=time, hold_time=1.0, sample_times=[0.0])[
        1, 0
    ]
    assert force == pytest.approx(800 * speed * 4 * (1 - math.exp(-time / 4)), rel=1e-12)
    long = CREEP.path_response([0.18, 0.18 + speed * 200], FAR, move_time=200.0, hold_time=1.0, sample_times=[0.0])[
        1, 0
    ]
    assert long == pytest.approx(800 * speed * 4, rel=1e-9)
    assert retained_fraction(1e-9, 4.0) == pytest.approx(1.0) and retained_fraction(0.0, 4.0) == 1.0


def test_the_rate_in_small_steps_is_the_response_of_a_path():
    """Small steps of the rate, projected after each, end where `path_response` does exactly."""
    generator = np.random.default_rng(2)
    length = 0.2 + np.cumsum(generator.normal(0, 4e-3, 8))
    tension, steps, step = np.array([90.0, 60, 5, 0, 30, 80, 12, 70]), 400, 1e-3
    read = DECADES.path_response(length, tension, move_time=steps * step, hold_time=0.0, sample_times=[0.0])[:, 0]

    @jax.jit
    def move(relaxing, travel, start, end):
        def one(k, x):
            slope = DECADES.rate(x, travel / (steps * step), 0.0)
            moved = jax.tree.map(lambda a, b: a + step * b, x, slope)
            return DECADES.project(moved, start + (end - start) * (k + 1) / steps)

        relaxing = jax.lax.fori_loop(0, steps, one, relaxing)
        return relaxing, DECADES.force(relaxing, end, constant)

    relaxing = DECADES.initial(length[0], 0.0)
    for k in range(1, len(length)):
        relaxing, force = move(relaxing, length[k] - length[k - 1], tension[k - 1], tension[k])
        assert float(force) == pytest.approx(read[k], abs=0.02)
    assert read.min() < -1 and read.max() > 1 and read[3] == 0


@pytest.mark.slow
def test_the_muscle_never_pushes(specimen, law):
    """Law, friction with its viscous part, and creep, each as far against the force as it goes."""
    slip = MaxwellSlip(12.0, 0.5 * mm, viscous=1e5)
    muscle = Muscle(specimen, law, slip, MaxwellCreep(5000.0, 10.0))
    contraction = np.linspace(-0.03, 0.3, 67)
    anchors = (jnp.asarray(0.3),) * slip.elements
    for relaxing in ((jnp.asarray(-500.0),), (jnp.asarray(-20.0),), (jnp.asarray(500.0),)):
        state = MuscleState(anchors, relaxing)
        force = muscle.tension(contraction, 3 * bar, state)
        whole = force + muscle.viscous_force(contraction, 3 * bar, -10.0, state)
        assert np.all(np.asarray(whole) >= -1e-9)
        assert np.all(np.diff(np.asarray(force)) <= 1e-9)  # and it falls with the contraction
        assert np.all(np.asarray(whole)[np.asarray(muscle.tension(contraction, 3 * bar)) == 0] == 0)


SHARED = MaxwellCreep(800.0, 4.0, pressure_share=0.08, pressure_time_constant=2.5)


@pytest.mark.slow
def test_a_step_of_the_pressure_arrives_in_part_and_the_rest_as_an_exponential(specimen, law):
    """Closed form: the delayed pressure is y = p1 - (p1 - p0) exp(-t/tau), and the share sees the law there."""
    muscle = Muscle(specimen, law, creep=SHARED)
    first, last, contraction = 2 * bar, 4 * bar, 0.08
    before, after = (float(muscle.force(contraction, p)) for p in (first, last))
    state = muscle.init_state(contraction, first)
    assert float(muscle.force(contraction, first, state)) == pytest.approx(before, rel=1e-12)
    assert float(muscle.force(contraction, last, state)) == pytest.approx(after - 0.08 * (after - before), rel=1e-12)
    found = solve_ivp(
        lambda _, y: [float(muscle.state_rate(MuscleState((), (jnp.zeros(()), y[0])), 0.0, last).creep[1])],
        (0, 10),
        [first],
        rtol=1e-10,
        atol=1e-6,
        t_eval=[1.0, 5.0, 10.0],
    )
    expected = last - (last - first) * np.exp(-found.t / 2.5)
    np.testing.assert_allclose(found.y[0], expected, rtol=1e-8)
    for pressure in expected:
        force = muscle.force(contraction, last, MuscleState((), (jnp.zeros(()), jnp.asarray(pressure))))
        wanted = after - 0.08 * (after - float(muscle.force(contraction, pressure)))
        assert float(force) == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize("delayed", [0.0, 3 * bar, 6 * bar])
def test_delayed_pressure_neither_makes_the_muscle_push_nor_exceeds_half_of_the_tension(specimen, law, delayed):
    muscle = Muscle(specimen, law, creep=MaxwellCreep(5000.0, 1.0, pressure_share=0.5))
    contraction = np.linspace(-0.03, 0.3, 67)[:, None]
    pressure = np.linspace(0, 6, 13) * bar
    tension = np.asarray(muscle.tension(contraction, pressure))
    for arm in (-500.0, 0.0, 500.0):
        state = MuscleState((), (jnp.asarray(arm), jnp.asarray(delayed)))
        whole = np.asarray(muscle.tension(contraction, pressure, state))
        assert np.all(np.abs(whole - tension) <= tension / 2 + 1e-9)
