"""The real-time control loop of a joint rig."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, RigError, StoppedError
from mckibben.rig.backend import Backend, Block
from mckibben.rig.bench import JointLimits
from mckibben.rig.compiled import ControlProgram
from mckibben.rig.joint_record import COMMANDED_AT, COMMANDS, READING, REFERENCE, JointReading, Phase, columns
from mckibben.rig.record import Recorder
from mckibben.rig.safety import MOST_READ, PROBED, JointMonitor, StopFlag
from mckibben.units import bar, deg

_PRIORITY = 20  # of 1 to 99: above ordinary processes, below those of the system
_SWITCH = 1e-4  # s: longest time for which another thread keeps the interpreter

VALVES = "valve1", "valve2"
"""Outputs of a joint rig."""

VENTED = 0.2 * bar
"""Below this pressure [Pa] a muscle counts as vented."""

_VENTING = 5.0  # s for which the venting is observed
_RESTING = 60.0  # s for which a joint may swing before a run


@dataclass(frozen=True)
class RunPlan:
    """Plan of a run: approach and reference.

    Parameters
    ----------
    references
        Angle [rad] and stiffness [N*m/rad] at the start of each period, shape (periods, 2).
    period
        Control period [s].
    raising
        Periods in which the pressures are ramped to `pressures`, without the controller.
    settling
        Periods in which the controller holds the first reference.
    pressures
        Pressures of the muscles at the start [Pa].
    command_limits
        Lowest and highest command of each muscle [Pa].
    probing, torques
        Periods of the probe before the ramp, and torques of the muscles in it, see `ChannelProbe`; 0 for none.

    Examples
    --------
    >>> plan = RunPlan(np.zeros((100, 2)), 1e-3, 20, 10, (2e5, 2e5), ((0.0, 6e5), (0.0, 6e5)))
    >>> plan.periods, plan.phase(25).name
    (130, 'SETTLING')
    """

    references: NDArray[np.float64]
    period: float
    raising: int
    settling: int
    pressures: tuple[float, float]
    command_limits: tuple[tuple[float, float], tuple[float, float]]
    probing: int = 0
    torques: tuple[float, float] = (0.0, 0.0)

    @property
    def periods(self) -> int:
        """Number of periods of probe, ramp, settling and run."""
        return self.probing + self.raising + self.settling + len(self.references)

    def phase(self, number: int) -> Phase:
        """Phase of a period."""
        number -= self.probing
        if number < 0:
            return Phase.PROBING
        if number < self.raising:
            return Phase.RAISING
        if number < self.raising + self.settling:
            return Phase.SETTLING
        return Phase.RUN if number - self.raising - self.settling < len(self.references) else Phase.VENTING


class RunProgress(NamedTuple):
    """Progress of a run.

    Attributes
    ----------
    time, duration
        Time and duration [s].
    phase, reading
        Phase of the run, and latest reading.
    reference
        Reference angle [rad].
    missed
        Number of missed deadlines.
    """

    time: float
    duration: float
    phase: Phase
    reading: JointReading
    reference: float
    missed: int


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run.

    Attributes
    ----------
    kind
        "completed"; or "stopped" at a limit, "signal", "silent", "rig", "failed".
    text
        The reason, as a sentence.
    error
        The error that stopped it.
    vented_after
        Time from the vent until both pressures were below 0.2 bar [s]; None if that was not measured.
    remaining
        The higher pressure [Pa] as last measured after the vent; None if it was not.
    """

    kind: str
    text: str
    error: McKibbenError | None = None
    vented_after: float | None = None
    remaining: float | None = None

    @property
    def completed(self) -> bool:
        """Whether the run was completed."""
        return self.error is None

    @property
    def venting(self) -> str:
        """Result of the venting, as a sentence."""
        if self.remaining is None:
            return "the valves were commanded to vent, but no sensor confirms it: check before touching it"
        if self.vented_after is None:
            left = f"{self.remaining / bar:.3g} bar were last measured after the vent, within {_VENTING:g} s"
            return f"{left}: the valves are slow or do not vent, check before touching it"
        return f"both muscles were below {VENTED / bar:g} bar {self.vented_after * 1e3:.0f} ms after the vent"


