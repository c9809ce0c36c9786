"""A test on a rig, from the checks before it to the dataset."""

from __future__ import annotations

import os
import platform
import re
import shutil
import signal
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import mckibben
from mckibben.config.document import Document, Place, dotted
from mckibben.dataset import IsobaricDataset
from mckibben.errors import FileError, McKibbenError, McKibbenWarning, Problem, RangeError, RigError, ScenarioError
from mckibben.rig.dry_run import Outline, outline
from mckibben.rig.record import Event, Point, assemble, header_of, passages, points, read_header, segments
from mckibben.rig.recorder import Recorder
from mckibben.rig.runner import DONE, Runner, columns_of
from mckibben.rig.session import VENTED, Report
from mckibben.rig.steps import Step, described
from mckibben.storage.files import check_free, file_lock, make_folder
from mckibben.storage.interruption import handle_signals
from mckibben.study.rig.building import Setup, build_setup, build_steps
from mckibben.study.rig.document import RigTest
from mckibben.units import bar, mm, percent

if TYPE_CHECKING:
    from mckibben.rig.ni import Presence
    from mckibben.study.rig.building import Setup


def readings(protocol: Path | None) -> Iterator[tuple[str, bool]]:
    """Lines of text, each with whether all is well with what it is about. Nothing is pressed or moved.

    Parameters
    ----------
    protocol
        Whose rig is looked at, and which is then held against its limits; None is the paper's wiring on ``Dev1``.

    Raises
    ------
    ScenarioError
        If the protocol cannot be read.
    """
    from mckibben.rig.ni import present

    if protocol is None:
        yield from map(_line, present())
        return
    from mckibben.study.rig.building import build_setup, build_wiring, read_calibrations
    from mckibben.study.rig.document import read_test

    test, document = read_test(protocol)
    card = test.rig.nidaqmx
    if card is not None:
        calibrations = read_calibrations(Path(str(card.calibration)))
        yield from map(_line, present(build_wiring(card), calibrations, server=card.server or ""))
    else:
        yield from _virtual(build_setup(test))
    try:
        checked = check(test, document, source=str(protocol))
    except McKibbenError as error:
        yield str(error), False
        return
    yield checked.describe().splitlines()[-2].strip(), True
    yield "nothing stands against it", True


def _line(found: Presence) -> tuple[str, bool]:
    where = f" at {found.where}" if found.where else ""
    return f"{found.name}{where}: {found.problem or found.reading}", not found.problem


def _virtual(setup: Setup) -> Iterator[tuple[str, bool]]:
    backend, calibrations = setup.backend, setup.bench.calibrations
    yield f"rig: virtual, {backend.rate:g} Hz, vents by itself after {backend.patience:g} s", True
    backend.open()
    try:
        volts = backend.read(max(1, round(0.1 * backend.rate))).volts
    finally:
        backend.close()
    for channel, read in zip(backend.inputs, volts.T, strict=True):
        calibration = calibrations[channel.name]
        lost = bool(calibration.lost(read, channel).any())
        said = (
            "lost: check its plug and its supply" if lost else f"{calibration.si(read).mean():.4g} {calibration.unit}"
        )
        yield f"{channel.name} at {channel.where}: {read.mean():.4f} V, {said}", not lost
    for channel in backend.outputs:
        yield f"{channel.name} at {channel.where}: {channel.low:g}..{channel.high:g} V", True


