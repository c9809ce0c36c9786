"""`mckibben bench`: models of muscles on tasks with fixed splits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Exit, Option

from mckibben.cli.options import (
    Force,
    Json,
    Out,
    check_choice,
    echo,
    job_progress,
    keeping,
    notify,
    results_folder,
    table,
)
from mckibben.storage.files import to_json, write_json


def bench(
    submissions: Annotated[
        list[Path] | None, Argument(metavar="[SUBMISSION.py]...", help="Files with a function fit(training).")
    ] = None,
    tasks: Annotated[str, Option(metavar="NAMES", help="Tasks, such as 'map-wall, joint' (default: all).")] = "",
    baselines: Annotated[
        str, Option(metavar="NAMES", help="Baselines, such as 'eq2, gp' (default: all), or 'none'.")
    ] = "",
    data: Annotated[
        list[Path] | None,
        Option(metavar="FOLDER", help="Folder with a task.yaml, in place of the built-in tasks; repeatable."),
    ] = None,
    show: Annotated[bool, Option("--list", help="List tasks and baselines, and compute nothing.")] = False,
    json: Json = False,
    out: Out = None,
    force: Force = False,
) -> None:
    """Compare models of muscles on fixed tasks: Eq. 2 and other baselines, and submissions of one Python file."""
    from mckibben.bench import BASELINES, TASKS, compare_submissions, read_task, task_named
    from mckibben.bench.comparison import FILES

    results_folder(out, FILES, force)
    names = [one.strip() for one in tasks.split(",") if one.strip()]
    for one in names:
        check_choice(one, TASKS, "a task")
    methods = [one.strip() for one in baselines.split(",") if one.strip()] or list(BASELINES)
    methods = [] if methods == ["none"] else methods
    for one in methods:
        check_choice(one, BASELINES, "a baseline")
    chosen = [task_named(one) for one in names or (() if data else TASKS)]
    chosen += [read_task(folder) for folder in data or ()]
    if show:
        rows = [
            (one.name, one.training.kind, str(len(one.training.blocks)), str(len(one.tests)), one.digest(), one.source)
            for one in chosen
        ]
        headers = "task", "kind", "training blocks", "test blocks", "digest", "source"
        if json:
            echo(to_json({"tasks": [dict(zip(headers, row, strict=True)) for row in rows], "baselines": [*BASELINES]}))
        else:
            table("Tasks", headers, rows)
            echo(f"baselines: {', '.join(BASELINES)}")
        return
    with job_progress(quiet=json) as report:
        found = compare_submissions(chosen, submissions or (), methods, progress=report)
    if out:
        with keeping(out):
            found.save(out)
            write_json(out / "results.json", found.records())
    if json:
        echo(to_json(found.records()))
    else:
        table("Errors at the test data, relative to their standard deviation", found.headers, found.rows())
    if out:
        notify(f"wrote {', '.join(FILES)} to {out}", json)
    if found.failed:
        raise Exit(1)
