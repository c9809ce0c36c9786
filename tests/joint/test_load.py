import dataclasses
import math

import numpy as np
import pytest


def test_table_2_in_numbers(load):
    assert float(load.total_inertia) == pytest.approx(0.045, rel=1e-14)  # 0.02 + 0.5 0.01 + 0.5 0.04
    assert float(load.gravity_moment) == pytest.approx(1.4715, rel=1e-14)  # (0.05 + 0.1) 9.81
    assert float(load.gravity_torque(0.0)) == pytest.approx(1.4715 / 2, rel=1e-14)
    assert float(load.gravity_stiffness(0.0)) == pytest.approx(1.4715 * math.sqrt(3) / 2, rel=1e-14)
    assert float(load.gravity_stiffness(0.0)) == pytest.approx(1.27, abs=0.005)


def test_it_hangs_stably_at_30_deg(load):
    hanging = math.pi / 6
    assert float(load.gravity_torque(hanging)) == pytest.approx(0.0, abs=1e-15)
    assert float(load.gravity_torque(hanging - 0.1)) > 0 > float(load.gravity_torque(hanging + 0.1))
    assert float(load.gravity_stiffness(hanging)) == pytest.approx(1.4715)


def test_inverted_it_is_the_same_torque_with_the_other_sign(load):
    inverted = dataclasses.replace(load, hanging=False)
    angle = np.linspace(-1, 1, 7)
    np.testing.assert_allclose(inverted.gravity_torque(angle), -load.gravity_torque(angle), rtol=1e-15)
    np.testing.assert_allclose(inverted.gravity_stiffness(angle), -load.gravity_stiffness(angle), rtol=1e-15)
    assert float(inverted.total_inertia) == float(load.total_inertia)


def test_gravity_stiffness_is_minus_the_slope_of_its_torque(load):
    angle, step = np.linspace(-1, 1, 9), 1e-6
    slope = (load.gravity_torque(angle + step) - load.gravity_torque(angle - step)) / (2 * step)
    np.testing.assert_allclose(load.gravity_stiffness(angle), -slope, rtol=1e-8)
