"""Real sensors, pushes, muscles of another strength, and a law corrected on line, in scenario files."""

from pathlib import Path

import numpy as np
import pytest

from mckibben.control import ActuatorAdaptation, DecouplingControl, LawAdaptation
from mckibben.muscle import PressureAffineLaw
from mckibben.plant import SampledSensors, TorquePulses
from mckibben.scenario import Scenario, batched
from mckibben.study.tune import gain_ranges
from mckibben.units import deg, ms

BASE = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
MUSCLE = "law: lei-mas-10-180n}"
LOOPS = BASE[BASE.index("  # From the angle error") : BASE.index("reference:")]
SENSORS = "sensors: {encoder: 0.022 deg, pressure_noise: 4 kPa, delay: 0.5, seed: 7}\n"
PULSES = "disturbance: {height: 0.5 N*m, width: 100 ms, interval: 1 s, start: 250 ms}\n"
DECOUPLING = """\
  class: decoupling
  feedback: {{bandwidth: 50 rad/s}}
  adaptation: {}
  actuator_adaptation: {{}}

"""
FULL = "{strength_spread: 0.08, mass_spread: 0.1 kg, friction_spread: 0.4, torque_error: 0.03 N*m, bandwidth: 25 rad/s}"


def text(sensors=SENSORS, disturbance=PULSES, strength=0.93, adaptation=FULL):
    whole = BASE.replace("controller:\n", f"{sensors}{disturbance}controller:\n")
    if strength is not None:
        whole = whole.replace(MUSCLE, f"law: lei-mas-10-180n, strength: {strength}}}")
    return whole if adaptation is None else whole.replace(LOOPS, DECOUPLING.format(adaptation))


@pytest.fixture(scope="module")
def real():
    return Scenario.parse(text())


def test_it_builds_what_it_says(real):
    plant, control = real.plant(), real.control()
    assert plant.sensors == SampledSensors(0.022 * deg, 4e3, 0.5, 7)
    assert plant.disturbance == TorquePulses(0.5, 100 * ms, 1.0, 250 * ms)
    assert isinstance(control, DecouplingControl)
    assert control.adaptation == LawAdaptation(0.08, 0.1, 0.4, 0.03, 25.0)
    assert control.actuator_adaptation == ActuatorAdaptation()
    plain = Scenario.parse(BASE).plant().joint
    for muscle in (plant.joint.muscle1, plant.joint.muscle2, control.model.muscle1):
        assert isinstance(muscle.law, PressureAffineLaw)
        assert float(muscle.force(0.1, 3e5)) == pytest.approx(0.93 * float(plain.muscle1.force(0.1, 3e5)), rel=1e-12)


def test_the_model_keeps_its_own_strength():
    own = text(strength=None, adaptation=None).replace(
        "controller:\n",
        "controller:\n  model: {geometry: {from: knee-table-2, connector_length: 208 mm}, "
        f"muscle: {{specimen: MAS-10-180N-AA-MC-O, {MUSCLE}}}\n",
    )
    many = batched(
        Scenario.parse(own), {"joint.muscle.strength": [0.9, 1.1], "controller.model.muscle.strength": [1, 1]}
    )
    np.testing.assert_array_equal(many.plant().joint.muscle1.strength, [0.9, 1.1])
    np.testing.assert_array_equal(many.control().model.muscle1.strength, [1.0, 1.0])
    alone = batched(Scenario.parse(own), {"joint.muscle.strength": [0.9, 1.1]})
    assert alone.control().model.muscle1.strength is None


def test_what_an_adaptation_takes_for_true_is_no_gain(real):
    assert not [name for name in gain_ranges(real) if ".adaptation." in name]
