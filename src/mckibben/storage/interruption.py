"""Signals that interrupt a long job in good order."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""What stops a run: Ctrl-C, a polite end, and a terminal that closes."""

_SAME = 1.0  # s


@contextmanager
def heeded(tell: Callable[[int], None]) -> Iterator[None]:
    """Tell of a signal in place of what it does otherwise; one that comes again raises KeyboardInterrupt as well.

    One that comes again within a second is the same: a terminal that closes may send SIGHUP twice (its shell does as
    well), and the impatient press Ctrl-C twice. Neither ends a process that has a rig in its hands. Signals that are
    ignored, as SIGHUP is under nohup, still are. Only the main thread is told of signals; in another this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: dict[int, float] = {}

    def heed(number: int, _: object) -> None:
        tell(number)
        if time.monotonic() - heard.setdefault(number, time.monotonic()) > _SAME:
            raise KeyboardInterrupt

    before = {}
    try:
        for number in SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                before[number] = signal.signal(number, heed)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
