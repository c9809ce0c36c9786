import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.plant import FirstOrderValve, IdealValve


def test_an_ideal_valve_is_at_its_command_at_once_and_stays():
    assert float(IdealValve().switched(1e5, 3e5)) == 3e5
    assert float(IdealValve().rate(3e5, 3e5)) == 0.0
    assert float(IdealValve().rate(1e5, 3e5)) == 0.0


def test_a_first_order_valve_does_not_jump():
    assert float(FirstOrderValve(0.02).switched(1e5, 3e5)) == 1e5


def test_a_first_order_valve_has_done_63_percent_after_its_time_constant():
    valve = FirstOrderValve(0.02)
    assert float(valve.rate(1e5, 3e5)) == pytest.approx(2e5 / 0.02)
    path = solve_ivp(lambda t, p: [float(valve.rate(p[0], 3e5))], (0, 0.02), [1e5], rtol=1e-8)
    assert (path.y[0, -1] - 1e5) / 2e5 == pytest.approx(1 - math.exp(-1), rel=1e-6)


def test_valves_take_arrays():
    command, pressure = np.array([1e5, 2e5]), np.array([3e5, 3e5])
    np.testing.assert_allclose(FirstOrderValve(0.1).rate(pressure, command), [-2e6, -1e6])
    np.testing.assert_array_equal(IdealValve().switched(pressure, command), command)
