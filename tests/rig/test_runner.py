"""A test on the simulated rig: steps, record, resuming, venting."""

import contextlib
import multiprocessing
import signal
import time
from dataclasses import replace

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import StoppedError
from mckibben.identification import identify_with_friction
from mckibben.muscle import ExponentialLaw, MaxwellSlip, Muscle, forces
from mckibben.rig import IsobaricProtocol, record
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.protocol import IsometricProtocol, IsotonicProtocol
from mckibben.rig.record import Recorder, assemble, read_record, segments
from mckibben.rig.runner import Runner, columns_of
from mckibben.rig.simulated import Regulator, SimulatedRig
from mckibben.rig.steps import Acquire, Dwell, Move, Pressurise, Repeat, Vent, Walk
from mckibben.units import bar, mm, percent
from tests.rig import faults

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
LIMITS = RigLimits(pressure=6.5 * bar, force=630.0, stretch=8 * mm, shorten=50 * mm)
EXACT = Regulator(hysteresis=0.0, repeatability=0.0)
QUICK = {"dwell": 0.2, "acquisition": 0.1, "samples": 100, "speed": 4 * mm}


def run(folder, steps, *, of=MUSCLE, muscle=MUSCLE, twin=None, limits=LIMITS, **given):
    twin = twin or SimulatedRig(muscle, seed=3, regulator=EXACT)
    bench = Bench(of=of, limits=limits, steady=0.3)
    with Recorder(folder, {}, columns_of(twin.inputs)) as recorder:
        Runner(twin, bench, recorder, **given).run(steps)
    twin.pass_time(1.5)
    assert twin.truth.pressure < 0.2 * bar
    return bench


def test_the_isobaric_test_measures_the_law(tmp_path):
    protocol = IsobaricProtocol(pressures=[1 * bar, 6 * bar], repeats=2, contraction_max=6 * percent, **QUICK)
    bench = run(tmp_path, protocol.steps_for(MUSCLE))
    data, planned = assemble(tmp_path, bench), protocol.plateaus(MUSCLE)
    np.testing.assert_allclose(data.contraction, planned.contraction, atol=1e-9)
    np.testing.assert_array_equal(data.table["repeat"], planned.repeat)
    np.testing.assert_array_equal(data.table["direction"] == "loading", planned.stretching)
    np.testing.assert_array_equal(data.levels, np.array(protocol.pressures)[planned.level])
    there = forces(MUSCLE, data.contraction, data.pressure)
    assert np.abs(data.force - there).max() < 5 * 0.5 / np.sqrt(100) + 0.3  # 0.3 N: pressure noise and the screw's play
    assert len(data) == len(planned.time)
    assert (np.diff(data.table["time"]) > 0).all()


def test_boundaries_are_found_where_no_law_tells_them(tmp_path):
    protocol = IsobaricProtocol(pressures=[1 * bar, 6 * bar], repeats=1, step=2 * mm, **QUICK)
    bench = run(tmp_path, protocol.steps_for(MUSCLE.specimen), of=MUSCLE.specimen)
    data = assemble(tmp_path, bench)
    for pressure in protocol.pressures:
        here = data.at(pressure)
        assert 450 < here.force.max() <= 630 * 0.95 or here.contraction.min() == pytest.approx(-0.03, abs=0.012)
        slack = (here.force < 1) & (here.table["direction"] == "unloading").to_numpy()
        assert slack.sum() in (1, 2, 3)  # three, or as many as the stroke has
        loading = here.select((here.table["direction"] == "loading").to_numpy())
        assert loading.contraction.min() == here.contraction.min()


@pytest.mark.slow
def test_at_constant_length_and_at_constant_force(tmp_path):
    quick = {"dwell": 0.2, "acquisition": 0.1, "samples": 100}
    isometric = IsometricProtocol(contractions=[5 * percent], pressures=[1e5, 3e5, 5e5], speed=4 * mm, **quick)
    data = assemble(tmp_path / "1", run(tmp_path / "1", isometric.steps_for(MUSCLE)))
    assert list(data.table["phase"].to_numpy()) == ["filling"] * 3 + ["venting"] * 3
    np.testing.assert_allclose(data.contraction, 0.05)
    np.testing.assert_allclose(data.force, forces(MUSCLE, data.contraction, data.pressure), atol=1.0)
    isotonic = IsotonicProtocol(forces=[100.0], pressures=[2e5, 4e5], rate=1 * bar, **quick)
    data = assemble(tmp_path / "2", run(tmp_path / "2", isotonic.steps_for(MUSCLE)))
    np.testing.assert_allclose(data.force, 100.0, atol=2.5)
    np.testing.assert_allclose(data.force, forces(MUSCLE, data.contraction, data.pressure), atol=1.5)
    assert data.contraction[1] > data.contraction[0] + 0.03
    assert list(data.table["direction"].to_numpy()) == ["unloading"] * 2 + ["loading"] * 2
    assert (data.table["set_force"] == 100.0).all()


@pytest.mark.slow
def test_a_test_at_constant_forces_is_identified(tmp_path):
    muscle = replace(MUSCLE, friction=MaxwellSlip(12.0, 0.5 * mm))
    protocol = IsotonicProtocol(repeats=1, **QUICK)
    data = assemble(tmp_path, run(tmp_path, protocol.steps_for(muscle), of=muscle, muscle=muscle))
    found = identify_with_friction(ExponentialLaw, data)
    assert found.hysteresis.friction.half_width == pytest.approx(12.0, abs=0.5)
    fitted, truth = (forces(law, data.contraction, data.pressure) for law in (found.law, MUSCLE.law))
    assert np.sqrt(np.mean((fitted - truth) ** 2)) < 1.0


