"""What a test does when it is stopped: vent whatever happens meanwhile, and claim nothing that was not seen."""

import signal

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import RigError, SignalledError, SilentError, StoppedError
from mckibben.muscle import Muscle
from mckibben.rig.backend import Backend
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.record import Recorder, read_record
from mckibben.rig.runner import Runner, columns_of
from mckibben.rig.safety import StopFlag
from mckibben.rig.simulated import Regulator
from mckibben.rig.steps import Dwell, Move, Pressurise
from mckibben.units import bar, mm, percent
from tests.rig.faults import FaultyRig, samples_stopped, supply_lost

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
LIMITS = RigLimits(pressure=6.5 * bar, force=630.0, stretch=8 * mm, shorten=50 * mm)
UNDER_PRESSURE = [Pressurise(pressure=2 * bar), Dwell(duration=5.0)]


class Around:
    """A twin whose methods do something else from some reading on."""

    opened = Backend.opened

    def __init__(self, twin, after, **instead):
        self._twin, self._after, self._instead, self.reads = twin, after, instead, 0
        self.closed = 0

    def __getattr__(self, name):
        if name in self._instead and self.reads >= self._after:
            return lambda *given, **named: self._instead[name](self, *given, **named)
        return getattr(self._twin, name)

    def read(self, count, *, timeout=1.0):
        self.reads += 1
        if "read" in self._instead and self.reads > self._after:
            return self._instead["read"](self, count, timeout=timeout)
        return self._twin.read(count, timeout=timeout)

    def close(self):
        self.closed += 1
        self._twin.close()


def start(folder, rig, steps, **given):
    bench = Bench(of=MUSCLE, limits=LIMITS, steady=0.3)
    with Recorder(folder, {}, columns_of(rig.inputs)) as recorder:
        stop_flag = getattr(given.get("report"), "stop_flag", StopFlag())
        Runner(rig, bench, recorder, stop_flag=stop_flag, **given).run(steps)


def twin(**given):
    return FaultyRig(MUSCLE, seed=3, regulator=Regulator(hysteresis=0.0, repeatability=0.0), **given)


def empty(rig):
    rig.pass_time(1.5)
    return rig.truth.pressure < 0.2 * bar


class Signalling:
    """Interrupts a test after so many cycles."""

    def __init__(self, after):
        self.left, self.stop_flag = after, StopFlag()

    def __call__(self, progress):
        self.left -= 1
        if self.left == 0:
            self.stop_flag.signal = signal.SIGINT


def test_a_signal_that_comes_again_while_it_stops_cuts_the_watching_short(tmp_path):
    def again(rig, count, timeout):
        raise KeyboardInterrupt

    rig = Around(twin(), 20, read=again)
    with pytest.raises(SignalledError, match="no sensor confirms"):
        start(tmp_path, rig, UNDER_PRESSURE, report=Signalling(20))
    assert empty(rig) and rig.closed
    assert [event.kind for event in read_record(tmp_path).events][-2:] == ["stopped", "vented"]


def test_a_signal_in_the_midst_of_a_vent_still_closes(tmp_path):
    def interrupted(rig):
        raise KeyboardInterrupt

    rig = Around(twin(), 20, vent=interrupted)
    with pytest.raises(KeyboardInterrupt):
        start(tmp_path, rig, UNDER_PRESSURE, report=Signalling(20))
    assert rig.closed and empty(rig)


def test_nothing_moves_before_the_muscle_was_seen_to_be_empty(tmp_path):
    """Air that was left in it, or a valve that does not let it out."""

    def full(rig, count, timeout):
        block = rig._twin.read(count, timeout=timeout)
        block.values[:, 1] += 1 * bar
        return block

    rig = Around(twin(), 0, read=full)
    with pytest.raises(StoppedError, match=r"it is 1 bar 1.* s after 0 bar were set; shut the supply by hand"):
        start(tmp_path, rig, [Move(to=5 * percent, speed=4 * mm), Dwell(duration=1.0)])
    assert (read_record(tmp_path).columns["position"] == 0).all()


def test_what_the_watch_found_is_told_even_where_it_cannot_be_recorded(tmp_path, monkeypatch):
    rig = Around(twin(), 20, read=lambda rig, count, timeout: lost(rig._twin.read(count, timeout=timeout)))

    def lost(block):
        def full(*_):
            raise RigError("the disk is full")

        monkeypatch.setattr(Recorder, "append", full)
        return block._replace(values=np.full_like(block.values, 1e9))

    with pytest.raises(StoppedError, match=r"the force sensor is lost.*the disk is full"):
        start(tmp_path, rig, UNDER_PRESSURE)
    assert empty(rig)


def test_a_supply_that_fails_in_a_long_ramp_is_found_within_it(tmp_path):
    rig = twin(faults=[supply_lost(30.0)])
    with pytest.raises(StoppedError, match="the pressure does not follow"):
        start(tmp_path, rig, [Pressurise(pressure=6 * bar, rate=0.1 * bar)])
    assert rig.truth.time < 40.0


def test_where_the_motor_stands_is_recorded_only_where_it_was_seen_to_stand(tmp_path):
    steps = [Move(to=20 * percent, speed=4 * mm)]
    rig = twin()
    with pytest.raises(SignalledError):
        start(tmp_path / "1", rig, steps, report=Signalling(20))
    told = read_record(tmp_path / "1").events[-1]
    assert told.kind == "vented"
    assert told.data["position"] == pytest.approx(rig.truth.stretch, abs=1e-5)
    rig = twin(faults=[samples_stopped(2.0)])
    with pytest.raises(StoppedError) as stopped:
        start(tmp_path / "2", rig, steps)
    assert isinstance(stopped.value.__cause__, SilentError)
    assert "position" not in read_record(tmp_path / "2").events[-1].data
