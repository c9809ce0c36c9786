"""State of a browser on the server, computations in threads, and long jobs with progress.

The state lives in memory until the server ends; a job goes on while its page is closed.
"""

from __future__ import annotations

import asyncio
import contextvars
import ctypes
import gc
import platform
import tempfile
import time
import warnings
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from nicegui import app, background_tasks

from mckibben.errors import McKibbenError, McKibbenWarning, printable
from mckibben.notebook import stop_check

T = TypeVar("T")


class Session:
    """State of the pages of one browser, in memory, and a folder for its files, until its `end`.

    Each page has one state, an instance of its class, which is created at the first visit and outlives the tab.
    """

    def __init__(self) -> None:
        self._states: dict[type, object] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="mckibben-web-")

    @property
    def folder(self) -> Path:
        """Folder of the session's files."""
        return Path(self._folder.name)

    def state(self, kind: type[T]) -> T:
        """The state of a kind, created on first use."""
        state = self._states.setdefault(kind, kind())
        assert isinstance(state, kind)
        return state

    def end(self) -> None:
        """Cancel the jobs, forget the states, and remove the folder."""
        for state in self._states.values():
            if isinstance(jobs := getattr(state, "jobs", None), Jobs):
                jobs.cancel()
        self._states.clear()
        self._folder.cleanup()


_sessions: OrderedDict[str, Session] = OrderedDict()


def session(most: int = 32) -> Session:
    """Session of the requesting browser, which is created at its first request.

    Parameters
    ----------
    most
        Most sessions; beyond, the least recently used one ends.
    """
    name = app.storage.browser["id"]
    visitor = _sessions.pop(name, None) or Session()
    _sessions[name] = visitor
    if len(_sessions) > most:
        _sessions.popitem(last=False)[1].end()
    return visitor


def end_sessions() -> None:
    """End all sessions."""
    while _sessions:
        _sessions.popitem()[1].end()


class _CancelledError(Exception):
    """A job was cancelled."""


_heard: contextvars.ContextVar[list[str] | None] = contextvars.ContextVar("heard", default=None)
_show_otherwise = warnings.showwarning


def collect_warnings() -> None:
    """Route our warnings to the computation that issues them: `warnings.catch_warnings` is not thread-safe."""
    warnings.simplefilter("always", McKibbenWarning)

    def heard(message: Warning | str, category: type[Warning], *where: Any, **others: Any) -> None:
        texts = _heard.get()
        if texts is None or not issubclass(category, McKibbenWarning):
            _show_otherwise(message, category, *where, **others)
        elif str(message) not in texts:
            texts.append(str(message))

    warnings.showwarning = heard


async def in_thread(function: Callable[..., T], *arguments: object) -> tuple[T, list[str]]:
    """Run a function in a thread; return its result and warnings. Any exception becomes a `McKibbenError`."""
    texts: list[str] = []

    def run() -> T:
        _heard.set(texts)  # of this context, which belongs to the thread
        try:
            return function(*arguments)
        except (McKibbenError, _CancelledError):
            raise
        except Exception as error:
            reason = printable(f"{type(error).__name__}: {error}", 1000)
            raise McKibbenError(reason, remedy="this is a fault of mckibben: please report it") from error

    return await asyncio.to_thread(run), texts


class Latest(Generic[T]):
    """A computation for rapidly changing input: it uses the newest arguments and skips intermediate ones.

    Parameters
    ----------
    compute
        Computation, run in a thread.
    show, fail
        Get each result and each `McKibbenError`, on the event loop.
    """

    def __init__(self, compute: Callable[..., T], show: Callable[[T], None], fail: Callable[[Exception], None]) -> None:
        self._compute, self._show, self._fail = compute, show, fail
        self._waiting: tuple[object, ...] | None = None
        self._busy = False

    async def __call__(self, *arguments: object) -> None:
        """Compute and show; if an earlier computation is running, return at once and compute these arguments next."""
        self._waiting = arguments
        if self._busy:
            return
        self._busy = True
        try:
            while self._waiting is not None:
                newest, self._waiting = self._waiting, None
                try:
                    result, _ = await in_thread(self._compute, *newest)
                except McKibbenError as error:
                    self._fail(error)
                else:
                    self._show(result)
        finally:
            self._busy = False


def share_heaps() -> None:
    """Let all threads allocate from two heaps: one for each thread would keep, of what a study frees, a third."""
    if (libc := _glibc()) is not None:
        libc.mallopt(-8, 2)  # M_ARENA_MAX


def release_memory() -> None:
    """Give freed memory back to the system."""
    if (libc := _glibc()) is not None:
        gc.collect()
        libc.malloc_trim(0)


def _glibc() -> ctypes.CDLL | None:
    return ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None


class Jobs:
    """At most one job per page: it continues when the page is closed, and a reloaded page shows its progress.

    Attributes
    ----------
    version
        Increases whenever there is something new to show.
    step, part, began
        What the job does, the part that is done, 0 to 1, and its start [s, monotonic].
    took
        Duration of the last job of each kind [s].
    """

    def __init__(self) -> None:
        self.version = 0
        self.step, self.part, self.began, self.kind = "", 0.0, 0.0, ""
        self.took: dict[str, float] = {}
        self._number = self._running = 0

    @property
    def busy(self) -> bool:
        """Whether a job runs."""
        return self._running == self._number != 0

    @property
    def elapsed(self) -> float:
        """Time since the start of the job [s]."""
        return time.monotonic() - self.began

    @property
    def expected(self) -> float | None:
        """Duration [s] by the part that is done, or that of the last job of its kind; None if unknown."""
        return self.elapsed / self.part if self.part > 0.05 else self.took.get(self.kind)

    def cancel(self) -> None:
        """Stop at the next progress report or evaluation of a fit; a run continues, but its result is discarded."""
        self._number += 1
        self.version += 1

    def start(
        self,
        compute: Callable[[Callable[[str, float], None]], T],
        done: Callable[[T, list[str]], None],
        fail: Callable[[McKibbenError], None],
        kind: str = "",
    ) -> None:
        """Compute in a thread, replacing a running job.

        Parameters
        ----------
        compute
            Gets a function that takes step and part, and raises if the job was cancelled.
        done
            Called on the event loop with the result and the texts of warnings.
        fail
            Called with a `McKibbenError` instead.
        kind
            Jobs of one kind take about as long.
        """
        self._number += 1
        number = self._running = self._number
        self.step, self.part, self.began, self.kind = "", 0.0, time.monotonic(), kind
        self.version += 1

        def check() -> None:
            if number != self._number:
                raise _CancelledError

        def progress(step: str, part: float) -> None:
            check()
            self.step, self.part = step, part

        def work() -> T:
            stop_check.set(check)  # of the context of its thread
            return compute(progress)

        async def run() -> None:
            with suppress(_CancelledError):
                try:
                    result, heard = await in_thread(work)
                except McKibbenError as error:
                    if number == self._number:
                        fail(error)
                else:
                    if number == self._number:
                        self.took[kind] = self.elapsed
                        done(result, heard)
            if number == self._number:
                self._running = 0
                self.version += 1
            release_memory()

        background_tasks.create(run(), name="mckibben job")


@dataclass
class JobState:
    """State of a page with jobs.

    Attributes
    ----------
    error, notes
        Error of the last job, or its remarks.
    jobs
        Its jobs.
    """

    error: McKibbenError | None = None
    notes: list[str] = field(default_factory=list)
    jobs: Jobs = field(default_factory=Jobs)

    @property
    def finished(self) -> bool:
        """Whether the page has what the next one needs."""
        return False
