"""`mckibben rig`: run a test on a rig, and see beforehand what stands against it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.commands.interruptible import late_progress
from mckibben.commands.options import Json, quantity_or_none, said
from mckibben.commands.rig_control import control
from mckibben.errors import FileError, ParameterError, Problem, SignalledError, StoppedError

if TYPE_CHECKING:
    from mckibben.rig.handling import Progress, Report
    from mckibben.study.rig.checking import Checked

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
    from mckibben.study.numbers import to_json
    from mckibben.study.rig.checking import check, check_room
    from mckibben.study.rig.document import read_test

    standing = quantity_or_none("--standing-at", standing_at, "1")
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
    said(f"recorded in {out} within {time.monotonic() - begun:.0f} s; next: mckibben identify {name}", json)


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
    from mckibben.study.rig.presence import readings

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
    with late_progress(quiet=quiet, width=8) as bars:
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
