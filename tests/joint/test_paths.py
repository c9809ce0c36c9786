"""Contract of all geometries: paths, moment arms, torque, stiffness, attainable set."""

import math

import numpy as np
import pytest
from numpy.polynomial import Chebyshev

from mckibben import AntagonisticJoint, Cam, KneeGeometry, PairedPaths, Pulley, TabulatedPath, TwoBonePath, catalog
from mckibben.errors import McKibbenWarning, RangeError
from mckibben.joint import Geometry
from mckibben.units import deg, mm

MUSCLE = catalog.joint("knee-table-2").muscle1
ANGLES = np.linspace(-25, 25, 11) * deg
TABLE = np.linspace(-40, 40, 17) * deg
ANCHORS = {1: (-30 * mm, 160 * mm, -35 * mm, 5 * mm), 2: (28 * mm, 162 * mm, 33 * mm, -4 * mm)}
KNEE = KneeGeometry(370 * mm, 30 * mm, 208 * mm)
CAMS = Cam(30 * mm, 162 * mm, arm_slope=8 * mm, arm_curvature=-20 * mm), Cam(28 * mm, 160 * mm, arm_slope=-5 * mm)
TABLES = tuple(TabulatedPath(TABLE, lengths=np.asarray(path)) for path in KNEE.path_lengths(TABLE))
ARMS = TabulatedPath(TABLE, arms=0.03 + 0.004 * np.cos(TABLE), rest_length=162 * mm)
GEOMETRIES: dict[str, Geometry] = {
    "knee": KNEE,
    "pulleys": PairedPaths(Pulley(30 * mm, 162 * mm), Pulley(25 * mm, 160 * mm)),
    "cams": PairedPaths(*CAMS),
    "two bones": PairedPaths(TwoBonePath(*ANCHORS[1]), TwoBonePath(*ANCHORS[2])),
    "tables": PairedPaths(*TABLES),
    "arms and a pulley": PairedPaths(ARMS, Pulley(25 * mm, 160 * mm)),
}
PRESSURES = (3.2e5, 2.4e5)


@pytest.fixture(params=GEOMETRIES)
def joint(request):
    return AntagonisticJoint(GEOMETRIES[request.param], MUSCLE, MUSCLE)


@pytest.mark.slow
def test_moment_arms_and_stiffness_are_derivatives(joint):
    step = 1e-6
    paths, arms = joint.geometry.paths_and_arms(ANGLES)
    (up1, up2), (down1, down2) = joint.geometry.path_lengths(ANGLES + step), joint.geometry.path_lengths(ANGLES - step)
    np.testing.assert_allclose(arms[0], (up1 - down1) / (2 * step), rtol=1e-7)
    np.testing.assert_allclose(arms[1], (down2 - up2) / (2 * step), rtol=1e-7)
    torque, stiffness = joint.torque_and_stiffness(ANGLES, PRESSURES)
    up, down = (joint.torque(ANGLES + sign * step, PRESSURES) for sign in (1, -1))
    np.testing.assert_allclose(stiffness, (down - up) / (2 * step), rtol=1e-6)
    np.testing.assert_allclose(torque, joint.torque(ANGLES, PRESSURES), rtol=1e-12)
    assert np.shape(paths) == (2, ANGLES.size)


@pytest.mark.parametrize("angle", [-0.4, -0.1, 0.0, 0.3])
def test_moment_arms_are_those_of_the_formula(paper, angle):
    """The series of tables are the exact curves to 1e-6 m."""
    expected = {
        "pulleys": (0.030, 0.025),
        "cams": (0.030 + 0.008 * angle - 0.010 * angle**2, 0.028 - 0.005 * angle),
        "arms and a pulley": (0.03 + 0.004 * math.cos(angle), 0.025),
        "knee": paper.eq5(angle),
        "tables": paper.eq5(angle),
    }
    for name, arms in expected.items():
        assert [float(arm) for arm in GEOMETRIES[name].moment_arms(angle)] == pytest.approx(arms, abs=1e-6)


def test_beyond_the_table_the_moment_arm_is_constant():
    series = Chebyshev.fit(TABLE, np.asarray(KNEE.path_lengths(TABLE)[0]), len(TABLES[0].coefficients) - 1)
    outside = np.array([-50.0, 50.0]) * deg
    ends = TABLE[[0, -1]]
    expected = series(ends) + series.deriv()(ends) * (outside - ends)
    np.testing.assert_allclose(TABLES[0].length(outside, 1), expected, rtol=1e-9)
    assert GEOMETRIES["tables"].angle_range == pytest.approx((-40 * deg, 40 * deg))
    assert GEOMETRIES["pulleys"].angle_range == (-math.inf, math.inf)


@pytest.mark.parametrize(
    "make",
    [
        lambda: PairedPaths(TwoBonePath(*ANCHORS[2]), TwoBonePath(*ANCHORS[1])),
        lambda: TwoBonePath(0.03, 0.0, 0.0, 0.03),
        lambda: Pulley(-30 * mm, 160 * mm),
        lambda: TabulatedPath(TABLE),
        lambda: TabulatedPath(TABLE, arms=[0.03] * 17),
        lambda: TabulatedPath(TABLE, lengths=[0.2] * 16),
        lambda: TabulatedPath(TABLE[:3], lengths=[0.2] * 3),
        lambda: PairedPaths(TABLES[0], TabulatedPath(TABLE + 2.0, arms=[0.03] * 17, rest_length=0.16)),
    ],
)
def test_what_is_no_joint_is_refused(make):
    with pytest.raises(RangeError):
        make()


def test_a_mistyped_row_of_a_table_is_found():
    lengths = np.array(KNEE.path_lengths(TABLE)[0])
    lengths[5] -= 18 * mm
    with pytest.warns(McKibbenWarning, match=f"at {TABLE[5] / deg:.4g} deg"):
        TabulatedPath(TABLE, lengths=lengths)
