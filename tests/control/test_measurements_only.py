"""No controller is told more than its measurements: those of one plant, played to it on another, give its commands."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.control import (
    PID,
    BackpropPID,
    Controller,
    DecouplingControl,
    ExtendedStateObserver,
    LawAdaptation,
    PositionStiffnessControl,
    Reference,
    Sine,
    SlidingMode,
)
from mckibben.control.adaptation import with_strengths
from mckibben.joint import Measurement
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant, PlantState, SampledSensors, Sensors, TorquePulses
from mckibben.simulation import compiled_episode, sampled
from mckibben.units import deg

pytestmark = pytest.mark.usefixtures("optimized")  # two programs are compared bit for bit
PERIOD, PERIODS = 1e-3, 3000
SLOW = Reference(angle=Sine(8 * deg, 0.6, 0.0, np.pi / 2), stiffness=15.0)
START = PlantState(8 * deg, 0.0, (3.6e5, 3.9e5))
SENSORS = SampledSensors(encoder=0.022 * deg, pressure_noise=4e3, delay=0.5, seed=3)
PULSES = TorquePulses(0.5, 0.1, 1.0, 0.5)


class Tape(Sensors):
    """What real sensors tell; or, played, what was told once, whatever is true."""

    inner: Sensors
    tape: Measurement
    played: bool

    def init(self, true):
        return self.inner.init(true)

    def measure(self, state, index, true):
        state, measured = self.inner.measure(state, index, true)
        played = jax.tree.map(lambda each: each[jnp.asarray(index).astype(int)], self.tape)
        return state, jax.tree.map(lambda old, new: jnp.where(self.played, old, new), played, measured)


class Reporting(Controller):
    """A controller that reports what it was told."""

    inner: Controller

    def init(self, measurement):
        return self.inner.init(measurement), measurement

    def step(self, state, setpoint, measurement, period):
        inner, commands = self.inner.step(state[0], setpoint, measurement, period)
        return (inner, measurement), commands

    def telemetry(self, state):
        inner, measurement = state
        return {**self.inner.telemetry(inner), "told": measurement}


CONTROLLERS = {
    "pid and backprop": lambda knee, load: PositionStiffnessControl(
        BackpropPID(PID(2e5, 60e5, 0.4e5), signal_scale=0.2, error_scale=0.01, output_scale=5e5, seed=2),
        PID(0.08e5, 5e5, 0.0),
        model=knee,
    ),
    "sliding, adaptive": lambda knee, load: DecouplingControl(
        knee, load, SlidingMode(40.0, 250.0), ExtendedStateObserver(200.0), adaptation=LawAdaptation()
    ),
}
"""Each of its own parts; other parts of control by inversion are played to in test_decoupling."""


@pytest.fixture(scope="module")
def run(knee, load):
    """The record of a controller on a plant with muscles, a mass, a valve and pushes of its own; a program for each."""
    setpoints = sampled(SLOW, PERIODS * PERIOD, PERIOD)[1]
    silent = Measurement(np.zeros(PERIODS), (np.zeros(PERIODS),) * 2)

    def run(control, strengths, *, mass=0.5, lag=0.02, pulses=PULSES, sensors=SENSORS, tape=None):
        told = Tape(sensors, tape or silent, np.asarray(tape is not None))
        heavy = dataclasses.replace(load, mass2=mass)
        plant = JointPlant(
            with_strengths(knee, strengths), heavy, FirstOrderValve(lag), sensors=told, disturbance=pulses
        )
        start = plant.complete_state(numeric(START))
        given = jax.tree.map(jnp.asarray, numeric((plant, Reporting(control))))
        return compiled_episode(*given, setpoints, start, jnp.asarray(PERIOD), 2)[1]

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_the_commands_follow_from_what_was_told(run, knee, load, name):
    control = CONTROLLERS[name](knee, load)
    first = run(control, (0.94, 1.05), mass=0.6, lag=0.03)
    numbers = {"mass": 0.35, "lag": 0.012, "pulses": TorquePulses(-1.0, 0.2, 0.7, 0.1)}
    again = run(control, (1.08, 0.97), **numbers, tape=first.telemetry["told"])
    for one, other in zip(jax.tree.leaves(first.telemetry), jax.tree.leaves(again.telemetry), strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(first.commands[0], again.commands[0])
    np.testing.assert_array_equal(first.commands[1], again.commands[1])
    assert np.ptp(first.commands[0]) > 5e4 and not first.limited.all()
    assert np.abs(first.state.angle - again.state.angle).max() > 1 * deg  # the other plant went its own way
