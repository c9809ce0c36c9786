"""The law corrected on line: what least squares over the whole record has, by NumPy, and what is true."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.signal import lfilter

from mckibben.control import LawAdaptation
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.units import deg

PERIOD, PERIODS = 1e-3, 4000
TIMES = PERIOD * np.arange(PERIODS)
SWING = 8 * deg * np.sin(2 * np.pi * 0.6 * TIMES), 2 * np.pi * 0.6
PRESSURE1 = 4.4e5 + 0.6e5 * np.sin(2 * np.pi * 0.9 * TIMES)
KNOWN = LawAdaptation()
HELD = LawAdaptation(mass_spread=0.15)
"""Believes the load known; and not."""


def moved(paper, strengths=(1.0, 1.0), *, heavier=0.0, still=None, pressure1=PRESSURE1, push=0.0):
    """Angles [rad] and pressures [Pa] of a joint with so strong muscles and so much more of the second mass [kg].

    Along a sine, or still at an angle. The pressure of muscle 2 is what the equation of motion asks for, by hand.
    """
    swing, speed = SWING
    angle, acceleration = (swing, -(speed**2) * swing) if still is None else (np.full(PERIODS, still), 0.0)
    velocity = np.gradient(swing, PERIOD, edge_order=2) if still is None else 0.0
    (eps1, eps2), (d1, d2) = paper.contractions(angle), paper.eq5(angle)
    inertia, moment = paper.inertia + heavier * 0.2**2, paper.G + heavier * 0.2 * 9.81
    needed = inertia * acceleration + paper.damping * velocity - moment * np.sin(np.pi / 6 - angle) - push
    force2 = (needed + strengths[0] * paper.eq3(eps1, pressure1) * d1) / d2 / strengths[1]
    offset = paper.eq3(eps2, 0.0)
    pressure2 = (force2 - offset) / ((paper.eq3(eps2, 1e5) - offset) / 1e5)
    assert force2.min() > 5 and pressure2.min() > 0 and pressure2.max() < 8e5
    return np.stack([angle, np.broadcast_to(pressure1, angle.shape), pressure2])


def noisy(record, seed):
    """As a real encoder and real pressure sensors tell it."""
    noise = np.random.default_rng(seed).normal(0.0, 4e3, (2, PERIODS))
    angle = np.round(record[0] / (0.022 * deg)) * (0.022 * deg)
    return np.stack([angle, *(record[1:] + noise)])


@pytest.fixture(scope="module")
def records(paper_precontracted):
    """By name: what is measured."""
    make = functools.partial(moved, paper_precontracted)
    true = make((0.92, 1.07))
    return {
        "as estimated": make(),
        "other muscles": true,
        "noisy": noisy(true, 1),
        "noisy, as estimated": noisy(make(), 2),
        "still": make((0.92, 1.07), still=0.1, pressure1=3.6e5),
        "nothing hangs": make((0.9, 0.9), still=np.pi / 6, pressure1=np.full(PERIODS, 1.2e5)),
        "heavier": make(heavier=0.2),
        "far off": make((0.6, 0.65), pressure1=PRESSURE1 + 0.5e5),
    }


@pytest.fixture(scope="module")
def listened(load):
    """What is estimated, over time and in the end, of many records; one program for all adaptations of a model."""

    @eqx.filter_jit
    def program(adaptations, records, model, load, period):
        def one(adaptation, record):
            def next_period(adapted, told):
                angle, *pressures = told
                adapted = adaptation.step(adapted, model, load, angle, tuple(pressures), period)
                return adapted, (*adapted.strengths, adapted.mass, adapted.friction)

            first = adaptation.init(model, load, record[0, 0], (record[1, 0], record[2, 0]))
            return lax.scan(next_period, first, tuple(record[:, 1:]))

        return jax.vmap(one)(adaptations, records)

    def listened(adaptations, records, model, kind=jnp.float64):
        together = jax.tree.map(lambda *x: np.stack(x), *map(numeric, adaptations))
        given = cast((together, np.stack(records), numeric(model), numeric(load), np.asarray(PERIOD)), kind)
        final, course = program(*given)
        return jax.tree.map(np.asarray, final), np.stack(course, axis=1)

    return listened


@pytest.fixture(scope="module")
def cases(records):
    """Each record heard with the load known and not."""
    return {(name, held): (HELD if held else KNOWN, records[name]) for name in records for held in (False, True)}


@pytest.fixture(scope="module")
def estimated(listened, cases, knee):
    """By record, and whether the load is held for uncertain: what it is in the end, and the course."""
    final, course = listened(*zip(*cases.values(), strict=True), knee)
    deviations = np.stack(final.deviations, axis=1)
    return {case: (deviations[i], course[i, :, -1], course[i]) for i, case in enumerate(cases)}


def at_once(paper, adaptation, record):
    """The deviations by one least squares over a whole record, in NumPy: the equations, and the prior as three more."""
    spread, mass_spread, error, band = (
        getattr(adaptation, name) for name in ("strength_spread", "mass_spread", "torque_error", "bandwidth")
    )
    angle, pressure1, pressure2 = record
    (eps1, eps2), (d1, d2) = paper.contractions(angle), paper.eq5(angle)
    gravity = np.sin(np.pi / 6 - angle)
    torques = paper.eq3(eps1, pressure1) * d1, paper.eq3(eps2, pressure2) * d2, gravity
    kept = np.exp(-band * PERIOD)

    def filtered(signal):
        for _ in range(3):
            rest, _ = lfilter([1 - kept], [1, -kept], signal[1:], zi=[kept * signal[0]])
            signal = np.concatenate([signal[:1], rest])
        return signal

    motion = filtered(angle)
    torque1, torque2, gravity = (filtered(each)[1:-1] for each in torques)
    velocity, acceleration = (motion[2:] - motion[:-2]) / (2 * PERIOD), np.diff(motion, 2) / PERIOD**2
    hung = mass_spread * (0.2 * 9.81 * gravity - 0.2**2 * acceleration)
    rows = np.stack([-spread * torque1, spread * torque2, hung], axis=1)
    right = paper.inertia * acceleration + paper.damping * velocity - paper.G * gravity + torque1 - torque2
    heard = np.arange(2, len(angle)) * band * PERIOD > 8
    weight = 1 / (error * np.sqrt(2 / (band * PERIOD)))
    rows, right = np.vstack([weight * rows[heard], np.eye(3)]), np.concatenate([weight * right[heard], np.zeros(3)])
    return np.linalg.lstsq(rows, right, rcond=None)[0]


def test_period_by_period_it_is_least_squares_over_the_whole_record(estimated, cases, paper_precontracted):
    found = {case: at_once(paper_precontracted, *cases[case]) for case in cases}
    for case, (deviations, _, _) in estimated.items():
        np.testing.assert_allclose(deviations, found[case], rtol=1e-6, atol=1e-8, err_msg=str(case))
    assert max(np.abs(each).max() for each in found.values()) > 1


@pytest.mark.parametrize("held", [False, True])
def test_it_finds_muscles_that_are_not_as_believed(estimated, held):
    _, (strength1, strength2, mass, _), _ = estimated["other muscles", held]
    assert (strength1, strength2) == pytest.approx((0.92, 1.07), abs=0.003)
    assert mass == pytest.approx(0.0, abs=0.002)


def test_it_takes_no_estimate_further_off_than_three_deviations(estimated):
    deviations, (*strengths, _, _), _ = estimated["far off", False]
    assert deviations.min() < -3.5
    assert strengths == pytest.approx((0.82, 0.82), rel=1e-12)


@pytest.mark.slow
def test_with_a_drift_time_it_follows_a_strength_that_drifts_and_forgets_within_the_prior(
    listened, records, knee, paper_precontracted
):
    drifting = np.linspace(1.09, 0.91, PERIODS)
    followed = [moved(paper_precontracted, (drifting, 1.0)), records["nothing hangs"]]
    forgetting = dataclasses.replace(KNOWN, drift_time=0.5)
    final, course = listened([forgetting] * 2, followed, knee)
    _, kept = listened([KNOWN] * 2, followed, knee)
    late = slice(PERIODS // 2, None)
    error, error_kept = (np.abs(each[0, 0] - drifting[1:])[late].max() for each in (course, kept))
    assert error < 0.05 and 3 * error < error_kept
    covariance = np.moveaxis(np.array(final.covariance), -1, 0)
    assert np.linalg.eigvalsh(covariance).max() <= 1 + 1e-9
    np.testing.assert_allclose(course[1, :2], 1.0, atol=1e-6)
