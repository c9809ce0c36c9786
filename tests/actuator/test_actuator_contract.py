# ruff: noqa: E501 - tables of cases
"""What holds for every actuator, and the second-order valve against SciPy."""

import numpy as np
import pytest
from scipy.linalg import expm

import mckibben as mk
from mckibben.actuator import SecondOrderValve, ValveGroup, ValvesByMuscle
from mckibben.paper.tables import SETTINGS, plant_of

C, SUPPLY = 5e-9, 7e5
CLOSED = [
    mk.IdealValve(),
    mk.FirstOrderValve(0.05),
    mk.FirstOrderValve(0.05, rate=1e6),
    *(SecondOrderValve(60.0, damping=damping) for damping in (0.2, 0.7, 1.0, 1.00001, 3.0)),
]
EXAMPLES = (
    mk.FirstOrderValve(0.05, rate=1e6),
    SecondOrderValve(60.0, damping=0.5),
    mk.FlowValve(C, SUPPLY),
    mk.PressureRegulator(C, SUPPLY, time_constant=0.02, reservoir_volume=1e-3, line_conductance=C),
    mk.SwitchingValves(C, SUPPLY, period=0.02),
    mk.Tube(mk.PressureRegulator(C, SUPPLY, time_constant=0.02, hysteresis=1e4, wall_conductance=0.5), volume=5e-6, conductance=2e-9),
    mk.UnequalValves(
        mk.Tube(mk.FlowValve(C, SUPPLY), volume=5e-6, conductance=2e-9), mk.FlowValve(C, SUPPLY, wall_conductance=0.5, leak=1e-12), reservoir_volume=1e-3, line_conductance=C
    ),
    ValvesByMuscle((ValveGroup(("fast",), mk.FlowValve(C, SUPPLY)), ValveGroup(("*",), mk.SwitchingValves(C, SUPPLY, period=0.02)))).for_muscles(["fast", "slow"]),
)  # fmt: skip
"""An instance of each class with fields, for the tests of all components."""
SECOND = [valve for valve in CLOSED if isinstance(valve, SecondOrderValve)]


@pytest.mark.parametrize("valve", SECOND, ids=repr)
def test_a_pressure_that_keeps_its_rate_needs_the_command(valve):
    rate, w = 1e5, valve.bandwidth
    command = float(valve.command_for(2e5, rate))
    assert w * w * (command - 2e5) - 2 * valve.damping * w * rate == pytest.approx(0.0, abs=1e-4)
    assert valve.model_lag(plant_of(SETTINGS[0]).joint) == pytest.approx(2 * valve.damping / w)


@pytest.mark.parametrize("damping", [0.2, 0.7, 0.95, 0.9999, 1.0, 1.05, 3.0])
@pytest.mark.parametrize("elapsed", [1e-4, 5e-3, 0.1])
def test_a_second_order_valve_follows_the_matrix_exponential(damping, elapsed):
    """Of its pressure above the command, and of the rate; near critical damping by a series."""
    bandwidth, error, rate = 60.0, -2e5, 3e6
    moved = expm(np.array([[0.0, 1.0], [-(bandwidth**2), -2 * damping * bandwidth]]) * elapsed) @ [error, rate]
    valve = SecondOrderValve(bandwidth, damping=damping)
    pressure, after = valve.after(4e5 + error, rate, 4e5, elapsed)
    assert float(pressure) == pytest.approx(4e5 + moved[0], rel=1e-12)
    assert float(after) == pytest.approx(moved[1], rel=1e-12, abs=1e-12 * 3e6)
