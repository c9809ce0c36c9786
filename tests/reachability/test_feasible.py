"""Nearest feasible references: independently checked, no larger one is feasible, changes are described."""

import dataclasses

import numpy as np
import pytest

from mckibben.actuator import FirstOrderValve
from mckibben.control import Constant, Multisine, Ramp, Reference, Samples, Sine, Step
from mckibben.errors import ParameterError, RangeError
from mckibben.plant import JointPlant
from mckibben.reachability import Preserved, check_trackability, nearest_references
from mckibben.reachability.trajectory import centre_of, scaled, slowed
from mckibben.simulation import check_reference
from mckibben.units import deg

PERIOD = 0.01
OPTIONS = {"duration": 2.0, "control_period": PERIOD}


def nearest(plant, reference, **options):
    found = nearest_references(plant, reference, **OPTIONS, **options)
    return {near.preserved: near for near in found}


@pytest.fixture(scope="module")
def printed(as_printed, load):
    return JointPlant(as_printed, load, FirstOrderValve(0.02))


@pytest.mark.slow
def test_a_trackable_reference_has_none(plant):
    assert nearest_references(plant, Reference(Sine(10 * deg, 0.5), 15.0), **OPTIONS) == ()


@pytest.mark.slow
def test_infeasible_reference_of_the_geometry_as_printed(printed):
    found = nearest(printed, Reference(Sine(20 * deg, 0.5), 72.5))
    assert set(found) == {Preserved.ANGLE, Preserved.STIFFNESS}, "no speed helps: 20 deg is outside the static range"
    angle = found[Preserved.ANGLE]
    assert isinstance(angle.reference.angle, Sine) and angle.reference.angle.frequency == 0.5
    assert angle.reference.angle.amplitude / deg == pytest.approx(0.95 * 10.37, abs=0.03), "less a margin of 5 %"
    reach = check_reference(printed, angle.reference, **OPTIONS)
    assert reach.feasible, "statically too, by an independent check"
    margin = np.minimum(reach.desired_stiffness - reach.lowest, reach.highest - reach.desired_stiffness)
    assert margin.min() > 0.02
    assert angle.stiffness_change == pytest.approx(np.abs(reach.desired_stiffness - 72.5).max(), abs=0.1)
    stiffness = found[Preserved.STIFFNESS]
    assert stiffness.reference.stiffness == Constant(72.5) and stiffness.stiffness_change == 0
    assert check_reference(printed, stiffness.reference, **OPTIONS).feasible
    larger = dataclasses.replace(stiffness.reference.angle, amplitude=20 * deg * (stiffness.amplitude + 0.02))
    assert not check_reference(printed, Reference(larger, 72.5), **OPTIONS).feasible
    assert stiffness.amplitude == pytest.approx(0.12, abs=0.01) and "stiffness unchanged" in stiffness.describe()
    assert "by up to 31" in angle.describe()


@pytest.mark.slow
def test_a_fast_reference_is_made_smaller_or_slower(plant):
    desired = Reference(Sine(20 * deg, 6.0), 15.0)
    found = nearest(plant, desired)
    smaller, slower = found[Preserved.ANGLE], found[Preserved.AMPLITUDE]
    assert 0.2 < smaller.amplitude < 0.6 and smaller.speed == 1
    assert slower.amplitude == 1 and 0.5 < slower.speed < 0.9
    assert slower.reference.angle.frequency == pytest.approx(6.0 * slower.speed)
    assert slower.times[-1] == pytest.approx(1.99 / slower.speed), "the whole path is checked"
    for near in (smaller, slower):
        options = {"duration": 2.0 / near.speed, "control_period": PERIOD / near.speed}
        assert check_trackability(plant, near.reference, **options).trackable
        assert np.abs(near.trackability.trajectory.stiffness - 15).max() == pytest.approx(
            near.stiffness_change, abs=1e-9
        )
    faster = slowed(desired.angle, min(slower.speed + 0.05, 1.0))
    assert np.isnan(check_trackability(plant, Reference(faster, 15.0), **OPTIONS).bands.rate_limited.lowest).any(), (
        "no stiffness will do"
    )


