"""A test run into a folder: the lock, the record, the signals, and in the end the dataset."""

from __future__ import annotations

import os
import platform
import signal
import time
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import mckibben
from mckibben.dataset import IsobaricDataset
from mckibben.errors import FileError, McKibbenWarning, Problem, RigError, ScenarioError
from mckibben.files import folder as made
from mckibben.rig.assembly import assemble
from mckibben.rig.chunks import read_header
from mckibben.rig.handling import VENTED, Report
from mckibben.rig.plateaus import Point, points
from mckibben.rig.record import Event, header_of, passages, segments
from mckibben.rig.recorder import Recorder
from mckibben.rig.runner import DONE, Runner, columns_of
from mckibben.rig.steps import described
from mckibben.study.keeping import alone, check_free
from mckibben.study.rig.checking import Checked, check, check_room
from mckibben.study.rig.document import RigTest
from mckibben.study.signals import heeded

PROTOCOL = "protocol.yaml"
"""What was asked for, beside the record in a folder."""


@dataclass(frozen=True)
class _Past:
    """What a folder's record says of what was done before.

    `left` is where the motor stood last, and `certain` whether it was seen to stand there when the test had ended.
    """

    done: tuple[Point, ...] = ()
    since: float = 0.0
    left: int = 0
    certain: bool = True
    finished: bool = False


def data_name(test: RigTest) -> str:
    """The file of a folder in which the dataset is: ``isobaric.nc``, ``isometric.nc`` ..., ``points.nc`` of steps."""
    return "points.nc" if test.protocol.form == "steps" else f"{test.protocol.form}.nc"


def run_test(
    checked: Checked,
    folder: str | os.PathLike[str],
    *,
    resume: bool = False,
    standing_at: float | None = None,
    report: Report | None = None,
) -> IsobaricDataset:
    """Run a test that was checked, record it in a folder, and make the dataset of the record.

    Parameters
    ----------
    checked
        From `check`.
    folder
        Where ``protocol.yaml``, the record and, when all is done, the dataset go.
    resume
        Go on with the test that is in the folder: at the first point that it lacks.
    standing_at
        With `resume`: the contraction [-] at which the motor stands now. A virtual rig stands where the muscle was
        mounted, and a real one where the record says that it was stopped.
    report
        Is told of progress.

    Raises
    ------
    FileError, ScenarioError
        If the folder holds a test already (or none to go on with, or another one), is in use, or has no room.
    RigError
        If the rig is not there.
    StoppedError
        If the test was stopped; the muscle has been vented, and what was recorded is kept.
    """
    folder = Path(folder)
    if resume and not (folder / PROTOCOL).exists():
        raise FileError(str(folder), [Problem("holds no test to go on with", remedy="leave --resume out")])
    if not resume:
        if segments(folder):
            remedy = "go on with it (--resume), or choose another folder"
            raise FileError(str(folder), [Problem("holds a record already", remedy=remedy)])
        check_free(folder, [PROTOCOL, data_name(checked.test)])
    made(folder)
    with alone(folder / "lock", "running a test here"):
        if resume:
            _same(checked.test, folder)
        past = _past(folder) if resume else _Past()
        if not past.finished:
            check_room(folder, checked.room)
            if not resume:
                checked.test.to_yaml(folder / PROTOCOL)
            try:
                _go_on(checked, folder, past, standing_at, report)
            except RigError:
                if not resume and next(passages(folder), None) is None:  # it did not even begin
                    for path in (*segments(folder), folder / PROTOCOL):
                        path.unlink(missing_ok=True)
                raise
        return _assembled(checked, folder)


def gather(folder: str | os.PathLike[str]) -> IsobaricDataset:
    """Make the dataset of what a folder's record holds, finished or not.

    Raises
    ------
    FileError
        If there is no test.
    """
    folder = Path(folder)
    if not (folder / PROTOCOL).exists():
        raise FileError(str(folder), [Problem("holds no test", remedy="give the folder of `rig run --out`")])
    checked = check(RigTest.read(folder / PROTOCOL))
    with alone(folder / "lock", "running a test here"):
        return _assembled(checked, folder)


