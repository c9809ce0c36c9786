"""`mckibben sweep`: a scenario many times, with some of its numbers varied."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.cli.options import INTERRUPTED, Json, late_progress, table
from mckibben.errors import ParameterError

if TYPE_CHECKING:
    from mckibben.study.scenario import Scenario
    from mckibben.study.sweep import SweepResult


def sweep(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="What to run; see examples/.")],
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'NAME=RANGE'", help="Vary this, such as 'load.mass2=0.2 kg..1.0 kg'; may be given several times."
        ),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="A varied number of the plant that the controller's model follows, or all of them; may be "
            "given several times. Unless given, the model stays that of the file.",
        ),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="Show what can be varied, and do nothing else.")] = False,
    design: Annotated[
        str | None, typer.Option(metavar="KIND", help="sobol (unless given), random, or grid: every combination.")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(metavar="N", help="How many runs: 1024 unless given; a grid has its own.")
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="Of the design: 0 unless given.")] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME,NAME", help="Compute these alone, such as angle_rmse,coupling; all unless given."),
    ] = None,
    precision: Annotated[
        int | None, typer.Option(metavar="BITS", help="64 (unless given), or 32: half the time, some 6 digits.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep everything here, each block of runs once it is done.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the sweep in DIR; what is left out is taken from there.")
    ] = False,
    dask: Annotated[
        str | None,
        typer.Option(metavar="CLUSTER", help="local for processes on this machine, or tcp://HOST:PORT of a scheduler."),
    ] = None,
    json: Json = False,
) -> None:
    """Run a scenario many times with some of its numbers varied; nothing that is finished is ever lost."""
    try:
        if list_:
            _list(scenario, json)
            return
        if out is None:
            raise ParameterError("there is no folder for the sweep", remedy="say where to keep it: --out DIR")
        from mckibben.storage.files import check_free
        from mckibben.study.scenario import Scenario
        from mckibben.study.sweep import sweep as run
        from mckibben.study.sweep.sweep import JOURNAL

        read = Scenario.read(scenario)
        if not resume and not (out / JOURNAL).exists():  # else `run` says what to do
            check_free(out, ("results.json", "sweep.png", "sweep.svg"))
        names = None if metrics is None else [name.strip() for each in metrics for name in each.split(",")]
        with late_progress(quiet=json) as bar:
            swept = run(
                read,
                over or None,
                out=out,
                design=design,
                samples=samples,
                seed=seed,
                metrics=names,
                precision=precision,
                known="all" if known == ["all"] else known or None,
                resume=resume,
                dask=dask,
                source=str(scenario),
                progress=_progress(bar),
            )
        _show(swept, out, json)
    except KeyboardInterrupt as stop:
        typer.echo(f"interrupted: {stop}" if str(stop) else "interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from None


def _show(swept: SweepResult, out: Path, json: bool) -> None:
    """Keep and print the statistics and the figure."""
    from mckibben.study.reporting import to_json, write_json
    from mckibben.study.sweep import summary
    from mckibben.study.sweep.result import correlation_rows, feasibility_sentence, metric_rows, outcome_rows

    numbers = summary(swept)
    write_json(out / "results.json", numbers)
    if json:
        typer.echo(to_json(numbers))
    else:
        if not swept.computed:
            typer.echo(f"the sweep in {out} is complete; nothing was computed")
        table(f"{numbers['scenario']}: {swept.count} runs", ("runs", "share", "outcome"), outcome_rows(numbers))
        headers = ("metric", "unit", "median", "5 %", "95 %", "worst", "in run", "")
        rows = metric_rows(numbers)
        if rows:
            table("Runs that did not fail", headers, rows)
        rows = correlation_rows(numbers)
        if rows:
            table("What matters: rank correlations, the strongest first", ("input", "with", "Spearman"), rows)
        typer.echo(feasibility_sentence(numbers))
    from mckibben import report

    report.save(report.sweep(swept), out, "sweep")
    typer.echo(f"kept sweep.nc, results.json and sweep.png and .svg in {out}", err=json)


def _list(path: Path, json: bool) -> None:
    from mckibben.study.reporting import to_json
    from mckibben.study.scenario import Scenario
    from mckibben.study.sweep.result import parameter_rows

    read: Scenario = Scenario.read(path)
    numbers = parameter_rows(read)
    if json:
        typer.echo(to_json(numbers))
        return
    rows = [(each["name"], each["nominal"] or "-", each["range"], each["unit"]) for each in numbers]
    table(read.name, ("can be varied", "nominal", "may be", "unit"), rows)


def _progress(bar: Callable[[str, float], None] | None) -> Callable[[int, int], None] | None:
    """What tells a bar of runs that are done: runs a second, and the time left."""
    if bar is None:
        return None
    calls, began = 0, (0.0, 0)

    def show(done: int, runs: int) -> None:
        nonlocal calls, began
        calls, now = calls + 1, time.monotonic()
        if calls <= 2:  # the first block waits for the compiler
            began = (now, done)
        said = f"{done} of {runs} runs"
        if done > began[1] and now > began[0] + 1:
            rate = (done - began[1]) / (now - began[0])
            said += f", {rate:.4g} runs/s, {_time((runs - done) / rate)} left"
        bar(said, done / runs)

    return show


def _time(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
