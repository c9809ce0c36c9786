"""Calibration of robots on recordings of others: other laws, friction, masses, encoder zeros and noise."""

import dataclasses

import numpy as np
import pytest

from mckibben.calibration import JointPrior, calibrate_scenario
from mckibben.calibration.experiment import recording_of
from mckibben.calibration.models import RobotModel
from mckibben.control import Multisine, Reference, Sine, Sum
from mckibben.muscle import MaxwellSlip
from mckibben.scenario import Scenario
from mckibben.units import deg, mm
from tests.robot.test_control import TWO

pytestmark = pytest.mark.slow
SECONDS = 6.0


def foreign(robot, rng):
    """A robot whose muscles have another curvature, strength and friction, and whose bodies have other masses."""
    muscles = []
    for muscle in robot.all_muscles:
        law = dataclasses.replace(muscle.law, decay=1.2 * muscle.law.decay)
        at = 0.1, 4.4e5
        strength = float(muscle.law.force(*at) / law.force(*at)) * (1 + 0.08 * rng.standard_normal())
        friction = MaxwellSlip(8 * np.exp(0.3 * rng.standard_normal()), 0.4 * mm, elements=3)
        muscles.append(dataclasses.replace(muscle, law=law, strength=strength, friction=friction))
    bodies = [
        dataclasses.replace(body, mass=body.mass * factor, inertia=tuple(each * factor for each in body.inertia))
        for body, factor in zip(robot.bodies, 1 + 0.05 * rng.standard_normal(len(robot.bodies)), strict=True)
    ]
    return dataclasses.replace(RobotModel(robot).with_muscles(muscles).robot, bodies=tuple(bodies))


def reference(rng, amplitude, stiffness):
    """Slow and fast motion, and a slow change of the stiffness."""
    fast = Multisine((0.12 * amplitude,) * 4, tuple(rng.uniform(0.8, 3.5, 4)), tuple(rng.uniform(0, 6, 4)))
    slow = Sine(0.6 * amplitude, rng.uniform(0.15, 0.35))
    return Reference(Sum((slow, fast)), Sine(0.1 * stiffness, rng.uniform(0.1, 0.25), offset=stiffness))


def moved(scenario, plant, rng, amplitudes, stiffness):
    """Two recordings of the plant under the scenario's controller, then true angles and pressures, and zeros."""
    references = {
        name: reference(rng, amplitude, own)
        for name, amplitude, own in zip(scenario.joint_names, amplitudes, stiffness, strict=True)
    }
    run = scenario.replace(robot=plant, reference=references, duration=2 * SECONDS).run_once()
    zero = 0.5 * deg * rng.standard_normal(len(scenario.joint_names))
    whole, half = recording_of(run), run.times.size // 2
    step = 0.022 * deg
    read = dataclasses.replace(
        whole,
        angle=np.round((whole.angle + zero) / step) * step,
        pressures=whole.pressures + 4e3 * rng.standard_normal(whole.pressures.shape),
        commands=None,
    )
    first, second = (
        dataclasses.replace(read, **{name: getattr(read, name)[part] for name in ("time", "angle", "pressures")})
        for part in (slice(half), slice(half, None))
    )
    return first, second


def check(scenario, amplitudes, stiffness, seed=3):
    """The error of the torques of held-out motion is halved."""
    rng = np.random.default_rng(seed)
    plant = foreign(scenario.robot, rng)
    fitted, held_out = moved(scenario.with_fixed_model(), plant, rng, amplitudes, stiffness)
    fit = calibrate_scenario(scenario, [fitted], JointPrior(mass=0.05, inertia=0.1), held_out=[held_out])
    before, after = fit.held_out_errors
    assert after < 0.5 * before and f"{after:.2g} N*m" in fit.verdict()


def test_a_leg_with_other_muscles_is_predicted():
    check(Scenario.parse(TWO), np.array([4.0, 12.0]) * deg, (15.0, 15.0))
