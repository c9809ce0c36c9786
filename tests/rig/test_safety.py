"""The safety monitor: every limit, on every sample."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mckibben.errors import StoppedError
from mckibben.rig.backend import Block
from mckibben.rig.bench import RigLimits
from mckibben.rig.safety import RigMonitor
from mckibben.rig.simulated import FORCE_SENSOR, PRESSURE_SENSOR
from mckibben.units import bar, mm

LIMITS = RigLimits(pressure=4 * bar, force=500.0, stretch=5 * mm, shorten=40 * mm)
INPUTS = (FORCE_SENSOR.channel, PRESSURE_SENSOR.channel)


class Backend:
    """The inputs of a rig, and what it was told to do."""

    inputs, rate = INPUTS, 1000.0

    def __init__(self):
        self.calls = []

    def clock(self):
        return 0.5

    def vent(self):
        self.calls.append("vent")

    def stop(self):
        self.calls.append("stop")

    def heartbeat(self):
        self.calls.append("heartbeat")


def monitored(limits=LIMITS, **given):
    return RigMonitor(Backend(), limits, **given)


def block(first=0, force=100.0, pressure=2 * bar, position=0.0, count=100):
    """Samples at 1 kHz; what is given as a pair goes evenly from the one to the other."""
    values = np.empty((count, 2))
    for column, value in enumerate((force, pressure)):
        values[:, column] = np.linspace(*value, count) if isinstance(value, tuple) else value
    return Block(first, np.arange(first, first + count) / 1e3, values, np.full(count, position))


def test_what_is_within_the_limits_passes_and_is_told():
    seen = monitored(origin=1 * mm).check_block(block(force=(90.0, 110.0), position=1 * mm), 0.1)
    assert (seen.force, seen.pressure, seen.position) == pytest.approx((100.0, 2 * bar, 2 * mm))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"force": (100.0, 501.0)}, "the force of 501 N is beyond the limit of 500 N"),
        ({"pressure": (2 * bar, 4.01 * bar)}, "the pressure of 4.01 bar is beyond the limit of 4 bar"),
        ({"position": 5.002 * mm}, "the travel of 5.002 mm is outside the limits of -40 to 5 mm"),
        ({"position": -40.01 * mm}, "the travel of -40.01 mm is outside"),
        ({"pressure": -0.3 * bar}, "the pressure sensor is lost"),
        ({"force": 2001.0}, "the force sensor is lost"),
        ({"force": -2001.0}, "the force sensor is lost"),
        ({"force": math.nan}, "the force sensor is lost"),
        ({"pressure": math.nan}, "the pressure sensor is lost"),
    ],
)
def test_what_is_beyond_a_limit_stops(wrong, message):
    with pytest.raises(StoppedError, match=message):
        monitored().check_block(block(**wrong), 0.1)


def test_a_pressure_that_changes_too_fast_stops_unless_it_is_vented():
    limits = replace(LIMITS, pressure_rate=5 * bar)
    steady = monitored(limits)
    steady.check_block(block(0, pressure=1 * bar), 0.1)
    steady.check_block(block(100, pressure=1.4 * bar), 0.2)
    with pytest.raises(StoppedError, match="the rate of pressure of 6 bar/s is beyond the limit of 5 bar/s"):
        steady.check_block(block(200, pressure=2 * bar), 0.3)
    venting = monitored(limits)
    venting.check_block(block(0, pressure=2 * bar), 0.1)
    venting.expect(None, 0.1, venting=True)
    venting.check_block(block(100, pressure=0.5 * bar), 0.2)


def test_a_pressure_that_does_not_follow_stops_when_its_time_is_over():
    follows = monitored()
    follows.expect(3 * bar, 0.0)
    follows.check_block(block(9800), 9.9)
    with pytest.raises(StoppedError, match=r"the pressure does not follow: 2 bar 10\.1 s after 3 bar were set"):
        check_at(follows, 10_000)


def check_at(one, first):
    return one.check_block(block(first), first / 1e3 + 0.1)


def test_old_readings_and_gaps_stop():
    with pytest.raises(StoppedError, match=r"the newest sample is 0\.6"):
        monitored().check_block(block(), 0.7)
    gap = monitored()
    gap.check_block(block(), 0.1)
    gap.check_block(block(500), 0.6)
    with pytest.raises(StoppedError, match=r"samples were dropped: the gap is 0\.6"):
        gap.check_block(block(1200), 1.3)


def test_a_time_that_goes_back_stops():
    back = monitored()
    back.check_block(block(100), 0.2)
    with pytest.raises(StoppedError, match="time of the samples"):
        back.check_block(block(50), 0.2)


def test_a_sensor_that_hangs_is_lost_after_a_while():
    hangs = monitored(replace(LIMITS, frozen=0.5))
    for first in range(0, 600, 100):
        hangs.check_block(block(first, pressure=(1.9 * bar, 2 * bar)), first / 1e3 + 0.1)
    with pytest.raises(StoppedError, match=r"the force sensor is lost: it has given 100 N for 0\.6 s"):
        hangs.check_block(block(600, pressure=(1.9 * bar, 2 * bar)), 0.7)
