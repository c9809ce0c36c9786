"""Whatever goes wrong, and whenever: both muscles are vented within a period, and no sample is lost."""

import math
import signal

import numpy as np
import pytest

from mckibben.realtime import loop
from mckibben.realtime.loop import StopFlag
from mckibben.realtime.simulated import Unplugged, VirtualJoint
from mckibben.rig.twin.faults import Delaying, Dropping, HostDelayed, Silent, SupplyLost
from mckibben.units import bar, ms

from .conftest import LIMITS, PERIOD, Kept

PERIODS = 30
INSTANTS = np.random.default_rng(5).uniform(0, PERIODS * PERIOD, 200)


class Watched(VirtualJoint):
    """Notes when it was vented first, by its own clock."""

    vented_at = math.inf

    def vent(self):
        self.vented_at = min(self.vented_at, self.clock())
        super().vent()


@pytest.fixture(scope="module")
def watched(stiff):
    def make(**changes):
        joint = stiff.joint(**changes)
        joint.__class__ = Watched
        return joint

    return make


def check_vented(joint, kept, ending, kind):
    """Vented, empty, with the reason in the record."""
    assert ending.kind == kind and ending.error is not None
    assert next(event for event in kept.events if event[0] == kind)[1] == ending.text
    joint.pass_time(200 * ms)
    assert max(joint.truth[2:]) < 0.05 * bar


def check_safe(joint, kept, ending, kind):
    """And every sample that was taken is in the record."""
    check_vented(joint, kept, ending, kind)
    sample = kept.columns["sample"]
    assert np.array_equal(sample, np.arange(sample.size))
    return kept.columns


SENSORS = ("angle", "pressure1", "pressure2")


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_that_is_lost_at_any_time_vents_within_its_period(stiff, watched, monkeypatch, sensor):
    monkeypatch.setattr(loop, "_VENTING", 100 * ms)  # s for which it would look for a pressure that it cannot read
    for instant in INSTANTS:
        joint = watched(faults=[Unplugged(instant, sensor)])
        ending, kept = stiff.run(joint, course=stiff.course(PERIODS + 1))
        columns = check_safe(joint, kept, ending, "stopped")
        assert f"the sensor of {sensor} is lost" in ending.text
        found = math.ceil(instant / PERIOD - 1e-9)
        assert joint.vented_at == pytest.approx(found * PERIOD, abs=1e-9)
        assert (columns["phase"] < 3).sum() == found + 1
        assert (ending.vented_after is None) == (sensor != "angle")


def test_a_device_that_falls_silent_at_any_time(stiff, watched):
    for instant in INSTANTS:
        joint = watched(faults=[Silent(instant)])
        ending, kept = stiff.run(joint, course=stiff.course(PERIODS + 1))
        check_safe(joint, kept, ending, "silent")
        found = math.ceil(instant / PERIOD - 1e-9) * PERIOD
        assert joint.vented_at == pytest.approx(found + LIMITS.silence, abs=1e-9)


def test_samples_that_are_late_at_any_time(stiff, watched):
    for instant in INSTANTS:
        joint = watched(faults=[Delaying(instant, 60 * ms)])
        ending, kept = stiff.run(joint, course=stiff.course(PERIODS + 1))
        check_safe(joint, kept, ending, "stopped")
        assert "old" in ending.text
        assert joint.vented_at == pytest.approx(math.ceil(instant / PERIOD - 1e-9) * PERIOD + 60 * ms, abs=1e-9)


def test_a_host_that_is_away_for_longer_than_the_rig_waits(stiff, watched):
    for instant in INSTANTS:
        joint = watched(faults=[HostDelayed(instant, 0.12)])
        ending, kept = stiff.run(joint, course=stiff.course(PERIODS + 1))
        check_safe(joint, kept, ending, "stopped")


def test_too_many_samples_dropped_at_any_time(stiff, watched):
    for instant in INSTANTS:
        joint = watched(faults=[Dropping(instant, 60)])
        ending, kept = stiff.run(joint, course=stiff.course(PERIODS + 100))
        check_vented(joint, kept, ending, "stopped")
        assert "60 samples were dropped" in ending.text


def test_air_that_fails_is_found_before_the_joint_has_gone_far(stiff, watched):
    for instant in INSTANTS:
        joint = watched(faults=[SupplyLost(instant)])
        ending, kept = stiff.run(joint, course=stiff.course(300))
        columns = check_safe(joint, kept, ending, "stopped")
        assert "does not follow" in ending.text
        assert columns["time"][-1] < instant + 0.2


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_any_time_vents_within_a_period(stiff, watched, number):
    for instant in INSTANTS:
        told, joint = StopFlag(), watched()

        def show(shown, told=told, instant=instant):
            if shown.time >= instant - PERIOD:
                told.signal = number

        ending, kept = stiff.run(joint, course=stiff.course(PERIODS + 2), told=told, show=show)
        check_safe(joint, kept, ending, "signal")
        assert ending.error.signal == number
        assert instant - PERIOD <= joint.vented_at <= instant + PERIOD


def test_an_exception_at_any_time_vents_and_is_raised_again(stiff, watched):
    for instant in INSTANTS:
        joint, vented_before = watched(), []

        class Noting(Kept):
            def event(self, kind, text="", joint=joint, vented_before=vented_before, **data):
                if kind == "failed":  # the record may take its time: the vent comes first
                    vented_before.append(joint.vented_at <= joint.clock())
                super().event(kind, text, **data)

        kept = Noting()

        def show(shown, instant=instant):
            if shown.time >= instant - PERIOD:
                raise ZeroDivisionError("a fault of the host's own")

        with pytest.raises(ZeroDivisionError):
            stiff.run(joint, course=stiff.course(PERIODS + 2), recorder=kept, show=show)
        assert kept.events[-1] == ("failed", "ZeroDivisionError: a fault of the host's own")
        assert vented_before == [True] and instant - PERIOD <= joint.vented_at <= instant
        joint.pass_time(200 * ms)
        assert max(joint.truth[2:]) < 0.05 * bar
        assert np.array_equal(kept.columns["sample"], np.arange(kept.columns["sample"].size))


def test_a_host_that_dies_is_found_by_the_rig_itself(stiff):
    for instant in INSTANTS:
        joint = stiff.joint(patience=20 * ms)
        joint.open()
        joint.read(1)
        joint.press([4.0, 4.0])
        joint.beat()
        while joint.clock() < instant:
            joint.read(1)
            joint.beat()
        joint.pass_time(15 * ms)
        assert min(joint.truth[2:]) > 0.5 * bar
        joint.pass_time(200 * ms)
        assert max(joint.truth[2:]) < 0.05 * bar


def test_a_recorder_that_fails_stops_the_run(stiff, watched):
    from mckibben.errors import RigError

    class Full(Kept):
        def append(self, table):
            if len(self.tables) == 1:
                raise RigError("no space left")
            super().append(table)

    joint, kept = watched(), Full()
    ending, _ = stiff.run(joint, course=stiff.course(300), recorder=kept)
    assert ending.kind == "rig" and "no space left" in ending.text
    assert joint.vented_at < 0.11
    joint.pass_time(200 * ms)
    assert max(joint.truth[2:]) < 0.05 * bar
