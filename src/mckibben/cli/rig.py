"""`mckibben rig control`: a scenario on a joint rig."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.cli.options import Json, job_progress, metric, notify, parse_optional_quantity, table
from mckibben.errors import FileError, ParameterError, Problem, SignalledError, StoppedError

if TYPE_CHECKING:
    from mckibben.realtime import Ran, Session, Shown
    from mckibben.rig.session import Progress, Report
    from mckibben.study.rig.running import Checked
    from mckibben.study.scenario import Scenario


_KEPT = ("scenario.yaml", "results.json", "result.nc", "tracking.png", "tracking.svg")
_APART = 0.25  # s


def control(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="What to run; see examples/.")],
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Where record and results go.")] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig", metavar="RIG.yaml", help="What it runs on, see examples/rig/joint-rig.yaml; else virtual."
        ),
    ] = None,
    unpaced: Annotated[
        bool, typer.Option("--unpaced", help="Let the virtual joint run as fast as it can, not in real time.")
    ] = False,
    ideal: Annotated[
        bool,
        typer.Option("--ideal", help="Measure the virtual joint perfectly, and begin as `mckibben simulate` does."),
    ] = False,
    duration: Annotated[str, typer.Option(metavar="TIME", help="Of the run: '60 s'; else the scenario's.")] = "",
    json: Json = False,
) -> None:
    """Run a scenario's controller on a joint, in real time, and record it. Ctrl-C stops it, vented.

    Exit codes: 0 done, 1 stopped (the reason is printed and recorded), 2 refused before anything moved, and 128 plus
    the signal's number (130 for Ctrl-C).
    """
    if out is None:
        raise ParameterError("there is no folder for the record", remedy="say where to keep it: --out DIR")
    from mckibben.realtime.compiled_step import compute_in_this_thread

    compute_in_this_thread()
    from mckibben.realtime import JointRig, prepared
    from mckibben.storage.files import check_free, make_folder
    from mckibben.study.scenario import Scenario

    read = _lasting(Scenario.read(scenario), parse_optional_quantity("--duration", duration, "s"))
    on = None if rig is None else JointRig.read(rig)
    if on is not None and on.nidaqmx is not None and unpaced:
        raise ParameterError("--unpaced is for the virtual joint", remedy="leave it out")
    check_free(make_folder(out), (*_KEPT, "record-0001.chunks"))
    session = prepared(read, on, source=str(scenario), paced=not unpaced, ideal=ideal)
    if not session.reach.reachable:
        typer.echo(f"warning: {session.reach.describe()}", err=True)
    read.to_yaml(out / "scenario.yaml")
    with _line(quiet=json) as show:
        ran = session.run(out, show=show)
    _report(ran, session, out, paced=not unpaced, json=json)
    error = ran.ending.error
    if error is not None:
        typer.echo(f"stopped and vented: {ran.ending.text}", err=True)
        raise typer.Exit(128 + error.signal if isinstance(error, SignalledError) else 1)
    if ran.result is not None and ran.result.outcome.lost:
        raise typer.Exit(1)


def _lasting(scenario: Scenario, duration: float | None) -> Scenario:
    """The same for another time [s]."""
    if duration is None:
        return scenario
    from mckibben.simulation.loop import sampling_times

    sampling_times(duration, scenario.control_period)  # raises where they make no sense together
    return scenario.model_copy(update={"duration": duration})


def _report(ran: Ran, session: Session, out: Path, *, paced: bool, json: bool) -> None:
    """Print what came of it, and keep it."""
    from mckibben.study.reporting import METRICS, shown, to_json, write_json

    result, timing, name = ran.result, ran.timing, session.scenario.name
    metrics = shown(result.metrics()) if result is not None else {}
    numbers = {
        "scenario": name,
        "ended": ran.ending.kind,
        "described": ran.ending.text,
        "vented_after_s": ran.ending.vented_after,
        "outcome": result.outcome.name.lower() if result is not None else None,
        "infeasible": "" if ran.reach.reachable else ran.reach.describe(),
        "metrics": metrics,
        "priority": ran.priority,
        "timing": timing.to_json() if paced else None,
    }
    write_json(out / "results.json", numbers)
    kept = ["the record", "scenario.yaml", "results.json"]
    if result is not None:
        from mckibben import report

        result.to_netcdf(out / "result.nc")
        report.save(report.tracking({name: result}), out, "tracking")
        kept += ["result.nc", "tracking.png and .svg"]
    if json:
        typer.echo(to_json(numbers))
    else:
        rows = [(METRICS[n][0].replace("_", " "), metric(n, value), METRICS[n][1]) for n, value in metrics.items()]
        if rows:
            table(name, ("metric", "value", "unit"), rows)
        if result is not None:
            typer.echo(result.describe())
        if paced:
            spreads = (
                ("sample to loop", timing.lateness),
                ("loop to valves", timing.work),
                ("jitter between commands", timing.jitter),
            )
            table(
                f"{timing.missed} of {timing.periods} deadlines missed ({timing.skipped} periods skipped, "
                f"{timing.dropped} samples dropped), {ran.priority} priority",
                ("time [us]", "median", "95 %", "99.9 %", "worst"),
                [(what, *(f"{time * 1e6:.0f}" for time in spread)) for what, spread in spreads],
            )
        vented = ran.ending.vented_after
        typer.echo(
            "the pressures were not seen to fall: look before you touch"
            if vented is None
            else f"both muscles below 0.2 bar {vented * 1e3:.0f} ms after the vent"
        )
    notify(f"kept {', '.join(kept)} in {out}", json)


class _Line:
    """A line on the terminal: how far it is, angle and pressures, missed deadlines.

    The loop leaves what it has to tell, and a thread shows it a few times a second. The thread begins with the loop and
    so has its priority: one that had less could keep the interpreter from the loop for long.
    """

    def __init__(self) -> None:
        self._shown: Shown | None = None
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    def __call__(self, shown: Shown) -> None:
        self._shown = shown
        if self._thread is None:
            self._thread = threading.Thread(target=self._show, name="progress", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Show the last of it."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
            sys.stderr.write("\n")

    def _show(self) -> None:
        while True:
            over = self._over.wait(_APART)
            assert self._shown is not None
            sys.stderr.write(f"\r{_text(self._shown)}\x1b[K")
            sys.stderr.flush()
            if over:
                return


@contextmanager
def _line(*, quiet: bool) -> Iterator[_Line | None]:
    """The line, where there is a terminal to show it on."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    line = _Line()
    try:
        yield line
    finally:
        line.close()


