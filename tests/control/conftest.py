"""What the tests of controllers share: runs of setpoints, and programs that are quicker to compile."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.control import Reference, Sine
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import numeric
from mckibben.simulation import sampled
from mckibben.units import deg

PERIOD = 1e-3
SINE = Sine(10 * deg, 0.5, 0.0, np.pi / 2)  # it starts at rest


def off(answer, after=0):
    """The error of the angle [deg]."""
    record, setpoints = answer
    return (np.asarray(record.state.angle) - np.asarray(setpoints.angle))[after:] / deg


def rmse(answer, after=0):
    return float(np.sqrt(np.mean(off(answer, after) ** 2)))


@pytest.fixture(scope="session")
def follow(short_episode):
    """Follows a setpoint from rest at its start; one program for each structure of a controller."""

    def follow(seconds, plant, control, angle=SINE, stiffness=15.0, start=None):
        setpoints = sampled(Reference(angle=angle, stiffness=stiffness), seconds, PERIOD)[1]
        start = numeric(plant.equilibrium(float(setpoints.angle[0]), stiffness=start))
        plant, control = numeric((plant, control))
        return short_episode(plant, control, setpoints, start, jnp.asarray(PERIOD), 2)[1], setpoints

    return follow


@pytest.fixture(scope="session")
def barely_compiled():
    """Like `equinox.filter_jit`, in two thirds of its time; the answers are the same but for rounding."""

    def barely_compiled(function):
        program = eqx.filter_jit(function)

        def call(*args):
            with batched_program():
                return program(*args)

        return call

    return barely_compiled
