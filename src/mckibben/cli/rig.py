"""`mckibben rig`: tests on a test rig, and a scenario on a joint rig."""

from __future__ import annotations

import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument

from mckibben.cli.command import command, plain_command, present
from mckibben.cli.help import Command, Commands
from mckibben.cli.options import ScenarioFile, check_unused, echo, job_progress, parse_quantity, required_folder
from mckibben.errors import FileError, ParameterError, Problem, SignalledError, StoppedError
from mckibben.storage.files import check_free, make_folder
from mckibben.units import bar, percent

if TYPE_CHECKING:
    from mckibben.rig import RunProgress
    from mckibben.rig.runner import Progress, ProgressCallback
    from mckibben.rig.running import CheckedTest
    from mckibben.rig.sensor_line import SensorLine


_RECORDING = "recording.nc"
_INTERVAL = 0.25  # s


@plain_command
def control(
    scenario: ScenarioFile,
    out: Path | None = None,
    rig: Path | None = None,
    unpaced: bool = False,
    ideal: bool = False,
    check: bool = False,
    service: Path | None = None,
    json: bool = False,
) -> None:
    """Run a scenario's controller on a joint or robot in real time, and record it. Ctrl-C stops it and vents.

    Exit codes: 0 done, 1 stopped (the reason is printed and recorded), 2 refused before anything moved, and 128 plus
    the signal's number (130 for Ctrl-C).

    Parameters
    ----------
    out : DIR
        Folder of record and results.
    rig : RIG.yaml
        Rig, see examples/rig/ (default: simulated).
    unpaced
        Run the simulated joint as fast as possible.
    ideal
        Ideal sensors, and the same start as `mckibben simulate`.
    check
        Show the reading of each sensor of the rig; nothing is set or recorded.
    service : SERVICE.yaml
        Estimate the stiffness on the way, and let the controller's model follow it; a file of `mckibben calibrate`.
    json
        Print machine-readable results instead of a table.
    """
    from mckibben.rig import JointRig, JointRunResult, prepare
    from mckibben.rig.running import status_line
    from mckibben.scenario import Scenario

    read = Scenario.read(scenario)
    on = None if rig is None else JointRig.read(rig, joint_type=read.joint_type)
    if on is not None and on.physical and unpaced:
        raise ParameterError("--unpaced applies to the simulated joint", remedy="leave it out")
    if check:
        check_unused("--check", service=service)
        session = prepare(read, on, source=str(scenario), paced=not unpaced, ideal=ideal)
        _show_status(map(status_line, session.status()))
        return
    out = required_folder(out, "run")
    check_free(make_folder(out), (*JointRunResult.file_names(), "record-0001.mcap"))
    serving, firmware = None, read
    if service is not None:
        from mckibben.calibration.serving import InService, serve

        serving = serve(read, InService.read(service), elsewhere=not unpaced)
        read = serving.scenario
    session = prepare(read, on, source=str(scenario), paced=not unpaced, ideal=ideal, firmware=firmware)
    for warning in session.warnings:
        echo(f"warning: {warning}", err=True)
    with run_line(quiet=json) as progress:
        try:
            ran = session.run(out, progress=progress, service=serving)
        except StoppedError as stopped:
            echo(str(stopped), err=True)
            raise typer.Exit(1) from None
    error = ran.outcome.error
    if error is not None:  # before the results, as the disk may be full
        echo(f"stopped: {ran.outcome.text}; {ran.outcome.venting}", err=True)
    try:
        present(ran, json=json, out=out, force=True)
    finally:
        if error is not None:
            raise typer.Exit(128 + error.signal if isinstance(error, SignalledError) else 1)