def _assembled(checked: Checked, folder: Path) -> IsobaricDataset:
    calibration = _header(checked)["calibration"]
    for path in segments(folder):
        if read_header(path)[0]["header"]["calibration"] != calibration:
            message = f"{path} was recorded with another calibration; the dataset is made with the present one"
            warnings.warn(message, McKibbenWarning, stacklevel=3)
    data = assemble(folder, checked.setup.bench, source=_source(checked, folder))
    name = data_name(checked.test)
    try:
        data.to_netcdf(folder / name)
    except OSError as error:
        problem = f"it cannot be written: {os.strerror(error.errno) if error.errno else error}"
        remedy = f"the record is whole: make room, then mckibben rig data {folder}"
        raise FileError(str(folder / name), [Problem(problem, remedy=remedy)]) from error
    return data


def _go_on(checked: Checked, folder: Path, past: _Past, standing_at: float | None, report: Report | None) -> None:
    bench, backend = checked.setup.bench, checked.setup.backend
    origin = _origin(checked, folder, past, standing_at)
    columns = columns_of([channel.name for channel in backend.inputs])
    begin = Recorder.resume if segments(folder) else Recorder.create
    with begin(folder, _header(checked), columns) as recorder:
        runner = Runner(backend, bench, recorder, done=past.done, origin=origin, since=past.since, report=report)
        with heeded(lambda number: runner.interrupt(number, signal.Signals(number).name)):
            runner.run(checked.steps)


def _origin(checked: Checked, folder: Path, past: _Past, standing_at: float | None) -> int:
    bench = checked.setup.bench
    if standing_at is not None:
        return bench.pulses_at(standing_at)
    if checked.test.rig.virtual is not None:
        return 0
    if not past.certain:
        message = (
            f"was left in the middle: nothing tells where the motor stands (the record ends at {past.left} pulses)"
        )
        remedy = "measure it, and give the muscle's contraction there (--standing-at '5 %')"
        raise FileError(str(folder), [Problem(message, remedy=remedy)])
    return past.left


def _past(folder: Path) -> _Past:
    """What the record tells."""
    events: list[Event] = []
    since, left = 0.0, 0
    step = 1 / header_of(folder)[0]["rate_Hz"] if segments(folder) else 0.0
    for one in passages(folder):
        if isinstance(one, Event):
            events.append(one)
        elif len(one.columns["time"]):
            since, left = float(one.columns["time"][-1]) + step, int(one.columns["pulses"][-1])
    found = points(events)
    done = tuple(point for number, point in enumerate(found) if point.number == number)
    finished = any(event.kind == DONE for event in events)
    stood = events[-1].data.get("pulses") if events and events[-1].kind in (VENTED, DONE) else None
    return _Past(done, since, left if stood is None else stood, not events or stood is not None, finished)


def _same(test: RigTest, folder: Path) -> None:
    """Raise unless the folder's test is this one."""
    if RigTest.read(folder / PROTOCOL) == test:
        return
    remedy = f"go on with its own ({folder / PROTOCOL}), or choose another folder"
    raise ScenarioError(str(folder), [Problem("holds another test", remedy=remedy)])


def _header(checked: Checked) -> dict[str, Any]:
    bench = checked.setup.bench
    specimen = bench.specimen
    return {
        "protocol": checked.test.dumps(),
        "steps": described(checked.steps),
        "specimen": {
            "name": specimen.name,
            "initial_length_m": float(specimen.initial_length),
            "initial_diameter_m": float(specimen.initial_diameter),
            "rated_force_N": float(specimen.rated_force),
            "mounted_at": bench.mounted_at,
        },
        "calibration": {name: one.to_json() for name, one in bench.calibrations.items()},
        "drive": {"pulses_per_metre": bench.drive.pulses_per_metre},
        "rig": dict(checked.setup.backend.described),
        "rate_Hz": bench.rate,
        "clock": "time_s is the card's, from the beginning of the test; interruptions are left out",
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": {
            "mckibben": mckibben.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
            "platform": platform.platform(),
        },
    }


def _source(checked: Checked, folder: Path) -> str:
    return f"{checked.rig} rig: {checked.test.name}, {header_of(folder)[0]['date']}"
