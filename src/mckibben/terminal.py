"""What a terminal shows: tables, a progress bar, numbers that may not exist. rich is imported where it is needed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
