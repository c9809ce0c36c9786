"""Runner of a test: steps on a rig, each cycle checked and recorded; resumable, vented in any case."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.constants import g

from mckibben.errors import McKibbenError, RigError, SignalledError, StoppedError
from mckibben.muscle import Muscle, forces
from mckibben.rig.backend import Block, Channel, MovingBackend
from mckibben.rig.bench import Bench
from mckibben.rig.by_hand import HandBench, length_of
from mckibben.rig.interpreter import StepInterpreter
from mckibben.rig.record import PLACE, POINT, RecordedPoint, Recorder
from mckibben.rig.safety import PROBED, STILL, BlockMeans, RigMonitor, StopFlag
from mckibben.rig.steps import SPEED, Acquire, HoldForce, ProtocolStep
from mckibben.storage.mcap import Column
from mckibben.units import bar, mm, percent

DONE, RESUMED, BLOCK, STOPPED, VENTED, DROPPED = "done", "resumed", "block", "stopped", "vented", "dropped"
"""Kinds of event; a block begins at a `Vent`, from which a test is resumed."""

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


def columns_of(inputs: Sequence[Channel]) -> tuple[Column, ...]:
    """Return the columns of the record of a test.

    >>> [column.name for column in columns_of([Channel("force", "N"), Channel("pressure", "Pa")])]
    ['time', 'force', 'pressure', 'position', 'plateau']
    """
    values = (Column(channel.name, channel.unit, "float32") for channel in inputs)
    return (Column("time", "s"), *values, Column("position", "m", "float32"), Column("plateau", "1", "int32"))


class Runner(StepInterpreter):
    """Runs the steps of a test: each cycle reads a block, checks it, sends the heartbeat and records the block.

    Parameters
    ----------
    backend, bench, recorder
        Backend, the bench with its limits, and an open recorder with the columns of `columns_of`.
    done
        Points that earlier sessions have recorded, up to a `Vent`: the steps before it are skipped.
    origin
        Position of the motor when it was opened [m], from the mounted one.
    since
        Time at which the record goes on [s].
    report
        Is called with the progress after each cycle.
    stop_flag
        Stops the test when a signal has set it.
    """

    def __init__(
        self,
        backend: MovingBackend,
        bench: Bench,
        recorder: Recorder,
        *,
        done: Sequence[RecordedPoint] = (),
        origin: float = 0.0,
        since: float = 0.0,
        report: ProgressCallback | None = None,
        stop_flag: StopFlag | None = None,
    ) -> None:
        super().__init__(bench)
        self.backend, self.recorder, self.origin, self.since = backend, recorder, origin, since
        self.report, self.stop_flag = report, stop_flag or StopFlag()
        self.monitor = RigMonitor(backend, bench.limits, origin)
        self.standing, self.set_point = origin, 0.0  # measured position of the motor [m], set pressure [Pa]
        self._names = [channel.name for channel in backend.inputs]
        self._expected = 0
        self._latest: BlockMeans | None = None
        self._done, self._live, self._number = done, not done, 0
        self._held: float | None = None  # force

    def run(self, steps: Sequence[ProtocolStep]) -> None:
        """Open the backend, do the steps, vent, close.

        Parameters
        ----------
        steps
            Steps of the test, as `dry_run` has checked them.

        Raises
        ------
        StoppedError
            If a limit was exceeded, or anything failed; the muscle was vented, and the reason recorded.
        SignalledError
            If the reason was a signal.
        """
        with self.backend.opened():
            try:
                with self.monitor.guard():
                    self._empty()
                    if self._live:  # the steps begin where the muscle was mounted, at a speed until one sets another
                        self._move_to(0.0, self.bench.fastest / 4)
                    self._do(steps)
                    self._vent()
                    for _ in range(2):  # a chunk that is damaged later must not cause a finished test to move again
                        self.recorder.event(DONE, "all steps are done", points=self._number, position=self.standing)
                        self.recorder.flush()
            except BaseException as error:
                raise self._record_stop(error) from error

    # the steps

    def _acquire(self, acquire: Acquire) -> float:
        number = self._number
        if not self._live:
            self._number += 1
            self.position = self._done[number].position
            return self._done[number].force
        self._measure_length()
        bench, recorder = self.bench, self.recorder
        every = max(1, round(bench.rate * acquire.duration / acquire.samples))
        rows = (acquire.samples - 1) * every + 1
        first, position = recorder.rows, self.standing
        begun, means = self._sampled(rows, number)
        self._number += 1
        point = RecordedPoint(
            number=number,
            first=first,
            rows=rows,
            every=every,
            samples=acquire.samples,
            time=begun,
            position=position,
            contraction=bench.contraction_at(position),
            force=means["force"],
            pressure=means["pressure"],
            set_pressure=self.set_point,
            set_force=self._held,
            direction=acquire.direction,
            phase=acquire.phase,
            repeat=self._repeat,
            keep=acquire.keep,
        )
        self._check_against_law(point)
        recorder.event(POINT if acquire.keep else PLACE, **asdict(point))
        return point.force

    def _check_against_law(self, point: RecordedPoint) -> None:
        """Raise if the force deviates from the law by more than the limit."""
        of, most = self.bench.of, self.bench.limits.deviation
        if most == math.inf or not isinstance(of, Muscle):
            return
        there = float(forces(of, point.contraction, point.pressure))
        if not abs(point.force - there) <= most:
            raise StoppedError(
                f"the force of {point.force:.4g} N at {point.contraction / percent:.4g} % and "
                f"{point.pressure / bar:.3g} bar deviates from the law, {there:.4g} N",
                value=point.force,
                unit="N",
                remedy="check its clamps, the motor and the force sensor, or raise limits.deviation",
            )

    def _move_to(self, position: float, speed: float) -> None:
        self.position = position
        if self._live:
            self._move(position, speed)

    def _rest(self, duration: float) -> None:
        left = round(duration * self.bench.rate) if self._live else 0
        while left > 0:
            left -= len(self._cycle(min(left, self.bench.samples_per_cycle)).time)

    def _pressurise(self, pressure: float, rate: float | None, holding: float | None) -> None:
        self._held = None
        if self._live:
            self._set_pressure(pressure, rate, holding)

    def _vent(self) -> None:
        self._held = None
        if not self._live and self._number >= len(self._done):
            self._live = True
            self.recorder.event(RESUMED, f"at point {self._number}", point=self._number)
        if self._live:
            self.recorder.event(BLOCK, points=self._number)
            self._vent_and_wait()

    def _hold(self, step: HoldForce) -> None:
        self._held = step.force
        if not self._live or self._hang(step.force):
            return
        deadline = self.now + step.longest
        while abs(self._means().force - step.force) > step.tolerance or self.backend.moving:
            self._step_towards(step.force, step.speed)
            if self.now > deadline:
                raise StoppedError(
                    f"the force of {step.force:g} N was not reached within {step.longest:g} s",
                    remedy="choose one that the muscle has at this pressure within its range",
                )
        self.position = self.standing

    # the rig

    @property
    def now(self) -> float:
        """Time of the latest sample, by the clock of the rig [s]."""
        return self._latest.time if self._latest is not None else 0.0

    def _empty(self) -> None:
        """Vent and wait: no pressure is set and nothing moves before the muscle is measured to be empty."""
        self.recorder.event("opened", "", **self.backend.description)
        self._vent_and_wait()
        if self.backend.physical:  # sensors, valve and supply, before the pressure rises above 1 bar
            self._set_pressure(PROBED)
            self._vent_and_wait()

    def _sampled(self, count: int, plateau: int) -> tuple[float, dict[str, float]]:
        """Take and record the rows of a plateau; return the time of the first one [s], and the mean by input."""
        sums: NDArray[np.float64] = np.zeros(len(self._names))
        begun, left = None, count
        while left:
            block = self._cycle(min(left, self.bench.samples_per_cycle), plateau=plateau)
            sums += self.monitor.sums
            begun = float(block.time[0]) if begun is None else begun
            left -= len(block.time)
        return self.since + (begun or 0.0), dict(zip(self._names, (sums / count).tolist(), strict=True))

    def _move(self, position: float, speed: float) -> None:
        """Move the motor to a position [m] at a speed [m/s], and wait until it is there."""
        distance = position - self.standing
        if abs(distance) < STILL:
            return
        if isinstance(self.backend, HandBench):
            self._move_by_hand(self.backend, position)
            return
        self.backend.move(distance, speed)
        deadline = self.now + 1.5 * abs(distance) / speed + 5 * self.bench.cycle + 1.0
        while self.backend.moving or abs(position - self.standing) > STILL:
            # shorter cycles near the end, so that no time is lost
            left = math.ceil(abs(position - self.standing) / speed * self.bench.rate) + 1
            self._cycle(min(self.bench.samples_per_cycle, left))
            if self.now > deadline:
                message = f"the motor is {abs(position - self.standing) / mm:.3g} mm away from its target"
                raise StoppedError(message, remedy="check its driver and its end switches")

    def _move_by_hand(self, bench: HandBench, position: float) -> None:
        if not bench.weights:  # else the muscle is as long as the weight makes it
            self._ask(
                f"turn the screw to {self.bench.contraction_at(position) / percent:.4g} % contraction, then press Enter"
            )
            bench.position = position - self.origin
            self._cycle()

    def _ask(self, text: str) -> str:
        """Ask the operator of a `HandBench`; samples are taken, checked and recorded meanwhile."""
        assert isinstance(self.backend, HandBench)
        if self.backend.simulated is not None:
            return ""
        answer = self.backend.ask(text)
        while not answer.done():
            self._cycle()
        return answer.result()

    def _hang(self, force: float) -> bool:
        """Have a weight of a force [N] hung on the muscle; False on a bench without weights."""
        bench = self.backend
        if not isinstance(bench, HandBench) or not bench.weights:
            return False
        if bench.weight != force:
            self._ask(f"hang {force / g:.4g} kg on the muscle ({force:g} N), then press Enter")
            bench.weight = force
            self._cycle()
        return True

    def _measure_length(self) -> None:
        """Ask for the length of a muscle with a weight."""
        bench, length = self.backend, None
        if not isinstance(bench, HandBench) or not bench.weights:
            return
        if bench.simulated is not None:
            contraction = bench.hanging(self._means().pressure)
        else:
            while length is None:
                length = length_of(self._ask("length of the muscle, such as 163.5 mm"))
            contraction = float(self.bench.specimen.contraction_at(length))
        bench.position = self.bench.position_at(contraction) - self.origin
        self._cycle()

    def _step_towards(self, force: float, speed: float) -> None:
        """Begin a short move towards a force [N], unless the motor is moving."""
        if self.backend.by_hand or self.backend.moving or self._latest is None:
            return
        limits, most = self.bench.limits, speed * self.bench.cycle
        distance = min(max((force - self._latest.force) * _COMPLIANCE, -most), most)
        if distance and -limits.shorten <= self.standing + distance <= limits.stretch:
            self.backend.move(distance, speed)

    def _set_pressure(self, pressure: float, rate: float | None = None, holding: float | None = None) -> None:
        """Change the pressure, and wait until the muscle has it.

        Parameters
        ----------
        pressure
            Set pressure [Pa].
        rate
            Rate of the set pressure [Pa/s]; None for a step.
        holding
            Force that is held meanwhile by moving [N]; None for constant length.

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
                    self._step_towards(holding, SPEED)
        self._set_valve(pressure)
        self.monitor.expect(pressure, self.now)
        remedy = "check supply, valve and muscle, and whether the sensors are swapped"
        self._settle(pressure, lambda measured: abs(measured - pressure) <= self.bench.settled, remedy, holding)

    def _vent_and_wait(self) -> None:
        """Vent, and wait until the muscle is empty."""
        self.set_point = 0.0
        self.recorder.event("venting")
        self.backend.vent()
        self.monitor.expect(None, self.now, venting=True)
        remedy = "shut the supply by hand, and check the valve; if it is empty, tare its sensor"
        self._settle(0.0, lambda measured: measured <= self.bench.vented, remedy)

    def _set_valve(self, pressure: float) -> None:
        self.backend.set_valves([max(pressure, 0.0)])

    def _settle(
        self, pressure: float, near: Callable[[float], bool], remedy: str, holding: float | None = None
    ) -> None:
        """Wait until the pressure has been near its setpoint for a time, then monitor its deviation."""
        set_at, since, settling = self.now, self.now, self.bench.limits.settling
        while self.now - since < self.bench.steady - 1e-9:
            latest = self._means()
            if not near(latest.pressure):
                since = latest.time
            if holding is not None:
                self._step_towards(holding, SPEED)
            if latest.time > set_at + settling + self.bench.steady:
                message = (
                    f"the pressure does not settle: it is {latest.pressure / bar:.3g} bar {latest.time - set_at:.3g} s "
                    f"after {pressure / bar:.3g} bar were set"
                )
                raise StoppedError(message, value=latest.pressure, unit="Pa", remedy=remedy)
        self.monitor.expect(pressure, self.now - settling)

    def _means(self) -> BlockMeans:
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
                clock = self.backend.clock()
                self._latest = latest = monitor.check_block(block, clock)
                monitor.check_latency(clock - latest.time)
                monitor.heartbeat()
        except BaseException:
            if block is not None:
                with contextlib.suppress(RigError):  # the reason for the stop is more informative
                    self._record(block, 1, plateau)
            raise
        self.standing = float(block.position[-1]) + self.origin
        self._record(block, 1 if plateau >= 0 else bench.decimation, plateau)
        self.stop_flag.check()
        if self.report is not None:
            contraction = bench.contraction_at(self.standing)
            self.report(Progress(latest.time, latest, contraction, self.set_point, self._number))
        return block

    def _record(self, block: Block, every: int, plateau: int) -> None:
        if block.first != self._expected:
            lost = block.first - self._expected
            text = f"{lost} samples were dropped"
            self.recorder.event(DROPPED, text, samples=lost, time=self.since + float(block.time[0]))
        self._expected = block.first + len(block.time)
        kept = slice(-block.first % every, None, every)
        times, positions = (block.time[kept] + self.since).tolist(), (block.position[kept] + self.origin).tolist()
        values = block.values[kept].astype(np.float32).tolist()
        rows = zip(times, values, positions, strict=True)
        self.recorder.append([(time, *row, position, plateau) for time, row, position in rows])

    def _record_stop(self, error: BaseException) -> StoppedError:
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
        )
        if found.pressure is None:
            vented = "the valve was commanded to vent, but no sensor confirms it"
        elif found.duration is not None:
            vented = "the muscle is vented"
        else:
            vented = f"{found.pressure / bar:.3g} bar ARE LEFT IN THE MUSCLE: shut the supply by hand"
        data: dict[str, float] = {} if found.pressure is None else {"pressure": found.pressure}
        if found.position is not None:
            data["position"] = found.position + self.origin
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
