import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mckibben.actuator import FirstOrderValve, IdealValve
from mckibben.errors import RangeError
from mckibben.units import bar


def test_an_ideal_valve_is_at_its_command_at_once_and_stays():
    valve = IdealValve()
    assert float(valve.after_command(1e5, 3e5)) == float(valve.pressure_after(1e5, 3e5, 0.01)) == 3e5
    assert float(valve.command_for(1e5, 7e6)) == 1e5


def test_a_first_order_valve_moves_at_the_rate_that_its_command_is_for():
    valve, rate, moment = FirstOrderValve(0.02), -3e6, 1e-7
    moved = valve.pressure_after(2e5, valve.command_for(2e5, rate), moment)
    assert (float(moved) - 2e5) / moment == pytest.approx(rate, rel=1e-5)


@pytest.mark.parametrize("command", [0.5e5, 2.2e5, 6e5])
def test_a_limited_rate_is_the_solution_of_its_differential_equation(command):
    valve, start = FirstOrderValve(0.05, rate=20 * bar), 2e5

    def rate(_, pressure):
        return np.clip((command - pressure) / 0.05, -20e5, 20e5)

    times = np.linspace(0, 0.3, 7)
    wanted = solve_ivp(rate, (0, 0.3), [start], t_eval=times, rtol=1e-9, atol=1e-3, max_step=1e-3).y[0]
    np.testing.assert_allclose(valve.pressure_after(start, command, times), wanted, atol=1.0)


def test_no_command_exceeds_a_limited_rate():
    valve = FirstOrderValve(0.05, rate=20 * bar)
    assert [float(valve.command_for(2e5, rate)) for rate in (10e5, 30e5, -30e5)] == [2.5e5, np.inf, -np.inf]
    with pytest.raises(RangeError) as caught:
        FirstOrderValve(0.05, rate=0.0)
    assert caught.value.field == "rate"