@contextmanager
def run_line(*, quiet: bool) -> Iterator[Callable[[RunProgress], None] | None]:
    """Progress line of a run on a joint rig, if there is a terminal.

    A thread with the loop's priority writes it, as the loop could wait for one of lower priority.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    latest: deque[RunProgress] = deque(maxlen=1)
    over = threading.Event()

    def write() -> None:
        while True:
            ended = over.wait(_INTERVAL)
            sys.stderr.write(f"\r{_text(latest[0])}\x1b[K")
            sys.stderr.flush()
            if ended:
                return

    thread = threading.Thread(target=write, name="progress", daemon=True)

    def show(now: RunProgress) -> None:
        latest.append(now)
        if thread.ident is None:
            thread.start()

    try:
        yield show
    finally:
        over.set()
        if latest:
            thread.join()
            sys.stderr.write("\n")


def _text(now: RunProgress) -> str:
    size, unit = now.joint_type.size("deg"), now.joint_type.shown("deg")
    angles = " ".join(f"{angle / size:6.2f}" for angle in now.angles)
    references = " ".join(f"{angle / size:6.2f}" for angle in now.references)
    told = f" (reference {references})" if len(now.references) == 1 else ""
    pressures = [pressure / bar for pressure in now.pressures]
    several = len(pressures) > 2
    read = f"{min(pressures):.2f}..{max(pressures):.2f}" if several else " ".join(f"{p:5.2f}" for p in pressures)
    time = f"{now.time:6.2f} of {now.duration:.4g} s"
    return f"{now.phase.name.lower()} {time}  {angles} {unit}{told}  {read} bar  missed {now.missed}"


rig = typer.Typer(
    cls=Commands,
    name="rig",
    help="Tests on a simulated or physical rig, recorded, resumable, with a safety monitor that vents.",
    no_args_is_help=True,
)


@rig.command(cls=Command)
@plain_command
def run(
    protocol: Path,
    out: Path | None = None,
    resume: bool = False,
    dry_run: bool = False,
    standing_at: str = "",
    operator: Literal["person", "simulated"] = "person",
) -> None:
    """Run a test and record it. Ctrl-C stops it and vents; --resume continues it.

    Exit codes: 0 done, 1 stopped (the reason is printed and recorded), 2 refused before anything moved, and 128 plus
    the signal's number (130 for Ctrl-C).

    Parameters
    ----------
    protocol : PROTOCOL.yaml
        Protocol; see examples/rig/paper-protocol.yaml.
    out : DIR
        Folder of protocol, record and dataset.
    resume
        Resume the test in DIR at the next point.
    dry_run
        Print steps, duration and violations, without moving.
    standing_at : CONTRACTION
        With --resume: position of the motor, if unknown.
    operator
        Who hangs weights and gives lengths: a person, or by the law of the protocol's muscle the simulation.
    """
    from mckibben.rig.document import read_test
    from mckibben.rig.record import segments
    from mckibben.rig.running import check, simulate_operator

    standing = parse_quantity("--standing-at", standing_at, "1") if standing_at else None
    if standing is not None and not resume:
        raise ParameterError("--standing-at applies to a resumed test", remedy="add --resume")
    test, document = read_test(protocol)
    checked = check(test, document, source=str(protocol), session=len(segments(out)) if out else 0)
    if operator == "simulated":
        simulate_operator(checked)
    if dry_run:
        echo(checked.describe())
        return
    if out is None:
        raise FileError(str(protocol), [Problem("needs a folder for the record", remedy="add --out DIR, or --dry-run")])
    from mckibben.rig.running import data_name, run_test

    begun = time.monotonic()
    try:
        with _progress_line(checked) as report:
            data = run_test(checked, out, resume=resume, standing_at=standing, report=report)
    except StoppedError as error:
        echo(str(error), err=True)
        if segments(out):
            echo(f"resume with: mckibben rig run {protocol} --out {out} --resume", err=True)
        raise typer.Exit(128 + error.signal if isinstance(error, SignalledError) else 1) from None
    name = out / data_name(test)
    echo(repr(data))
    echo(f"recorded in {out} within {time.monotonic() - begun:.0f} s; next: mckibben identify {name}")


@rig.command(cls=Command)
@plain_command
def data(folder: Path, recording: bool = False) -> None:
    """Make the dataset of a test from its record, complete or not.

    Parameters
    ----------
    folder : DIR
        A folder of `rig run --out`.
    recording
        All samples over time, too, as for `points`: recording.nc in DIR.
    """
    from mckibben.rig.running import gather, gather_recording

    if recording:
        check_free(folder, [_RECORDING])
    echo(repr(gather(folder)))
    if recording:
        whole = gather_recording(folder)
        whole.to_netcdf(folder / _RECORDING)
        echo(repr(whole))


@rig.command(cls=Command)
def check(protocol: Annotated[Path, Argument(metavar="PROTOCOL.yaml", help="Protocol of the rig.")]) -> None:
    """Show the status of each channel, and all violations of a protocol."""
    from mckibben.rig.running import readings

    _show_status(readings(protocol))


@rig.command(cls=Command, context_settings={"ignore_unknown_options": True})  # of negative readings
@command
def line(
    readings: Annotated[list[str], Argument(metavar="READING=VALUE...", help='Such as "0.51 = 98.1 N".')],
) -> SensorLine:
    """Fit gain and offset of a channel to readings at known values, such as weights on a load cell."""
    from mckibben.rig.sensor_line import sensor_line

    return sensor_line(readings)


def _show_status(lines: Iterable[tuple[str, bool]]) -> None:
    """Print lines, each with whether it is in order, and exit with 1 if one is not."""
    missing = False
    for line, there in lines:
        echo(line)
        missing |= not there
    if missing:
        raise typer.Exit(1)


rig.command(cls=Command)(control)


@contextmanager
def _progress_line(checked: CheckedTest) -> Iterator[ProgressCallback | None]:
    """Progress line on the terminal."""
    total = max(1, checked.dry_run.plateaus)
    with job_progress(width=8) as show:

        def report(progress: Progress) -> None:
            assert show is not None
            latest = progress.latest
            state = f"{latest.pressure / bar:5.2f} bar {latest.force:6.1f} N {progress.contraction / percent:5.1f} %"
            show(f"{state}  {progress.points}/{total}", min(1.0, progress.points / total))  # fits 80 columns

        yield report if show else None
