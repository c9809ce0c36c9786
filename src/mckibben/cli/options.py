"""Options, tables, progress and the skeleton of long jobs that the commands share."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mckibben.errors import ParameterError, UnitError

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset


Json = Annotated[bool, typer.Option("--json", help="Print machine-readable results instead of a table.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write results, figures and data here.")]
Data = Annotated[str, typer.Argument(metavar="DATA", help="A data file, or the name of a dataset in the catalog.")]
InitialLength = Annotated[
    str,
    typer.Option(metavar="LENGTH", help="Length of the deflated muscle, such as '180 mm', where a file has lengths."),
]
SlackForce = Annotated[
    str, typer.Option(metavar="FORCE", help="Force up to which the muscle counts as slack, such as '1 N'.")
]
Column = Annotated[
    list[str] | None,
    typer.Option(metavar="'HEADER=NAME'", help="Read the column HEADER as the quantity NAME; repeatable."),
]


SkipCorrupt = Annotated[bool, typer.Option("--skip-corrupt", help="Skip rows that contain no number, and report them.")]


def read_data(
    data: str, columns: list[str] | None, initial_length: str, slack_force: str, *, skip_corrupt: bool = False
) -> IsobaricDataset:
    """Read a data file or a dataset of the catalog; ignored columns are reported on standard error."""
    from mckibben.study.inputs import data_named

    found = data_named(
        data,
        columns=parse_columns(columns),
        initial_length=parse_optional_quantity("--initial-length", initial_length, "m"),
        slack_force=parse_optional_quantity("--slack-force", slack_force, "N"),
        skip_corrupt=skip_corrupt,
    )
    report_ignored_columns(found.table.attrs)
    return found


def report_ignored_columns(attributes: Mapping[str, Any]) -> None:
    """Report the columns of a file that were not read, on standard error."""
    ignored = attributes.get("ignored_columns")
    if ignored:
        typer.echo(f"ignored columns: {ignored} (read one with --column 'HEADER=NAME')", err=True)


def notify(text: str, json: bool) -> None:
    """Print a message; on standard error where standard output is JSON."""
    typer.echo(text, err=json)


def parse_columns(columns: list[str] | None) -> dict[str, str] | None:
    """Quantity names by column header from --column; None if there are none."""
    named = {}
    for text in columns or []:
        header, equals, name = text.rpartition("=")
        if not equals:
            raise UnitError(f"--column {text!r} is not HEADER=NAME", remedy="write --column 'Druck [bar]=pressure_bar'")
        named[header] = name
    return named or None


def parse_quantity(option: str, text: str, unit: str) -> float:
    """Value of an option in SI units; an error names the option."""
    from mckibben.units import quantity

    try:
        return quantity(text, unit)
    except UnitError as error:
        raise UnitError(f"{option}: {error}", value=text, unit=unit) from None


def parse_optional_quantity(option: str, text: str, unit: str) -> float | None:
    """Value of an option in SI units, None if it was not given."""
    return parse_quantity(option, text, unit) if text else None


_PIPED_WIDTH = 240  # columns of a table written to a file or a pipe


def table(title: str, headers: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a titled table; cells are plain text."""
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(*headers, box=box.SIMPLE_HEAD)
    for row in rows:
        table.add_row(*map(Text, row))
    console = Console(highlight=False, width=None if sys.stdout.isatty() else _PIPED_WIDTH)
    console.print(Text(title))
    console.print(table)


@contextmanager
def progress(*, width: int = 40) -> Iterator[Callable[[str, float], None]]:
    """Progress bar of `width` columns on standard error."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (
        BarColumn(bar_width=width),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("{task.description}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, part: bar.update(task, description=what, completed=part)


def metric(name: str, value: float) -> str:
    """Format a metric; NaN is "never" for a settling time, else "-"."""
    if value == value:
        return f"{value:.4g}"
    return "never" if name == "stiffness_settling_s" else "-"


INTERRUPTED = 130
"""Exit code after Ctrl-C, by the convention of shells."""


@contextmanager
def job_progress(*, quiet: bool, width: int = 40) -> Iterator[Callable[[str, float], None] | None]:
    """Progress bar that appears with the first report, None if `quiet`: errors in the options come before it."""
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
    """Skeleton of a long command: progress, and after Ctrl-C exit code 130 with a message of what is kept."""
    try:
        with job_progress(quiet=quiet) as report:
            yield report
    except KeyboardInterrupt as interrupt:
        typer.echo(f"interrupted: {str(interrupt) or kept}", err=True)
        raise typer.Exit(INTERRUPTED) from None


def required_folder(out: Path | None, job: str) -> Path:
    """The folder of --out, which a long job requires."""
    if out is None:
        raise ParameterError(f"the {job} needs an output folder", remedy="give one with --out DIR")
    return out
