"""Shared options, tables, progress and skeleton of long jobs."""

from __future__ import annotations

import functools
import inspect
import math
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import typer
from typer import Argument, Option
from typer.core import TyperGroup

from mckibben.errors import (
    ON_COMMAND_LINE,
    DatasetError,
    ParameterError,
    Problem,
    UnitError,
    closest,
    printable,
    quoted,
)
from mckibben.storage.files import check_free, explain_write_errors, make_folder, to_json, write_json
from mckibben.units import parse_range, quantity, show

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset, Recipe
    from mckibben.scenario import RunSettings

Document = TypeVar("Document", bound="RunSettings")

Json = Annotated[bool, Option("--json", help="Print machine-readable results instead of a table.")]
Out = Annotated[Path | None, Option("--out", metavar="DIR", help="Write results, figures and data here.")]
Data = Annotated[
    list[str], Argument(metavar="DATA...", help="Data files of one test, or the name of a dataset in the catalog.")
]

Accuracy = Annotated[
    str,
    Option(
        "--accuracy",
        metavar="ANGLE",
        help="Accuracy of the angle, such as '1e-6 rad', for which the integration steps are chosen. Default: accuracy "
        "or substeps of the file.",
    ),
]
ModelFollows = Annotated[
    list[str] | None,
    Option(
        metavar="NAME",
        help="Varied plant parameter that the controller's model follows, or 'all'; repeatable. Default: the "
        "controller's model keeps the values of the file.",
    ),
]
Extrapolate = Annotated[
    bool,
    Option("--extrapolate", help="Apply the force laws at all pressures of their specimens, also where not measured."),
]


_MEANT = {
    "run": "simulate",
    "fit": "identify",
    "plot": "identify DATA --out DIR",
    "laws": "catalog",
    "specimens": "catalog",
    "help": "-h",
}


class Commands(TyperGroup):
    """Commands, of which an unknown one is an error that names the one that is meant, or all.

    Options with a wrong number are refused in the words of other errors.
    """

    def invoke(self, ctx: Any) -> Any:
        """Run the command in the arguments."""
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            if (refusal := _refusal(error)) is None:
                raise
            raise refusal from None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return name, command and other arguments."""
        if self.get_command(ctx, args[0]) is None and not args[0].startswith("-"):
            known = self.list_commands(ctx)
            meant = (_MEANT.get(args[0]) if ctx.parent is None else "") or closest(args[0], known)
            remedy = f"did you mean `{ctx.command_path} {meant}`?" if meant else f"known are {', '.join(known)}"
            raise ParameterError(f"{ctx.command_path} has no command {quoted(args[0])}", value=args[0], remedy=remedy)
        return super().resolve_command(ctx, args)


def _refusal(error: typer.BadParameter) -> ParameterError | None:
    """Error of a number that typer's validation by pydantic refuses; None for another mistake."""
    cause: Any = error.__cause__
    if error.param is None or not hasattr(cause, "errors"):
        return None
    found, name = cause.errors()[0], max(error.param.opts, key=len)
    kind, value, limits = found["type"], found["input"], found.get("ctx", {})
    what = {"int_parsing": ("a whole number", "5"), "float_parsing": ("a number", "0.5")}.get(kind)
    if what is not None:
        message = f"{name}: {quoted(value)} is not {what[0]}"
        return ParameterError(message, value=value, remedy=f"write it in digits, such as {what[1]}")
    if kind == "greater_than_equal":
        message, remedy = f"{name}: {value} is less than {limits['ge']}", f"give at least {limits['ge']}"
        return ParameterError(message, value=value, lower=limits["ge"], remedy=remedy)
    if kind == "less_than_equal":
        message, remedy = f"{name}: {value} is more than {limits['le']}", f"give at most {limits['le']}"
        return ParameterError(message, value=value, upper=limits["le"], remedy=remedy)
    return None


