import math

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import RangeError
from mckibben.joint import KneeGeometry

arms_of = jax.jit(lambda h, r, c, angle: KneeGeometry(h, r, c).moment_arms(angle))
lengths_of = jax.jit(lambda h, r, c, angle: KneeGeometry(h, r, c).path_lengths(angle))


def test_equation_4_by_hand(as_printed):
    angle = math.radians(10)
    sine, cosine = math.sin(angle), math.cos(angle)
    first = math.sqrt((0.37 + 0.03 * sine) ** 2 + (0.03 - 0.03 * cosine) ** 2) - 0.19
    second = math.sqrt((0.37 - 0.03 * sine) ** 2 + (0.03 - 0.03 * cosine) ** 2) - 0.19
    assert [float(x) for x in as_printed.geometry.path_lengths(angle)] == pytest.approx([first, second], rel=1e-14)
    assert first > 0.18 > second  # muscle 1 lengthens as the angle grows


@pytest.mark.parametrize("degrees", [-55, -30, -5, 0, 0.01, 20, 55])
def test_equation_5_is_the_derivative_of_equation_4(as_printed, paper, degrees):
    angle = math.radians(degrees)
    got = [float(arm) for arm in as_printed.geometry.moment_arms(angle)]
    assert got == pytest.approx([float(arm) for arm in paper.eq5(angle)], rel=1e-13)


@given(
    st.floats(0.1, 1.0), st.floats(0.01, 0.3), st.floats(0.0, 0.5), st.floats(-1.5, 1.5)
)  # joint length, radius as a part of it, connectors, angle
def test_equation_5_holds_for_every_knee(length, part, connectors, angle):
    radius = part * length
    arm1, arm2 = arms_of(length, radius, connectors, angle)
    span1 = math.hypot(length + radius * math.sin(angle), radius - radius * math.cos(angle))
    span2 = math.hypot(length - radius * math.sin(angle), radius - radius * math.cos(angle))
    expected1 = radius * (length * math.cos(angle) + radius * math.sin(angle)) / span1
    expected2 = radius * (length * math.cos(angle) - radius * math.sin(angle)) / span2
    assert float(arm1) == pytest.approx(expected1, rel=1e-10, abs=1e-14)
    assert float(arm2) == pytest.approx(expected2, rel=1e-10, abs=1e-14)


@given(st.floats(-1.0, 1.0))
def test_a_knee_seen_from_behind_is_the_same_knee(angle):
    first, second = lengths_of(0.37, 0.03, 0.19, angle)
    behind1, behind2 = lengths_of(0.37, 0.03, 0.19, -angle)
    assert float(first) == pytest.approx(float(behind2), rel=1e-14)
    assert float(second) == pytest.approx(float(behind1), rel=1e-14)


def test_arrays_go_through(as_printed):
    angles = np.linspace(-0.5, 0.5, 6).reshape(2, 3)
    for pair in (lengths_of(0.37, 0.03, 0.19, angles), as_printed.geometry.moment_arms(angles)):
        assert [x.shape for x in pair] == [(2, 3), (2, 3)]


def test_longer_connectors_shorten_the_muscles_and_leave_the_arms(as_printed, knee):
    for before, after in zip(as_printed.geometry.path_lengths(0.2), knee.geometry.path_lengths(0.2), strict=True):
        assert float(before - after) == pytest.approx(0.018, rel=1e-12)
    assert as_printed.geometry.moment_arms(0.2) == knee.geometry.moment_arms(0.2)


def test_connectors_that_leave_no_muscle_are_refused_in_arrays_too():
    lengths = np.array([0.4, 0.5])
    assert KneeGeometry(lengths, 0.03, 0.36).joint_length.tolist() == [0.4, 0.5]
    with pytest.raises(RangeError):
        KneeGeometry(lengths, 0.03, 0.38)
