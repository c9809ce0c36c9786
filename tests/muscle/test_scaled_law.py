"""Muscles that are weaker or stronger than their law; what holds for each law is in test_law_contract."""

import dataclasses

import jax
import numpy as np
import pytest

from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import ForceCorrection, adjusted_law
from mckibben.numerics.compiled import numeric
from mckibben.units import bar


def with_strengths(joint: AntagonisticJoint, strength1, strength2) -> AntagonisticJoint:
    muscle1, muscle2 = (
        dataclasses.replace(muscle, law=adjusted_law(muscle.law, strength=strength))
        for muscle, strength in ((joint.muscle1, strength1), (joint.muscle2, strength2))
    )
    return dataclasses.replace(joint, muscle1=muscle1, muscle2=muscle2)


@pytest.mark.parametrize("strength", [0.0, -0.5, np.nan, np.inf, np.array([1.0, -1.0])])
def test_a_factor_that_makes_no_sense_is_refused(law, strength):
    with pytest.raises(RangeError, match="strength is"):
        adjusted_law(law, strength=strength)


def test_a_correction_is_constant_beyond_the_contractions_of_its_calibration():
    """A polynomial in the contraction relative to the window, (eps - 0.1)/0.05."""
    correction = ForceCorrection((-20.0, 5.0, 3.0), (1e-5, -2e-5, 0.0), 0.1, 0.05)
    for contraction, v in ((0.06, -0.8), (0.1, 0.0), (0.13, 0.6), (0.15, 1.0), (0.2, 1.0), (0.05, -1.0), (-0.02, -1.0)):
        offset, gain = correction.terms(contraction)
        assert float(offset) == pytest.approx(-20.0 + 5.0 * v + 3.0 * v**2)
        assert float(gain) == pytest.approx(1e-5 - 2e-5 * v)


def test_a_joint_of_other_muscles_has_their_torque_and_stiffness(knee, paper_precontracted):
    """By the paper's equations, each muscle's tension times its own factor."""
    angle, pressures, (s1, s2) = 0.1, (3.2 * bar, 4.1 * bar), (0.9, 1.1)
    joint = with_strengths(knee, s1, s2)
    (torque, stiffness), (by_torque, by_stiffness) = jax.jit(
        lambda joint: (joint.torque_and_stiffness(angle, pressures), joint.affine_map(angle))
    )(numeric(joint))

    def pulled(angle):
        eps, arms = paper_precontracted.contractions(angle), paper_precontracted.eq5(angle)
        force1, force2 = (paper_precontracted.eq3(e, p) for e, p in zip(eps, pressures, strict=True))
        return s2 * force2 * arms[1] - s1 * force1 * arms[0]

    assert float(torque) == pytest.approx(pulled(angle), rel=1e-12)
    slope = (pulled(angle + 1e-6) - pulled(angle - 1e-6)) / 2e-6
    assert float(stiffness) == pytest.approx(-slope, rel=1e-7)
    for (at_zero, first, second), value in ((by_torque, torque), (by_stiffness, stiffness)):
        assert at_zero + first * pressures[0] + second * pressures[1] == pytest.approx(float(value), rel=1e-12)
