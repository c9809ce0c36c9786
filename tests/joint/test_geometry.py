import math

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben.errors import RangeError
from mckibben.joint import KneeGeometry

arms_of = jax.jit(lambda h, r, c, angle: KneeGeometry(h, r, c).moment_arms(angle))


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


def test_longer_connectors_shorten_the_muscles_and_leave_the_arms(as_printed, knee):
    for before, after in zip(as_printed.geometry.path_lengths(0.2), knee.geometry.path_lengths(0.2), strict=True):
        assert float(before - after) == pytest.approx(0.018, rel=1e-12)
    assert as_printed.geometry.moment_arms(0.2) == knee.geometry.moment_arms(0.2)


def test_connectors_that_leave_no_muscle_are_refused_in_arrays_too():
    lengths = np.array([0.4, 0.5])
    assert KneeGeometry(lengths, 0.03, 0.36).joint_length.tolist() == [0.4, 0.5]
    with pytest.raises(RangeError):
        KneeGeometry(lengths, 0.03, 0.38)
