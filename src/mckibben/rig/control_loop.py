"""The real-time control loop of a joint rig."""

from __future__ import annotations

import contextlib
import gc
import math
import os
import sys
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import PyTree
from numpy.typing import ArrayLike, NDArray

from mckibben.errors import McKibbenError, RigError, StoppedError
from mckibben.result import Listing
from mckibben.rig.backend import Backend, Block, check_unit
from mckibben.rig.bench import JointLimits
from mckibben.rig.channels import Channels
from mckibben.rig.compiled import ControlProgram
from mckibben.rig.joint_record import COMMANDED_AT, Phase, RowLayout, columns
from mckibben.rig.record import Recorder
from mckibben.rig.safety import MOST_READ, PROBED, JointMonitor, StopFlag
from mckibben.units import HINGE, JointType, bar

_PRIORITY = 20  # of 1 to 99: above ordinary processes, below those of the system
_SWITCH = 1e-4  # s: longest time for which another thread keeps the interpreter

VENTED = 0.2 * bar
"""Below this pressure [Pa] a muscle counts as vented."""

_VENTING = 5.0  # s for which the venting is observed
_RESTING = 60.0  # s for which a joint may swing before a run


class ServiceEstimate(Protocol):
    """Estimate of the controller's model during a run."""

    def add(self, samples: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """Take rows of time [s], angles [rad] and pressures [Pa]; return the `ControlProgram.numbers` from now on."""

    def result(self) -> Followed:
        """Return what was estimated, after the run."""


class Followed(Protocol):
    """Stiffness over the time of a run."""

    def verdict(self) -> str:
        """The stiffness at the end."""

    def listing(self) -> Listing:
        """Table over time."""


@dataclass(frozen=True)
class RunPlan:
    """Plan of a run: approach and reference.

    Parameters
    ----------
    references
        Angles [rad] and stiffnesses [N*m/rad] of the joints at the start of each period, shape (periods, 2 * joints).
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
        Periods of the probe before the ramp, and torques of the muscles in it, see `ChannelProbe`.
    channels, ranges
        Names of joints and muscles, and limits by input that differ from those of all, see `JointMonitor`.

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
    pressures: tuple[float, ...]
    command_limits: tuple[tuple[float, float], ...]
    probing: int = 0
    torques: ArrayLike = ()
    channels: Channels = Channels()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

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
    phase, angles, pressures
        Phase of the run, and latest angles [rad], of a slide positions [m], and pressures [Pa].
    references
        Reference angles [rad]; none before the controller runs.
    missed
        Number of missed deadlines.
    """

    time: float
    duration: float
    phase: Phase
    angles: Sequence[float]
    pressures: Sequence[float]
    references: Sequence[float]
    missed: int
    joint_type: JointType = HINGE


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
        Time from the vent until all pressures were below 0.2 bar [s]; None if that was not measured.
    remaining
        The highest pressure [Pa] as last measured after the vent; None if it was not.
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
        return f"all muscles were below {VENTED / bar:g} bar {self.vented_after * 1e3:.0f} ms after the vent"


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
    service: ServiceEstimate | None = None,
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
    service
        Estimate of the model on the way; its numbers become those of the controller.

    Returns
    -------
    RunOutcome
        Also of a run that was stopped. Errors that are not from mckibben are raised again, after the vent.

    Raises
    ------
    RigError
        If the backend does not match, before anything moves.
    """
    loop = ControlLoop(backend, program, plan, limits, recorder, stop_flag or StopFlag(), progress, service)
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
    readings, valves = plan.channels.readings, plan.channels.valves
    if not {*readings} <= {*inputs} or sorted(outputs) != sorted(valves):
        what = "robot" if plan.channels.is_named else "joint"
        raise RigError(
            f"the inputs of the rig are {', '.join(inputs)}, its outputs {', '.join(outputs)}",
            remedy=f"a {what} needs {', '.join(readings)}, and {' and '.join(valves)} alone",
        )
    for channel in backend.inputs:
        if channel.name in plan.channels.by_joint("angle"):
            check_unit(channel, plan.channels.joint_type.unit("rad"))
    numbers = [valves.index(name) for name in outputs]
    for valve, number in zip(backend.outputs, numbers, strict=True):
        lowest, highest = plan.command_limits[number]
        if not valve.low <= min(lowest, 0.0) or not highest <= valve.high:
            raise RigError(
                f"{valve.name} gives {valve.low / bar:g}..{valve.high / bar:g} bar, and commands go up to "
                f"{highest / bar:g} bar",
                field=valve.name,
                remedy="use another valve, or lower the rated pressure",
            )
    return [inputs.index(name) for name in readings], numbers


_TAUT = 0.01  # N*m, least torque of a muscle that is not slack


@dataclass(eq=False)
class ChannelProbe:
    """Check of sensors, valves and supply: vented, muscle 1, vented, muscle 2, ... each for an equal part of the time.

    The means over the second half of each part are compared: by at least half of the set pressure, the sensor of the
    muscle has to follow, and no other must. The joints must not move against the torques of the muscle: the work of the
    torques of the one that is filled is positive in any stable rest.

    Parameters
    ----------
    periods
        Control periods of the whole probe.
    torques
        Torque [N*m] of each muscle at that pressure, shape (muscles,), or on each joint, shape (muscles, joints).
    command_limits
        Lowest and highest command [Pa] of each muscle; one that takes no air is not probed.
    channels
        Names of joints and muscles.
    """

    periods: int
    torques: ArrayLike
    command_limits: Sequence[tuple[float, float]]
    channels: Channels = Channels()
    _part: int = field(default=0, init=False)
    _readings: list[Sequence[float]] = field(default_factory=list, init=False)
    _vented: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), init=False)

    @property
    def parts(self) -> int:
        """Number of the parts."""
        return 2 * len(self.channels.muscles)

    def commands(self, number: int, reading: Sequence[float]) -> list[float]:
        """Take the reading of a period, and return its commands [Pa].

        Raises
        ------
        StoppedError
            As `finish`, at the end of a part.
        """
        part, place = divmod(self.parts * number, self.periods)
        if part != self._part:
            self.finish()
            self._part = part
        if 2 * place >= self.periods:
            self._readings.append(reading)
        return [PROBED * (part == 2 * muscle + 1) for muscle in range(len(self.channels.muscles))]

    def finish(self) -> None:
        """Check the readings of the part so far; nothing without readings.

        Raises
        ------
        StoppedError
            If the sensor of the muscle does not follow, another one does, or the joints move the wrong way.
        """
        if not self._readings:
            return
        means, self._readings = np.mean(self._readings, axis=0), []
        muscle, pressurised = divmod(self._part, 2)
        if not pressurised:
            self._vented = means
        elif self.command_limits[muscle][1] >= PROBED:
            self._check(muscle, means - self._vented)

    def _check(self, muscle: int, change: NDArray[np.float64]) -> None:
        """Check the change of angles and pressures by a muscle."""
        joints, names = len(self.channels.joints), self.channels.by_muscle("pressure")
        angles, pressures = change[:joints], change[joints:]
        other = int(np.argmax(np.where(np.arange(len(names)) == muscle, -np.inf, pressures)))
        follows = pressures[muscle] >= PROBED / 2
        disturbed = other != muscle and pressures[other] >= PROBED / 2
        with_muscle = f"with {PROBED / bar:g} bar set at {self.channels.valves[muscle]}"
        if disturbed or not follows:
            remedy = f"check the supply, {self.channels.valves[muscle]}, its hose, and the wiring of {names[muscle]}"
            if disturbed:
                remedy = f"check whether {names[muscle]} and {names[other]} share a hose or a sensor"
            if disturbed and not follows:
                remedy = "the pressure sensors are swapped, or the valves: exchange two of them"
            raise StoppedError(
                f"{with_muscle}, {names[muscle]} rises by {pressures[muscle] / bar:.2f} bar and {names[other]} by "
                f"{pressures[other] / bar:.2f} bar",
                field=names[muscle],
                value=float(pressures[muscle]),
                unit="Pa",
                remedy=remedy,
            )
        torques = np.reshape(self.torques, (len(names), joints))[muscle]
        strongest = int(np.argmax(np.abs(torques)))
        against = angles @ torques < -self.channels.least_motion * abs(torques[strongest])
        if abs(torques[strongest]) > _TAUT and against:
            name, kind = self.channels.by_joint("angle")[strongest], self.channels.joint_type
            raise StoppedError(
                f"{with_muscle}, {name} moves by {kind.show(angles[strongest], 'deg', 2)}, against the muscle",
                field=name,
                value=float(angles[strongest]),
                unit=kind.unit("rad"),
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
    service: ServiceEstimate | None = None

    def __post_init__(self) -> None:
        plan, joints, muscles = self.plan, len(self.plan.channels.joints), len(self.plan.channels.muscles)
        self._columns, self._valves = _channels(self.backend, plan)
        self.monitor = JointMonitor(self.backend, self.limits, plan.period, plan.channels, plan.ranges)
        self._layout = RowLayout.of(plan.channels)
        count = len(columns(self.program.telemetry, plan.channels)) - self._layout.references.start
        self._no_command = [math.nan] * count
        self._next = 0  # number of the next sample
        self._begun = 0  # that of the plan's first period
        self._delay = math.inf  # shortest delay of a sample [s]
        self._missed = 0
        self._probe = ChannelProbe(plan.probing, plan.torques, plan.command_limits, plan.channels)
        self._ramp_start: list[float] | None = None
        self._state: PyTree = None  # of the controller
        self._stepped: int | None = None  # sample of its last step
        self._inputs = np.zeros(3 * joints + muscles + 1)
        self._commands: tuple[float, ...] | None = None
        self._samples: list[list[float]] = []  # that the estimate has not got yet

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
        """Wait until the vented joints hang still for a part of the probe, which compares angles.

        They may swing beyond their limits until then.
        """
        names, periods = self.plan.channels.by_joint("angle"), math.ceil(self.plan.probing / self._probe.parts)
        kind, least = self.plan.channels.joint_type, self.plan.channels.least_motion
        angles: deque[list[float]] = deque(maxlen=periods)
        while len(angles) < periods or (moved := np.ptp(angles, axis=0)).max() > least:
            self.stop_flag.check()
            if self._next * self.plan.period > _RESTING:
                raise StoppedError(
                    f"{names[moved.argmax()]} of the vented rig moves by {kind.show(moved.max(), 'deg', 2)}",
                    field=names[moved.argmax()],
                    remedy="hold it still, or check the angle sensor",
                )
            block = self.backend.read(self._waiting(), timeout=self.monitor.limits.silence)
            rows = self._rows(block, self.backend.clock())
            self.monitor.check_latency()
            self.monitor.heartbeat()
            self._next = self._begun = block.first + len(block.time)
            self.recorder.append(rows)
            first = self._layout.readings.start
            angles.extend(row[first : first + len(names)] for row in rows)

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
        reading = rows[-1][self._layout.readings]
        references = self._act(number, rows[-1], reading)
        monitor.heartbeat()
        commanded = rows[-1][COMMANDED_AT] = self.backend.clock()
        self._missed += lost + last + (commanded > times[last] + plan.period * (1 + 1e-9))
        self._report(times[last], number, reading, references)
        if self.service is not None and references:
            self._estimate(self.service, rows)

    def _estimate(self, service: ServiceEstimate, rows: list[list[float]], *, together: float = 0.5) -> None:
        """Hand samples to the estimate, a time [s] of them together, and take the controller that it gives."""
        self._samples += [[row[0], *row[self._layout.readings]] for row in rows]
        if len(self._samples) * self.plan.period < together:
            return
        numbers, self._samples = service.add(np.array(self._samples)), []
        if numbers is not None:
            self.program.numbers = numbers

    def _report(self, time: float, number: int, reading: Sequence[float], references: Sequence[float]) -> None:
        """Report the progress after a period."""
        if self.progress is not None:
            duration, phase = self.plan.periods * self.plan.period, self.plan.phase(number)
            joints = len(self.plan.channels.joints)
            read = reading[:joints], reading[joints:]
            kind = self.plan.channels.joint_type
            self.progress(RunProgress(time, duration, phase, *read, references, self._missed, kind))

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

    def _act(self, number: int, row: list[float], reading: Sequence[float]) -> Sequence[float]:
        """Set the valves; return the reference angles [rad]."""
        plan, joints = self.plan, len(self.plan.channels.joints)
        if number < plan.probing:
            return self._open_loop(self._probe.commands(number, reading), row)
        self._probe.finish()
        number -= plan.probing
        if number < plan.raising:
            if self._ramp_start is None:
                self._ramp_start = [max(pressure, 0.0) for pressure in reading[joints:]]
            part = (number + 1) / plan.raising
            ramp = [start + part * (end - start) for start, end in zip(self._ramp_start, plan.pressures, strict=True)]
            return self._open_loop(ramp, row)
        reference = plan.references[max(number - plan.raising - plan.settling, 0)]
        if self._stepped is None:
            self._state = self.program.init(*reading)
            self._stepped = number - 1
        inputs = self._inputs
        inputs[: 2 * joints] = reference
        inputs[2 * joints : -1] = reading
        inputs[-1] = (number - self._stepped) * plan.period
        self._stepped = number
        self._state, values = self.program.step(self._state, inputs)
        muscles = len(self._valves)
        commands, limited = self._command(values[:muscles].tolist())
        row[self._layout.references.start :] = [
            *reference.tolist(),
            *commands,
            float(limited),
            *values[muscles:].tolist(),
        ]
        return reference[:joints].tolist()

    def _open_loop(self, pressures: Sequence[float], row: list[float]) -> Sequence[float]:
        """Set the valves without the controller; return that there is no reference."""
        commands, _ = self._command(pressures)
        first = self._layout.commands.start
        row[first : first + len(commands) + 1] = [*commands, 0.0]
        return ()

    def _command(self, pressures: Sequence[float]) -> tuple[tuple[float, ...], bool]:
        """Command pressures [Pa] within their limits; return the commands, and whether they were limited."""
        if not all(map(math.isfinite, pressures)):
            texts = " and ".join(f"{pressure:g}" for pressure in pressures)
            raise StoppedError(f"the controller commands {texts} Pa", remedy="simulate the scenario first")
        limits = zip(pressures, self.plan.command_limits, strict=True)
        commands = tuple(min(max(pressure, low), high) for pressure, (low, high) in limits)
        self.backend.set_valves([commands[i] for i in self._valves])
        self._commands = commands
        return commands, commands != tuple(pressures)
