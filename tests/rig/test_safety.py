"""The watch: every limit, on every sample."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mckibben.errors import RangeError, StoppedError
from mckibben.rig.backend import AnalogChannel, Block, Drive
from mckibben.rig.safety import Limits, Watch
from mckibben.rig.simulated.sensing import FORCE, PRESSURE
from mckibben.units import bar, mm

LIMITS = Limits(pressure=4 * bar, force=500.0, stretch=5 * mm, shorten=40 * mm)
INPUTS = (AnalogChannel("force", -10.0, 10.0), AnalogChannel("pressure", -10.0, 10.0))


def watch(limits=LIMITS, **given):
    return Watch(limits, INPUTS, {"force": FORCE, "pressure": PRESSURE}, Drive(), **given)


def block(first=0, force=100.0, pressure=2 * bar, pulses=0, count=100):
    """Samples at 1 kHz; what is given as a pair goes evenly from the one to the other."""
    volts = np.empty((count, 2))
    for column, (value, calibration) in enumerate(((force, FORCE), (pressure, PRESSURE))):
        volts[:, column] = calibration.volts(np.linspace(*value, count) if isinstance(value, tuple) else value)
    return Block(first, np.arange(first, first + count) / 1e3, volts, np.full(count, pulses, np.int64))


def test_what_is_within_the_limits_passes_and_is_told():
    seen = watch(origin=400).look(block(force=(90.0, 110.0), pulses=400), 0.1)
    assert (seen.force, seen.pressure, seen.position) == pytest.approx((100.0, 2 * bar, 2 * mm))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"force": (100.0, 501.0)}, "the force of 501 N is beyond the limit of 500 N"),
        ({"pressure": (2 * bar, 4.01 * bar)}, "the pressure of 4.01 bar is beyond the limit of 4 bar"),
        ({"pulses": 2001}, "the stretch of 5.002 mm is beyond the limit of 5 mm"),
        ({"pulses": -16001}, "the way on the short side of 40 mm is beyond"),
        ({"pressure": -0.3 * bar}, "the pressure sensor is lost"),
        ({"force": 2000.0}, "the force sensor is lost: it gives 10 to 10 V"),
        ({"force": -2000.0}, "the force sensor is lost"),
        ({"force": math.nan}, "the force sensor is lost"),
        ({"pressure": math.nan}, "the pressure sensor is lost"),
    ],
)
def test_what_is_beyond_a_limit_stops(wrong, message):
    with pytest.raises(StoppedError, match=message):
        watch().look(block(**wrong), 0.1)


def test_one_sample_is_enough():
    one = block()
    one.volts[57, 0] = float(FORCE.volts(600.0))
    with pytest.raises(StoppedError, match="the force of 600 N"):
        watch().look(one, 0.1)


def test_a_pressure_that_changes_too_fast_stops_unless_it_is_vented():
    limits = replace(LIMITS, pressure_rate=5 * bar)
    steady = watch(limits)
    steady.look(block(0, pressure=1 * bar), 0.1)
    steady.look(block(100, pressure=1.4 * bar), 0.2)
    with pytest.raises(StoppedError, match="the rate of the pressure of 6 bar/s is beyond the limit of 5 bar/s"):
        steady.look(block(200, pressure=2 * bar), 0.3)
    venting = watch(limits)
    venting.look(block(0, pressure=2 * bar), 0.1)
    venting.expect(None, 0.1, venting=True)
    venting.look(block(100, pressure=0.5 * bar), 0.2)


def test_a_pressure_that_does_not_follow_stops_when_its_time_is_over():
    follows = watch()
    follows.expect(3 * bar, 0.0)
    follows.look(block(9800), 9.9)
    with pytest.raises(StoppedError, match="the pressure does not follow: 2 bar where 3 bar were set"):
        watch_at(follows, 10_000)


def watch_at(one, first):
    return one.look(block(first), first / 1e3 + 0.1)


def test_old_readings_and_gaps_stop():
    with pytest.raises(StoppedError, match=r"the readings are 0\.6"):
        watch().look(block(), 0.7)
    gap = watch()
    gap.look(block(), 0.1)
    gap.look(block(500), 0.6)
    with pytest.raises(StoppedError, match=r"no readings for 0\.6"):
        gap.look(block(1200), 1.3)


def test_a_sensor_that_hangs_is_lost_after_a_while():
    hangs = watch(replace(LIMITS, frozen=0.5))
    for first in range(0, 600, 100):
        hangs.look(block(first, pressure=(1.9 * bar, 2 * bar)), first / 1e3 + 0.1)
    with pytest.raises(StoppedError, match=r"the force sensor is lost: it has given 0\.5 V for 0\.6 s"):
        hangs.look(block(600, pressure=(1.9 * bar, 2 * bar)), 0.7)


@pytest.mark.parametrize("wrong", [{"force": 0.0}, {"pressure": math.nan}, {"stretch": math.inf}, {"gap": -1.0}])
def test_limits_have_a_meaning(wrong):
    with pytest.raises(RangeError, match=next(iter(wrong))):
        replace(LIMITS, **wrong)
