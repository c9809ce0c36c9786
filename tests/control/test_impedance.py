"""What a push on a joint feels: torque over angle of the closed loop, with an impedance and without."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import mckibben as mk
from mckibben.plant import Disturbance
from mckibben.units import mm

STIFFNESS = 15.0
FREQUENCIES = (0.1, 0.5, 1.0, 2.0, 2.65)  # Hz: the last is a third of the bandwidth of a valve of 20 ms


class _Push(Disturbance):
    """Sine of the torque [N*m]."""

    amplitude: float
    frequency: float

    def torque(self, time):
        return self.amplitude * jnp.sin(2 * jnp.pi * self.frequency * jnp.asarray(time))


def felt(control, amplitude):
    """|torque / angle| [N*m/rad] at each frequency, over the last two periods."""
    found = []
    for frequency in FREQUENCIES:
        push = _Push(amplitude, frequency)
        plant = mk.JointPlant(control.model, control.load, mk.FirstOrderValve(0.02), disturbance=push)
        duration = round(max(4 / frequency, 2.0), 3)
        reference = mk.Reference(angle=0.0, stiffness=STIFFNESS)
        run = mk.simulate(plant, control, reference, duration=duration, control_period=1e-3)
        late = run["time"] >= duration - 2 / frequency
        wave = np.exp(-2j * np.pi * frequency * run["time"][late])
        found.append(amplitude / abs(2 * np.mean(run["angle"][late] * wave)))
    return np.array(found)


@pytest.mark.slow
def test_a_push_feels_the_stiffness_that_is_asked_for(knee, load):
    rubbing = dataclasses.replace(knee.muscle1, friction=mk.MaxwellSlip(7.5, 0.5 * mm))
    rough = dataclasses.replace(knee, muscle1=rubbing, muscle2=rubbing)
    gains = mk.PolePlacement(60.0), mk.ExtendedStateObserver(200.0)
    smooth = mk.DecouplingControl(knee, load, *gains, impedance=True)
    compensated = mk.DecouplingControl(
        rough, load, *gains, impedance=True, friction_compensation=True, friction_in_observer=1.0
    )
    for control, amplitude in ((smooth, 0.3), (compensated, 0.3), (compensated, 0.8)):
        np.testing.assert_allclose(felt(control, amplitude), STIFFNESS, rtol=0.15)
    assert felt(dataclasses.replace(smooth, impedance=False), 0.3)[0] > 50 * STIFFNESS  # that of the position loop
    uncompensated = mk.DecouplingControl(rough, load, *gains, impedance=True)
    assert felt(uncompensated, 0.3)[0] > 2 * STIFFNESS  # that of presliding as well