@contextlib.contextmanager
def realtime_process_settings() -> Iterator[str]:
    """Reduce the jitter of this process; yields "real-time" or, without the permission, "ordinary" priority."""
    collecting, switching = gc.isenabled(), sys.getswitchinterval()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH)
    scheduled = _set_real_time_priority()
    try:
        yield "ordinary" if scheduled is None else "real-time"
    finally:
        if scheduled is not None:
            os.sched_setscheduler(0, *scheduled)
        sys.setswitchinterval(switching)
        gc.unfreeze()
        if collecting:
            gc.enable()


def _set_real_time_priority() -> tuple[int, os.sched_param] | None:
    """Set real-time priority; return the policy before, or None without the permission."""
    if not hasattr(os, "sched_setscheduler"):
        return None
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except OSError:
        return None
    return before


def control(
    backend: Backend,
    program: ControlProgram,
    plan: RunPlan,
    limits: JointLimits,
    recorder: Recorder,
    *,
    stop_flag: StopFlag | None = None,
    progress: Callable[[RunProgress], None] | None = None,
) -> RunOutcome:
    """Open a backend, run a controller on it, vent it and close it; all of it is recorded.

    Parameters
    ----------
    backend, program, plan, limits
        Closed backend, compiled controller, the plan of the run, and its safety limits.
    recorder
        Recorder with the columns of `record.columns`; it is left open.
    stop_flag
        Stops the run when it is set.
    progress
        Is called each period, and must return at once.

    Returns
    -------
    RunOutcome
        Also of a run that was stopped. Errors that are not from mckibben are raised again, after the vent.

    Raises
    ------
    RigError
        If the backend does not match, before anything moves.
    """
    loop = ControlLoop(backend, program, plan, limits, recorder, stop_flag or StopFlag(), progress)
    monitor = loop.monitor
    error: McKibbenError | None = None
    with backend.opened():
        try:
            with monitor.guard():
                recorder.event("opened", "", backend=dict(backend.description))
                loop.run()
        except McKibbenError as stopped:
            error = stopped
        except BaseException as failed:
            _note(recorder, "failed", f"{type(failed).__name__}: {failed}")
            raise
        monitor.stop()
        if backend.losses:
            _note(recorder, "losses", backend.losses)
        kind = "completed" if error is None else _KINDS.get(type(error).__name__, "failed")
        text = f"completed {len(plan.references) * plan.period:g} s" if error is None else str(error)
        _note(recorder, kind, text)

        def record(block: Block) -> None:
            with contextlib.suppress(McKibbenError):
                loop.record_venting(block)

        found = monitor.observe_venting(record, threshold=VENTED, duration=_VENTING, samples=1)
        outcome = RunOutcome(kind, text, error, found.duration, found.pressure)
        _note(recorder, "vented" if found.duration is not None else "not vented", outcome.venting)
        return outcome


_KINDS = {"SignalledError": "signal", "SilentError": "silent", "StoppedError": "stopped", "RigError": "rig"}