_OF_READING: Mapping[str, object] = {  # names as in a recipe, which has them all
    "read": Annotated[
        Path | None,
        Option("--read", metavar="FILE", help="Recipe: all options of reading; those on the command line prevail."),
    ],
    "column": Annotated[
        list[str] | None,
        Option(
            metavar="'HEADER=NAME'",
            help="Read the column HEADER as NAME, such as pressure_bar, or ignore it; repeatable.",
        ),
    ],
    "initial_length": Annotated[
        str, Option(metavar="LENGTH", help="Length of the deflated muscle, such as '180 mm', if the file has lengths.")
    ],
    "ambient": Annotated[
        str, Option(metavar="PRESSURE", help="Ambient pressure, such as '101.3 kPa', if pressures are absolute.")
    ],
    "decimal": Annotated[
        str, Option("--decimal", metavar=".|,", help="Decimal sign of a text, if the file does not determine it.")
    ],
    "sample_rate": Annotated[str, Option(metavar="RATE", help="For a file without times, such as '1000 Hz'.")],
    "contraction": Annotated[str, Option(metavar="RATIO", help="Contraction, such as '10 %', if no column gives it.")],
    "accept": Annotated[
        list[str] | None, Option(metavar="TOPIC", help="Answer the questions of a topic with yes; repeatable.")
    ],
}
_UNITS = {"initial_length": "m", "ambient": "Pa", "sample_rate": "Hz", "contraction": "1"}
_UNSET = {"column": None, "read": None, "accept": None}


class Reading(NamedTuple):
    """Reading options of a command."""

    recipe: Recipe

    def data(self, names: list[str]) -> IsobaricDataset:
        """Data files or a dataset from the catalog; reading and preprocessing are reported on standard error."""
        from mckibben.study.inputs import data_named

        dataset = data_named(names, self.recipe)
        report_reading(dataset.table.attrs)
        for note in dataset.table.attrs.get("preprocessing", "").splitlines():
            echo(f"found in the data: {note}", err=True)
        return dataset


def reads_files(*without: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Replace a command's keyword `reading`, a `Reading`, by the options that read files, except some."""
    options = {name: option for name, option in _OF_READING.items() if name not in without}

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def with_reading(**arguments: Any) -> None:
            command(reading=_reading(**{name: arguments.pop(name) for name in options}), **arguments)

        signature = inspect.signature(command, eval_str=True)
        kind = inspect.Parameter.KEYWORD_ONLY
        shown: list[inspect.Parameter] = []
        for parameter in signature.parameters.values():
            if parameter.name != "reading":
                shown.append(parameter.replace(kind=kind))
                continue
            shown += [
                inspect.Parameter(name, kind, annotation=option, default=_UNSET.get(name, ""))
                for name, option in options.items()
            ]
        with_reading.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]
        return with_reading

    return decorate


def _reading(*, read: Path | None, column: list[str] | None, accept: list[str] | None, **texts: str) -> Reading:
    """The recipe of --read with the options of the command line."""
    from mckibben.dataset.recipe import Recipe

    recipe = Recipe.read(read) if read else Recipe()
    options: dict[str, object] = {
        name: parse_quantity(f"--{name.replace('_', '-')}", text, _UNITS[name]) if name in _UNITS else text
        for name, text in texts.items()
        if text
    }
    if recipe.initial_length is not None and "initial_length" not in options:
        length = show(recipe.initial_length, "mm")
        echo(
            f"initial length {length}, from the recipe; for a muscle of another length, give --initial-length", err=True
        )
    if columns := parse_columns(column):
        asked = {_quantity(name) for name in columns.values()}
        others = {header: name for header, name in (recipe.columns or {}).items() if _quantity(name) not in asked}
        options["columns"] = others | columns
    if accept:
        options["accept"] = [*recipe.accept, *accept]
    return Reading(recipe.with_options(options))


def _quantity(name: str) -> str:
    """The quantity of a name such as force_N, or the name itself if it is unknown."""
    from mckibben.dataset.vocabulary import parse_header

    return parse_header(name.lstrip("-")).quantity or name


def report_reading(attributes: Mapping[str, Any]) -> None:
    """Report how the columns of a file were read, and which were not, on standard error."""
    if read := attributes.get("columns_read"):
        echo(read, err=True)
    if ignored := attributes.get("ignored_columns"):
        echo(f"ignored columns: {ignored} (read one with --column 'HEADER=NAME')", err=True)


_BOTH_REMEDIES = re.compile(r"(?:columns=\{[^}]*\}|\S+)" + ON_COMMAND_LINE)


