"""Commands that return a `Result`: what is common to all of them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from mckibben.cli.options import Force, Json, Out, echo, keeping, long_job, notify, results_folder, text_width
from mckibben.storage.files import to_json

if TYPE_CHECKING:
    from mckibben.result import Result

DETAILS = Annotated[bool, Option("--details", help="Print notes and further tables, too.")]
_ADDED = {"details": (DETAILS, False), "json": (Json, False), "out": (Out, None), "force": (Force, False)}


def command(function: Callable[..., Result], /) -> Callable[..., None]:
    """Make a command of a function that returns a `Result`.

    The command gets the options `--details`, `--json`, `--out` and `--force`, prints the result, writes its files, and
    exits with 1 if the result is not `ok`. A parameter `progress` gets a progress bar and is not an option; a long
    computation can be interrupted. A parameter `force` gets the value of that option.

        @command
        def margins(scenario: ScenarioFile, points: Points = 20) -> Margins:
            "Compute the stability margins of the sampled loop at operating points along the reference."
            return Scenario.read(scenario).margins(points)
    """
    function.__annotations__.pop("return", None)  # its class is imported when the command runs
    signature = inspect.signature(function, eval_str=True)
    parameters = [
        p.replace(kind=p.KEYWORD_ONLY) for p in signature.parameters.values() if p.name not in ("progress", "force")
    ]
    parameters += [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default)
        for name, (annotation, default) in _ADDED.items()
    ]
    takes_progress = "progress" in signature.parameters
    takes_force = "force" in signature.parameters

    @functools.wraps(function)
    def run(*, details: bool, json: bool, out: Path | None, force: bool, **arguments: Any) -> None:
        results_folder(out, ("results.json",), force)  # before the computation
        if takes_force:
            arguments["force"] = force
        if takes_progress:
            with long_job(quiet=json, kept="") as progress:
                result = function(progress=progress, **arguments)
        else:
            result = function(**arguments)
        present(result, details=details, json=json, out=out, force=force)

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def present(result: Result, *, details: bool = False, json: bool = False, out: Path | None = None, force: bool) -> None:
    """Write the files of a result, and print it; exit with 1 if it is not `ok`."""
    names: list[str] = []
    try:
        if out:  # before printing: the reader of the output may be gone
            with keeping(out):
                names = result.save(out, force=force)
    finally:
        echo(to_json(result.to_dict()) if json else result.to_text(width=text_width(), details=details))
    if out:
        notify(f"wrote {', '.join(names)} to {out}", json)
    if not result.ok:
        raise typer.Exit(1)
