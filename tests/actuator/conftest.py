"""The lag of a model of a valve or tube in closed loop."""

import jax.numpy as jnp
import pytest

from mckibben.actuator.base import AirVolume
from mckibben.units import bar


@pytest.fixture
def lag_of():
    """Area between a small step of the target and the pressure over that step [s], for an asked lag [s]."""

    def measured(model, volume, lag, period):
        start, step, area = 2.5 * bar, 0.02 * bar, 0.0
        pressure, still = jnp.asarray(start), AirVolume(jnp.asarray(volume), jnp.zeros(()))
        state = model.init_model(pressure)
        for _ in range(200):
            command = model.command_toward(pressure, state, start + step, still, lag, period)
            following, state = model.predict(pressure, state, command, still, period)
            area += float(start + step - (pressure + following) / 2) * period / step
            pressure = following
        return area

    return measured
