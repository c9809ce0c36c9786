"""Printing, progress, errors of mistyped commands, and values of options."""

from __future__ import annotations

import errno
import math
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument

from mckibben.errors import ON_COMMAND_LINE, FileError, ParameterError, Problem, UnitError, printable, quoted
from mckibben.storage.files import check_free, make_folder
from mckibben.storage.store import STUDY, check_study
from mckibben.units import parse_range, quantity

Progress = Callable[[str, float], None] | None
"""Function that shows a step of a computation, and the part that is done; None without a progress bar."""
ScenarioFile = Annotated[Path, Argument(metavar="SCENARIO.yaml", help="Scenario file; see examples/.")]
_BOTH_REMEDIES = re.compile(r"(?:columns=\{[^}]*\}|\S+)" + ON_COMMAND_LINE)


def on_command_line(text: str) -> str:
    """A message with remedies in command-line terms instead of Python's."""
    return _BOTH_REMEDIES.sub(r"\1", text)


def echo(text: str, *, err: bool = False) -> None:
    """Print text; control characters, such as escape sequences in names, are escaped. Messages keep to the terminal."""
    lines, stream = printable(text), sys.stderr if err else sys.stdout
    if stream.isatty() and not lines.startswith("{"):  # JSON is kept
        width = shutil.get_terminal_size().columns
        whole: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
        lines = "\n".join(textwrap.fill(line, width, subsequent_indent="    ", **whole) for line in lines.splitlines())
    print(lines, file=stream, flush=True)


def parse_quantity(option: str, text: str, unit: str, *, positive: bool = False) -> float:
    """Value of an option in SI units.

    Parameters
    ----------
    option, text
        Name, for errors, and what was given.
    unit
        SI unit with its dimensions.
    positive
        Whether only finite numbers above 0 are allowed.

    Examples
    --------
    >>> parse_quantity("--dwell", "200 ms", "s")
    0.2
    """
    with of_option(option):
        value = quantity(text, unit)
    if positive and not 0 < value < math.inf:
        message = f"{option} {quoted(text)} is not above 0"
        raise ParameterError(message, field=option, value=value, unit=unit, remedy="give a positive value")
    return value


def parse_limits(option: str, text: str, unit: str) -> tuple[float, float]:
    """Range of an option in SI units, or twice its single value; an error names the option.

    >>> parse_limits("--limits", "1..6 bar", "Pa")
    (100000.0, 600000.0)
    """
    with of_option(option):
        return parse_range(text, unit)


@contextmanager
def of_option(option: str) -> Iterator[None]:
    """Name the option in an error of its unit."""
    try:
        yield
    except UnitError as error:
        wrong = {"value": error.value, "unit": error.unit, "remedy": error.remedy}
        raise UnitError(f"{option}: {error.message}", **wrong) from None  # type: ignore[arg-type]


def parse_pair(option: str, text: str, example: str) -> tuple[str, str]:
    """Both parts of an option with a comma; empty texts if it was not given.

    >>> parse_pair("--step", "0.5 %, 0.25 bar", "0.5 %, 0.25 bar")
    ('0.5 %', '0.25 bar')
    """
    first, comma, second = (word.strip() for word in text.partition(","))
    if text and not (first and comma and second):
        raise ParameterError(f"{option} {quoted(text)} is not a pair", value=text, remedy=f"write it like '{example}'")
    return first, second


def parse_pairs(option: str, texts: list[str] | None, example: str) -> dict[str, str]:
    """Values by name of a repeatable option NAME=VALUE; the value has no further sign of equality.

    >>> parse_pairs("--with", ["rate=20 bar/s"], "rate=20 bar/s")
    {'rate': '20 bar/s'}
    """
    pairs: dict[str, str] = {}
    for text in texts or []:
        name, equals, value = (word.strip() for word in text.rpartition("="))
        if not equals or pairs.setdefault(name, value) != value:
            message = f"{option} {quoted(text)} {'repeats a name' if equals else 'is not a pair'}"
            raise ParameterError(message, field=option, value=text, remedy=f"write it like {option} '{example}', once")
    return pairs


def check_unused(place: str, **values: object) -> None:
    """Raise a `ParameterError` if one of these options was given, though it does not apply in a place."""
    if names := [f"--{name.replace('_', '-')}" for name, value in values.items() if value]:
        message = f"{', '.join(names)}: not with {place}"
        raise ParameterError(message, field=names[0], value=values, remedy=f"leave out either, {names[0]} or {place}")


