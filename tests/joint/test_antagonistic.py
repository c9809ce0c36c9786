import dataclasses
import math

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben import catalog
from mckibben.errors import DomainWarning
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import ChouLaw, MaxwellCreep, Muscle

ANGLES = np.radians(np.linspace(-30, 30, 13))
TAUT = [(4e5, 4e5), (3.5e5, 4.5e5), (5.5e5, 4.6e5)]

affine_of = jax.jit(lambda joint, angle: joint.affine_map(angle))
both_of = jax.jit(lambda joint, angle, held: joint.torque_and_stiffness(angle, held))

angles = st.floats(math.radians(-25), math.radians(25))
pressures = st.floats(2e5, 6e5)


@pytest.mark.parametrize("held", TAUT)
def test_torque_and_stiffness_are_those_of_the_papers_equations(knee, paper_precontracted, held):
    eps = paper_precontracted.contractions(ANGLES)
    np.testing.assert_allclose(knee.contractions(ANGLES, held), eps, atol=1e-14)
    taut = (paper_precontracted.eq3(eps[0], held[0]) > 0) & (paper_precontracted.eq3(eps[1], held[1]) > 0)
    assert taut.sum() >= 5
    torque, stiffness = both_of(knee, ANGLES, held)
    np.testing.assert_allclose(torque, paper_precontracted.torque(ANGLES, held), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(stiffness[taut], paper_precontracted.stiffness(ANGLES, held)[taut], rtol=1e-11)


def test_stiffness_is_minus_the_slope_of_the_torque_slack_muscles_included(knee):
    angle, step = np.radians([-28.0, -10.0, 0.0, 13.0, 28.0])[:, None], 1e-6
    held = (np.array([0.0, 1e5, 4e5]), np.array([3e5, 0.0, 4e5]))
    slope = (both_of(knee, angle + step, held)[0] - both_of(knee, angle - step, held)[0]) / (2 * step)
    np.testing.assert_allclose(both_of(knee, angle, held)[1], -slope, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("degrees", [-20, 0, 4, 20])
def test_the_affine_map_is_torque_and_stiffness_of_taut_muscles(knee, degrees):
    angle = math.radians(degrees)
    found = affine_of(knee, angle)
    for held in TAUT:
        if min(float(t) for t in knee.tensions(angle, held)) <= 0:
            continue
        torque, stiffness = (float(x) for x in both_of(knee, angle, held))
        assert float(found.torque(held)) == pytest.approx(torque, rel=1e-11, abs=1e-12)
        assert float(found.stiffness(held)) == pytest.approx(stiffness, rel=1e-11)


# Two unlike muscles, so that nothing holds by symmetry alone.
def unlike() -> AntagonisticJoint:
    knee = catalog.joint("knee-table-2")
    geometry = dataclasses.replace(knee.geometry, connector_length=0.208)
    specimen = knee.muscle1.specimen
    return AntagonisticJoint(geometry, Muscle(specimen, ChouLaw.of(specimen)), knee.muscle2)


UNLIKE = unlike()
SWAPPED = AntagonisticJoint(UNLIKE.geometry, UNLIKE.muscle2, UNLIKE.muscle1)
both = jax.jit(UNLIKE.torque_and_stiffness)
both_swapped = jax.jit(SWAPPED.torque_and_stiffness)


@given(angles, pressures, pressures)
def test_swapping_the_muscles_and_the_angles_sign_flips_the_torque_and_keeps_the_stiffness(angle, p1, p2):
    torque, stiffness = both(angle, (p1, p2))
    mirrored, same = both_swapped(-angle, (p2, p1))
    assert float(mirrored) == pytest.approx(-float(torque), rel=1e-12, abs=1e-12)
    assert float(same) == pytest.approx(float(stiffness), rel=1e-12)


@pytest.mark.parametrize("method", ["torque", "stiffness", "torque_and_stiffness", "tensions", "forces"])
def test_outside_a_muscles_domain_a_direct_call_warns_once(as_printed, method):
    asked = getattr(as_printed, method)
    given = ((0.0,) if method == "forces" else ()) + ((3e5, 7e5),)
    with pytest.warns(
        DomainWarning, match=r"^muscle 'MAS-10\S+: contraction -.* 3 bar .*; muscle 'MAS.* 7 bar"
    ) as said:
        asked(0.3, *given)
    assert len(said) == 1 and said[0].filename == __file__
    jax.jit(asked)(0.3, *given)  # traced: nothing to look at


def test_creep_follows_the_lengths_of_both_muscles(knee):
    """Each relaxes after a stretch of its own; both resist the turn."""
    muscle = dataclasses.replace(knee.muscle1, creep=MaxwellCreep(stiffness=3000.0, time_constant=8.0))
    creeping = dataclasses.replace(knee, muscle1=muscle, muscle2=muscle)
    angle, velocity, pressures, step = 0.1, 0.7, (3e5, 4e5), 1e-6
    relaxed = creeping.init_state(angle, pressures)
    states = tuple(jax.tree.map(lambda x, at=at: x + at, one) for one, at in zip(relaxed, (5.0, -3.0), strict=True))
    before, after = (creeping.geometry.path_lengths(angle + velocity * side) for side in (-step, step))
    stretching = [float(b - a) / (2 * step) for a, b in zip(before, after, strict=True)]
    rates = creeping.state_rate(states, angle, velocity, pressures)
    assert stretching[0] > 0 > stretching[1]
    for held, rate, pressure, found in zip(states, stretching, pressures, rates, strict=True):
        expected = [float(one) for one in jax.tree.leaves(muscle.state_rate(held, rate, pressure))]
        assert [float(one) for one in jax.tree.leaves(found)] == pytest.approx(expected, rel=1e-6)
        assert expected[0] * rate > 0
    turned = jax.tree.map(lambda x: x * 1e-3, rates)
    resisting = float(creeping.creep_torque(angle, pressures, turned))
    assert resisting < -1e-4
    whole = creeping.forces(angle, 0.0, pressures, turned).torque - creeping.torque(angle, pressures)
    assert resisting == pytest.approx(float(whole), rel=1e-9)
