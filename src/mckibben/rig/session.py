"""Session of a test on a rig: moves, pressures and samples, each cycle checked and recorded."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.constants import g

from mckibben.errors import McKibbenError, RigError, SignalledError, StoppedError
from mckibben.rig.backend import Block, MovingBackend
from mckibben.rig.bench import Bench
from mckibben.rig.by_hand import HandBench, length_of
from mckibben.rig.recorder import Recorder
from mckibben.rig.safety import PROBED, BlockMeans, RigMonitor, StopFlag
from mckibben.rig.steps import SPEED
from mckibben.units import bar, mm, percent

STOPPED, VENTED, DROPPED = "stopped", "vented", "dropped"
"""Kinds of event."""

_OBSERVED = 10.0  # s after a stop
_COMPLIANCE = 0.005 * mm  # m/N: gain of the force control, per cycle


class Progress(NamedTuple):
    """Progress of a test.

    Attributes
    ----------
    time
        Time of the rig [s].
    latest
        Means of the latest cycle.
    contraction, set_pressure
        Contraction [-], and set pressure [Pa].
    points
        Number of points taken.
    """

    time: float
    latest: BlockMeans
    contraction: float
    set_pressure: float
    points: int


ProgressCallback = Callable[[Progress], None]
"""Called once per cycle."""


@dataclass(eq=False)
class RigSession:
    """One session of a test: each cycle reads a block, checks it, sends the heartbeat and records the block.

    Parameters
    ----------
    backend, bench, recorder
        Backend, the bench with its limits, and an open recorder with the columns of `columns_of`.
    origin
        Position of the motor when it was opened [pulses], from the mounted one.
    since
        Time at which the record goes on [s].
    report
        Is called with the progress after each cycle.
    stop_flag
        Stops the test when a signal has set it.
    """

    backend: MovingBackend
    bench: Bench
    recorder: Recorder
    _: KW_ONLY
    origin: int = 0
    since: float = 0.0
    report: ProgressCallback | None = None
    stop_flag: StopFlag = field(default_factory=StopFlag)

    def __post_init__(self) -> None:
        self.pulses = self.origin
        per_metre = self.bench.drive.pulses_per_metre
        self.monitor = RigMonitor(self.backend, self.bench.limits, per_metre, self.origin)
        self._names = [channel.name for channel in self.backend.inputs]
        self._expected = 0
        self._latest: BlockMeans | None = None
        self.set_point = 0.0  # set pressure [Pa]
        self._points = 0

    def begin(self) -> None:
        """Vent and wait: no pressure is set and nothing moves before the muscle is measured to be empty."""
        self.recorder.event("opened", "", **self.backend.description)
        self.vent_and_wait()
        if self.backend.physical:  # sensors, valve and supply, before the pressure rises above 1 bar
            self.set_pressure(PROBED)
            self.vent_and_wait()

    def acquire(self, count: int, plateau: int) -> tuple[float, Mapping[str, float]]:
        """Take and record the samples of a plateau; return the time of the first one [s], and the mean by input.

        Parameters
        ----------
        count
            Number of rows.
        plateau
            Number of the plateau, for its column.
        """
        sums: NDArray[np.float64] = np.zeros(len(self._names))
        begun, left, self._points = None, count, plateau
        while left:
            block = self._cycle(min(left, self.bench.samples_per_cycle), plateau=plateau)
            sums += self.monitor.sums
            begun = float(block.time[0]) if begun is None else begun
            left -= len(block.time)
        self._points = plateau + 1
        means = dict(zip(self._names, (sums / count).tolist(), strict=True))
        return self.since + (begun or 0.0), means

    @property
    def now(self) -> float:
        """Time of the latest sample, by the clock of the rig [s]."""
        return self._latest.time if self._latest is not None else 0.0

    def move_to(self, pulses: int, speed: float) -> None:
        """Move the motor to a position [pulses] at a speed [m/s], and wait until it is there."""
        distance = pulses - self.pulses
        if not distance:
            return
        if isinstance(self.backend, HandBench):
            self._move_by_hand(self.backend, pulses)
            return
        rate = self.bench.drive.rate(speed)
        self.backend.move(distance, rate)
        deadline = self.now + 1.5 * abs(distance) / rate + 5 * self.bench.cycle + 1.0
        while self.backend.moving:
            # shorter cycles near the end, so that no time is lost
            left = math.ceil((abs(pulses - self.pulses) / rate) * self.bench.rate) + 1
            self._cycle(min(self.bench.samples_per_cycle, max(left, 1)))
            if self.now > deadline:
                raise StoppedError("the motor does not finish its move", remedy="check its driver")
        while self.pulses != pulses:
            self._cycle(max(1, self.bench.samples_per_cycle // 10))
            if self.now > deadline:
                raise StoppedError(
                    f"the motor is {abs(self.pulses - pulses)} pulses away from its target",
                    remedy="check its driver and its end switches",
                )

    def _move_by_hand(self, bench: HandBench, pulses: int) -> None:
        if not bench.weights:  # else the muscle is as long as the weight makes it
            self.ask(
                f"turn the screw to {self.bench.contraction_at(pulses) / percent:.4g} % contraction, then press Enter"
            )
            bench.position = pulses - self.origin
            self._cycle()

    def ask(self, text: str) -> str:
        """Ask the operator of a `HandBench`; samples are taken, checked and recorded meanwhile."""
        assert isinstance(self.backend, HandBench)
        answer = self.backend.ask(text)
        while not answer.done():
            self._cycle()
        return answer.result()

    def hang(self, force: float) -> bool:
        """Have a weight of a force [N] hung on the muscle; False on a bench without weights."""
        bench = self.backend
        if not isinstance(bench, HandBench) or not bench.weights:
            return False
        if bench.weight != force:
            self.ask(f"hang {force / g:.4g} kg on the muscle ({force:g} N), then press Enter")
            bench.weight = force
            self._cycle()
        return True

    def measure_length(self) -> None:
        """Ask for the length of a muscle with a weight."""
        bench, length = self.backend, None
        if not isinstance(bench, HandBench) or not bench.weights:
            return
        while length is None:
            length = length_of(self.ask("length of the muscle, such as 163.5 mm"))
        contraction = float(self.bench.specimen.contraction_at(length))
        bench.position = self.bench.pulses_at(contraction) - self.origin
        self._cycle()

    def step_towards(self, force: float, speed: float) -> None:
        """Begin a short move towards a force [N], unless the motor is moving."""
        if self.backend.by_hand or self.backend.moving or self._latest is None:
            return
        drive, limits = self.bench.drive, self.bench.limits
        rate, per_metre = drive.rate(speed), drive.pulses_per_metre
        most = max(1, int(rate * self.bench.cycle))
        distance = round((force - self._latest.force) * _COMPLIANCE * per_metre)
        distance = max(-most, min(most, distance))
        if distance and -limits.shorten * per_metre <= self.pulses + distance <= limits.stretch * per_metre:
            self.backend.move(distance, rate)

    def wait(self, duration: float) -> None:
        """Wait for a duration [s]."""
        left = round(duration * self.bench.rate)
        while left > 0:
            left -= len(self._cycle(min(left, self.bench.samples_per_cycle)).time)

    def set_pressure(
        self, pressure: float, rate: float | None = None, holding: float | None = None, shut: float | None = None
    ) -> None:
        """Change the pressure, and wait until the muscle has it.

        Parameters
        ----------
        pressure
            Set pressure [Pa].
        rate
            Rate of the set pressure [Pa/s]; None for a step.
        holding
            Force that is held meanwhile by moving [N]; None for constant length.
        shut
            Least time for which the valve is shut once the muscle has the pressure [s]; None to leave it open.

        Raises
        ------
        StoppedError
            If the pressure does not settle, or a limit is exceeded.
        """
        before, self.set_point = self.set_point, pressure
        self.recorder.event("pressure", pressure=pressure)
        if rate is not None:
            begun = self.now
            while (part := rate * (self.now - begun)) < abs(pressure - before):
                ramp = before + math.copysign(part, pressure - before)
                self.monitor.expect(ramp, begun)
                self._set_valve(ramp)
                self._cycle()
                if holding is not None:
                    self.step_towards(holding, SPEED)
        self._set_valve(pressure)
        set_at = self.now
        self.monitor.expect(pressure, set_at)
        deadline = set_at + self.bench.limits.settling + self.bench.steady

        def in_time(latest: BlockMeans) -> None:
            if holding is not None:
                self.step_towards(holding, SPEED)
            if latest.time > deadline:
                raise StoppedError(
                    f"the pressure does not settle: it is {latest.pressure / bar:.3g} bar, and {pressure / bar:.3g} "
                    "bar were set",
                    value=latest.pressure,
                    unit="Pa",
                    remedy="check supply, valve and muscle, and whether the sensors are swapped",
                )

        steady = self.bench.steady if shut is None else self.bench.cycle
        self._settle(lambda latest: abs(latest.pressure - pressure) <= self.bench.settled, in_time, steady)
        if shut is None:
            self._expect_settled(pressure)
            return
        self.backend.shut()
        self.recorder.event("shut")
        self.monitor.expect(None, self.now)
        self.wait(shut)

    def vent_and_wait(self) -> None:
        """Vent, and wait until the muscle is empty."""
        self.set_point = 0.0
        self.recorder.event("venting")
        self.backend.vent()
        self.monitor.expect(None, self.now, venting=True)
        since = self.now

        def in_time(latest: BlockMeans) -> None:
            if latest.time > since + self.bench.limits.settling:
                message = f"{latest.pressure / bar:.3g} bar remain {latest.time - since:.3g} s after venting"
                remedy = "shut the supply by hand, and check the valve; if it is empty, tare its sensor"
                raise StoppedError(message, value=latest.pressure, unit="Pa", remedy=remedy)

        self._settle(lambda latest: latest.pressure <= self.bench.vented, in_time, self.bench.steady)
        self._expect_settled(0.0)

    def _set_valve(self, pressure: float) -> None:
        self.backend.set_valves([max(pressure, 0.0)])

    def _settle(
        self, near: Callable[[BlockMeans], bool], in_time: Callable[[BlockMeans], None], duration: float
    ) -> None:
        """Wait until the pressure has been near its setpoint for a time [s]; `in_time` checks the deadline."""
        steady = 0.0
        while steady < duration - 1e-9:
            before = self.now
            latest = self.read_cycle()
            steady = steady + latest.time - before if near(latest) else 0.0
            in_time(latest)

    def _expect_settled(self, pressure: float) -> None:
        """Monitor the deviation from now on, without more settling time."""
        self.monitor.expect(pressure, self.now - self.bench.limits.settling)

    def read_cycle(self) -> BlockMeans:
        """Means of one cycle."""
        self._cycle()
        assert self._latest is not None
        return self._latest

    def _cycle(self, count: int | None = None, *, plateau: int = -1) -> Block:
        """Read a block, check it, send the heartbeat, record the block."""
        bench, monitor, block = self.bench, self.monitor, None
        try:
            with monitor.guard():
                block = self.backend.read(count or bench.samples_per_cycle, timeout=bench.limits.gap)
                self._latest = latest = monitor.check_block(block, self.backend.clock())
                monitor.heartbeat()
        except BaseException:
            if block is not None:
                with contextlib.suppress(RigError):  # the reason for the stop is more informative
                    self._record(block, 1, plateau)
            raise
        self.pulses = int(block.pulses[-1]) + self.origin
        self._record(block, 1 if plateau >= 0 else bench.decimation, plateau)
        self.stop_flag.check()
        if self.report is not None:
            self.report(Progress(latest.time, latest, bench.contraction_at(self.pulses), self.set_point, self._points))
        return block

    def _record(self, block: Block, every: int, plateau: int) -> None:
        if block.first != self._expected:
            lost = block.first - self._expected
            text = f"{lost} samples were dropped"
            self.recorder.event(DROPPED, text, samples=lost, time=self.since + float(block.time[0]))
        self._expected = block.first + len(block.time)
        kept = slice(-block.first % every, None, every)
        times, pulses = (block.time[kept] + self.since).tolist(), (block.pulses[kept] + self.origin).tolist()
        values = block.values[kept].astype(np.float32).tolist()
        self.recorder.append([(time, *row, at, plateau) for time, row, at in zip(times, values, pulses, strict=True)])

    def record_stop(self, error: BaseException) -> StoppedError:
        """Record the reason of a stop, observe the venting, and return both as an error.

        Parameters
        ----------
        error
            Reason of the stop, of whatever class.

        Returns
        -------
        StoppedError
            Of a signal a `SignalledError`.
        """
        if isinstance(error, KeyboardInterrupt) and self.stop_flag.signal:  # a second signal
            error = self.stop_flag.error()
        reason = str(error) if isinstance(error, McKibbenError) else f"{type(error).__name__}: {error}".rstrip(": ")
        reported: list[str] = []
        bench = self.bench
        self._note(lambda: self.recorder.event(STOPPED, reason, error=type(error).__name__), reported)
        found = self.monitor.observe_venting(
            lambda block: self._note(lambda: self._record(block, 1, -1), reported),
            threshold=bench.vented,
            duration=_OBSERVED,
            samples=bench.samples_per_cycle,
            timeout=bench.cycle,
        )
        if found.pressure is None:
            vented = "the valve was commanded to vent, but no sensor confirms it"
        elif found.duration is not None:
            vented = "the muscle is vented"
        else:
            vented = f"{found.pressure / bar:.3g} bar ARE LEFT IN THE MUSCLE: shut the supply by hand"
        data: dict[str, float] = {} if found.pressure is None else {"pressure": found.pressure}
        if found.pulses is not None:
            data["pulses"] = found.pulses + self.origin
        self._note(lambda: self.recorder.event(VENTED, vented, **data), reported)
        self._note(self.recorder.flush, reported)
        text = "; ".join([f"stopped: {reason}", vented, *(text for text in reported if text not in reason)])
        if isinstance(error, SignalledError):
            return SignalledError(text, signal=error.signal)
        return StoppedError(text)

    def _note(self, do: Callable[[], object], reported: list[str]) -> None:
        """Write to the record; a failure must not prevent venting, and is reported once."""
        try:
            do()
        except Exception as error:
            if str(error) not in reported:
                reported.append(str(error))
