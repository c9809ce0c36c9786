"""`mckibben rig control`: a scenario on a joint rig."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.commands.options import Json, quantity_or_none, said
from mckibben.errors import ParameterError, SignalledError
from mckibben.terminal import metric, table

if TYPE_CHECKING:
    from mckibben.study.joint_rig import Ran, Session, Shown
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
    from mckibben.study.joint_rig.programs import compute_in_this_thread

    compute_in_this_thread()
    from mckibben.files import folder
    from mckibben.study.joint_rig import JointRig, prepared
    from mckibben.study.keeping import check_free
    from mckibben.study.scenario import Scenario

    read = _lasting(Scenario.read(scenario), quantity_or_none("--duration", duration, "s"))
    on = None if rig is None else JointRig.read(rig)
    if on is not None and on.nidaqmx is not None and unpaced:
        raise ParameterError("--unpaced is for the virtual joint", remedy="leave it out")
    check_free(folder(out), (*_KEPT, "record-0001.chunks"))
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
    from mckibben.study.numbers import METRICS, shown, to_json, write_json

    result, timing, name = ran.result, ran.timing, session.scenario.name
    metrics = shown(result.metrics()) if result is not None else {}
    numbers = {
        "scenario": name,
        "ended": ran.ending.kind,
        "described": ran.ending.text,
        "vented_after_s": ran.ending.vented_after,
        "outcome": result.outcome.name.lower() if result is not None else None,
        "out_of_reach": "" if ran.reach.reachable else ran.reach.describe(),
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
    said(f"kept {', '.join(kept)} in {out}", json)


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
