"""The lag of a model of a valve or tube in closed loop."""

import jax
import jax.numpy as jnp
import pytest

from mckibben.actuator.base import AirVolume, Point
from mckibben.units import bar


@pytest.fixture
def lag_of():
    """Area between a small step of the target and the pressure over that step [s], for an asked lag [s]."""

    def measured(model, volume, lag, period):
        start, step, still = 2.5 * bar, 0.02 * bar, AirVolume(jnp.asarray(volume), jnp.zeros(()))

        def move(carry, _):
            pressure, state = carry
            at = Point(pressure, state, still)
            command = model.command_toward(at, start + step, lag, period)
            following, state = model.predict(at, command, period)
            return (following, state), start + step - (pressure + following) / 2

        pressure = jnp.asarray(start)
        errors = jax.jit(lambda: jax.lax.scan(move, (pressure, model.init_model(pressure)), length=200)[1])()
        return float(errors.sum()) * period / step

    return measured
