"""Dry friction of the joint itself: a pendulum against closed forms, its energy, sticking, scenarios and exports."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.actuator import IdealValve
from mckibben.joint import GeneralLoad, PairedPaths, Pulley
from mckibben.muscle.friction import polygon
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointFriction, JointPlant
from mckibben.units import deg, mm

TORQUE, PRESLIDING, GRAVITY, INERTIA = 0.01, 2e-3, 0.7, 0.02  # N*m, rad, N*m, kg*m^2
PERIOD, SUBSTEPS = 1e-3, 2
FRICTION = JointFriction(TORQUE, PRESLIDING)


@pytest.fixture(scope="module")
def pendulum(knee):
    """A pendulum whose muscles are slack at all angles."""
    pulley = Pulley(10 * mm, 100 * mm)
    joint = dataclasses.replace(knee, geometry=PairedPaths(pulley, pulley))
    return JointPlant(joint, GeneralLoad(INERTIA, GRAVITY), IdealValve(), friction=FRICTION)


@pytest.fixture(scope="module")
def swing(pendulum):
    """States of a swing from an angle at rest."""

    @eqx.filter_jit
    def run(plant, angle):
        def step(state, _):
            return plant.advance(state, (0.0, 0.0), PERIOD, SUBSTEPS), state

        return lax.scan(step, plant.init_state(angle, (0.0, 0.0)), None, 8000)[1]

    return lambda angle, **changes: run(
        numeric(dataclasses.replace(pendulum, friction=dataclasses.replace(FRICTION, **changes))), jnp.asarray(angle)
    )


def test_the_loop_of_a_reversal_has_the_area_of_coulomb_friction():
    """4 tau A, less what the elements give back, w tau / k in each at both ends."""
    amplitude = 20 * deg
    angles = amplitude * np.sin(np.linspace(0, 4 * np.pi, 4001))

    def move(state, angle):
        return FRICTION.project(state, angle), FRICTION.resisting_torque(state, angle)

    torque = np.asarray(lax.scan(move, FRICTION.initial(0.0), jnp.asarray(angles))[1])
    assert np.abs(torque).max() == pytest.approx(TORQUE)
    share, stiffness = polygon(FRICTION.elements)
    travel = amplitude - share @ (share / stiffness) * PRESLIDING
    assert np.trapezoid(torque[2000:], angles[2000:]) == pytest.approx(4 * TORQUE * travel, rel=1e-4)
    assert travel == pytest.approx(amplitude, rel=0.01)


@pytest.mark.slow
def test_the_amplitude_of_a_pendulum_falls_by_the_same_in_every_cycle(swing):
    angle = np.asarray(swing(0.15).angle)
    peaks = angle[1:-1][(angle[1:-1] > angle[:-2]) & (angle[1:-1] >= angle[2:])]
    peaks = np.append(angle[0], peaks[peaks > 0.04])
    assert len(peaks) >= 2
    np.testing.assert_allclose(-np.diff(peaks), 4 * TORQUE / GRAVITY, rtol=0.04)


def test_it_sticks_within_the_friction_and_does_not_creep(swing):
    """At rest at an angle whose gravity is 80 % of the friction."""
    held = 0.8 * TORQUE / GRAVITY
    angle = np.asarray(swing(held).angle)
    assert np.abs(angle - held).max() < 2 * PRESLIDING
    end = angle[-4000:]
    assert np.ptp(end) < np.ptp(angle[:1000])
    assert abs(end[:2000].mean() - end[2000:].mean()) < 0.01 * PRESLIDING
    loose = np.asarray(swing(held, torque=1e-9).angle)
    assert loose.min() == pytest.approx(-held, rel=1e-3)
