"""Whatever goes wrong, and whenever: both muscles are vented within a period, and no sample is lost."""

import math
import shutil
import signal

import numpy as np
import pytest

from mckibben.errors import RigError, StoppedError
from mckibben.rig import JointSession, control_loop
from mckibben.rig.record import Recorder
from mckibben.rig.safety import StopFlag
from mckibben.units import bar, ms
from tests.rig import faults

from .conftest import LIMITS, PERIOD, Kept

PERIODS = 30
INSTANTS = np.random.default_rng(5).uniform(0, PERIODS * PERIOD, 12)


class Watched(faults.FaultyJoint):
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


def check_vented(joint, kept, outcome, kind):
    """Vented, empty, with the reason in the record."""
    assert outcome.kind == kind and outcome.error is not None
    assert next(event for event in kept.events if event[0] == kind)[1] == outcome.text
    joint.pass_time(200 * ms)
    assert max(joint.truth[1:]) < 0.05 * bar


# What fails, the kind of outcome, words of its text, and the time from the first sample that shows it to the vent [s].
FAULTS = {
    "angle lost": (lambda at: faults.disconnected(at, "angle"), "stopped", "the angle sensor is lost", 0.0),
    "pressure 1 lost": (lambda at: faults.disconnected(at, "pressure1"), "stopped", "pressure 1 sensor is lost", 0),
    "pressure 2 lost": (lambda at: faults.disconnected(at, "pressure2"), "stopped", "pressure 2 sensor is lost", 0),
    "silent": (faults.samples_stopped, "silent", "", LIMITS.silence),
    "late": (lambda at: faults.samples_delayed(at, 60 * ms), "silent", "", LIMITS.silence),
    "host away": (lambda at: faults.host_delayed(at, 0.12), "stopped", "", None),
    "dropped": (lambda at: faults.samples_dropped(at, 60), "stopped", "60 samples were dropped", None),
    "no air": (faults.supply_lost, "stopped", "does not follow", None),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_at_any_time_vents_and_loses_no_sample(stiff, watched, monkeypatch, name):
    make, kind, text, delay = FAULTS[name]
    monkeypatch.setattr(
        control_loop, "_VENTING", 100 * ms
    )  # s for which it would look for a pressure that it cannot read
    for instant in INSTANTS:
        joint = watched(faults=[make(instant)])
        outcome, kept = stiff.run(joint, plan=stiff.plan(300))
        check_vented(joint, kept, outcome, kind)
        assert text in outcome.text
        sample, unread = kept.columns["sample"], name.startswith("pressure") or name == "silent"
        assert np.array_equal(sample, np.arange(sample.size)) or name == "dropped"
        if delay is not None:
            found = math.ceil(instant / PERIOD - 1e-9)
            assert joint.vented_at == pytest.approx(found * PERIOD + delay, abs=1e-9)
            assert (kept.columns["phase"] < 3).sum() <= found + 1
        assert joint.vented_at < instant + 0.2
        assert (outcome.vented_after is None) == (outcome.remaining is None) == unread


def test_pressure_that_falls_slowly_is_told_from_pressure_that_is_not_measured(stiff, watched, monkeypatch):
    monkeypatch.setattr(control_loop, "_VENTING", 3 * ms)
    outcome, _ = stiff.run(watched(faults=[]), plan=stiff.plan(PERIODS))
    assert outcome.vented_after is None and outcome.remaining > control_loop.VENTED
    assert f"{outcome.remaining / bar:.3g} bar" in outcome.venting


def test_samples_from_before_the_stop_do_not_count_for_the_vent(stiff, watched):
    """A suspended host finds seconds of samples from before."""
    joint = watched(faults=[faults.host_delayed(10 * PERIOD, 5.0)], patience=60.0)
    outcome, kept = stiff.run(joint, plan=stiff.plan(PERIODS))
    check_vented(joint, kept, outcome, "stopped")
    assert 0.03 < outcome.vented_after < 0.2 and kept.columns["time"][-1] > 5.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_any_time_vents_within_a_period(stiff, watched, number):
    for instant in INSTANTS:
        flag, joint = StopFlag(), watched()

        def progress(shown, flag=flag, instant=instant):
            if shown.time >= instant - PERIOD:
                flag.signal = number

        outcome, kept = stiff.run(joint, plan=stiff.plan(PERIODS + 2), stop_flag=flag, progress=progress)
        check_vented(joint, kept, outcome, "signal")
        assert outcome.error.signal == number
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

        def progress(shown, instant=instant):
            if shown.time >= instant - PERIOD:
                raise ZeroDivisionError("a fault of the host's own")

        with pytest.raises(ZeroDivisionError):
            stiff.run(joint, plan=stiff.plan(PERIODS + 2), recorder=kept, progress=progress)
        assert kept.events[-1] == ("failed", "ZeroDivisionError: a fault of the host's own")
        assert vented_before == [True] and instant - PERIOD <= joint.vented_at <= instant
        joint.pass_time(200 * ms)
        assert max(joint.truth[1:]) < 0.05 * bar
        assert np.array_equal(kept.columns["sample"], np.arange(kept.columns["sample"].size))


def session(stiff, joint, plan):
    """A run without reference and result: it is about the record."""
    header = {"what": "joint rig"}
    return JointSession(stiff.scenario, stiff.plant, None, None, joint, LIMITS, plan, stiff.control, header)


def test_a_folder_that_vanishes_stops_the_run_at_once(stiff, watched, tmp_path):
    folder = tmp_path / "out"

    def progress(shown):
        if shown.time > 0.1:
            shutil.rmtree(folder, ignore_errors=True)

    joint = watched(paced=True)
    with pytest.raises(StoppedError, match=f"nothing is kept at {folder};.*; all muscles were below 0.2 bar"):
        session(stiff, joint, stiff.plan(5000)).run(folder, progress=progress)
    assert joint.vented_at < 1.5


@pytest.mark.slow
def test_a_record_whose_end_is_not_written_is_no_completed_run(stiff, watched, tmp_path, monkeypatch):
    close = Recorder.close

    def fail(recorder):
        close(recorder)
        raise RigError("no space left")

    monkeypatch.setattr(Recorder, "close", fail)
    monkeypatch.setattr(JointSession, "measured", lambda *_: None)
    ran = session(stiff, watched(), stiff.plan(30)).run(tmp_path)
    assert (ran.outcome.kind, ran.outcome.text) == ("rig", "no space left")
    assert ran.outcome.vented_after is not None and ran.timing.periods == 30
