"""A process that minds one loop: no garbage collection, exact sleeps, a say before others, signals as notes."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Iterator

from mckibben.study.signals import heeded

_PRIORITY = 20  # of 1 to 99: above what is ordinary, below what keeps the machine going
_TIMER_SLACK = 29  # PR_SET_TIMERSLACK of Linux
_SWITCH = 1e-4  # s: how long another thread may keep the interpreter to itself


class Told:
    """The signal that has come, if one has: 0 for none. A loop looks at it once a period."""

    def __init__(self) -> None:
        self.signal = 0


@contextlib.contextmanager
def signals_told() -> Iterator[Told]:
    """Note the signals that `heeded` tells of."""
    told = Told()

    def note(number: int) -> None:
        told.signal = number

    with heeded(note):
        yield told


@contextlib.contextmanager
def undisturbed() -> Iterator[str]:
    """Let this thread run as evenly as the system allows, and say what it does: "real-time" or "ordinary" priority.

    Real-time priority needs the right to it (on Linux ``CAP_SYS_NICE``); without, everything else is done.
    """
    collecting, switching = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH)
    slack = _timer_slack(1)
    scheduled = _first()
    try:
        yield "ordinary" if scheduled is None else "real-time"
    finally:
        if scheduled is not None:
            os.sched_setscheduler(0, *scheduled)
        if slack is not None:
            _timer_slack(0)
        sys.setswitchinterval(switching)
        gc.unfreeze()
        if collecting:
            gc.enable()


def _first() -> tuple[int, os.sched_param] | None:
    """Take real-time priority; what was before, or None if there is no right to it."""
    if not hasattr(os, "sched_setscheduler"):
        return None
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError:
        return None
    return before


def _timer_slack(nanoseconds: int) -> int | None:
    """How late the system may end a sleep of this thread; 0 for as it is otherwise. None where it cannot be told."""
    if sys.platform != "linux":
        return None
    try:
        return ctypes.CDLL(None).prctl(_TIMER_SLACK, nanoseconds, 0, 0, 0)
    except (OSError, AttributeError):
        return None
