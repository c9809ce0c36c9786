"""The real-time control loop and its timing."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, RigError, SignalledError, StoppedError
from mckibben.realtime.compiled_step import ControlProgram
from mckibben.realtime.config import Connected, Reading
from mckibben.realtime.limits import Course, Shown, Watch
from mckibben.realtime.record import Phase, Rows
from mckibben.rig.backend import Backend
from mckibben.storage.interruption import handle_signals
from mckibben.units import bar

_PRIORITY = 20  # of 1 to 99: above what is ordinary, below what keeps the machine going
_TIMER_SLACK = 29  # PR_SET_TIMERSLACK of Linux
_SWITCH = 1e-4  # s: how long another thread may keep the interpreter to itself


class StopFlag:
    """The signal that has come, if one has: 0 for none. A loop looks at it once a period."""

    def __init__(self) -> None:
        self.signal = 0


@contextlib.contextmanager
def signals_told() -> Iterator[StopFlag]:
    """Note the signals that `handle_signals` tells of."""
    told = StopFlag()

    def note(number: int) -> None:
        told.signal = number

    with handle_signals(note):
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


class Spread(NamedTuple):
    """Of times [s]: median, 95 and 99.9 percent, and the worst."""

    median: float
    most: float
    nearly_all: float
    worst: float

    @classmethod
    def of(cls, times: NDArray[np.float64]) -> Spread:
        """NaN where there are none."""
        if not times.size:
            return cls(*[float("nan")] * 4)
        return cls(*(float(value) for value in np.percentile(times, (50, 95, 99.9, 100))))

    def to_json(self) -> dict[str, float]:
        """In microseconds."""
        return dict(zip(("median_us", "p95_us", "p999_us", "worst_us"), (time * 1e6 for time in self), strict=True))


class Timing(NamedTuple):
    """The timing of a run's closed loop.

    Attributes
    ----------
    periods
        That it had.
    missed
        Of those, in how many no command from the sample at their start reached the valves before their end.
    skipped
        Of those, in how many there was none at all: the loop had been late, and took the next sample.
    dropped
        Of those, how many samples the device lost.
    lateness
        From when a sample was taken until the loop had it.
    work
        From then until the commands were out: limits, controller, valves.
    jitter
        By how much the time between commands differs from the period.
    """

    periods: int
    missed: int
    skipped: int
    dropped: int
    lateness: Spread
    work: Spread
    jitter: Spread

    @classmethod
    def of(cls, columns: Mapping[str, NDArray[Any]], period: float) -> Timing:
        """Of the columns of a record, its closed loop alone."""
        closed = np.isin(columns["phase"], (Phase.SETTLING, Phase.RUN))
        sample, taken, had, out = (
            columns[name][closed].astype(float) for name in ("sample", "time", "read_at", "answered_at")
        )
        answered = np.isfinite(out)
        periods = int(sample[-1] - sample[0] + 1) if sample.size else 0
        in_time = answered & (out <= taken + period * (1 + 1e-9))
        with np.errstate(invalid="ignore"):
            between = np.diff(out[answered])
        return cls(
            periods=periods,
            missed=periods - int(in_time.sum()),
            skipped=int((~answered).sum()),
            dropped=periods - sample.size,
            lateness=Spread.of((had - taken)[answered]),
            work=Spread.of((out - had)[answered]),
            jitter=Spread.of(np.abs(between - period)),
        )

    def to_json(self) -> dict[str, Any]:
        """As a JSON object, times in microseconds."""
        counts = {name: getattr(self, name) for name in ("periods", "missed", "skipped", "dropped")}
        return counts | {name: getattr(self, name).to_json() for name in ("lateness", "work", "jitter")}


VENTED = 0.2 * bar
"""Below it a muscle counts as vented."""

_VENTING = 0.5  # s: how long the fall of the pressures is watched
_MOST = 1000  # samples that are taken at once


class Loop:
    """One run on a backend that is open; arguments as for `control`. All that a period needs is at hand."""

    def __init__(
        self,
        backend: Backend,
        program: ControlProgram,
        course: Course,
        watch: Watch,
        rows: Rows,
        connected: Connected,
        told: StopFlag,
        show: Callable[[Shown], None] | None,
    ) -> None:
        self._backend, self._program, self._course, self._watch = backend, program, course, watch
        self._rows, self._connected, self._told, self._show = rows, connected, told, show
        self._next = 0  # sample
        self._delay = math.inf  # the least that a sample took to get here
        self._missed = 0
        self._raised_from: tuple[float, float] | None = None
        self._state: Any = None  # of the controller
        self._stepped: int | None = None  # the sample of its last step
        self._inputs = np.zeros(6)
        self._commands = (0.0, 0.0)
        self._pressed = False

    def run(self) -> None:
        """All periods of the course, to the end of the last."""
        total, backend, course = self._course.periods, self._backend, self._course
        silence = self._watch.limits.silence
        while self._next < total:
            if self._told.signal:
                raise SignalledError(_signalled(self._told.signal), signal=self._told.signal)
            block = backend.read(min(self._waiting(), total - self._next), timeout=silence)
            clock = backend.clock()
            self._take(block.first, block.time.tolist(), block.volts.tolist(), clock)
        end = self._next * course.period
        while backend.clock() < end and not self._told.signal:  # the last commands have their period too
            self._look_on()

    def _waiting(self) -> int:
        """How many samples are there to be taken; at least the next one, which may be yet to come."""
        if not math.isfinite(self._delay):
            return 1
        due = math.floor((self._backend.clock() - self._delay) / self._course.period + 1e-6) + 1
        return min(max(due - self._next, 1), _MOST)

    def _take(self, first: int, times: Sequence[float], volts: Sequence[Sequence[float]], clock: float) -> None:
        course, watch, rows = self._course, self._watch, self._rows
        lost = first - self._next
        if lost < 0:
            raise RigError(f"sample {first} came where {self._next} was due", remedy="check the device")
        last = len(times) - 1
        row, readings = self._recorded(first, times, volts, clock)
        if lost * course.period > watch.limits.late:
            raise StoppedError(
                f"{lost} samples were dropped", value=lost, remedy="find out what kept the device or the host busy"
            )
        self._delay = min(self._delay, clock - times[last])
        for time, signals, reading in zip(times, volts, readings, strict=True):
            if not all(value == value for value in reading):
                self._connected.read(signals)  # says which sensor is lost
            watch.look(time, reading)
            if self._pressed:
                watch.follow(reading, self._commands)
        if clock - times[last] > watch.limits.late:
            raise StoppedError(
                f"the newest sample is {clock - times[last]:.3g} s old",
                value=clock - times[last],
                upper=watch.limits.late,
                unit="s",
                remedy="find out what kept the device or the host busy",
            )
        number, reading = self._next - 1, readings[-1]
        if number >= course.periods:  # what was due last was dropped
            return
        wish = self._act(number, row, reading)
        self._backend.beat()
        answered = self._backend.clock()
        rows.answered(row, answered)
        self._missed += lost + last + (answered > times[last] + course.period * (1 + 1e-9))
        if self._show is not None:
            self._show(
                Shown(times[last], course.periods * course.period, self._phase(number), reading, wish, self._missed)
            )

    def _recorded(
        self,
        first: int,
        times: Sequence[float],
        volts: Sequence[Sequence[float]],
        clock: float,
        *,
        venting: bool = False,
    ) -> tuple[int, list[Reading]]:
        """Record samples before anything else is done with them; the row of the last, and what each says."""
        rows, connected, row, readings = self._rows, self._connected, -1, []
        for number, (time, signals) in enumerate(zip(times, volts, strict=True), start=first):
            phase = Phase.VENTING if venting else self._phase(number)
            row = rows.begin(number, phase, time, connected.picked(signals), clock)
            reading = connected.seen(signals)
            rows.measured(row, reading)
            readings.append(reading)
        self._next = first + len(times)
        return row, readings

    def _phase(self, number: int) -> Phase:
        course = self._course
        if number < course.raising:
            return Phase.RAISING
        if number < course.raising + course.settling:
            return Phase.SETTLING
        return Phase.RUN if number < course.periods else Phase.VENTING

    def _act(self, number: int, row: int, reading: Reading) -> float:
        """Give the valves their commands, and say which angle is wished for [rad]."""
        course = self._course
        angle, pressure1, pressure2 = reading
        if number < course.raising:
            if self._raised_from is None:
                self._raised_from = max(pressure1, 0.0), max(pressure2, 0.0)
            part = (number + 1) / course.raising
            wanted = [was + part * (to - was) for was, to in zip(self._raised_from, course.pressures, strict=True)]
            self._press(wanted)
            self._rows.commanded(row, (math.nan, math.nan), self._commands, False)
            return math.nan
        at = max(number - course.raising - course.settling, 0)
        wish = course.wishes[at]
        if self._stepped is None:
            self._state = self._program.init(*reading)
            self._stepped = number - 1
        inputs = self._inputs
        inputs[0:2] = wish
        inputs[2], inputs[3], inputs[4] = angle, pressure1, pressure2
        inputs[5] = (number - self._stepped) * course.period
        self._stepped = number
        self._state, values = self._program.step(self._state, inputs)
        limited = self._press(values[:2].tolist())
        self._rows.commanded(row, wish, self._commands, limited, values[2:])
        return float(wish[0])

    def _press(self, wanted: Sequence[float]) -> bool:
        """Give the valves commands [Pa]; whether they had to be cut off."""
        if not (math.isfinite(wanted[0]) and math.isfinite(wanted[1])):
            raise StoppedError(
                f"the controller commands {wanted[0]:g} and {wanted[1]:g} Pa", remedy="simulate the scenario first"
            )
        (low1, high1), (low2, high2) = self._course.limited_to
        commands = min(max(wanted[0], low1), high1), min(max(wanted[1], low2), high2)
        self._backend.press(self._connected.volts(commands))
        self._commands, self._pressed = commands, True
        return commands[0] != wanted[0] or commands[1] != wanted[1]

    def watch_venting(self) -> float | None:
        """Read on until both pressures are gone; after what time [s] they were, None if that was not seen.

        There are no beats any more: a rig whose `vent` did nothing vents by itself.
        """
        begun, period = self._next, self._course.period
        try:
            while (self._next - begun) * period < _VENTING:
                reading = self._look_on()
                if reading.pressure1 < VENTED and reading.pressure2 < VENTED:
                    return (self._next - begun) * period
        except McKibbenError:  # of what is broken already, or because of it
            return None
        finally:
            with contextlib.suppress(McKibbenError):
                self._rows.flush()
        return None

    def _look_on(self) -> Reading:
        """The samples that are there, or the next one, recorded; what the newest says."""
        block = self._backend.read(self._waiting(), timeout=self._watch.limits.silence)
        clock = self._backend.clock()
        return self._recorded(block.first, block.time.tolist(), block.volts.tolist(), clock, venting=True)[1][-1]


def _signalled(number: int) -> str:
    return f"stopped by {signal.Signals(number).name}" + (" (Ctrl-C)" if number == signal.SIGINT else "")
