import dataclasses
import math

import numpy as np
import pytest

from mckibben.errors import RangeError


def test_table_2_in_numbers(load):
    assert float(load.total_inertia) == pytest.approx(0.045, rel=1e-14)  # 0.02 + 0.5 0.01 + 0.5 0.04
    assert float(load.gravity_moment) == pytest.approx(1.4715, rel=1e-14)  # (0.05 + 0.1) 9.81
    assert float(load.gravity_torque(0.0)) == pytest.approx(1.4715 / 2, rel=1e-14)
    assert float(load.gravity_stiffness(0.0)) == pytest.approx(1.4715 * math.sqrt(3) / 2, rel=1e-14)
    assert float(load.gravity_stiffness(0.0)) == pytest.approx(1.27, abs=0.005)


def test_the_acceleration_is_equation_6_with_the_numbers_of_table_2(load):
    angle, velocity, torque = np.random.default_rng(0).uniform(-3, 3, (3, 50))
    acceleration = load.acceleration(angle, velocity, torque)
    # Eq. 6 with the numbers of Table 2: I = 0.045 kg*m^2, G = 1.4715 N*m.
    expected = (torque + 1.4715 * np.sin(math.pi / 6 - angle) - load.damping * velocity) / 0.045
    np.testing.assert_allclose(acceleration, expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("hanging", [True, False])
def test_a_weight_at_the_place_of_the_second_mass_is_more_of_that_mass(load, hanging):
    load = dataclasses.replace(load, hanging=hanging)
    heavier = dataclasses.replace(load, mass2=load.mass2 + 0.3)
    weighted = load.with_weight(0.3, load.distance2)
    for angle in (-0.5, 0.0, 0.4):
        assert weighted.required_torque(angle, 0.2, 3.0) == pytest.approx(heavier.required_torque(angle, 0.2, 3.0))


def test_a_load_without_any_inertia_is_refused(load):
    weightless = dataclasses.replace(load, mass1=0.0, mass2=0.0)
    assert float(weightless.total_inertia) == 0.02
    with pytest.raises(RangeError) as refused:
        dataclasses.replace(weightless, inertia=0.0)
    assert refused.value.field == "total_inertia"
