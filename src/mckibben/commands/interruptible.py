"""What commands share that run for long and can be interrupted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from mckibben.terminal import progress

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
