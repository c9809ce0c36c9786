"""Options, tables, progress and interruption of the commands."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mckibben.errors import UnitError

if TYPE_CHECKING:
    from mckibben.dataset import IsobaricDataset


Json = Annotated[bool, typer.Option("--json", help="Print machine-readable results instead of a table.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Keep results, figures and data here.")]
Data = Annotated[str, typer.Argument(metavar="DATA", help="A file of measurements, or a dataset of the catalog.")]
InitialLength = Annotated[
    str, typer.Option(metavar="LENGTH", help="Of the deflated muscle, such as '180 mm'; where a file has lengths only.")
]
SlackForce = Annotated[
    str, typer.Option(metavar="FORCE", help="Up to this force a muscle counts as slack, such as '1 N'.")
]
Column = Annotated[
    list[str] | None,
    typer.Option(metavar="'HEADER=NAME'", help="Read a column under another name; may be given several times."),
]


SkipCorrupt = Annotated[
    bool, typer.Option("--skip-corrupt", help="Leave out rows that hold no number, and report them.")
]


def measured(
    data: str, columns: list[str] | None, initial_length: str, slack_force: str, *, skip_corrupt: bool = False
) -> IsobaricDataset:
    """The data that a command names; columns of the file that are not read are named on standard error."""
    from mckibben.study.inputs import data_named

    found = data_named(
        data,
        columns=renamed(columns),
        initial_length=quantity_or_none("--initial-length", initial_length, "m"),
        slack_force=quantity_or_none("--slack-force", slack_force, "N"),
        skip_corrupt=skip_corrupt,
    )
    say_ignored(found.table.attrs)
    return found


def say_ignored(attributes: Mapping[str, Any]) -> None:
    """Name the columns of a file that were not read, on standard error."""
    ignored = attributes.get("ignored_columns")
    if ignored:
        typer.echo(f"ignored columns: {ignored} (read one with --column 'HEADER=NAME')", err=True)


def said(text: str, json: bool) -> None:
    """Say what was done: beside the results, not among them, where these are for a machine."""
    typer.echo(text, err=json)


def renamed(columns: list[str] | None) -> dict[str, str] | None:
    """The names that --column gives, by header; None for none."""
    named = {}
    for text in columns or []:
        header, equals, name = text.rpartition("=")
        if not equals:
            raise UnitError(f"--column {text!r} names no column", remedy="write --column 'Druck [bar]=pressure_bar'")
        named[header] = name
    return named or None


def quantity_of(option: str, text: str, unit: str) -> float:
    """What an option says, in SI; an error names the option."""
    from mckibben.units import quantity

    try:
        return quantity(text, unit)
    except UnitError as error:
        raise UnitError(f"{option}: {error}", value=text, unit=unit) from None


def quantity_or_none(option: str, text: str, unit: str) -> float | None:
    """The same, and None where it was not given."""
    return quantity_of(option, text, unit) if text else None


_PIPED_WIDTH = 240  # columns of a table that goes into a file or a pipe


def table(title: str, headers: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """Print a table under its title; cells are plain text."""
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
    """A progress bar on standard error, itself so many columns wide."""
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
    """A number, or that there is none: never settled, or not defined for this run."""
    if value == value:
        return f"{value:.4g}"
    return "never" if name == "stiffness_settling_s" else "-"


INTERRUPTED = 130
"""The exit code after Ctrl-C, as shells have it."""


@contextmanager
def late_progress(*, quiet: bool, width: int = 40) -> Iterator[Callable[[str, float], None] | None]:
    """A progress bar that is not there before it is told of progress: what is wrong with the options comes first.

    None where it is to be quiet.
    """
    if quiet:
        yield None
        return
    with ExitStack() as shown:
        bars: list[Callable[[str, float], None]] = []

        def report(what: str, part: float) -> None:
            if not bars:
                bars.append(shown.enter_context(progress(width=width)))
            bars[0](what, part)

        yield report
