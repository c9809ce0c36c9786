"""External torque: timing, size and the resulting motion."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import IdealValve
from mckibben.control import Setpoint
from mckibben.joint import KneeLoad
from mckibben.numerics.batching import cast
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, TorquePulses
from mckibben.simulation import compiled_episode

PERIOD = 1e-3


@jax.jit
def _pushed(pulses, count, step):
    return pulses.torque(count * step)


def torque_over_time(pulses, periods, period=PERIOD, kind=jnp.float64):
    """The torque in each of the control periods, as the plant has it."""
    pulses, count, step = cast((numeric(pulses), jnp.arange(periods, dtype=float), jnp.asarray(period)), kind)
    torque = _pushed(pulses, count, step)
    assert torque.dtype == kind
    return np.asarray(torque)


def counted(height, width, interval, start, periods):
    """The same by whole numbers of periods."""
    expected = np.zeros(periods)
    for number, first in enumerate(range(start, periods, interval)):
        expected[first : first + width] = height * (-1) ** number
    return expected


@pytest.mark.parametrize("kind", [jnp.float64, jnp.float32], ids=["64 bits", "32 bits"])
@pytest.mark.parametrize("period", [1e-3, 0.7e-3, 1 / 300])
def test_a_pulse_lasts_so_many_periods_from_the_one_in_which_it_is_due(kind, period):
    for width, interval, start in ((100, 1000, 500), (1, 7, 0), (333, 1111, 77), (29, 30, 1)):
        pulses = TorquePulses(0.5, width * period, interval * period, start * period)
        expected = counted(0.5, width, interval, start, 60_000)
        np.testing.assert_array_equal(torque_over_time(pulses, 60_000, period, kind), expected, err_msg=str(start))


def test_between_two_periods_it_begins_with_the_next():
    np.testing.assert_array_equal(
        torque_over_time(TorquePulses(-2.0, 2e-3, 10e-3, 2.5e-3), 20), counted(-2.0, 2, 10, 3, 20)
    )


@pytest.mark.slow
def test_a_push_speeds_up_a_joint_at_rest_by_torque_over_inertia(knee, playback):
    """Slack muscles, no gravity, no damping: each step of the integration is exact."""
    load = KneeLoad(mass1=0.5, mass2=0.5, distance1=0.1, distance2=0.2, inertia=0.02, damping=0.0, gravity=0.0)
    pulses = TorquePulses(0.02, 10 * PERIOD, 40 * PERIOD, 20 * PERIOD)
    plant = JointPlant(knee, load, IdealValve(), disturbance=pulses)
    periods = 80
    slack = Setpoint(jnp.zeros(periods), jnp.zeros(periods))
    start = plant.init_state(0.0, (0.0, 0.0))
    assert [float(t) for t in knee.tensions(0.0, (0.0, 0.0))] == [0.0, 0.0]
    _, record = compiled_episode(numeric(plant), playback, slack, start, jnp.asarray(PERIOD), 1)
    jerk = counted(0.02, 10, 40, 20, periods) / 0.045
    velocity = np.concatenate([[0.0], np.cumsum(jerk)[:-1]]) * PERIOD
    angle = np.concatenate([[0.0], np.cumsum(velocity * PERIOD + jerk * PERIOD**2 / 2)[:-1]])
    np.testing.assert_allclose(record.state.velocity, velocity, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(record.state.angle, angle, rtol=1e-9, atol=1e-15)
    assert velocity[40] == pytest.approx(0.02 * 0.01 / 0.045)
    np.testing.assert_array_equal(record.state.io.disturbance, counted(0.02, 10, 40, 20, periods))