@pytest.mark.slow
def test_an_unattainable_stiffness_is_clipped_and_the_angle_preserved(plant):
    desired = Reference(Sine(10 * deg, 0.5), Step(13.0, 25.0, 1.0))
    found = nearest(plant, desired)
    assert set(found) == {Preserved.ANGLE}, "25 N*m/rad cannot be kept at any amplitude"
    near = found[Preserved.ANGLE]
    assert near.reference.angle == desired.angle and (near.amplitude, near.speed, near.shift) == (1, 1, 0)
    times = np.arange(200) * PERIOD
    stiffness = np.asarray(near.reference.stiffness(times))
    np.testing.assert_allclose(stiffness[times < 0.8], 13.0, atol=1e-6)
    reach = check_reference(plant, near.reference, **OPTIONS)
    top = reach.highest - stiffness
    late = times > 1.2
    assert reach.feasible and top[late].max() < 0.06 * (reach.highest - reach.lowest)[late].max()


@pytest.mark.slow
def test_margins_are_kept(plant):
    desired = Reference(Sine(10 * deg, 0.5), 25.0)
    margins = []
    for margin in (0.02, 0.2):
        reach = check_reference(plant, nearest(plant, desired, margin=margin)[Preserved.ANGLE].reference, **OPTIONS)
        margins.append(float(((reach.highest - reach.desired_stiffness) / (reach.highest - reach.lowest)).min()))
    assert margins == pytest.approx([0.02, 0.2], abs=0.02)
    with pytest.raises(RangeError, match=r"the margin is 0\.5"):
        nearest_references(plant, desired, margin=0.5)


@pytest.mark.slow
def test_an_infeasible_centre_is_shifted(plant):
    near = nearest(plant, Reference(Sine(5 * deg, 0.5, 50 * deg), 22.0))[Preserved.ANGLE]
    assert near.amplitude == 1
    top = (50 * deg + near.shift + 5 * deg) / deg
    assert top == pytest.approx(38.57 - 0.05 * (38.57 + 36.49) / 2, abs=0.02)
    assert f"shifted by {near.shift / deg:+.3g} deg" in near.describe()


def test_a_step_of_the_angle_is_smoothed(plant):
    near = nearest(plant, Reference(Step(-30 * deg, 30 * deg, 1.0), 22.0))[Preserved.ANGLE]
    assert near.step_smoothing == 0.25 and isinstance(near.reference.angle, Samples)
    assert "smoothed over 250 ms" in near.describe()
    moved = np.asarray(near.reference.angle(np.array([0.0, 0.8, 1.0, 1.2, 1.9]))) / deg
    np.testing.assert_allclose(moved, [-30, -30, 0, 30, 30], atol=3)  # to half a sample
    assert check_trackability(plant, near.reference, **OPTIONS).trackable


@pytest.mark.parametrize(
    ("signal", "about"),
    [
        (Constant(2.0), 2.0),
        (Step(1.0, 3.0, 0.5), 1.0),
        (Sine(1.0, 2.0, 0.5, 0.3), 0.5),
        (Multisine((1.0, 0.2), (1.0, 3.0), (), 0.2), 0.2),
        (Samples(np.array([0.0, 1.0]), np.array([0.0, 4.0])), 2.0),
    ],
    ids=lambda x: type(x).__name__,
)
def test_smaller_and_slower_signals(signal, about):
    times = np.linspace(0, 1, 21)
    assert centre_of(signal, times) == pytest.approx(about)
    small = scaled(signal, 0.25, about, 1.0, times)
    assert type(small) is type(signal)
    np.testing.assert_allclose(small(times), 1 + 0.25 * (np.asarray(signal(times)) - about), atol=1e-12)
    slow = slowed(signal, 0.5)
    if isinstance(signal, Step):
        assert slow == signal
    else:
        np.testing.assert_allclose(slow(2 * times), signal(times), atol=1e-9)


def test_a_ramp_is_slowed_by_its_duration():
    assert slowed(Ramp(0.0, 1.0, 0.2, 0.5), 0.5) == Ramp(0.0, 1.0, 0.2, 1.0)


@pytest.mark.slow
def test_a_run_of_one_period(plant):
    (near,) = nearest_references(plant, Reference(Constant(5 * deg), 40.0), duration=0.01, control_period=0.01)
    assert float(near.reference.stiffness(0.0)) < 20


def test_other_objects_cannot_be_slowed():
    class Odd(Constant):
        pass

    assert slowed(Odd(1.0), 0.5) == Odd(1.0)
    with pytest.raises(ParameterError, match="cannot be slowed"):
        slowed("text", 0.5)
