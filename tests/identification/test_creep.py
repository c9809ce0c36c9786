"""Creep after steps of the pressure: found with its interval, absent where there is none, and wrong forms noticed."""

import numpy as np
import pytest
from scipy.signal import lfilter

from mckibben.dataset import Recording
from mckibben.errors import IdentificationError
from mckibben.identification import identify_pressure_creep
from mckibben.muscle import MaxwellCreep, NoCreep

STEP = 0.04  # s
LEVELS = 1e5 * np.array([1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1])


def eq3(contraction, pressure):
    """Force [N] of the paper's law, written out."""
    p, eps = pressure / 1e5, contraction * 100
    return (-245.8 + 109 * p) + (3.216 - 3.442 * p) * eps + (255.6 - 13.18 * p) * np.exp(-0.3 * eps)


def delayed(pressure, time_constant):
    """Pressure behind a first-order lag, exact for one that is piecewise linear."""
    ratio = STEP / time_constant
    decay, part = np.exp(-ratio), -np.expm1(-ratio) / ratio
    return pressure - lfilter([1.0], [1.0, -decay], part * np.diff(pressure, prepend=pressure[0]))


def recordings_at(contractions=(0.0, 0.04), shares=((0.06, 4.0),), *, gain=None, seed=0, levels=LEVELS, noise=0.4):
    """Recordings of steps through a valve with a lag of 80 ms, with friction of 5 N, at each contraction."""
    random, found = np.random.default_rng(seed), []
    for contraction in contractions:
        stepped = np.repeat(levels, int(8 / STEP))
        pressure = delayed(stepped, 0.08)
        force = eq3(contraction, pressure)
        for share, time_constant in shares:
            behind = delayed(pressure, time_constant)
            area = 1 if gain is None else 0
            force = force + share * area * (eq3(contraction, behind) - eq3(contraction, pressure))
            force = force + (gain or 0.0) * (behind - pressure)
        friction = 5.0 * np.repeat(np.sign(np.diff(levels, prepend=0.0)), int(8 / STEP))
        force = force + friction + random.normal(0, noise, len(force))
        time = STEP * np.arange(len(force))
        measured = pressure + random.normal(0, 100, len(force))
        found.append(Recording.of(time=time, pressure=measured, force=force, contraction=contraction))
    return found


@pytest.mark.parametrize(("share", "time_constant"), [(0.06, 4.0), (-0.04, 1.5)])
def test_share_and_time_constant_are_in_their_intervals(share, time_constant):
    found = identify_pressure_creep(recordings_at(shares=((share, time_constant),)))
    assert found.is_significant and found.p_value < 1e-6 and not found.notes
    assert found.share_interval[0] - 0.01 * abs(share) < share < found.share_interval[1] + 0.01 * abs(share)
    assert found.time_constant_interval[0] / 1.01 < time_constant < found.time_constant_interval[1] * 1.01
    assert found.time_constant_interval[1] < 1.2 * found.time_constant_interval[0]
    assert found.creep == MaxwellCreep(0.0, found.time_constant, pressure_share=found.share)
    assert found.plateaus == 22
    assert "share of" in found.verdict()


@pytest.mark.slow
def test_one_recording_at_several_lengths_and_separate_ones_give_the_same():
    first, second = recordings_at(noise=0.01)
    columns = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in ("pressure", "force", "contraction")
    }
    time = np.concatenate([first.time, first.time[-1] + STEP + second.time])
    joined, separate = (
        identify_pressure_creep(Recording.of(time=time, **columns)),
        identify_pressure_creep([first, second]),
    )
    assert joined.share == pytest.approx(separate.share, rel=0.01)
    assert joined.time_constant == pytest.approx(separate.time_constant, rel=0.03)


@pytest.mark.parametrize("seed", range(3))
def test_without_creep_none_is_found(seed):
    found = identify_pressure_creep(recordings_at(shares=(), seed=seed))
    assert not found.is_significant and found.creep == NoCreep()
    assert found.p_value > 0.01 and not found.notes


@pytest.mark.parametrize("seed", range(4))
def test_creep_is_found_in_one_staircase_upwards(seed):
    """Six plateaus at one length: about two degrees of freedom."""
    levels = 1e5 * np.array([1, 2, 3, 4, 5, 6])
    with_creep, without = (
        identify_pressure_creep(recordings_at((0.0,), shares=shares, levels=levels, seed=seed))
        for shares in (((0.06, 4.0),), ())
    )
    assert with_creep.p_value < 0.005 and with_creep.is_significant
    assert without.p_value > 0.05 and not without.is_significant


def test_creep_far_slower_than_the_plateaus_is_said_to_be_undetermined():
    found = identify_pressure_creep(recordings_at(shares=((0.08, 300.0),)))
    assert found.is_significant and found.time_constant_interval[1] == np.inf and found.notes
    assert found.share_interval == (-np.inf, np.inf)
    assert "not determined" in found.verdict()


def test_one_level_of_the_pressure_is_refused():
    with pytest.raises(IdentificationError) as refused:
        identify_pressure_creep(recordings_at((0.0,), levels=1e5 * np.ones(3)))
    assert refused.value.lower == 2 and refused.value.remedy


@pytest.mark.parametrize("rest", [5.0, 0.1])
def test_a_single_step_gives_the_creep_and_a_warning(rest):
    """As on a knee: after 2 bar, 22 % of the force follow with 15 s, while the encoder flickers by a count.

    The recording begins at rest, or with the valve.
    """
    rng, time = np.random.default_rng(1), np.arange(0, 48 + rest, 0.02)
    pressure = 2e5 * -np.expm1(-np.maximum(time - rest, 0) / 0.12)
    delayed = pressure * -np.expm1(-np.maximum(time - rest, 0) / 15)
    force = 1.1e-4 * (pressure + 0.22 * (delayed - pressure)) + rng.normal(0, 0.1, len(time))
    contraction = 0.05 + 7.5e-4 * (rng.random(len(time)) < 0.02)
    found = identify_pressure_creep(Recording.of(time=time, pressure=pressure, force=force, contraction=contraction))
    low, high = found.share_interval
    assert low < 0.22 < high and high - low < 0.03
    assert found.time_constant == pytest.approx(15.0, rel=0.1)
    assert [note.field for note in found.notes] == ["plateaus"]
