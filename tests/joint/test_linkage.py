"""Parts of a joint in the plane: the line of action keeps the moment arm."""

import numpy as np
import pytest

from mckibben.joint import Cam, PairedPaths, Pulley, Slide, SlidingMass
from mckibben.joint.linkage import Linkage, linkage_of
from mckibben.units import deg, mm

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


def test_the_muscles_of_a_slide_have_their_path_lengths_along_the_incline():
    geometry, position, along = Slide(150 * mm, 165 * mm), 6 * mm, np.array([np.cos(0.5), np.sin(0.5)])
    linkage = linkage_of(geometry, (position,), SlidingMass(mass=2.0, incline=0.5))
    for strand, length in zip(linkage.strands(position), geometry.path_lengths(position), strict=True):
        assert strand.length == pytest.approx(float(length))
        np.testing.assert_allclose(np.abs(strand.end - strand.start), strand.length * along)
    np.testing.assert_allclose(linkage.tip(position) - linkage.tip(0.0), position * along)


def test_a_muscle_that_is_none_is_not_drawn():
    linkage = linkage_of(Slide(rest_length2=165 * mm), (0.0,), SlidingMass(mass=2.0, incline=90 * deg))
    first, second = linkage.strands(0.0)
    assert first is None and second.length == pytest.approx(165 * mm)