@dataclass(frozen=True)
class Checked:
    """A test that may be run.

    Attributes
    ----------
    test
        The test.
    setup
        Its rig, still closed.
    steps
        What is done.
    outline
        What that takes.
    room
        On the disk [bytes]: the record and the dataset.
    """

    test: RigTest
    setup: Setup
    steps: tuple[Step, ...]
    outline: Outline
    room: int

    def describe(self) -> str:
        """The dry run in words: the steps, and what they take."""
        found, upto = self.outline, "at most " if self.outline.at_most else ""
        limits = self.setup.bench.limits
        law = f"{found.force:.0f} N by the law, " if found.force else ""
        return "\n".join(
            [
                f"{self.test.name}: {self.setup.bench.specimen.name} on the {self.rig} rig",
                *described(self.steps, 1),
                f"{upto}{_time(found.duration)}, {found.plateaus} points, {found.samples} samples, "
                f"{found.pulses} pulses, {self.room / 1e6:.0f} MB on the disk",
                f"contraction {found.contraction[0] / percent:.4g}..{found.contraction[1] / percent:.4g} %, pressure "
                f"{found.pressure[0] / bar:g}..{found.pressure[1] / bar:g} bar; {law}limits: {limits.force:g} N, "
                f"{limits.pressure / bar:g} bar, {limits.stretch / mm:g} mm to stretch, {limits.shorten / mm:g} mm to "
                "shorten",
            ]
        )

    @property
    def rig(self) -> str:
        """Which kind of rig it is."""
        return "virtual" if self.test.rig.virtual is not None else "nidaqmx"


def check(test: RigTest, document: Document | None = None, *, source: str = "protocol", session: int = 0) -> Checked:
    """Go through a test without moving anything.

    Parameters
    ----------
    test
        As read.
    document
        Its text, for the lines of what is wrong.
    source
        What errors call it.
    session
        How often the test was begun before: a virtual rig has other noise each time.

    Raises
    ------
    ScenarioError
        With all that stands against it.
    """
    lines = document or Document()
    setup = build_setup(test, session)
    try:
        steps = build_steps(test.protocol, setup.bench.of)
    except RangeError as error:
        raise ScenarioError(source, _unsuited(str(error), ("protocol", test.protocol.form), lines)) from None
    found = outline(steps, setup.bench, setup.backend.inputs, patience=setup.backend.patience)
    if found.problems:
        raise ScenarioError(source, [_placed(problem, test, lines) for problem in found.problems])
    row = sum(column.stored.itemsize for column in columns_of([one.name for one in setup.backend.inputs]))
    return Checked(test, setup, steps, found, found.bytes(row) + 2 * 4 * found.samples)


def check_room(folder: Path, needed: int) -> None:
    """Raise if a disk has not that much room left.

    Raises
    ------
    ScenarioError
        It names both.
    """
    there = folder
    while not there.exists():
        there = there.absolute().parent
    free = shutil.disk_usage(there).free
    if free < needed:
        message = f"has {free / 1e6:.0f} MB left, and the test takes up to {needed / 1e6:.0f} MB"
        raise ScenarioError(str(folder), [Problem(message, remedy="make room, or choose another folder")])


def _placed(problem: Problem, test: RigTest, lines: Document) -> Problem:
    """A problem with its place in the file, as far as the file has it."""
    parts: Sequence[str] = re.findall(r"[a-z_]+|\d+", problem.field)
    place: Place = tuple(int(part) if part.isdigit() else part for part in parts)
    if problem.field.startswith("["):
        form = test.protocol.form
        place = ("protocol", "steps", *place) if form == "steps" else ("protocol", form)
    return Problem(problem.message, lines.line(place), dotted(place), problem.remedy)


def _unsuited(text: str, place: Place, lines: Document) -> list[Problem]:
    """What a whole test says of itself: a heading, and lines of ``field: what is wrong``."""
    heading, *said = text.splitlines()
    problems = []
    for line in said or [heading]:
        field, colon, message = line.strip().partition(": ")
        at = (*place, field) if colon and field.isidentifier() else place
        problems.append(Problem(message if len(at) > len(place) else line.strip(), lines.line(at), dotted(at)))
    return problems


def _time(duration: float) -> str:
    seconds = round(duration)
    return f"{seconds // 3600} h {seconds // 60 % 60:02d} min {seconds % 60:02d} s"


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
    make_folder(folder)
    with file_lock(folder / "lock", "running a test here"):
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
    with file_lock(folder / "lock", "running a test here"):
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
        with handle_signals(lambda number: runner.interrupt(number, signal.Signals(number).name)):
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
