"""Commands from functions: options from their parameters and docstrings, and what those with a `Result` share."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from mckibben.cli.help import MORE, completion
from mckibben.cli.options import echo, keeping, long_job, on_command_line, results_folder, text_width
from mckibben.cli.reading import read_options
from mckibben.errors import ParameterError
from mckibben.result import Result
from mckibben.storage.files import check_free, to_json
from mckibben.storage.store import STUDY

_HEADING, _OTHER = "\nParameters\n----------\n", "\nOther Parameters\n----------------\n"
_ENTRY = re.compile(r"^(\w+)(?: : (.+))?\n((?:    .+\n?)+)", re.MULTILINE)


def options_of(function: Callable[..., object], panel: str = "") -> tuple[str, dict[str, inspect.Parameter]]:
    """Return help text and parameters of a function, with what its docstring says of them.

    Parameters
    ----------
        duration : TIME
            Duration of all parts.

    is the option `--duration TIME` or, of a parameter without a default, an argument. An underscore at the end of a
    name is left out. Options below "Other Parameters" are shown by `--help-all` only, others in a `panel`.
    """
    text, _, section = inspect.cleandoc(function.__doc__ or "").partition(_HEADING)
    common, _, other = section.partition(_OTHER)
    described = {
        name: (metavar or None, " ".join(words.split()), group)
        for group, entries in ((panel, common), (MORE, other))
        for name, metavar, words in _ENTRY.findall(entries)
    }
    parameters = {}
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        annotation = parameter.annotation
        if name in described:
            metavar, words, group = described[name]
            settings: dict[str, Any] = {"metavar": metavar, "help": words, "rich_help_panel": group or None}
            if annotation is not bool:  # typer inspects each of these functions whenever a command starts
                settings["autocompletion"] = completion(name, metavar or "")
            flag = f"--{name.strip('_').replace('_', '-')}"
            required = parameter.default is inspect.Parameter.empty
            annotation = Annotated[annotation, Argument(**settings) if required else Option(flag, **settings)]
        parameters[name] = parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=annotation)
    return re.sub(r"(?<!\n)\n(?!\n)", " ", text.strip()), parameters  # a paragraph is one line


def plain_command(function: Callable[..., None], /) -> Callable[..., None]:
    """Make a command of a function that prints what it does itself."""

    @functools.wraps(function)
    def run(**values: object) -> None:
        function(**values)

    text, parameters = options_of(function)
    return _described(run, text, parameters)


def command(function: Callable[..., Result], /) -> Callable[..., None]:
    """Make a command of a function that returns a `Result`.

    The command gets the options `--details`, `--json`, `--out` and `--force`, prints the result, writes its files, and
    exits with 1 if the result is not `ok`. The function may have parameters of these names, too. With a parameter

    - `resume`, the command is a study, which is continued by `--resume`, and never replaced by `--force`;
    - `reading`, it reads files, and has the options of `read_options`;
    - `progress`, it gets a progress bar; the computation can be interrupted.

        @command
        def margins(scenario: ScenarioFile) -> Margins:
            "Compute the stability margins of the sampled loop at operating points along the reference."
            return Scenario.read(scenario).margins()
    """
    function.__annotations__.pop("return", None)  # its class is imported when the command runs
    text, parameters = options_of(function)
    names = parameters.keys()
    resumed, progresses = "resume" in names, "progress" in names
    shared = options_of(present, "Results")[1]
    for name in ("result",) if resumed else ("result", "resume"):
        del shared[name]
    if resumed:  # people try it
        shared["force"] = shared["force"].replace(annotation=Annotated[bool, Option("--force", hidden=True)])
    reading = options_of(read_options, "Reading files")[1] if "reading" in names else {}
    options = {name: option for name, option in parameters.items() if name not in (*shared, "reading", "progress")}

    @functools.wraps(function)
    def run(*, details: bool, json: bool, out: Path | None, force: bool = False, **values: Any) -> None:
        if force and values.get("resume"):
            raise ParameterError("a study is continued or begun", field="--force", remedy="leave --force out")
        passed: dict[str, object] = {"json": json, "out": out, "force": force}
        passed = {name: value for name, value in passed.items() if name in names}
        if out and not resumed:  # before the computation; a study looks for itself
            check_free(out, (STUDY,), "choose another folder: a study is never replaced")
            results_folder(out, ("results.json",), force)
        if reading:
            passed["reading"] = read_options(**{name: values.pop(name) for name in reading})
        study = out / STUDY if resumed and out else None
        with long_job(quiet=json, study=study) if progresses else nullcontext() as progress:
            result = function(**values, **passed, **({"progress": progress} if progresses else {}))
        continued = values.get("resume") or bool(study and study.exists())
        present(result, details=details, json=json, out=out, force=force, resume=continued)

    return _described(run, text, options | reading | shared)


def _described(run: Callable[..., None], text: str, parameters: dict[str, inspect.Parameter]) -> Callable[..., None]:
    run.__doc__ = text
    run.__signature__ = inspect.Signature(list(parameters.values()))  # type: ignore[attr-defined]
    run.__annotations__ = {name: parameter.annotation for name, parameter in parameters.items()}
    return run


def present(
    result: Result,
    *,
    details: bool = False,
    json: bool = False,
    out: Path | None = None,
    force: bool = False,
    resume: bool = False,
) -> None:
    """Write the files of a result, and print it; exit with 1 if it is not `ok`.

    Parameters
    ----------
    details
        Print notes and further tables, too.
    json
        Print machine-readable results instead of a table.
    out : DIR
        Write results, figures and data here.
    force
        Replace the results of an earlier run in DIR.
    resume
        Continue the study in DIR.
    """
    names: list[str] = []
    try:
        if out:  # before printing: the reader of the output may be gone
            with keeping(out, "--resume" if resume else "--force"):
                names = result.save(out, force=force or resume)
    finally:
        text = on_command_line(result.to_text(width=text_width(), details=details))
        echo(to_json(result.saved(names) if names else result.to_dict()) if json else text)
    names += [STUDY] if out and resume and (out / STUDY).exists() else []
    if out:
        figure = next((f"; figure: {out / name}" for name in names if name.endswith(".png")), "")
        written = dict.fromkeys(re.sub("/.*", "/", name) for name in names)
        echo(f"wrote {', '.join(written)} to {out}{figure}", err=json)
    if not result.ok:
        raise typer.Exit(1)