def on_command_line(text: str) -> str:
    """A message with remedies in command-line terms instead of Python's."""
    return _BOTH_REMEDIES.sub(r"\1", text)


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print text; control characters, such as escape sequences in names, are escaped."""
    print(printable(text), file=sys.stderr if err else sys.stdout, end="\n" * nl, flush=True)


def notify(text: str, json: bool) -> None:
    """Print a message, on standard error if standard output is JSON."""
    echo(text, err=json)


def parse_positive(option: str, text: str, unit: str) -> float:
    """Value of an option in SI units, above 0 and finite."""
    value = parse_quantity(option, text, unit)
    if not 0 < value < math.inf:
        raise ParameterError(
            f"{option} {text!r} is not above 0", value=value, unit=unit, remedy="give a positive value"
        )
    return value


def parse_columns(columns: list[str] | None) -> dict[str, str] | None:
    """Quantity names by column header from --column; None if there are none."""
    named = {}
    for text in columns or []:
        header, equals, name = text.rpartition("=")
        if not equals:
            raise UnitError(f"--column {text!r} is not HEADER=NAME", remedy="write --column 'Druck [bar]=pressure_bar'")
        if named.setdefault(header, name) != name:
            remedy = "give one --column per header"
            raise UnitError(f"--column names {header!r} twice: {named[header]} and {name}", remedy=remedy)
    return named or None


def parse_limits(option: str, text: str, unit: str) -> tuple[float, float]:
    """Range, or twice the single value, of an option in SI units; an error names the option."""
    try:
        return parse_range(text, unit)
    except UnitError as error:
        raise UnitError(f"{option}: {error.message}", value=text, unit=unit, remedy=error.remedy) from None


def parse_quantity(option: str, text: str, unit: str) -> float:
    """Value of an option in SI units; an error names the option."""
    try:
        return quantity(text, unit)
    except UnitError as error:
        raise UnitError(f"{option}: {error.message}", value=text, unit=unit, remedy=error.remedy) from None


def parse_optional_quantity(option: str, text: str, unit: str) -> float | None:
    """Value of an option in SI units, None if it was not given."""
    return parse_quantity(option, text, unit) if text else None


def with_accuracy(document: Document, text: str) -> Document:
    """A scenario or suite with the accuracy of --accuracy, if it was given."""
    if not text:
        return document
    from mckibben.simulation.accuracy import check_accuracy

    accuracy = parse_quantity("--accuracy", text, "rad")
    check_accuracy(accuracy)
    changes: dict[str, Any] = {"accuracy": accuracy, "substeps": None}
    if setups := getattr(document, "setups", None):
        changes["setups"] = {name: one.model_copy(update={"substeps": None}) for name, one in setups.items()}
    return document.model_copy(update=changes)


def check_choice(name: str, choices: Iterable[str], what: str) -> None:
    """Raise an error if a name is not one of the choices."""
    if name not in choices:
        raise ParameterError(f"{name!r} is not {what}", value=name, remedy=f"choose one of {', '.join(choices)}")


_WIDTH_OF_A_PIPE = 100  # characters of a line where there is no terminal


def text_width() -> int:
    """Characters of a line: those of the terminal, or 100 in a file or a pipe."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else _WIDTH_OF_A_PIPE


