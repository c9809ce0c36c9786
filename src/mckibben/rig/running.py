"""Session of a test on a rig, from the checks before it to the dataset."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mckibben.config.document import Document, Place, dotted
from mckibben.dataset import IsobaricDataset, Recording
from mckibben.errors import FileError, McKibbenError, ParameterError, Problem, RangeError, RigError, ScenarioError
from mckibben.rig.backend import ChannelStatus, MovingBackend
from mckibben.rig.bench import Bench
from mckibben.rig.by_hand import HandBench
from mckibben.rig.document import RigTest, read_test
from mckibben.rig.dry_run import DryRun, dry_run
from mckibben.rig.protocol import steps_text
from mckibben.rig.record import (
    RecordedPoint,
    Recorder,
    assemble,
    header_of,
    read_record,
    recording_of,
    segments,
    software_versions,
)
from mckibben.rig.runner import BLOCK, DONE, VENTED, ProgressCallback, Runner, columns_of
from mckibben.rig.safety import stop_on_signals
from mckibben.rig.steps import ProtocolStep
from mckibben.storage.files import check_free, file_lock, make_folder
from mckibben.units import bar, mm, percent


def readings(protocol: Path) -> Iterator[tuple[str, bool]]:
    """Status of the channels of a protocol's rig, and its violations: lines, each with whether it is in order."""
    test, document = read_test(protocol)
    yield from map(status_line, test.rig.backend().status())
    try:
        checked = check(test, document, source=str(protocol))
    except McKibbenError as error:
        yield str(error), False
        return
    yield checked.describe().splitlines()[-2].strip(), True
    yield "no violations", True


def status_line(channel: ChannelStatus) -> tuple[str, bool]:
    """Line of a channel, and whether it works."""
    where = f" at {channel.where}" if channel.where else ""
    return f"{channel.name}{where}: {channel.problem or channel.reading}", not channel.problem


@dataclass(frozen=True)
class CheckedTest:
    """A checked test: its rig (closed), bench, steps, and dry run."""

    test: RigTest
    backend: MovingBackend
    bench: Bench
    steps: tuple[ProtocolStep, ...]
    dry_run: DryRun

    def describe(self) -> str:
        """Text of the dry run."""
        run, about = self.dry_run, "about " if self.dry_run.estimated else ""
        limits = self.bench.limits
        law = f"{run.force:.0f} N by the law, " if run.force else ""
        return "\n".join(
            [
                f"{self.test.name}: {self.bench.specimen.name} on the {self.rig} rig",
                steps_text(self.steps).rstrip(),
                f"{about}{_time(run.duration)}, {run.plateaus} points, {run.samples} samples, "
                f"{run.travel:.3g} m of travel",
                f"contraction {run.contraction[0] / percent:.4g}..{run.contraction[1] / percent:.4g} %, pressure "
                f"{run.pressure[0] / bar:g}..{run.pressure[1] / bar:g} bar; {law}limits: {limits.force:g} N, "
                f"{limits.pressure / bar:g} bar, {limits.stretch / mm:g} mm to stretch, {limits.shorten / mm:g} mm to "
                "shorten",
            ]
        )

    @property
    def rig(self) -> str:
        """Kind of the rig."""
        return self.backend.description["kind"]


def check(
    test: RigTest, document: Document | None = None, *, source: str = "protocol", session: int = 0
) -> CheckedTest:
    """Check a test by a dry run, in which nothing moves.

    Parameters
    ----------
    test
        Specimen, rig, limits and protocol.
    document
        Lines of the file that it comes from.
    source
        Name of the file, for errors.
    session
        Number of the session, from 0.

    Raises
    ------
    ScenarioError
        With all problems, at their lines in the document.
    """
    lines, backend = document or Document(), test.rig.backend(session)
    bench = test.bench(backend)
    try:
        steps = test.protocol.steps_for(bench.of)
    except RangeError as error:
        problems = error.problems or [Problem.of(error, field=error.field)]
        raise ScenarioError(source, [_with_line(problem, test, lines) for problem in problems]) from None
    run = dry_run(steps, bench, [*backend.inputs, *backend.outputs], patience=backend.patience)
    if run.problems:
        raise ScenarioError(source, [_with_line(problem, test, lines) for problem in run.problems])
    return CheckedTest(test, backend, bench, steps, run)


def simulate_operator(checked: CheckedTest) -> None:
    """Let the muscle of the protocol hang on the bench, so that nobody is asked for its lengths.

    Raises `ParameterError` if no weights hang on the muscle of the rig, or it has no law.
    """
    bench, muscle = checked.backend, checked.test.muscle
    if not isinstance(bench, HandBench) or not bench.weights:
        remedy = "leave it out, or give the rig `moved_by: weights`"
        raise ParameterError("nobody hangs weights on the muscle of this rig", field="operator", remedy=remedy)
    if muscle.law is None:
        remedy = "give the protocol's muscle one, such as `law: lei-mas-10-180n`"
        raise ParameterError("a simulated operator needs the law of a muscle", field="operator", remedy=remedy)
    bench.simulated = muscle.muscle()


