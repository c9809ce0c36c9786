"""Signal handling during a long job."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that stop a job: Ctrl-C, termination and a closed terminal."""

_REPEAT_INTERVAL = 1.0  # s


@contextmanager
def handle_signals(callback: Callable[[int], None]) -> Iterator[None]:
    """Call a function on a signal that would end the process; a repeated signal also raises KeyboardInterrupt.

    Repeats within 1 s are ignored: a closing terminal may send SIGHUP twice. Signals that were ignored before (SIGHUP
    under nohup) stay ignored. Outside of the main thread this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    first: dict[int, float] = {}

    def handle(number: int, _: object) -> None:
        callback(number)
        if time.monotonic() - first.setdefault(number, time.monotonic()) > _REPEAT_INTERVAL:
            raise KeyboardInterrupt

    previous = {}
    try:
        for number in SIGNALS:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                previous[number] = signal.signal(number, handle)
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
