"""docs/paper.md, decisions 3 and 4: what pressures within limits can hold."""

import dataclasses
import math
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.optimize import linprog

from mckibben.codegen.native import write_native
from mckibben.errors import RangeError, UnreachableError
from mckibben.joint import AntagonisticJoint, Cam, PairedPaths, SeriesSpring
from mckibben.joint.attainable import solve_static
from mckibben.units import bar, deg
from tests.muscle.test_law_contract import EXAMPLES

attainable = jax.jit(lambda joint, angle, torque: joint.attainable_stiffness(angle, torque))


def program(paper, angle, torque, limits=(0.0, 6e5), minimum_tension=0.0):
    """The same band as a linear program over both pressures in bar, from the paper's equations."""
    (d1, d2), (eps1, eps2) = paper.eq5(angle), paper.contractions(angle)
    at = lambda f: (f(0.0, 0.0), f(1e5, 0.0) - f(0.0, 0.0), f(0.0, 1e5) - f(0.0, 0.0))  # noqa: E731
    t0, t1, t2 = at(lambda p1, p2: paper.eq3(eps2, p2) * d2 - paper.eq3(eps1, p1) * d1)
    k0, k1, k2 = at(lambda p1, p2: paper.stiffness(angle, (p1, p2)))
    offsets = paper.eq3(eps1, 0.0), paper.eq3(eps2, 0.0)
    gains = paper.eq3(eps1, 1e5) - offsets[0], paper.eq3(eps2, 1e5) - offsets[1]
    found = []
    for sign in (1, -1):
        answer = linprog(
            [sign * k1, sign * k2],
            A_ub=[[-gains[0], 0], [0, -gains[1]]],
            b_ub=[offsets[0] - minimum_tension, offsets[1] - minimum_tension],
            A_eq=[[t1, t2]],
            b_eq=[torque - t0],
            bounds=[(limits[0] / 1e5, limits[1] / 1e5)] * 2,
            method="highs",
        )
        found.append(k0 + sign * answer.fun if answer.success else math.nan)
    return tuple(found)


@pytest.mark.parametrize(
    ("name", "degrees"), [("as printed", d) for d in (0, 3, 8)] + [("pre-contracted", d) for d in (-25, 0, 7, 30)]
)
@pytest.mark.parametrize("torque", [-0.7, 0.0, 0.5])
def test_the_band_is_the_optimum_of_a_linear_program(
    as_printed, knee, paper, paper_precontracted, name, degrees, torque
):
    joint, reference = {"as printed": (as_printed, paper), "pre-contracted": (knee, paper_precontracted)}[name]
    angle = math.radians(degrees)
    got = [float(x) for x in attainable(joint, angle, torque)]
    assert got == pytest.approx(program(reference, angle, torque), rel=1e-7, nan_ok=True)


def test_pressure_limits_and_a_minimum_tension_narrow_the_band_as_the_linear_program_says(knee, paper_precontracted):
    limited = jax.jit(lambda p, t: knee.attainable_stiffness(0.1, 0.3, pressure_limits=p, minimum_tension=t))
    got = [float(x) for x in limited((1e5, 4e5), 20.0)]
    expected = program(paper_precontracted, 0.1, 0.3, (1e5, 4e5), 20.0)
    assert got == pytest.approx(expected, rel=1e-7)
    wide = [float(x) for x in attainable(knee, 0.1, 0.3)]
    assert wide[0] < got[0] < got[1] < wide[1]


def test_as_printed_cocontraction_moves_the_stiffness_at_0_deg_within_70_4_and_73_5(as_printed):
    """Eq. 3 by hand, at 6 and 0 bar."""
    assert [float(x) for x in attainable(as_printed, 0.0, 0.0)] == pytest.approx([70.392, 73.464], abs=0.001)


def test_a_torque_beyond_the_range_cannot_be_held_and_one_inside_can(knee):
    low, high = (float(x) for x in knee.attainable_torque(0.1))
    assert low < 0 < high
    for torque, holdable in ((low - 1e-6, False), (low + 1e-6, True), (high - 1e-6, True), (high + 1e-6, False)):
        assert np.isfinite(attainable(knee, 0.1, torque)[0]) == holdable
    assert high == pytest.approx(float(knee.torque(0.1, (0.0, 6e5))), rel=1e-12)


@pytest.mark.parametrize("count", [2, 3])
def test_ranges_of_a_batch_of_joints_are_those_of_single_ones(knee, count):
    strengths = np.linspace(0.9, 1.1, count)
    joints = [replace(knee, muscle1=replace(knee.muscle1, strength=strength)) for strength in (strengths, *strengths)]
    batch, *single = (np.array(joint.attainable_torque(0.1)) for joint in joints)
    np.testing.assert_allclose(batch.T, single, rtol=1e-12)