def test_plateaus_are_recorded_whole_and_the_way_between_thinned_out(tmp_path):
    acquire = Acquire(samples=50, duration=0.1)
    run(tmp_path, [Move(to=2 * percent, speed=4 * mm), Dwell(duration=1.0), acquire, acquire])
    rows = read_record(tmp_path).columns
    for number in (0, 1):
        there = rows["time"][rows["plateau"] == number]
        assert len(there) == 99  # of a card twice as quick each second is a sample, the first and the last among them
        np.testing.assert_allclose(np.diff(there), 1e-3)
    between = rows["time"][rows["plateau"] == -1]
    assert np.diff(between).max() < 0.31 and len(between) < 60
    assert [point.every for point in read_record(tmp_path).points] == [2, 2]


class SlowRig(SimulatedRig):
    """A rig on a line that takes as long as is allowed for a gap."""

    latency = 1.01 * LIMITS.gap


def test_a_slow_line_stops_a_test_before_there_is_pressure(tmp_path):
    rig = faults.Spied(SlowRig(MUSCLE, seed=1))
    with pytest.raises(StoppedError, match="slow"):
        run(tmp_path, [Pressurise(pressure=2 * bar)], twin=rig)
    assert "set_valves" not in rig.calls


def test_a_fault_of_ours_vents_and_is_told(tmp_path):
    def report(progress):
        if progress.points:
            raise ZeroDivisionError("ours")

    steps = [Pressurise(pressure=2 * bar), Acquire(samples=100, duration=0.1)]
    with pytest.raises(StoppedError, match="stopped: ZeroDivisionError: ours; the muscle is vented") as stopped:
        run(tmp_path, steps, report=report)
    assert isinstance(stopped.value.__cause__, ZeroDivisionError)
    assert "ZeroDivisionError: ours" in [event.text for event in read_record(tmp_path).events]


def test_a_muscle_that_does_not_pull_as_its_law_tells_stops(tmp_path):
    other = Muscle(MUSCLE.specimen, MUSCLE.law, MaxwellSlip(30.0, 0.5e-3))
    steps = [Pressurise(pressure=3 * bar), Move(to=5 * percent, speed=4 * mm), Acquire(samples=100, duration=0.1)]
    with pytest.raises(StoppedError, match=r"force of [\d.]+ N at 5 % and [\d.]+ bar deviates from the law, [\d.]+ N"):
        run(tmp_path, steps, muscle=other, limits=replace(LIMITS, deviation=20.0))


@pytest.mark.slow
def test_every_fault_at_some_instants_ends_vented_and_recorded(tmp_path):
    generator, stopped = np.random.default_rng(7), 0
    for name, make in faults.FAULTS.items():
        for number in range(3):
            fault = make(float(generator.uniform(0, faults.DURATION)))
            stopped += bool(faults.broken(fault, number, tmp_path / f"{name} {number}"))
    assert stopped > 1.5 * len(faults.FAULTS)


def go_on(folder, told=None):
    """Begin the test of a folder, or go on with it; the numbers of rows on the disk go to a pipe."""
    session = len(segments(folder))
    twin = SimulatedRig(MUSCLE, seed=session, regulator=EXACT)
    bench = Bench(of=MUSCLE, limits=LIMITS, steady=0.2)
    since = read_record(folder).columns["time"].max(initial=-1e-3) + 1e-3 if session else 0.0
    with Recorder(folder, {}, columns_of(twin.inputs), resume=bool(session)) as record:

        def report(_):
            record.flush()
            if told:
                told.send(record.rows)

        acquire = Acquire(samples=50, duration=0.05)
        walk = {"step": 1 * mm, "speed": 4 * mm, "dwell": 0.1, "acquire": acquire}
        walks = Walk(to=4 * percent, **walk), Walk(to=1 * percent, **walk)
        steps = [Vent(), Pressurise(pressure=2 * bar), Move(to=1 * percent, speed=4 * mm), Repeat(times=3, steps=walks)]
        Runner(twin, bench, record, since=since, report=report).run(steps)
    return assemble(folder, bench)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning", "ignore:.*fork:DeprecationWarning")
def test_killed_at_random_instants_it_loses_nothing_that_was_recorded(tmp_path, monkeypatch):
    """No row that was reported to be on the disk is missing, and rows are those of a test that nobody killed."""
    monkeypatch.setattr(record, "PERIOD", 2e-3)  # s
    go_on(tmp_path / "warm")  # the table of the law is made once
    begin = time.perf_counter()
    expected, whole = go_on(tmp_path / "reference"), read_record(tmp_path / "reference")
    longest, kills = time.perf_counter() - begin, 0
    for number, share in enumerate(np.random.default_rng(5).uniform(0, 1, 20)):
        folder, (receiver, sender) = tmp_path / str(number), multiprocessing.Pipe(duplex=False)
        process = multiprocessing.get_context("fork").Process(target=go_on, args=(folder, sender))
        process.start()
        sender.close()
        process.join(share * longest)
        process.kill()
        process.join()
        reported = 0
        with contextlib.suppress(EOFError):
            while True:
                reported = receiver.recv()
        if segments(folder):
            left = read_record(folder)
            assert len(left) >= reported
            for name, values in left.columns.items():
                np.testing.assert_array_equal(values, whole.columns[name][: len(left)])
        kills += process.exitcode == -signal.SIGKILL
        data = go_on(folder)
        np.testing.assert_array_equal(data.contraction, expected.contraction)
        np.testing.assert_allclose(data.force, expected.force, atol=2.0)  # noise, and 0.01 bar; the next is 10 N away
        assert (np.diff(read_record(folder).columns["time"]) > 0).all()
        if kills == 5:
            return
    pytest.fail("it was not killed often enough")