def _channels(backend: Backend, plan: RunPlan) -> tuple[list[int], list[int]]:
    """Columns of angle and pressures among the inputs, and numbers of the muscles by output, if the backend matches."""
    if not math.isclose(backend.rate * plan.period, 1.0, rel_tol=1e-9):
        raise RigError(
            f"the rig takes {backend.rate:g} samples per second, and the control period is {plan.period * 1e3:g} ms",
            remedy="set both to the same value",
        )
    if backend.patience < 3 * plan.period:
        raise RigError(
            f"the watchdog of the rig expires after {backend.patience:g} s, the control period is {plan.period:g} s",
            value=backend.patience,
            lower=3 * plan.period,
            unit="s",
            remedy="set its patience to several periods",
        )
    inputs, outputs = ([channel.name for channel in channels] for channels in (backend.inputs, backend.outputs))
    if not {*JointReading._fields} <= {*inputs} or sorted(outputs) != [*VALVES]:
        raise RigError(
            f"the inputs of the rig are {', '.join(inputs)}, its outputs {', '.join(outputs)}",
            remedy=f"a joint needs {', '.join(JointReading._fields)}, and {' and '.join(VALVES)} alone",
        )
    lowest, highest = zip(*plan.command_limits, strict=True)
    for valve in backend.outputs:
        if not valve.low <= min(*lowest, 0.0) or not max(highest) <= valve.high:
            raise RigError(
                f"{valve.name} gives {valve.low / bar:g}..{valve.high / bar:g} bar, and commands go up to "
                f"{max(highest) / bar:g} bar",
                field=valve.name,
                remedy="use another valve, or lower the rated pressure",
            )
    return [inputs.index(name) for name in JointReading._fields], [VALVES.index(name) for name in outputs]


MOVED = 0.5 * deg
"""Change of the angle [rad] that counts as a motion."""

_TAUT = 0.01  # N*m, least torque of a muscle that is not slack


@dataclass(eq=False)
class ChannelProbe:
    """Check of sensors, valves and supply: vented, muscle 1, vented, muscle 2, each for a quarter of the time.

    The means over the second half of each quarter are compared: by at least half of the set pressure, the sensor of the
    muscle has to follow, and the other must not.

    Parameters
    ----------
    periods
        Control periods of the whole probe.
    torques
        Torque of each muscle at that pressure [N*m], of which the sign counts; 0 for a slack one.
    probed
        Whether each muscle takes air.
    """

    periods: int
    torques: tuple[float, float]
    probed: Sequence[bool]
    _quarter: int = field(default=0, init=False)
    _readings: list[JointReading] = field(default_factory=list, init=False)
    _vented: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3), init=False)

    def commands(self, number: int, reading: JointReading) -> tuple[float, float]:
        """Take the reading of a period, and return its commands [Pa].

        Raises
        ------
        StoppedError
            As `finish`, at the end of a quarter.
        """
        quarter, place = divmod(4 * number, self.periods)
        if quarter != self._quarter:
            self.finish()
            self._quarter = quarter
        if 2 * place >= self.periods:
            self._readings.append(reading)
        return PROBED * (quarter == 1), PROBED * (quarter == 3)

    def finish(self) -> None:
        """Check the readings of the quarter so far; nothing without readings.

        Raises
        ------
        StoppedError
            If the sensor of the muscle does not follow, that of the other does, or the joint moves the wrong way.
        """
        if not self._readings:
            return
        means, self._readings = np.mean(self._readings, axis=0), []
        muscle, pressurised = divmod(self._quarter, 2)
        if not pressurised:
            self._vented = means
        elif self.probed[muscle]:
            self._check(muscle, means - self._vented)

    def _check(self, muscle: int, change: NDArray[np.float64]) -> None:
        """Check the change of angle and pressures by a muscle."""
        number, other = muscle + 1, 2 - muscle
        follows, disturbed = change[number] >= PROBED / 2, change[other] >= PROBED / 2
        with_muscle = f"with {PROBED / bar:g} bar set at muscle {number}"
        if disturbed or not follows:
            remedy = f"check the supply, valve {number}, its hose, and the wiring of pressure sensor {number}"
            if disturbed:
                remedy = "check whether both muscles share a hose or a sensor"
            if disturbed and not follows:
                remedy = "the pressure sensors are swapped, or the valves: exchange two of them"
            raise StoppedError(
                f"{with_muscle}, pressure {number} rises by {change[number] / bar:.2f} bar and pressure {other} by "
                f"{change[other] / bar:.2f} bar",
                field=f"pressure{number}",
                value=float(change[number]),
                unit="Pa",
                remedy=remedy,
            )
        torque = self.torques[muscle]
        if abs(torque) > _TAUT and change[0] * np.sign(torque) < -MOVED:
            raise StoppedError(
                f"{with_muscle}, the angle moves by {change[0] / deg:.2g} deg, against the muscle",
                field="angle",
                value=float(change[0]),
                unit="rad",
                remedy="check the direction of the angle sensor, and whether the muscles are swapped",
            )


