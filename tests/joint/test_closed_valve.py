"""Stiffness with the air locked in: p V^n constant, followed independently through a small turn of the joint."""

import dataclasses
import math

import jax
import pytest
from scipy.optimize import brentq

from mckibben.joint import SeriesSpring

ATMOSPHERE = 101325.0
SPRING = SeriesSpring(stiffness=2e4, preload=60.0, travel=0.01)


closed = jax.jit(lambda joint, angle, held, index: joint.closed_valve_stiffness(angle, held, polytropic_index=index))
isobaric = jax.jit(lambda joint, angle, held: joint.stiffness(angle, held))


def volume(contraction):
    """Of the braid, from the thread's length and turns."""
    alpha, l0, d0 = math.radians(25), 0.18, 0.01
    thread, turns = l0 / math.cos(alpha), l0 * math.tan(alpha) / (math.pi * d0)
    length = l0 * (1 - contraction)
    return (thread**2 - length**2) / (4 * math.pi * turns**2) * length


def locked(pressure, before, now, index, dead):
    """The gauge pressure of air that was locked in at one contraction, at another."""
    return (pressure + ATMOSPHERE) * ((volume(before) + dead) / (volume(now) + dead)) ** index - ATMOSPHERE


def slope_of_locked_torque(paper, angle, held, index, spring=None, dead=0.0, step=2e-5):
    def contraction(path, pressure_at):
        """In a path, where the pressure depends on the contraction."""
        if spring is None:
            return 1 - path / 0.18

        def excess(x):
            c = 1 - (path - x) / 0.18
            return max(paper.eq3(c, pressure_at(c)), 0.0) - spring.preload - spring.stiffness * x

        if excess(0.0) <= 0:
            return 1 - path / 0.18
        x = spring.travel if excess(spring.travel) >= 0 else brentq(excess, 0, spring.travel, xtol=1e-16, rtol=1e-15)
        return 1 - (path - x) / 0.18

    start = [
        contraction(span - paper.connectors, lambda _, p=p: p) for span, p in zip(paper.spans(angle), held, strict=True)
    ]

    def torque(at):
        forces = []
        for span, p, before in zip(paper.spans(at), held, start, strict=True):
            pressure_at = lambda c, p=p, before=before: locked(p, before, c, index, dead)  # noqa: E731
            c = contraction(span - paper.connectors, pressure_at)
            forces.append(max(paper.eq3(c, pressure_at(c)), 0.0))
        d1, d2 = paper.eq5(at)
        return forces[1] * d2 - forces[0] * d1

    return (torque(angle + step) - torque(angle - step)) / (2 * step)


@pytest.mark.parametrize("index", [1.0, 1.4])
@pytest.mark.parametrize(("degrees", "held"), [(0, (3e5, 3e5)), (12, (4e5, 2.5e5)), (-15, (5e5, 4e5))])
def test_rigid_tendon(knee, paper_precontracted, index, degrees, held):
    angle = math.radians(degrees)
    got = float(closed(knee, angle, held, index))
    assert got == pytest.approx(-slope_of_locked_torque(paper_precontracted, angle, held, index), rel=1e-6)
    assert got > float(isobaric(knee, angle, held))


@pytest.mark.slow
def test_a_secant_over_three_degrees(knee, paper_precontracted):
    held, amplitude = (4e5, 2.5e5), math.radians(3)
    secant = jax.jit(lambda joint: joint.secant_stiffness(0.1, held, amplitude, polytropic_index=1.4, dead_volume=5e-6))
    expected = -slope_of_locked_torque(paper_precontracted, 0.1, held, 1.4, dead=5e-6, step=amplitude)
    assert float(secant(knee)) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("index", [1.0, 1.4])
@pytest.mark.parametrize(("degrees", "held"), [(2, (2e5, 2.2e5)), (6, (0.5e5, 5e5))])
@pytest.mark.slow
def test_series_spring(as_printed, paper, index, degrees, held):
    springy = dataclasses.replace(as_printed, tendon=SPRING)
    angle = math.radians(degrees)
    got = float(closed(springy, angle, held, index))
    assert got == pytest.approx(-slope_of_locked_torque(paper, angle, held, index, SPRING), rel=1e-5)
    assert got > float(isobaric(springy, angle, held))
