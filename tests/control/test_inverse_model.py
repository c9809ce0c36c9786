"""Feedforward of an inverse model in parallel with two loops."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.control import PID, InverseModelControl, PositionStiffnessControl, Sine
from mckibben.control.reference import ReferenceDerivatives
from mckibben.numerics.compiled import numeric
from mckibben.plant import JointPlant
from mckibben.units import deg
from tests.control.conftest import PERIOD, off

SINE = Sine(8 * deg, 1.0, 0.0, np.pi / 2)  # it starts at rest


@pytest.fixture(scope="module")
def control(knee, load):
    loops = PositionStiffnessControl(PID(3e5, 4e6, 5e4), PID(3e4, 1.1e6, 0.0), model=knee, minimum_tension=5.0)
    return InverseModelControl(loops, load)


@pytest.fixture(scope="module")
def run(follow):
    def run(plant, control, angle=SINE, stiffness=15.0, start=15.0):
        return follow(3.0, plant, control, angle, stiffness, start)

    return run


@pytest.mark.slow
def test_soft_loops_with_a_model_follow_a_sine_better(run, plant, control):
    with_model, alone = (np.sqrt(np.mean(off(run(plant, each)) ** 2)) for each in (control, control.loops))
    assert with_model < 0.1 * alone


def test_it_takes_over_the_pressures_as_they_are(run, plant, load, control):
    """Also where the model would have others: a plant at rest stays so."""
    laws = [muscle.law for muscle in (plant.joint.muscle1, plant.joint.muscle2)]
    names = ("a1", "a2", "b1", "b2", "c1", "c2")
    joint = eqx.tree_at(
        lambda j: [getattr(m.law, name) for m in (j.muscle1, j.muscle2) for name in names],
        plant.joint,
        [getattr(law, name) * scale for law, scale in zip(laws, (0.92, 1.08), strict=True) for name in names],
    )
    wrong = JointPlant(joint, numeric(dataclasses.replace(load, mass2=0.75)), FirstOrderValve(np.asarray(0.02)))
    rest = run(wrong, control, 0.1, 15.0)[0]
    record, _ = run(wrong, control, 0.1, float(rest.telemetry["stiffness_estimate"][0]))
    for command, pressure in zip((record.commands[0], record.commands[1]), rest.state.pressures, strict=True):
        np.testing.assert_allclose(command, float(pressure[0]), rtol=1e-6)


def test_the_inverse_is_that_of_the_reference_after_the_lag_of_the_valves(control):
    """Of a reference with constant acceleration, exactly."""
    lag, acceleration = 0.03, 1.5
    control = dataclasses.replace(control, valve=FirstOrderValve(lag))
    reference = jax.tree.map(jnp.asarray, ReferenceDerivatives(0.1, 0.2, acceleration, 0.0, 3.0))
    ahead = control._preview(reference, jnp.asarray(15.0), PERIOD)
    assert float(ahead.angle) == pytest.approx(0.1 + 0.2 * lag + acceleration * lag**2 / 2, rel=1e-12)
    assert float(ahead.velocity) == pytest.approx(0.2 + acceleration * lag, rel=1e-12)
    assert float(ahead.acceleration) == pytest.approx(acceleration, rel=1e-12)