def _text(now: Shown) -> str:
    from mckibben.units import bar, deg

    wish = f" (wish {now.wish / deg:6.2f})" if now.wish == now.wish else ""
    reading = now.reading
    return (
        f"{now.phase.name.lower()} {now.time:6.2f} of {now.of:.4g} s  {reading.angle / deg:6.2f} deg{wish}  "
        f"{reading.pressure1 / bar:5.2f} {reading.pressure2 / bar:5.2f} bar  missed {now.missed}"
    )


rig = typer.Typer(
    name="rig",
    help="Tests on a rig, virtual or real: record them so that nothing is lost, and vent when anything is wrong.",
    no_args_is_help=True,
)

Protocol = Annotated[
    Path, typer.Argument(metavar="PROTOCOL.yaml", help="What to do; see examples/rig/paper-protocol.yaml.")
]


@rig.command()
def run(
    protocol: Protocol,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where protocol, record and dataset go.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the test in DIR, at the next point.")] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the steps and what they take; move nothing.")
    ] = False,
    standing_at: Annotated[
        str,
        typer.Option(
            metavar="CONTRACTION", help="With --resume: where the motor stands, if it was left in the middle."
        ),
    ] = "",
    json: Json = False,
) -> None:
    """Run a test and record it. Ctrl-C stops it, vented; --resume goes on.

    Exit codes: 0 done, 1 stopped (the reason is printed and recorded), 2 refused before anything moved, and 128 plus
    the signal's number (130 for Ctrl-C).
    """
    from mckibben.rig.record import segments
    from mckibben.study.reporting import to_json
    from mckibben.study.rig.document import read_test
    from mckibben.study.rig.running import check, check_room

    standing = parse_optional_quantity("--standing-at", standing_at, "1")
    if standing is not None and not resume:
        raise ParameterError("--standing-at is for a test that goes on", remedy="add --resume")
    test, document = read_test(protocol)
    checked = check(test, document, source=str(protocol), session=len(segments(out)) if out else 0)
    if dry_run:
        if out:
            check_room(out, checked.room)
        typer.echo(to_json(_numbers(checked)) if json else checked.describe())
        return
    if out is None:
        raise FileError(str(protocol), [Problem("needs a folder to record to", remedy="add --out DIR, or --dry-run")])
    from mckibben.study.rig.running import data_name, run_test

    begun = time.monotonic()
    try:
        with _shown(checked, quiet=json) as report:
            data = run_test(checked, out, resume=resume, standing_at=standing, report=report)
    except StoppedError as error:
        typer.echo(str(error), err=True)
        typer.echo(f"go on with: mckibben rig run {protocol} --out {out} --resume", err=True)
        raise typer.Exit(128 + error.signal if isinstance(error, SignalledError) else 1) from None
    name = out / data_name(test)
    if json:
        typer.echo(to_json({**_numbers(checked), "data": str(name), "points": len(data)}))
    else:
        typer.echo(repr(data))
    notify(f"recorded in {out} within {time.monotonic() - begun:.0f} s; next: mckibben identify {name}", json)


