"""Parts of a joint in the plane: the line of action keeps the moment arm."""

import numpy as np
import pytest

from mckibben.joint import Cam, PairedPaths, Pulley
from mckibben.joint.mechanism import Mechanism
from mckibben.units import mm

PULLEYS = PairedPaths(Pulley(30 * mm, 162 * mm), Pulley(25 * mm, 160 * mm))
CAMS = PairedPaths(
    Cam(30 * mm, 162 * mm, arm_slope=8 * mm, arm_curvature=4 * mm), Cam(28 * mm, 160 * mm, arm_slope=-5 * mm)
)


@pytest.mark.parametrize("geometry", [PULLEYS, CAMS], ids=["pulleys", "cams"])
def test_pulleys_have_the_moment_arms(geometry):
    for angle in (0.0, 0.25):
        for outline, arm in zip(Mechanism(geometry).cams(angle), geometry.moment_arms(angle), strict=True):
            np.testing.assert_allclose(np.hypot(*outline.T), arm, rtol=1e-6)


def test_the_limb_turns_from_x_to_y():
    mechanism, angle = Mechanism(CAMS), 0.25
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
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
