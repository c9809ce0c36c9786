"""Kills a test on the simulated rig at random instants: every recorded sample has to be left, in a whole dataset.

A test is begun by a process that is killed (SIGKILL) at a random instant, and gone on with by others, which may be
killed as well, up to four times; then one comes to its end. After each kill the record is read: no row that was
reported to be on the disk is missing, and up to where the first process came the rows are those of a test that nobody
killed, to the bit. Of each finished test the dataset has every point once, and the forces of the test that nobody
killed.
"""

from __future__ import annotations

import os
import signal
import struct
import time
import warnings
from pathlib import Path

import numpy as np

from mckibben import catalog
from mckibben.muscle import Muscle
from mckibben.rig import recorder
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.record import Event, assemble, entries, points, read_record, segments
from mckibben.rig.recorder import Recorder
from mckibben.rig.runner import DONE, Runner, columns_of
from mckibben.rig.session import RigSession
from mckibben.rig.simulated import FORCE_SENSOR, PRESSURE_SENSOR, Regulator, SimulatedRig
from mckibben.rig.steps import Acquire, Dwell, Move, Pressurise, Repeat, Vent, Walk
from mckibben.units import bar, mm, percent

ACQUIRE = Acquire(samples=50, duration=0.05)
STEPS = (
    Move(to=5 * percent, speed=4 * mm),
    Pressurise(pressure=2 * bar),
    Move(to=1 * percent, speed=4 * mm),
    Dwell(duration=0.2),
    Repeat(
        times=3,
        steps=(
            Walk(to=4 * percent, step=1 * mm, speed=4 * mm, dwell=0.1, acquire=ACQUIRE),
            Walk(to=1 * percent, step=1 * mm, speed=4 * mm, dwell=0.1, acquire=ACQUIRE),
        ),
    ),
    Vent(),
)
POINTS = 36
MOST = 4  # kills of a test
MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
PERIOD = 2e-3  # s: a test takes as long as a breath here, and chunks are written accordingly often
_REPORT = struct.Struct("<Q")


def rig(session: int) -> tuple[SimulatedRig, Bench]:
    """The simulated rig of a session, and what stands on it; the regulator gives what it is told."""
    twin = SimulatedRig(
        MUSCLE,
        seed=session,
        regulator=Regulator(hysteresis=0.0, repeatability=0.0),
        force_sensor=FORCE_SENSOR,
        pressure_sensor=PRESSURE_SENSOR,
    )
    bench = Bench(
        of=MUSCLE,
        drive=twin.drive,
        calibrations=twin.calibrations,
        limits=RigLimits(pressure=3 * bar, force=400.0, stretch=8 * mm, shorten=50 * mm),
        steady=0.2,
    )
    return twin, bench


def go_on(folder: Path, told: int = -1) -> None:
    """Begin the test of a folder, or go on with it; rows on the disk are reported to a pipe."""
    session = len(segments(folder))
    twin, bench = rig(session)
    events, since = [], 0.0
    for one in entries(folder):
        if isinstance(one, Event):
            events.append(one)
        else:
            since = float(one.columns["time"][-1]) + 1 / bench.rate
    columns = columns_of([channel.name for channel in twin.inputs])
    with (Recorder.resume if session else Recorder.create)(folder, {"session": session}, columns) as record:

        def report(_: object) -> None:
            record.flush()
            if told >= 0:
                os.write(told, _REPORT.pack(record.rows))

        Runner(RigSession(twin, bench, record, since=since, report=report), done=points(events)).run(STEPS)


def killed(folder: Path, after: float) -> tuple[bool, int]:
    """Kill a process that goes on with the test after so long [s]: whether it had ended, and the rows it reported."""
    read, write = os.pipe()
    with warnings.catch_warnings():  # JAX has threads of its own; the child computes nothing with it
        warnings.simplefilter("ignore")
        child = os.fork()
    if child == 0:
        code = 1
        try:
            os.close(read)
            go_on(folder, write)
            code = 0
        finally:
            os._exit(code)
    os.close(write)
    deadline = time.monotonic() + after
    ended = 0
    while not ended and (left := deadline - time.monotonic()) > 0:
        ended, status = os.waitpid(child, os.WNOHANG)
        if not ended:
            time.sleep(min(left, 1e-3))
    if not ended:
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    reported = 0
    with os.fdopen(read, "rb") as told:
        while len(part := told.read(_REPORT.size)) == _REPORT.size:
            (reported,) = _REPORT.unpack(part)
    lived = os.WIFEXITED(status)
    if lived and os.WEXITSTATUS(status):
        raise AssertionError("a process that was not killed failed")
    return lived, reported


def trial(folder: Path, reference: Path, generator: np.random.Generator, longest: float) -> int:
    """One test, killed up to `MOST` times and then let come to its end: how often."""
    whole = read_record(reference)
    kills, least = 0, 0
    while True:
        after = float(generator.uniform(0, longest)) if kills < MOST else 60.0
        lived, reported = killed(folder, after)
        least = max(least, reported)
        there = segments(folder)
        if there:
            record = read_record(folder)
            assert len(record) >= least, f"{least} rows were on the disk, and {len(record)} are left"
            if len(there) == 1:
                for name, values in record.columns.items():
                    np.testing.assert_array_equal(values, whole.columns[name][: len(record)])
        else:
            assert least == 0
        if lived:
            break
        kills += 1
    check(folder, reference)
    return kills


def check(folder: Path, reference: Path) -> None:
    """Hold a finished test against the one that nobody killed."""
    _, bench = rig(0)
    events = [one for one in entries(folder) if isinstance(one, Event)]
    assert events[-1].kind == DONE
    assert [point.number for point in points(events)] == list(range(POINTS))
    data, wanted = assemble(folder, bench), assemble(reference, bench)
    assert len(data) == POINTS
    assert data.table["force_samples"].shape == wanted.table["force_samples"].shape
    np.testing.assert_array_equal(data.contraction, wanted.contraction)
    np.testing.assert_allclose(data.force, wanted.force, atol=2.0)  # noise, and 0.01 bar; the next is 10 N away
    assert (np.diff(data.table["time"].to_numpy()) > 0).all()
    rows = read_record(folder).columns
    assert (np.diff(rows["time"]) > 0).all()


def prepare(folder: Path) -> tuple[Path, float]:
    """The test that nobody kills, and how long it takes [s]."""
    recorder.PERIOD = PERIOD
    go_on(folder / "warm")  # the table of the law is made once, and not by those that are killed
    begin = time.perf_counter()
    go_on(folder / "reference")
    return folder / "reference", time.perf_counter() - begin
