"""A joint whose muscles have friction: against tiny steps in plain Python, its energy, and how it sticks."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control import Setpoint
from mckibben.muscle import MaxwellSlip
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState
from mckibben.units import bar, mm

PERIODS, PERIOD = 250, 1e-3
P1, P2 = 4e5, 3.6e5
SLIP = MaxwellSlip(12.0, 0.5 * mm, growth=0.5 / bar, reference_pressure=3 * bar, viscous=30.0, elements=3)


def with_friction(joint, slip=SLIP, **changes):
    muscle = dataclasses.replace(joint.muscle1, friction=slip)
    return dataclasses.replace(joint, muscle1=muscle, muscle2=muscle, **changes)


@pytest.fixture(scope="module")
def with_slip(ideal_plant, knee, load):
    return numeric(JointPlant(with_friction(knee), load, ideal_plant.valve))


def tiny_steps(paper, angle, velocity, seconds, damping, step=2e-5):
    """Angles each millisecond by Heun's method; each element is a stop that follows the length, and slips."""
    shares, stiffnesses = SLIP.shares, SLIP.stiffnesses.tolist()
    deflections = [[0.0] * SLIP.elements for _ in range(2)]

    def lengths(angle):
        return [paper.l0 * (1 - c) for c in paper.contractions(angle, math)]

    def moved(length, before, tension, pressure, deflection):
        width = 12 + 0.5 * (pressure - 3e5) / 1e5
        limit = width * math.tanh(tension / width)
        return [
            max(-w * limit / k, min(w * limit / k, x + length - before))
            for x, w, k in zip(deflection, shares, stiffnesses, strict=True)
        ]

    def acceleration(angle, velocity, before, pending):
        arms, eps, now = paper.eq5(angle, math), paper.contractions(angle, math), lengths(angle)
        torque, kept = 0.0, []
        for i, (sign, pressure) in enumerate(((-1, P1), (1, P2))):
            tension = max(paper.eq3(eps[i], pressure, math), 0.0)
            kept.append(moved(now[i], before[i], tension, pressure, pending[i]))
            stuck = sum(k * x for k, x in zip(stiffnesses, kept[i], strict=True))
            rate = -sign * arms[i] * velocity
            width = 12 + 0.5 * (pressure - 3e5) / 1e5
            most = tension - width * math.tanh(tension / width)  # the muscle never pushes
            viscous = max(-most, min(most, SLIP.viscous * rate))
            torque += sign * arms[i] * (tension + stuck + viscous)
        return (torque + paper.G * math.sin(math.pi / 6 - angle) - damping * velocity) / paper.inertia, kept

    angles = []
    each = round(1e-3 / step)
    for n in range(round(seconds / step)):
        if n % each == 0:
            angles.append(angle)
        before = lengths(angle)
        first, _ = acceleration(angle, velocity, before, deflections)
        ahead = angle + step * velocity, velocity + step * first
        second, deflections = acceleration(*ahead, before, deflections)
        angle, velocity = angle + step / 2 * (velocity + ahead[1]), velocity + step / 2 * (first + second)
        # the states are at the predicted length: move them to the length reached
        ahead_lengths, reached = lengths(ahead[0]), lengths(angle)
        deflections = [
            [x + r - a for x in deflection]
            for deflection, r, a in zip(deflections, reached, ahead_lengths, strict=True)
        ]
    return np.array(angles)


@pytest.mark.slow
def test_it_moves_as_in_tiny_steps_of_plain_python(with_slip, playback, short_episode, paper_precontracted):
    plant = eqx.tree_at(lambda plant: plant.load.damping, with_slip, jnp.asarray(0.02))
    start = numeric(plant.complete_state(PlantState(*map(jnp.asarray, (math.radians(12), 0.5)), (P1, P2))))
    held = Setpoint(jnp.full(PERIODS, P1), jnp.full(PERIODS, P2))
    state = short_episode(plant, playback, held, start, jnp.asarray(PERIOD), 4)[1].state
    expected = tiny_steps(paper_precontracted, math.radians(12), 0.5, 0.25, 0.02)
    assert np.ptp(expected) > math.radians(5)
    np.testing.assert_allclose(np.asarray(state.angle)[: len(expected)], expected, atol=2e-6)


def test_its_torque_is_against_the_motion_and_that_of_the_tensions(with_slip):
    joint, pressures = with_slip.joint, (P1, P2)
    states = joint.init_state(0.0, pressures)
    assert float(joint.friction_torque(0.0, 0.0, pressures, states)) == pytest.approx(0.0, abs=1e-12)
    up = float(joint.friction_torque(0.1, 0.5, pressures, states))
    down = float(joint.friction_torque(-0.1, -0.5, pressures, states))
    assert up < -0.5 and down > 0.5
    pulled = joint.forces(0.1, 0.5, pressures, states)
    arm1, arm2 = joint.geometry.moment_arms(0.1)
    assert float(pulled.torque) == pytest.approx(float(pulled.tensions[1] * arm2 - pulled.tensions[0] * arm1))
    assert float(pulled.tensions[0]) > float(joint.tensions(0.1, pressures)[0])  # muscle 1 is being stretched
    updated = joint.update_state(states, 0.1, pressures)
    again = joint.friction_torque(0.1, 0.5, pressures, updated)
    assert float(again) == pytest.approx(up, abs=1e-12)
