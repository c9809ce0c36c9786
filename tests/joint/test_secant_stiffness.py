"""Stiffness of a motion of a given size: against play operators along a path, and in its limits."""

import dataclasses

import jax
import numpy as np
import pytest

from mckibben.joint import SeriesSpring
from mckibben.muscle import MaxwellSlip
from mckibben.units import bar, deg, mm

SLIP = MaxwellSlip(7.5, 0.5 * mm, growth=0.5 / bar, reference_pressure=3 * bar)
HELD = (5.2e5, 5e5)
AMPLITUDES = np.array([0.01, 0.1, 0.3, 1.0, 3.0, 10.0]) * deg


@jax.jit
def secant(joint, angle, amplitude, index=None):
    return joint.secant_stiffness(angle, HELD, amplitude, polytropic_index=index)


isobaric = jax.jit(lambda joint, angle: joint.stiffness(angle, HELD))
closed = jax.jit(lambda joint, angle, index: joint.closed_valve_stiffness(angle, HELD, polytropic_index=index))


def with_friction(joint):
    muscle = dataclasses.replace(joint.muscle1, friction=SLIP)
    return dataclasses.replace(joint, muscle1=muscle, muscle2=muscle)


def torque_along(paper, angles):
    """By Eqs. 3, 5 and 7, and the play operators of a path in NumPy."""
    torque = paper.torque(angles, HELD)
    for sign, arm, contraction, pressure in zip(
        (-1, 1), paper.eq5(angles), paper.contractions(angles), HELD, strict=True
    ):
        tension = paper.eq3(contraction, pressure)
        torque = torque + sign * arm * SLIP.path_response(paper.l0 * (1 - contraction), tension, pressure)
    return torque


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.0, 8.0])
def test_it_is_that_between_the_reversals_of_a_slow_cycle(knee, paper_precontracted, degrees):
    found = np.asarray(secant(with_friction(knee), degrees * deg, AMPLITUDES))
    for amplitude, stiffness in zip(AMPLITUDES, found, strict=True):
        torque = torque_along(paper_precontracted, degrees * deg + amplitude * np.sin(np.linspace(0, 4 * np.pi, 4001)))
        # In a cycle, elements that yield at one reversal only move their middle: a part in a thousand.
        assert stiffness == pytest.approx((torque[3500] - torque[2500]) / (2 * amplitude), rel=1e-3)


def test_a_push_back_has_the_stiffness_of_half_its_size(knee, paper_precontracted):
    """Masing's rule: all elements yield from one side of the band to the other."""
    for push in (0.3 * deg, 2 * deg):
        turning = 8 * deg
        torque = torque_along(paper_precontracted, np.array([-5 * deg, turning, turning - push]))
        met = (torque[2] - torque[1]) / push
        assert met == pytest.approx(float(secant(with_friction(knee), turning - push / 2, push / 2)), rel=2e-3)


@pytest.mark.parametrize("index", [None, 1.0, 1.4])
@pytest.mark.slow
def test_a_small_motion_meets_friction_as_a_spring(knee, paper_precontracted, index):
    angle = 0.1
    law = float(isobaric(knee, angle) if index is None else closed(knee, angle, index))
    spring = sum(SLIP.stiffnesses.sum() * arm**2 for arm in paper_precontracted.eq5(angle))
    assert spring > 40
    assert float(secant(with_friction(knee), angle, 1e-4, index)) == pytest.approx(law + spring, rel=1e-5)
    assert float(secant(knee, angle, 1e-4, index)) == pytest.approx(law, rel=1e-5)


@pytest.mark.slow
def test_closed_valves_with_a_spring_in_series(as_printed):
    springy = dataclasses.replace(as_printed, tendon=SeriesSpring(stiffness=2e4, preload=60.0, travel=0.01))
    small = float(springy.secant_stiffness(0.05, HELD, 1e-4, polytropic_index=1.4))
    assert small == pytest.approx(float(springy.closed_valve_stiffness(0.05, HELD, polytropic_index=1.4)), rel=1e-6)
