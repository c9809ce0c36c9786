"""What holds for every angle, pressure and target of the pre-contracted knee."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mckibben import catalog
from mckibben.joint import AntagonisticJoint, KneeGeometry

PUBLISHED = catalog.joint("knee-table-2")
KNEE = AntagonisticJoint(KneeGeometry(0.37, 0.03, 0.208), PUBLISHED.muscle1, PUBLISHED.muscle2)

both = jax.jit(KNEE.torque_and_stiffness)
tensions = jax.jit(KNEE.tensions)
affine = jax.jit(KNEE.affine_map)
invert = jax.jit(lambda angle, torque, stiffness: KNEE.affine_map(angle).pressures_for(torque, stiffness))
band = jax.jit(KNEE.attainable_stiffness)
torques = jax.jit(KNEE.attainable_torque)
closed = jax.jit(lambda angle, held, index: KNEE.closed_valve_stiffness(angle, held, polytropic_index=index))

angles = st.floats(-0.5, 0.5)
pressures = st.floats(0.0, 6e5)
parts = st.floats(0.001, 1.0)


@jax.jit
def least(angle):
    """The pressures at which the muscles are just taut."""
    contractions = KNEE.contractions(angle, (0.0, 0.0))
    return [jnp.maximum(KNEE.muscle1.pressure_for(0.0, c), 0.0) for c in contractions]


@st.composite
def taut(draw):
    """An angle, and two pressures at which both muscles pull."""
    angle = draw(angles)
    return angle, tuple(float(low) + draw(parts) * (6e5 - float(low)) for low in least(angle))


@given(taut())
def test_stiffness_is_minus_the_slope_of_the_torque(state):
    angle, (p1, p2) = state
    assert min(float(x) for x in tensions(angle, (p1, p2))) > 0
    step = 1e-6
    slope = float(both(angle + step, (p1, p2))[0] - both(angle - step, (p1, p2))[0]) / (2 * step)
    assert float(both(angle, (p1, p2))[1]) == pytest.approx(-slope, rel=1e-6, abs=1e-5)


@given(taut())
@pytest.mark.slow
def test_whatever_taut_muscles_do_lies_in_the_attainable_set(state):
    angle, (p1, p2) = state
    assert min(float(x) for x in tensions(angle, (p1, p2))) > 0
    torque, stiffness = (float(x) for x in both(angle, (p1, p2)))
    lowest, highest = (float(x) for x in torques(angle))
    assert lowest - 1e-9 <= torque <= highest + 1e-9
    low, high = (float(x) for x in band(angle, torque))
    assume(np.isfinite(low))  # at the very edge rounding decides
    assert low - 1e-6 <= stiffness <= high + 1e-6


@given(taut())
def test_taut_muscles_follow_the_affine_map_and_its_inverse(state):
    angle, (p1, p2) = state
    assert min(float(x) for x in tensions(angle, (p1, p2))) > 0
    found = affine(angle)
    torque, stiffness = both(angle, (p1, p2))
    assert float(found.torque((p1, p2))) == pytest.approx(float(torque), rel=1e-10, abs=1e-10)
    assert float(found.stiffness((p1, p2))) == pytest.approx(float(stiffness), rel=1e-10, abs=1e-10)
    back = invert(angle, torque, stiffness)
    assert [float(p) for p in back] == pytest.approx([p1, p2], rel=1e-8, abs=1e-2)


@given(angles, pressures, pressures, st.floats(1.0, 1.4))
def test_locked_air_only_ever_stiffens(angle, p1, p2, index):
    locked = closed(angle, (p1, p2), index)
    assert float(locked) >= float(both(angle, (p1, p2))[1]) - 1e-9