def _with_line(problem: Problem, test: RigTest, lines: Document) -> Problem:
    """A problem of a step, of the protocol as a whole, or of another section, with its line in the file."""
    parts = re.findall(r"[a-z_]+|\d+", problem.field)
    place: Place = tuple(int(part) if part.isdigit() else part for part in parts)
    form = test.protocol.short_name
    if problem.field.startswith("["):
        place = ("protocol", "steps", *place) if form == "steps" else ("protocol", form)
    elif not place or place[0] not in RigTest.model_fields:
        place = lines.known(("protocol", form, *place))
    return replace(problem, line=lines.line(place), field=dotted(place))


def _time(duration: float) -> str:
    seconds = round(duration)
    return f"{seconds // 3600} h {seconds // 60 % 60:02d} min {seconds % 60:02d} s"


PROTOCOL = "protocol.yaml"
"""Protocol in the folder of a record."""


@dataclass(frozen=True)
class _PastSessions:
    """State of a recorded test: `position` is that of the motor, and `certain` whether it was measured at rest."""

    done: tuple[RecordedPoint, ...] = ()
    since: float = 0.0
    position: float = 0.0
    certain: bool = True
    finished: bool = False


def data_name(test: RigTest) -> str:
    """File name of the dataset: ``isobaric.nc``, ``isometric.nc`` ..., ``points.nc`` of steps."""
    return "points.nc" if test.protocol.short_name == "steps" else f"{test.protocol.short_name}.nc"


def run_test(
    checked: CheckedTest,
    folder: str | os.PathLike[str],
    *,
    resume: bool = False,
    standing_at: float | None = None,
    report: ProgressCallback | None = None,
) -> IsobaricDataset:
    """Run a checked test, record it, and make its dataset; a test that is stopped is vented, and can be resumed.

    Parameters
    ----------
    checked
        Test that has passed `check`.
    folder
        Folder of protocol, record and dataset.
    resume
        Continue the test in the folder at its next point.
    standing_at
        Contraction [-] at which the motor stands. Default: as known from the rig or its record.
    report
        Called with the progress after each point.

    Raises
    ------
    FileError
        If the folder has a record and `resume` is not set, or the reverse; if it is in use; or if the position of the
        motor is not known.
    ScenarioError
        If the folder has another test.
    RigError
        If the rig fails; `StoppedError` once it has begun, `SignalledError` after a signal.
    """
    folder = Path(folder)
    recorded = bool(segments(folder))
    if resume and not recorded and not (folder / PROTOCOL).exists():
        raise FileError(str(folder), [Problem("contains no test to resume", remedy="leave --resume out")])
    if recorded and not resume:
        remedy = "resume it (--resume), or choose another folder"
        raise FileError(str(folder), [Problem("contains a record", remedy=remedy)])
    if not recorded:
        names = [data_name(checked.test), *([] if resume else [PROTOCOL])]
        check_free(folder, names, "resume the test (--resume), or choose another folder")
    make_folder(folder)
    with file_lock(folder / "lock", "running a test here"):
        if resume:
            _check_same(checked, folder)
        past = _past(folder) if resume else _PastSessions()
        if not past.finished:
            if not resume:
                checked.test.to_yaml(folder / PROTOCOL)
            try:
                _run_session(checked, folder, past, standing_at, report)
            except RigError:
                if not resume and not segments(folder):  # it did not begin
                    (folder / PROTOCOL).unlink(missing_ok=True)
                raise
        return _save_dataset(checked, folder)


def gather(folder: str | os.PathLike[str]) -> IsobaricDataset:
    """Make the dataset of the record in a folder, finished or not; `FileError` if there is none."""
    folder = Path(folder)
    checked = check(_kept_test(folder))
    with file_lock(folder / "lock", "running a test here"):
        return _save_dataset(checked, folder)


def gather_recording(folder: str | os.PathLike[str]) -> Recording:
    """Return all samples of the record in a folder over time; `FileError` if there is none."""
    folder = Path(folder)
    checked = check(_kept_test(folder))
    return recording_of(folder, checked.bench, source=_source(checked, folder))


def _kept_test(folder: Path) -> RigTest:
    """Test of a folder: that of its record, or of its protocol if nothing is recorded yet."""
    path = folder / PROTOCOL
    if segments(folder):
        protocol = header_of(folder)[0].get("protocol")
        if protocol is None:
            remedy = f"give a folder of `rig run`; {folder / 'result.nc'} is for `mckibben calibrate --recording`"
            raise FileError(str(folder), [Problem("contains a run of `rig control`, and no test", remedy=remedy)])
        return RigTest.parse(protocol, source=f"the record in {folder}", folder=folder)
    if not path.exists():
        raise FileError(str(folder), [Problem("contains no test", remedy="give the folder of `rig run --out`")])
    return RigTest.read(path)


