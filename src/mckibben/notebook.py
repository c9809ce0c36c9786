"""Progress bar of notebooks, and interruption of long jobs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextvars import ContextVar
from html import escape
from typing import Any, TypeAlias

from mckibben.errors import printable

Progress: TypeAlias = Callable[[str, float], None]
"""Called with the current step of a long computation and the completed fraction, 0 to 1."""

stop_check: ContextVar[Callable[[], None]] = ContextVar("stop_check", default=lambda: None)
"""Called at each evaluation of a fit in this thread; raises to interrupt it from outside."""


def silent(step: str, fraction: float) -> None:
    """Progress callback of a computation within another."""


def notebook_progress(*, interval: float = 0.2, longest: int = 120) -> Progress | None:
    """Return a progress bar below the running cell of a notebook, removed at the end; None outside of a notebook.

    It is updated once per `interval` [s] at most, and shows up to `longest` characters of the current step.
    """
    python = sys.modules.get("IPython")
    if python is None or not hasattr(python.get_ipython(), "kernel"):
        return None
    from IPython.display import HTML, display

    cell: Any = display(HTML(""), display_id=True)
    last = 0.0

    def update(step: str, fraction: float) -> None:
        nonlocal last
        now = time.monotonic()
        if fraction < 1 and now < last + interval:
            return
        last = now
        bar = f"<progress max='1' value='{fraction:.3f}'></progress> {fraction:.0%} {escape(printable(step, longest))}"
        cell.update(HTML(bar if fraction < 1 else ""))

    return update