def _note(recorder: Recorder, kind: str, text: str) -> None:
    """Record an event; a recorder that fails now does not matter, everything is vented."""
    with contextlib.suppress(McKibbenError):
        recorder.event(kind, text)


@dataclass(eq=False)
class ControlLoop:
    """One run on an open backend; arguments as for `control`."""

    backend: Backend
    program: ControlProgram
    plan: RunPlan
    limits: JointLimits
    recorder: Recorder
    stop_flag: StopFlag
    progress: Callable[[RunProgress], None] | None

    def __post_init__(self) -> None:
        plan = self.plan
        self._columns, self._valves = _channels(self.backend, plan)
        self.monitor = JointMonitor(self.backend, self.limits, plan.period)
        self._no_command = [math.nan] * (len(columns(self.program.telemetry)) - REFERENCE.start)
        self._next = 0  # number of the next sample
        self._begun = 0  # that of the plan's first period
        self._delay = math.inf  # shortest delay of a sample [s]
        self._missed = 0
        self._probe = ChannelProbe(plan.probing, plan.torques, [high >= PROBED for _, high in plan.command_limits])
        self._ramp_start: tuple[float, float] | None = None
        self._state: Any = None  # of the controller
        self._stepped: int | None = None  # sample of its last step
        self._inputs = np.zeros(6)
        self._commands: tuple[float, float] | None = None

    def run(self) -> None:
        """Run all periods of the plan, to the end of the last one."""
        backend, plan = self.backend, self.plan
        silence = self.monitor.limits.silence
        if plan.probing:
            self._wait_for_rest()
        total = self._begun + plan.periods
        while self._next < total:
            self.stop_flag.check()
            block = backend.read(min(self._waiting(), total - self._next), timeout=silence)
            clock = backend.clock()
            rows = self._rows(block, clock)
            try:
                self._step(block, rows, clock)
            finally:  # also of a sample that stops the run
                self.recorder.append(rows)
        end = self._next * plan.period
        while backend.clock() < end and not self.stop_flag.signal:  # the last command lasts for its period
            block = backend.read(self._waiting(), timeout=silence)
            self._next += len(block.time)
            self.record_venting(block)

    def _wait_for_rest(self) -> None:
        """Wait until the vented joint hangs still for a quarter of the probe, which compares angles.

        It may swing beyond its limits until then.
        """
        quarter = math.ceil(self.plan.probing / 4)
        angles: deque[float] = deque(maxlen=quarter)
        while len(angles) < quarter or max(angles) - min(angles) > MOVED:
            self.stop_flag.check()
            if self._next * self.plan.period > _RESTING:
                raise StoppedError(
                    f"the vented joint moves by {(max(angles) - min(angles)) / deg:.2g} deg",
                    field="angle",
                    remedy="hold it still, or check the angle sensor",
                )
            block = self.backend.read(self._waiting(), timeout=self.monitor.limits.silence)
            rows = self._rows(block, self.backend.clock())
            self.monitor.check_latency()
            self.monitor.heartbeat()
            self._next = self._begun = block.first + len(block.time)
            self.recorder.append(rows)
            angles.extend(row[READING.start] for row in rows)

    def record_venting(self, block: Block) -> None:
        """Record samples after the last period."""
        self.recorder.append(self._rows(block, self.backend.clock(), venting=True))

    def _waiting(self) -> int:
        """Number of samples that can be read now; at least the next one, for which to wait."""
        if not math.isfinite(self._delay):
            return 1
        due = math.floor((self.backend.clock() - self._delay) / self.plan.period + 1e-6) + 1
        return min(max(due - self._next, 1), MOST_READ)

    def _step(self, block: Block, rows: list[list[float]], clock: float) -> None:
        """Check samples, act on the newest, send the heartbeat."""
        plan, monitor, times = self.plan, self.monitor, block.time.tolist()
        lost, last = block.first - self._next, len(times) - 1
        if lost < 0:
            raise RigError(f"sample {block.first} came when {self._next} was due", remedy="check the device")
        self._next = block.first + len(times)
        self._delay = min(self._delay, clock - times[last])
        for i, (time, signals) in enumerate(zip(times, block.values.tolist(), strict=True)):
            monitor.check_sample(time, signals, self._commands, clock if i == last else None)
        monitor.check_latency(clock - times[last])
        number = self._next - 1 - self._begun
        if number >= plan.periods:  # the last samples were dropped
            return
        reading = JointReading(*rows[-1][READING])
        reference = self._act(number, rows[-1], reading)
        monitor.heartbeat()
        commanded = rows[-1][COMMANDED_AT] = self.backend.clock()
        self._missed += lost + last + (commanded > times[last] + plan.period * (1 + 1e-9))
        self._report(times[last], number, reading, reference)

    def _report(self, time: float, number: int, reading: JointReading, reference: float) -> None:
        """Report the progress after a period."""
        if self.progress is not None:
            duration, phase = self.plan.periods * self.plan.period, self.plan.phase(number)
            self.progress(RunProgress(time, duration, phase, reading, reference, self._missed))

    def _rows(self, block: Block, clock: float, *, venting: bool = False) -> list[list[float]]:
        """Rows of samples, without commands."""
        rows = []
        for number, (time, signals) in enumerate(
            zip(block.time.tolist(), block.values.tolist(), strict=True), start=block.first
        ):
            phase = Phase.VENTING if venting else self.plan.phase(number - self._begun)
            reading = [signals[column] for column in self._columns]
            rows.append([time, number, phase, clock, math.nan, *reading, *self._no_command])
        return rows

    def _act(self, number: int, row: list[float], reading: JointReading) -> float:
        """Set the valves; return the reference angle [rad]."""
        plan = self.plan
        angle, pressure1, pressure2 = reading
        if number < plan.probing:
            return self._open_loop(self._probe.commands(number, reading), row)
        self._probe.finish()
        number -= plan.probing
        if number < plan.raising:
            if self._ramp_start is None:
                self._ramp_start = max(pressure1, 0.0), max(pressure2, 0.0)
            part = (number + 1) / plan.raising
            ramp = [start + part * (end - start) for start, end in zip(self._ramp_start, plan.pressures, strict=True)]
            return self._open_loop(ramp, row)
        reference = plan.references[max(number - plan.raising - plan.settling, 0)]
        if self._stepped is None:
            self._state = self.program.init(*reading)
            self._stepped = number - 1
        inputs = self._inputs
        inputs[0:2] = reference
        inputs[2], inputs[3], inputs[4] = angle, pressure1, pressure2
        inputs[5] = (number - self._stepped) * plan.period
        self._stepped = number
        self._state, values = self.program.step(self._state, inputs)
        commands, limited = self._command(values[:2].tolist())
        row[REFERENCE.start :] = [*reference.tolist(), *commands, float(limited), *values[2:].tolist()]
        return float(reference[0])

    def _open_loop(self, pressures: Sequence[float], row: list[float]) -> float:
        """Set the valves without the controller; return that there is no reference."""
        commands, _ = self._command(pressures)
        row[COMMANDS] = [*commands, 0.0]
        return math.nan

    def _command(self, pressures: Sequence[float]) -> tuple[tuple[float, float], bool]:
        """Command pressures [Pa] within their limits; return the commands, and whether they were limited."""
        first, second = pressures
        if not (math.isfinite(first) and math.isfinite(second)):
            raise StoppedError(
                f"the controller commands {first:g} and {second:g} Pa", remedy="simulate the scenario first"
            )
        (low1, high1), (low2, high2) = self.plan.command_limits
        commands = min(max(first, low1), high1), min(max(second, low2), high2)
        self.backend.set_valves([commands[i] for i in self._valves])
        self._commands = commands
        return commands, commands != (first, second)