def _save_dataset(checked: CheckedTest, folder: Path) -> IsobaricDataset:
    data = assemble(folder, checked.bench, source=_source(checked, folder))
    name = data_name(checked.test)
    try:
        data.to_netcdf(folder / name)
    except OSError as error:
        problem = f"it cannot be written: {os.strerror(error.errno) if error.errno else error}"
        remedy = f"the record is complete: free some space, then mckibben rig data {folder}"
        raise FileError(str(folder / name), [Problem(problem, remedy=remedy)]) from error
    return data


def _run_session(
    checked: CheckedTest, folder: Path, past: _PastSessions, standing_at: float | None, report: ProgressCallback | None
) -> None:
    origin = _origin(checked, folder, past, standing_at)
    columns, protocol = columns_of(checked.backend.inputs), checked.test.dumps(folder=folder)
    with (
        Recorder(folder, _header(checked, protocol), columns, {PROTOCOL: protocol.encode()}, resume=True) as recorder,
        stop_on_signals() as stop_flag,
    ):
        settings = {"origin": origin, "since": past.since, "report": report, "stop_flag": stop_flag}
        Runner(checked.backend, checked.bench, recorder, done=past.done, **settings).run(checked.steps)


def _origin(checked: CheckedTest, folder: Path, past: _PastSessions, standing_at: float | None) -> float:
    bench = checked.bench
    if standing_at is not None:
        return bench.position_at(standing_at)
    if checked.backend.homed:
        return 0
    if not past.certain:
        message = f"the position of the motor is not known (the record ends at {past.position / mm:.4g} mm)"
        remedy = "measure it, and give the contraction there (--standing-at '5 %')"
        raise FileError(str(folder), [Problem(message, remedy=remedy)])
    return past.position


def _past(folder: Path) -> _PastSessions:
    """State of the recorded test."""
    if not segments(folder):
        return _PastSessions()
    record = read_record(folder)
    events, times, positions = record.events, record.columns["time"], record.columns["position"]
    whole = 0
    for number, point in enumerate(record.points):
        if point.number != number or np.isnan(record.samples("time", point)).any():
            break
        whole += 1
    finished = any(event.kind == DONE for event in events)
    begun = [event.data["points"] for event in events if event.kind == BLOCK and event.data["points"] <= whole]
    at_rest = events[-1].data.get("position") if events and events[-1].kind in (VENTED, DONE) else None
    since = float(times[-1]) + 1 / record.header["rate_Hz"] if len(times) else 0.0
    position = float(positions[-1]) if len(positions) else 0.0
    return _PastSessions(
        tuple(record.points[: whole if finished else max(begun, default=0)]),
        since,
        position if at_rest is None else at_rest,
        not events or at_rest is not None,
        finished,
    )


def _check_same(checked: CheckedTest, folder: Path) -> None:
    """Check that the test in the folder is this one, with the same steps."""
    recorded = _kept_test(folder)
    if not checked.test.is_same(recorded):
        remedy = f"resume it with its own protocol ({folder / PROTOCOL}), or choose another folder"
        raise ScenarioError(str(folder), [Problem("contains another test", remedy=remedy)])
    if segments(folder) and header_of(folder)[0]["steps"] != steps_text(checked.steps):
        remedy = "restore the files that the protocol names, such as that of its law"
        raise ScenarioError(str(folder), [Problem("contains a test of other steps", field="steps", remedy=remedy)])


def _header(checked: CheckedTest, protocol: str) -> dict[str, object]:
    return {
        "protocol": protocol,
        "steps": steps_text(checked.steps),
        "rig": dict(checked.backend.description),
        "rate_Hz": checked.bench.rate,
        "bench": _described(checked),
        "clock": "time_s is the card's, from the beginning of the test; interruptions are left out",
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "versions": software_versions("numpy"),
    }


def _described(checked: CheckedTest) -> dict[str, object]:
    """Bench for readers of the record: the line from the position of the motor to the contraction."""
    bench, length = checked.bench, float(checked.bench.specimen.initial_length)
    origin = {
        "specimen": bench.specimen.name,
        "initial_length": f"{length!r} m",
        "slack_force": f"{bench.slack_force!r} N",
        "source": f"{checked.rig} rig: {checked.test.name}",
        "preprocessing": "none",
    }
    return {"mounted_at": bench.mounted_at, "initial_length": length, "origin": origin}


def _source(checked: CheckedTest, folder: Path) -> str:
    return f"{checked.rig} rig: {checked.test.name}, {header_of(folder)[0]['date']}"
