"""Identification from commanded pressures, of a simulated joint with known lag, delay, strengths and load."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from jax import lax

from mckibben import catalog
from mckibben.actuator import FirstOrderValve
from mckibben.calibration import JointPrior, JointRecording, calibrate_from_commands, calibrate_joint
from mckibben.calibration.experiment import calibrated_scenario
from mckibben.errors import IdentificationError
from mckibben.joint import AntagonisticJoint, GeneralLoad
from mckibben.muscle import MaxwellSlip, adjusted_law
from mckibben.numerics.batching import batched_program
from mckibben.numerics.compiled import jit
from mckibben.plant import JointPlant
from mckibben.scenario import Scenario
from mckibben.units import bar, deg, ms

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("optimized")]
PERIOD, DELAY, LAG = 10 * ms, 34 * ms, 80 * ms
STRENGTHS = (0.9, 1.12)
LOAD = GeneralLoad(inertia=0.02, greatest_gravity_torque=0.6, damping=0.05)
VALVE = FirstOrderValve(50 * ms)
FRICTION = MaxwellSlip(6.0, 0.4e-3)


def model():
    joint = catalog.joint("knee-table-2")
    geometry = dataclasses.replace(joint.geometry, connector_length=0.208)
    muscle = dataclasses.replace(joint.muscle1, friction=FRICTION)
    return AntagonisticJoint(geometry, muscle, muscle)


def commands(time, seed):
    """Steps of both pressures, one every 1.2 s."""
    levels = np.random.default_rng(seed).uniform(2.2, 4.2, (20, 2)) * bar
    return levels[np.minimum((time / 1.2).astype(int), 19)]


@jit
def moved(plant, commands, period):
    """Angles at the commands."""
    with batched_program():
        first = plant.init_state(0.0, (commands[0, 0], commands[0, 1]))
        return lax.scan(lambda s, c: (plant.follow(s, (c[0], c[1]), period, 1), s.angle), first, commands)[1]


def recorded(seed, *, seconds=12.0):
    """Angles of the true joint, computed at a fine step, at 100 Hz with noise and times that jitter."""
    joint = model()
    muscles = [
        dataclasses.replace(one, law=adjusted_law(one.law, strength=by))
        for one, by in zip((joint.muscle1, joint.muscle2), STRENGTHS, strict=True)
    ]
    joint = dataclasses.replace(joint, muscle1=muscles[0], muscle2=muscles[1])
    load, fine, every = dataclasses.replace(LOAD, inertia=0.024), 2 * ms, 5
    plant = JointPlant(joint, load, FirstOrderValve(LAG), command_delay=DELAY).with_period(fine)
    time = np.arange(0.0, seconds, fine)
    angle = np.asarray(moved(plant, commands(time, seed), fine))[::every]
    at = time[::every]
    noise = np.random.default_rng(seed).standard_normal(angle.size)
    times = at + 0.5 * ms * np.sin(np.arange(at.size))
    return JointRecording(times, angle + 0.05 * deg * noise, commands(at, seed), commanded=True)


@pytest.fixture(scope="module")
def recordings():
    return [recorded(seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def found(recordings):
    return calibrate_from_commands(model(), LOAD, VALVE, recordings[:2], JointPrior(strength=0.2, offset=0.05))


@pytest.mark.parametrize(("name", "true"), [("valve.time_constant", LAG), ("delay", DELAY)])
def test_lag_and_delay_are_within_their_intervals(found, name, true):
    one = found.quantities[name]
    assert one.determined
    assert abs(one.value - true) < 3 * one.deviation


def test_what_has_one_scale_is_told_up_to_a_factor(found):
    """Strengths, inertia and gravity grow together: their ratios are told."""
    strength1, strength2, inertia, gravity = (
        found.quantities[name] for name in ("muscle1.force", "muscle2.force", "load.inertia", "load.gravity_torque")
    )
    assert strength2.value / strength1.value == pytest.approx(STRENGTHS[1] / STRENGTHS[0], rel=0.05)
    for one, true in ((strength1, 0.9), (strength2, 1.12), (inertia, 0.024), (gravity, 0.6)):
        assert abs(one.value - true) < 3 * one.deviation


def test_a_scenario_gets_the_estimates_as_plant_and_model(found):
    example = (Path(__file__).parents[2] / "examples" / "pre-contracted-step-pid.yaml").read_text()
    plant = calibrated_scenario(Scenario.parse(example), found).plant()
    assert plant.command_delay == pytest.approx(found.quantities["delay"].value)
    assert plant.valve.time_constant == pytest.approx(found.quantities["valve.time_constant"].value)
    assert plant.sensors.encoder_offset == pytest.approx(found.quantities["zero"].value) != 0


def test_a_recording_that_was_held_out_is_simulated_better(found, recordings):
    before, after = found.errors(recordings[2])
    assert after < 0.2 * before
    assert after < 0.3 * deg
    rows = dataclasses.replace(found, held_out=(recordings[2],)).listings()[-1].rows()
    assert [row[1] for row in rows] == ["fitted", "fitted", "held out"]


@pytest.mark.parametrize(
    ("change", "unit"),
    [
        (lambda one: {"pressures": np.tile(one.pressures[0], (one.time.size, 1))}, ""),
        (lambda one: {"time": 8 * one.time}, "s"),
        (lambda one: {"time": one.time + (one.time > 5.0)}, "s"),
        (lambda one: {"angle": np.where(one.time > 5.0, np.nan, one.angle)}, ""),
        (lambda one: {"commanded": False}, ""),
    ],
)
def test_recordings_that_tell_nothing_are_refused(recordings, change, unit):
    bad = dataclasses.replace(recordings[0], **change(recordings[0]))
    with pytest.raises(IdentificationError) as caught:
        calibrate_from_commands(model(), LOAD, VALVE, [bad])
    assert caught.value.unit == unit
    assert caught.value.remedy


def test_commands_are_not_taken_for_measurements(recordings):
    with pytest.raises(IdentificationError):
        calibrate_joint(model(), LOAD, recordings)
    with pytest.raises(IdentificationError):
        calibrate_from_commands(model(), LOAD, VALVE, [])
