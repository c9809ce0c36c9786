"""Parts of a joint in the plane: cams turn as rigid bodies, and the line of action keeps the moment arm."""

import numpy as np
import pytest

from mckibben.joint import Cam, PairedPaths, Pulley
from mckibben.joint.mechanism import Mechanism
from mckibben.units import mm

PULLEYS = PairedPaths(Pulley(30 * mm, 162 * mm), Pulley(25 * mm, 160 * mm))
CAMS = PairedPaths(
    Cam(30 * mm, 162 * mm, arm_slope=8 * mm, arm_curvature=4 * mm), Cam(28 * mm, 160 * mm, arm_slope=-5 * mm)
)


def test_a_pulley_is_a_circle():
    for angle in (0.0, 0.3):
        outlines = Mechanism(PULLEYS).cams(angle)
        for outline, radius in zip(outlines, (30 * mm, 25 * mm), strict=True):
            np.testing.assert_allclose(np.hypot(*outline[:-1].T), radius, rtol=1e-6)
            np.testing.assert_array_equal(outline[-1], 0.0)


@pytest.mark.parametrize("geometry", [PULLEYS, CAMS], ids=["pulleys", "cams"])
def test_cams_turn_with_the_joint_from_x_to_y(geometry):
    mechanism, angle = Mechanism(geometry), 0.25
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for before, after in zip(mechanism.cams(0.0), mechanism.cams(angle), strict=True):
        np.testing.assert_allclose(after, before @ turn.T, atol=1e-6)
    np.testing.assert_allclose(mechanism.limb(angle, 0.2), turn @ mechanism.limb(0.0, 0.2))


@pytest.mark.parametrize("angle", [-0.2, 0.0, 0.3])
def test_muscles_pull_along_the_fixed_limb_at_the_distance_of_their_moment_arms(angle):
    mechanism = Mechanism(CAMS)
    arms = np.asarray(CAMS.moment_arms(angle))
    for strand, arm, side in zip(mechanism.strands(angle), arms, (-1, 1), strict=True):
        along = (strand.end - strand.start) / strand.length
        np.testing.assert_allclose(along, -mechanism.up, atol=1e-12)
        across = mechanism.up[1] * strand.end[0] - mechanism.up[0] * strand.end[1]
        assert across == pytest.approx(side * arm, rel=1e-4)


def test_straight_part_and_wrap_lengthen_as_the_path_does():
    mechanism, lengths = Mechanism(CAMS), []
    for angle in (-0.2, 0.3):
        strands = mechanism.strands(angle)
        lengths.append([one.length + np.hypot(*np.diff(one.wrap, axis=0).T).sum() for one in strands])
    change = np.array(CAMS.path_lengths(0.3)) - np.array(CAMS.path_lengths(-0.2))
    np.testing.assert_allclose(np.subtract(lengths[1], lengths[0]), change, rtol=2e-3)
