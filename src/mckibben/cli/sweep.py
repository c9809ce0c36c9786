"""`mckibben sweep`: runs of a scenario over ranges of its parameters."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mckibben.cli.options import Json, long_job, required_folder, table

if TYPE_CHECKING:
    from mckibben.study.scenario import Scenario
    from mckibben.study.sweep import SweepResult


def sweep(
    scenario: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="Scenario file; see examples/.")],
    over: Annotated[
        list[str] | None,
        typer.Option(
            metavar="'NAME=RANGE'", help="Parameter and its range, such as 'load.mass2=0.2 kg..1.0 kg'; repeatable."
        ),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Varied plant parameter that the controller's model follows, or 'all'; repeatable. By default the "
            "controller's model keeps the values of the file.",
        ),
    ] = None,
    list_: Annotated[bool, typer.Option("--list", help="List the parameters that can be varied, and exit.")] = False,
    design: Annotated[
        str | None, typer.Option(metavar="KIND", help="Design: sobol (default), random, or grid (full factorial).")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(metavar="N", help="Number of runs (default 1024); a grid has its own.")
    ] = None,
    seed: Annotated[int | None, typer.Option(metavar="N", help="Seed of the design (default 0).")] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME,NAME", help="Metrics to compute, such as angle_rmse,coupling (default: all)."),
    ] = None,
    precision: Annotated[
        int | None, typer.Option(metavar="BITS", help="64 (default) or 32 bits: half the time, about 6 digits.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Output folder; each block of runs is kept when it is done.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the sweep in DIR with its options.")] = False,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="CLUSTER", help="local (processes of this machine), or tcp://HOST:PORT of a dask scheduler."
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Run a scenario over ranges of its parameters; finished runs are kept, and the sweep can be resumed."""
    if list_:
        _list(scenario, json)
        return
    out = required_folder(out, "sweep")
    with long_job(quiet=json, kept=f"finished blocks are in {out}; continue with --resume") as bar:
        from mckibben.storage.files import check_free
        from mckibben.study.scenario import Scenario
        from mckibben.study.sweep import sweep as run
        from mckibben.study.sweep.sweep import JOURNAL

        read = Scenario.read(scenario)
        if not resume and not (out / JOURNAL).exists():  # an existing sweep is reported by `run`
            check_free(out, ("results.json", "sweep.png", "sweep.svg"))
        names = None if metrics is None else [name.strip() for each in metrics for name in each.split(",")]
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


def _show(swept: SweepResult, out: Path, json: bool) -> None:
    """Write and print the statistics, and write the figure."""
    from mckibben.storage.files import to_json, write_json
    from mckibben.study.sweep import summary
    from mckibben.study.sweep.result import correlation_rows, feasibility_sentence, metric_rows, outcome_rows

    numbers = summary(swept)
    write_json(out / "results.json", numbers)
    if json:
        typer.echo(to_json(numbers))
    else:
        if not swept.computed:
            typer.echo(f"the sweep in {out} is already complete")
        table(f"{numbers['scenario']}: {swept.count} runs", ("runs", "share", "outcome"), outcome_rows(numbers))
        headers = ("metric", "unit", "median", "5 %", "95 %", "worst", "in run", "")
        rows = metric_rows(numbers)
        if rows:
            table("Runs that completed", headers, rows)
        rows = correlation_rows(numbers)
        if rows:
            table("Rank correlations, strongest first", ("parameter", "metric", "Spearman"), rows)
        typer.echo(feasibility_sentence(numbers))
    from mckibben import report

    report.save(report.sweep(swept), out, "sweep")
    typer.echo(f"wrote sweep.nc, results.json, sweep.png and sweep.svg to {out}", err=json)


def _list(path: Path, json: bool) -> None:
    from mckibben.storage.files import to_json
    from mckibben.study.scenario import Scenario
    from mckibben.study.sweep.result import parameter_rows

    read: Scenario = Scenario.read(path)
    numbers = parameter_rows(read)
    if json:
        typer.echo(to_json(numbers))
        return
    rows = [(each["name"], each["nominal"] or "-", each["range"], each["unit"]) for each in numbers]
    table(read.name, ("parameter", "value", "range", "unit"), rows)


def _progress(bar: Callable[[str, float], None] | None) -> Callable[[int, int], None] | None:
    """Progress callback with the rate of runs and the remaining time."""
    if bar is None:
        return None
    calls, began = 0, (0.0, 0)

    def show(done: int, runs: int) -> None:
        nonlocal calls, began
        calls, now = calls + 1, time.monotonic()
        if calls <= 2:  # the first block includes compilation
            began = (now, done)
        text = f"{done} of {runs} runs"
        if done > began[1] and now > began[0] + 1:
            rate = (done - began[1]) / (now - began[0])
            text += f", {rate:.4g} runs/s, {_time((runs - done) / rate)} left"
        bar(text, done / runs)

    return show


def _time(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
