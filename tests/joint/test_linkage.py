"""Parts of a joint in the plane: the line of action keeps the moment arm."""

import numpy as np
import pytest

from mckibben.joint import Cam, PairedPaths, Pulley
from mckibben.joint.linkage import Linkage
from mckibben.units import mm

PULLEYS = PairedPaths(Pulley(30 * mm, 162 * mm), Pulley(25 * mm, 160 * mm))
CAMS = PairedPaths(
    Cam(30 * mm, 162 * mm, arm_slope=8 * mm, arm_curvature=4 * mm), Cam(28 * mm, 160 * mm, arm_slope=-5 * mm)
)


@pytest.mark.parametrize("geometry", [PULLEYS, CAMS], ids=["pulleys", "cams"])
def test_pulleys_have_the_moment_arms(geometry):
    for angle in (0.0, 0.25):
        for outline, arm in zip(Linkage(geometry).cams(angle), geometry.moment_arms(angle), strict=True):
            np.testing.assert_allclose(np.hypot(*outline.T), arm, rtol=1e-6)


def test_the_limb_turns_from_x_to_y():
    linkage, angle = Linkage(CAMS), 0.25
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    np.testing.assert_allclose(linkage.limb(angle, 0.2), turn @ linkage.limb(0.0, 0.2))
