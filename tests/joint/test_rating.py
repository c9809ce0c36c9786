"""A tension above the specimen's rating is not attainable."""

import dataclasses

import jax
import numpy as np
import pytest

from mckibben import catalog
from mckibben.units import bar, deg


@pytest.fixture(scope="module")
def printed():
    return catalog.joint("knee-table-2")


def test_the_torque_ends_where_a_tension_reaches_its_rating(printed):
    angle = -8 * deg  # muscle 2 is stretched: at 6 bar Eq. 3 gives more than its 630 N
    tension = float(printed.tensions(angle, (0.0, 6 * bar))[1])
    assert tension > 630
    arm1, arm2 = (float(arm) for arm in printed.geometry.moment_arms(angle))
    slackest = float(printed.tensions(angle, (0.0, 0.0))[0])
    _, highest = printed.attainable_torque(angle)
    assert float(highest) == pytest.approx(630 * arm2 - slackest * arm1, rel=1e-12)


def test_every_attainable_state_is_below_the_rating(printed):
    angles = np.linspace(-10, 10, 9) * deg
    lowest, highest = printed.attainable_torque(angles)
    attainable, tensions = jax.jit(printed.attainable_stiffness), jax.jit(printed.tensions)
    for angle, low, high in zip(angles, np.asarray(lowest), np.asarray(highest), strict=True):
        for torque in np.linspace(low, high, 5)[1:-1]:
            low_stiffness, high_stiffness = (float(k) for k in attainable(angle, torque))
            for part in (0.001, 0.5, 0.999):
                wanted = low_stiffness + part * (high_stiffness - low_stiffness)
                pressures = printed.pressures_for(float(angle), float(torque), wanted)
                assert max(float(t) for t in tensions(angle, pressures)) <= 630 * (1 + 1e-9)


def test_a_stronger_specimen_attains_more(printed):
    def rated(muscle, force):
        return dataclasses.replace(muscle, specimen=dataclasses.replace(muscle.specimen, rated_force=force))

    strong = dataclasses.replace(printed, muscle1=rated(printed.muscle1, 2e3), muscle2=rated(printed.muscle2, 2e3))
    assert float(strong.attainable_torque(-8 * deg)[1]) > float(printed.attainable_torque(-8 * deg)[1])
    assert float(strong.attainable_torque(0.0)[1]) == float(printed.attainable_torque(0.0)[1])  # 585 N there