@rig.command()
def data(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder of `rig run --out`.")],
) -> None:
    """Make the dataset of what was recorded so far, of a test that is not to go on."""
    from mckibben.study.rig.running import gather

    typer.echo(repr(gather(folder)))


@rig.command()
def check(
    protocol: Annotated[
        Path | None, typer.Argument(metavar="[PROTOCOL.yaml]", help="Whose rig and limits; none: what is connected.")
    ] = None,
) -> None:
    """Show what is connected and what each channel reads, or what is missing; and what stands against a protocol."""
    from mckibben.study.rig.running import readings

    missing = False
    for line, there in readings(protocol):
        typer.echo(line)
        missing |= not there
    if missing:
        raise typer.Exit(1)


rig.command()(control)


def _numbers(checked: Checked) -> dict[str, object]:
    found = checked.outline
    return {
        "name": checked.test.name,
        "rig": checked.rig,
        "duration_s": found.duration,
        "upper_bounds": found.at_most,
        "points": found.plateaus,
        "samples": found.samples,
        "pulses": found.pulses,
        "disk_bytes": checked.room,
        "highest_force_N": found.force,
    }


@contextmanager
def _shown(checked: Checked, *, quiet: bool) -> Iterator[Report | None]:
    """A line on the terminal: how far it is, what is measured, how long it takes yet by the rig's clock."""
    from mckibben.units import bar, percent

    found = checked.outline
    total = max(1, found.plateaus)
    with job_progress(quiet=quiet, width=8) as bars:
        if bars is None:
            yield None
            return
        last = [-math.inf]

        def report(progress: Progress) -> None:
            wall, part = time.monotonic(), min(1.0, progress.points / total)
            if wall - last[0] < 0.1 and part < 1.0:
                return
            last[0] = wall
            seen = progress.seen
            bars(  # 80 columns hold it
                f"{seen.pressure / bar:5.2f} bar {seen.force:6.1f} N {progress.contraction / percent:5.1f} %  "
                f"{progress.points}/{total}  {_duration(found.duration * (1 - part))} left",
                part,
            )

        yield report


def _duration(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 3600} h {whole // 60 % 60:02d} min" if whole >= 3600 else f"{whole // 60} min {whole % 60:02d} s"