def text_width() -> int:
    """Characters of a line: COLUMNS or those of the terminal, or 100 in a file or a pipe."""
    return shutil.get_terminal_size((100, 24)).columns


_LOG_INTERVAL, _LOG_SHARE = 10.0, 0.25  # s, and of the elapsed time: between lines of progress in a log


def _bar(stack: ExitStack, width: int) -> Callable[[str, float], None]:
    """A progress bar of `width` columns on standard error until the stack ends; in a log, lines ever less often."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as ProgressBar

    console = Console(stderr=True)
    if not console.is_terminal:
        return _log_lines()
    percent, text = TextColumn("{task.percentage:3.0f} %"), TextColumn("{task.description}")
    columns = (BarColumn(bar_width=width), percent, TimeElapsedColumn(), TimeRemainingColumn(), text)
    bar = stack.enter_context(ProgressBar(*columns, console=console))
    task = bar.add_task("starting", total=1.0)
    return lambda what, fraction: bar.update(task, description=what, completed=fraction)


def _log_lines() -> Callable[[str, float], None]:
    """Progress as lines on standard error: what begins, and an estimate of the time left."""
    lines: list[tuple[float, float]] = []  # time and part of the first report, then of each line

    def report(what: str, fraction: float) -> None:
        now = time.monotonic()
        if not fraction:
            echo(what, err=True)
        lines[:] = lines or [(now, fraction)]
        elapsed, done = now - lines[0][0], fraction - lines[0][1]
        if done > 0 and now - lines[-1][0] >= max(_LOG_INTERVAL, _LOG_SHARE * elapsed):
            spent, left = (timedelta(seconds=round(span)) for span in (elapsed, elapsed * (1 - fraction) / done))
            echo(f"{100 * fraction:.0f} % after {spent}, about {left} left: {what}", err=True)
            lines.append((now, fraction))

    return report


def results_folder(out: Path | None, names: Iterable[str], force: bool) -> None:
    """Create the results folder before the computation; `FileError` if it contains results and `force` is not set."""
    if out is not None:
        make_folder(out)
        if not force:
            check_free(out, names, "choose another folder, or replace it with --force")


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


@contextmanager
def keeping(out: Path, again: str = "--force") -> Iterator[None]:
    """Raise `FileError` that names the results on disk if that is full or fails, or if the folder has disappeared.

    Other kinds of `OSError` pass unchanged.
    """
    begun = time.time()
    try:
        yield
    except OSError as error:
        if isinstance(error, FileNotFoundError) and not out.is_dir():
            problem = Problem("the folder has disappeared, together with its files", remedy="begin anew")
        elif error.errno in _FULL:
            names = [file.name for file in sorted(out.iterdir()) if file.is_file() and file.stat().st_mtime > begun - 1]
            kept = f"kept are {', '.join(names)}" if names else "nothing is kept"
            problem = Problem(f"{error.strerror}; {kept}", remedy=f"make room, and run it again with {again}")
        else:
            raise
        raise FileError(str(out), [problem]) from error


INTERRUPTED = 130
"""Exit code after Ctrl-C, by shell convention."""


@contextmanager
def job_progress(*, quiet: bool = False, width: int = 40) -> Iterator[Progress]:
    """Progress bar that appears with the first report, after errors in the options; None if `quiet`."""
    with ExitStack() as stack:
        bars: list[Callable[[str, float], None]] = []

        def report(what: str, fraction: float) -> None:
            if not bars:
                bars.append(_bar(stack, width))
            bars[0](what, fraction)

        yield None if quiet else report


@contextmanager
def long_job(*, quiet: bool, study: Path | None) -> Iterator[Progress]:
    """Skeleton of a long command: progress, and after Ctrl-C exit code 130 with a message on what its study keeps."""
    try:
        with job_progress(quiet=quiet) as report:
            yield report
    except KeyboardInterrupt as interrupt:
        kept = f"what was finished is in {study.parent}; continue with --resume" if study and study.exists() else ""
        echo(f"interrupted: {str(interrupt) or kept or 'nothing is kept'}", err=True)
        raise typer.Exit(INTERRUPTED) from None


def check_results(out: Path, names: Iterable[str], *, resume: bool, force: bool) -> None:
    """Raise `FileError` as `check_study`, and if a new study would replace results and `force` is not set."""
    check_study(out / STUDY, resume=resume)
    results_folder(out, names, force or resume)


def required_folder(out: Path | None, job: str) -> Path:
    """The folder of --out, which a long job requires."""
    if out is None:
        raise ParameterError(f"the {job} needs an output folder", remedy="give one with --out DIR")
    return out
