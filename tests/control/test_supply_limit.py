"""A supply below the rated pressure: found from the commands, and torque kept at less co-contraction."""

import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve, PressureRegulator
from mckibben.control import (
    PID,
    DecouplingControl,
    PolePlacement,
    PositionStiffnessControl,
    Reference,
    Sine,
    SupplyLimit,
)
from mckibben.control.base import Measurement
from mckibben.muscle.air import L_PER_S_BAR
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.simulation import sampled
from mckibben.units import bar, deg

PERIOD, DURATION = 1e-3, 2.5


@pytest.fixture(scope="module")
def inner(knee):
    return PositionStiffnessControl(PID(2e5, 60e5, 0.4e5), PID(0.08e5, 5e5, 0.0), model=knee, minimum_tension=5.0)


@pytest.fixture(scope="module")
def run(short_episode, knee, load):
    """RMS error of the angle [deg] over the last second, and the record, at a stiffness that needs 4.5 bar."""
    setpoints = sampled(Reference(angle=Sine(6 * deg, 1.0), stiffness=16.5), DURATION, PERIOD)[1]

    def run(control, supply, lag=0.02):
        plant = JointPlant(knee, load, FirstOrderValve(lag, supply=supply))
        start = numeric(plant.equilibrium(0.0, stiffness=12.0))
        chosen = numeric((plant, control))
        record = short_episode(*chosen, setpoints, start, jnp.asarray(PERIOD), 2)[1]
        late = slice(-1000, None)
        error = (np.asarray(record.state.angle) - setpoints.angle)[late]
        return float(np.sqrt(np.mean(error**2))) / deg, record

    return run


def test_it_finds_the_supply_and_keeps_the_angle(run, inner):
    plain, _ = run(inner, 4.0 * bar)
    limited, record = run(SupplyLimit(inner), 4.0 * bar)
    estimate = np.asarray(record.telemetry["supply_estimate"]) / bar
    assert estimate[0] == pytest.approx(6.0, abs=0.01)  # of the law's domain
    assert estimate[-500:] == pytest.approx(4.0, abs=0.3)
    assert limited < 0.7 * plain


def test_valves_that_are_slow_are_no_lack_of_supply(run, inner):
    _, record = run(SupplyLimit(inner), 8.0 * bar, lag=0.06)
    assert np.asarray(record.telemetry["supply_estimate"]).min() > 5.9 * bar


def test_the_lag_is_that_of_the_model_of_the_valves_in_the_joint(run, inner, knee):
    """A regulator whose time constant depends on the muscles' volume limits as a first-order valve with that lag."""
    valve = PressureRegulator(0.12 * L_PER_S_BAR, 8 * bar, time_constant=8e-3)
    lag = float(valve.model_lag(knee))
    found, same = (
        run(SupplyLimit(inner, valve=one), 4.0 * bar)[1].telemetry["supply_estimate"]
        for one in (valve, FirstOrderValve(lag))
    )
    assert lag > 10e-3
    np.testing.assert_allclose(found, same, rtol=1e-9)


def test_the_delay_is_that_of_the_controller_within_another_wrapper(knee, load):
    late = DecouplingControl(knee, load, PolePlacement(30.0), command_delay=3e-3)
    for control in (late, SupplyLimit(late)):
        limited = SupplyLimit(control).with_period(PERIOD)
        state = limited.init(Measurement(jnp.asarray(0.0), (jnp.asarray(3e5),) * 2))
        assert len(state.sent) == 4
        sent = tuple((jnp.asarray(float(one)), jnp.asarray(0.0)) for one in range(4))
        assert limited._arrived(sent, PERIOD)[0] == pytest.approx(3.0)