@pytest.mark.parametrize(("slope1", "slope2"), [(0.1, 0.0), (0.0, 0.1), (0.1, 0.1), (0.0, 0.0)])
@pytest.mark.slow
def test_moment_arms_may_be_negative(knee, slope1, slope2):
    cams = (Cam(arm=0.02, rest_length=0.165, arm_slope=slope) for slope in (slope1, slope2))
    joint, angle = AntagonisticJoint(PairedPaths(*cams), knee.muscle1, knee.muscle2), -0.4
    arms = [float(arm) for arm in joint.geometry.moment_arms(angle)]
    assert arms == pytest.approx([0.02 - 0.4 * slope1, 0.02 - 0.4 * slope2])
    grid = np.meshgrid(np.linspace(0, 6e5, 301), np.linspace(0, 6e5, 301))
    torque = np.asarray(joint.torque(angle, tuple(grid)))
    low, high = (float(limit) for limit in joint.attainable_torque(angle))
    assert (low, high) == pytest.approx((torque.min(), torque.max()), abs=1e-9)

    middle, p1 = (low + high) / 2, np.linspace(0, 6e5, 20001)
    per_pascal = (joint.torque(angle, (p1, 6e5)) - joint.torque(angle, (p1, 5e5))) / 1e5
    p2 = 6e5 + np.asarray((middle - joint.torque(angle, (p1, 6e5))) / per_pascal)
    taut = np.min(joint.tensions(angle, (p1, p2)), axis=0) > 0
    there = (p2 >= 0) & (p2 <= 6e5) & taut
    stiffness = np.asarray(joint.evaluate(angle, (p1[there], p2[there]))[1])
    limits = [float(limit) for limit in attainable(joint, angle, middle)]
    assert limits == pytest.approx((stiffness.min(), stiffness.max()), rel=1e-3)


@pytest.mark.parametrize(("degrees", "torque", "stiffness"), [(0, -0.736, 15.0), (10, 0.2, 13.0), (-20, 0.5, 17.0)])
@pytest.mark.slow
def test_pressures_for_give_torque_and_stiffness_within_limits(knee, degrees, torque, stiffness):
    angle = math.radians(degrees)
    held = knee.pressures_for(angle, torque, stiffness)
    assert all(0 <= float(p) <= 6e5 for p in held)
    assert float(knee.torque(angle, held)) == pytest.approx(torque, abs=1e-10)
    assert float(knee.stiffness(angle, held)) == pytest.approx(stiffness, abs=1e-8)
    affine = knee.affine_map(angle)
    rows, offsets = (
        np.array([affine.torque[1:], affine.stiffness[1:]]),
        np.array([affine.torque[0], affine.stiffness[0]]),
    )
    inverse = np.linalg.solve(rows, np.array([torque, stiffness]) - offsets)
    assert [float(p) for p in held] == pytest.approx([float(p) for p in inverse], rel=1e-8)


def test_a_stiffness_out_of_reach_is_refused_with_the_range(knee):
    with pytest.raises(UnreachableError, match=r"stiffness 25 .* outside the attainable 9\.\d+\.\.20\.\d+") as caught:
        knee.pressures_for(0.0, 0.0, 25.0)
    assert caught.value.lower < caught.value.upper < 25.0


def test_a_torque_out_of_reach_is_refused_with_angle_and_torque(knee):
    with pytest.raises(UnreachableError, match=r"torque of 20 N\*m at 5\.73 deg is outside the attainable") as caught:
        knee.pressures_for(0.1, 20.0, 15.0)
    assert caught.value.upper == pytest.approx(float(knee.attainable_torque(0.1)[1]))


def test_an_angle_that_stretches_a_muscle_too_far_is_refused_with_the_contraction(as_printed):
    with pytest.raises(RangeError, match=r"contraction -3\.2 % is outside -3\.\.25 % of MAS-10-180N-AA-MC-O") as caught:
        as_printed.pressures_for(math.radians(11), -0.5, 112.0)
    assert "a longer connector_length" in caught.value.remedy


@pytest.mark.slow
def test_with_a_spring_the_pressures_found_give_what_was_asked(as_printed):
    springy = dataclasses.replace(as_printed, tendon=SeriesSpring(stiffness=2e4, preload=20.0, travel=0.02))
    held = springy.pressures_for(0.05, -0.5, 20.0)
    torque, stiffness = jax.jit(springy.torque_and_stiffness)(0.05, held)
    assert float(torque) == pytest.approx(-0.5, abs=1e-9)
    assert float(stiffness) == pytest.approx(20.0, abs=1e-6)


def test_the_torque_ends_where_a_tension_reaches_its_rating(as_printed):
    angle = -8 * deg  # muscle 2 is stretched: at 6 bar Eq. 3 gives more than its 630 N
    tension = float(as_printed.tensions(angle, (0.0, 6 * bar))[1])
    assert tension > 630
    arm1, arm2 = (float(arm) for arm in as_printed.geometry.moment_arms(angle))
    slackest = float(as_printed.tensions(angle, (0.0, 0.0))[0])
    _, highest = as_printed.attainable_torque(angle)
    assert float(highest) == pytest.approx(630 * arm2 - slackest * arm1, rel=1e-12)


@pytest.mark.slow
def test_a_scan_of_a_segment_has_no_copies_of_the_law_for_its_401_states(knee):
    """With them, the program has 2.2 million characters for a law of many terms."""
    law = EXAMPLES["SmoothLaw"]()
    joint = eqx.tree_at(lambda one: (one.muscle1.law, one.muscle2.law), knee, (law, law))

    def computed(given, _):
        angle, torque, stiffness = given
        known = solve_static(joint, angle, torque, stiffness)
        return joint.attainable_stiffness(angle, torque, amplitude=0.1 * deg), known

    assert len(write_native(computed, [np.asarray(x) for x in (0.1, 1.0, 20.0)], []).source) < 400_000