def table(title: str, headers: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    """Print a titled table, if it has rows; cells are plain text."""
    from mckibben.result import Column, Listing

    if rows:
        columns = {
            header: (Column(title=header), cells)
            for header, cells in zip(headers, zip(*rows, strict=True), strict=True)
        }
        echo(Listing(title, columns).to_text(text_width()) + "\n")


_LOG_INTERVAL, _LOG_SHARE = 10.0, 0.25  # s, and of the elapsed time: between lines of progress in a log


@contextmanager
def progress(*, width: int = 40) -> Iterator[Callable[[str, float], None]]:
    """Progress bar of `width` columns on standard error; lines, ever less often, in a log."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (
        BarColumn(bar_width=width),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.description}"),
    )
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _log_lines()
        return
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, part: bar.update(task, description=what, completed=part)


def _log_lines() -> Callable[[str, float], None]:
    """Progress as lines on standard error, with an estimate of the time left."""
    lines: list[tuple[float, float]] = []  # time and part of the first report, then of each line

    def report(what: str, part: float) -> None:
        now = time.monotonic()
        lines[:] = lines or [(now, part)]
        elapsed, done = now - lines[0][0], part - lines[0][1]
        if done > 0 and now - lines[-1][0] >= max(_LOG_INTERVAL, _LOG_SHARE * elapsed):
            left = time_text(elapsed * (1 - part) / done)
            echo(f"{100 * part:.0f} % after {time_text(elapsed)}, about {left} left: {what}", err=True)
            lines.append((now, part))

    return report


_ROUNDING = 1e-12  # of metrics, in shown units


def metric(name: str, value: float) -> str:
    """Format a metric; NaN is "never" for a settling time, else "-"."""
    if value == value:
        return f"{value if abs(value) > _ROUNDING else 0.0:.4g}"
    return "never" if name == "stiffness_settling_s" else "-"


def format_metrics(metrics: Mapping[str, float]) -> list[tuple[str, str, str]]:
    """Name, value and unit of metrics in shown units."""
    from mckibben.simulation.metrics import METRICS

    return [(METRICS[n][0].replace("_", " "), metric(n, value), METRICS[n][1]) for n, value in metrics.items()]


def time_text(seconds: float) -> str:
    """A duration in hours, minutes and seconds."""
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"


Force = Annotated[bool, Option("--force", help="Replace the results of an earlier run in DIR.")]


def results_folder(out: Path | None, names: Iterable[str], force: bool) -> None:
    """Create the results folder before the computation; `FileError` if it contains results and `force` is not set."""
    if out is not None:
        make_folder(out)
        if not force:
            check_free(out, names, "choose another folder, or replace it with --force")


@contextmanager
def keeping(out: Path, remedy: str = "make room, and run it again with --force") -> Iterator[None]:
    """Report which results are kept if writing fails: the disk is full, or the folder has disappeared."""
    begun = time.time()

    def kept() -> str:
        names = [path.name for path in sorted(out.iterdir()) if path.is_file() and path.stat().st_mtime >= begun - 1]
        return f"kept are {', '.join(names)}" if names else "nothing is kept"

    with explain_write_errors(out, kept, remedy):
        yield


def show_results(out: Path | None, numbers: Mapping[str, Any], text: str, json: bool) -> None:
    """Write numbers as results.json where a folder is given, and print them or a text."""
    if out:  # before printing: the reader of the output may be gone
        with keeping(out):
            write_json(out / "results.json", numbers)
    echo(to_json(numbers) if json else text)
    if out:
        notify(f"wrote results.json to {out}", json)


INTERRUPTED = 130
"""Exit code after Ctrl-C, by shell convention."""


@contextmanager
def job_progress(*, quiet: bool, width: int = 40) -> Iterator[Callable[[str, float], None] | None]:
    """Progress bar that appears with the first report, after errors in the options; None if `quiet`."""
    if quiet:
        yield None
        return
    with ExitStack() as stack:
        bars: list[Callable[[str, float], None]] = []

        def report(what: str, part: float) -> None:
            if not bars:
                bars.append(stack.enter_context(progress(width=width)))
            bars[0](what, part)

        yield report


@contextmanager
def long_job(*, quiet: bool, kept: str) -> Iterator[Callable[[str, float], None] | None]:
    """Skeleton of a long command: progress, and after Ctrl-C exit code 130 with a message on the kept results."""
    try:
        with job_progress(quiet=quiet) as report:
            yield report
    except KeyboardInterrupt as interrupt:
        echo(f"interrupted: {str(interrupt) or kept or 'nothing is kept'}", err=True)
        raise typer.Exit(INTERRUPTED) from None


def check_new(out: Path, *endings: str) -> None:
    """Check, before the computation, that an output file is new and can be written."""
    if out.suffix.lower() not in endings:
        problem = Problem(f"does not have the ending {' or '.join(endings)}", remedy="rename it")
        raise DatasetError(str(out), [problem])
    if not out.parent.is_dir():
        raise DatasetError(str(out), [Problem(f"there is no folder {out.parent}", remedy="create it")])
    if out.exists():
        raise DatasetError(str(out), [Problem("exists already", remedy="choose another file, or delete it")])


def required_folder(out: Path | None, job: str) -> Path:
    """The folder of --out, which a long job requires."""
    if out is None:
        raise ParameterError(f"the {job} needs an output folder", remedy="give one with --out DIR")
    return out
