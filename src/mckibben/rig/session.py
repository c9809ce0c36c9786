"""A rig in the hands of a test: moves, presses and reads it, watches every reading, and stops it in good order."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mckibben.errors import McKibbenError, RigError, SignalledError, StoppedError
from mckibben.rig.backend import Block, MovingBackend
from mckibben.rig.bench import Bench
from mckibben.rig.recorder import Recorder
from mckibben.rig.safety import BlockMeans, Watch
from mckibben.units import bar, mm

STOPPED, VENTED, DROPPED = "stopped", "vented", "dropped"
"""Kinds of event."""

_AFTERWARDS = 10.0  # s for which a stop is watched
_MOST_AFTERWARDS = 3  # times as many reads as go into that, for samples that wait
_COMPLIANCE = 0.005 * mm  # m/N moved towards a force to be held, a cycle
_SPEED = 0.2 * mm  # m/s of that, at most


class Progress(NamedTuple):
    """How far a test is: the time of the rig [s], what was seen last, and how many points were taken."""

    time: float
    seen: BlockMeans
    contraction: float
    set_pressure: float
    points: int


class Report(Protocol):
    """Is told of progress, every cycle."""

    def __call__(self, progress: Progress) -> None: ...


class PlateauSamples(NamedTuple):
    """Samples that were taken in a row: when the first one was [s], and the mean volts of each input by its name."""

    begun: float
    means: Mapping[str, float]


class RigSession:
    """What a test does with a rig.

    Parameters
    ----------
    backend, bench, recorder
        The rig, what stands on it, and what takes its samples.
    origin
        Where the motor stands when the backend is opened [pulses], from where the muscle was mounted.
    since
        The record's clock when this begins [s].
    report
        Is told of progress.

    Attributes
    ----------
    pulses
        Where the motor stands, from where the muscle was mounted.

    Notes
    -----
    A cycle is: read a block; watch over it; beat; record. If the block is silent, lost or beyond a limit, or a signal
    has come, the next call of the backend is `vent`.
    """

    def __init__(
        self,
        backend: MovingBackend,
        bench: Bench,
        recorder: Recorder,
        *,
        origin: int = 0,
        since: float = 0.0,
        report: Report | None = None,
    ) -> None:
        self.backend = backend
        self.bench = bench
        self.recorder = recorder
        self.pulses = origin
        self._origin = origin
        self._since = since
        self._report = report
        self._names = [channel.name for channel in backend.inputs]
        self._watch = Watch(bench.limits, backend.inputs, bench.calibrations, bench.drive, origin)
        self._expected = 0
        self._seen: BlockMeans | None = None
        self._signal: tuple[int, str] | None = None
        self._set_pressure = 0.0
        self._points = 0
        self._standing: int | None = None  # pulses, seen after a stop

    def interrupt(self, signal: int, name: str) -> None:
        """Stop after the cycle that runs; may be called from a signal handler."""
        self._signal = (signal, name)

    def begin(self) -> None:
        """The first look: nothing is pressed or moved before the muscle is seen to be empty."""
        self.recorder.event("opened", "", **self.backend.description)
        self.vent_and_wait()

    def acquire(self, count: int, plateau: int) -> PlateauSamples:
        """Take so many samples in a row, all of them recorded, as those of a plateau."""
        sums: NDArray[np.float64] = np.zeros(len(self._names))
        begun, left, self._points = None, count, plateau
        while left:
            block = self._cycle(min(left, self.bench.samples_a_cycle), plateau=plateau)
            sums += self._watch.sums
            begun = float(block.time[0]) if begun is None else begun
            left -= len(block.time)
        self._points = plateau + 1
        return PlateauSamples(
            self._since + (begun or 0.0), dict(zip(self._names, (sums / count).tolist(), strict=True))
        )

    @property
    def now(self) -> float:
        """The rig's clock at the last reading [s]."""
        return self._seen.time if self._seen is not None else 0.0

    def move_to(self, pulses: int, speed: float) -> None:
        """Go to where the motor stands so [pulses], at a speed [m/s]."""
        way = pulses - self.pulses
        if not way:
            return
        rate = self.bench.drive.rate(speed)
        self.backend.move(way, rate)
        deadline = self.now + 1.5 * abs(way) / rate + 5 * self.bench.cycle + 1.0
        while self.backend.moving:
            # not a whole cycle where the end is near, so that no time is lost
            left = math.ceil((abs(pulses - self.pulses) / rate) * self.bench.rate) + 1
            self._cycle(min(self.bench.samples_a_cycle, max(left, 1)))
            if self.now > deadline:
                raise StoppedError("the motor does not come to an end", remedy="check its driver")
        while self.pulses != pulses:
            self._cycle(max(1, self.bench.samples_a_cycle // 10))
            if self.now > deadline:
                raise StoppedError(
                    f"the motor stands {abs(self.pulses - pulses)} pulses from where it should",
                    remedy="check its driver and its end switches",
                )

    def step_towards(self, force: float, speed: float) -> None:
        """A short move towards a force."""
        if self.backend.moving or self._seen is None:
            return
        rate = self.bench.drive.rate(speed)
        most = max(1, int(rate * self.bench.cycle))
        way = round((force - self._seen.force) * _COMPLIANCE * self.bench.drive.pulses_per_metre)
        if way := max(-most, min(most, way)):
            limits, per_metre = self.bench.limits, self.bench.drive.pulses_per_metre
            if -limits.shorten * per_metre <= self.pulses + way <= limits.stretch * per_metre:
                self.backend.move(way, rate)

    def wait(self, duration: float) -> None:
        """Let so long go by [s]."""
        left = round(duration * self.bench.rate)
        while left > 0:
            left -= len(self._cycle(min(left, self.bench.samples_a_cycle)).time)

    def set_pressure(self, before: float, pressure: float, rate: float | None, holding: float | None) -> None:
        """Bring the pressure from one to another [Pa], at once or at a rate [Pa/s], its length held or a force [N]."""
        self._set_pressure = pressure
        self.recorder.event("pressure", pressure=pressure)
        if rate is not None:
            begun = self.now
            while (part := rate * (self.now - begun)) < abs(pressure - before):
                set_now = before + math.copysign(part, pressure - before)
                self._watch.expect(set_now, begun)
                self._set(set_now)
                self._cycle()
                if holding is not None:
                    self.step_towards(holding, _SPEED)
        self._set(pressure)
        self._watch.expect(pressure, self.now)
        self._settle(pressure, holding)

    def _set(self, pressure: float) -> None:
        self.backend.set_valves([float(self.bench.calibrations["valve"].volts(max(pressure, 0.0)))])

    def _settle(self, pressure: float, holding: float | None) -> None:
        """Until the pressure was near for a second; the watch stops it where that takes too long."""
        near = 0.0
        while near < self.bench.steady - 1e-9:
            before = self.now
            seen = self.read_cycle()
            near = near + seen.time - before if abs(seen.pressure - pressure) <= self.bench.settled else 0.0
            if holding is not None:
                self.step_towards(holding, _SPEED)
            self._late(pressure, seen)
        self._watch_closely(pressure)

    def vent_and_wait(self) -> None:
        """Vent, and wait until the muscle is empty."""
        self._set_pressure = 0.0
        self.recorder.event("venting")
        self.backend.vent()
        self._watch.expect(None, self.now, venting=True)
        since, near = self.now, 0.0
        while near < self.bench.steady - 1e-9:
            before = self.now
            seen = self.read_cycle()
            near = near + seen.time - before if seen.pressure <= self.bench.vented else 0.0
            if self.now > since + self.bench.limits.settling:
                raise StoppedError(
                    f"{seen.pressure / bar:.3g} bar are left {self.now - since:.3g} s after venting",
                    remedy="shut the supply by hand, and check the valve; if it is empty, tare its sensor",
                )
        self._watch_closely(0.0)

    def _watch_closely(self, pressure: float) -> None:
        """It is there: from now on it has no more time to get there."""
        self._watch.expect(pressure, self.now - self.bench.limits.settling)

    def _late(self, pressure: float, seen: BlockMeans) -> None:
        if seen.time > self._watch.since + self.bench.limits.settling + self.bench.steady:
            raise StoppedError(
                f"the pressure does not settle: {seen.pressure / bar:.3g} bar where {pressure / bar:.3g} bar were set",
                remedy="check the supply, the valve and the muscle",
            )

    def read_cycle(self) -> BlockMeans:
        """What a cycle tells."""
        self._cycle()
        assert self._seen is not None
        return self._seen

    def _cycle(self, count: int | None = None, *, plateau: int = -1) -> Block:
        """Read, watch, beat, record."""
        backend, bench = self.backend, self.bench
        block = backend.read(count or bench.samples_a_cycle, timeout=bench.cycle)
        try:
            self._seen = seen = self._watch.look(block, backend.clock())
        except BaseException:
            backend.vent()
            backend.stop()
            with contextlib.suppress(RigError):  # what the watch found says more
                self._record(block, 1, plateau)
            raise
        backend.heartbeat()
        self.pulses = int(block.pulses[-1]) + self._origin
        self._record(block, 1 if plateau >= 0 else bench.every, plateau)
        if self._signal is not None:
            raise _interrupted(*self._signal)
        if self._report is not None:
            self._report(Progress(seen.time, seen, bench.contraction_at(self.pulses), self._set_pressure, self._points))
        return block

    def _record(self, block: Block, every: int, plateau: int) -> None:
        if block.first != self._expected:
            lost = block.first - self._expected
            text = f"{lost} samples were dropped"
            self.recorder.event(DROPPED, text, samples=lost, time=self._since + float(block.time[0]))
        self._expected = block.first + len(block.time)
        kept = slice(-block.first % every, None, every)
        table: dict[str, object] = {"time": block.time[kept] + self._since, "plateau": np.full(1, plateau)}
        volts = block.volts[kept]
        count = len(volts)
        if not count:
            return
        table["plateau"] = np.full(count, plateau, np.int32)
        table["pulses"] = block.pulses[kept] + self._origin
        for at, name in enumerate(self._names):
            table[name] = volts[:, at]
        self.recorder.append(table)  # type: ignore[arg-type]

    def record_stop(self, error: BaseException) -> StoppedError:
        """Record why, watch the pressure fall, and say both."""
        if isinstance(error, KeyboardInterrupt) and self._signal is not None:  # it came again, and did not wait
            error = _interrupted(*self._signal)
        reason = str(error) if isinstance(error, McKibbenError) else f"{type(error).__name__}: {error}".rstrip(": ")
        said: list[str] = []
        self._note(lambda: self.recorder.event(STOPPED, reason, error=type(error).__name__), said)
        pressure = self._afterwards(said)
        if pressure is None:
            vented = "the valve was told to vent; no reading tells that it did"
        elif pressure <= self.bench.vented:
            vented = "the muscle is vented"
        else:
            vented = f"{pressure / bar:.3g} bar ARE LEFT IN THE MUSCLE: shut the supply by hand"
        data: dict[str, float] = {} if pressure is None else {"pressure": pressure}
        if self._standing is not None:
            data["pulses"] = self._standing
        self._note(lambda: self.recorder.event(VENTED, vented, **data), said)
        self._note(self.recorder.flush, said)
        text = "; ".join([f"stopped: {reason}", vented, *(text for text in said if text not in reason)])
        if isinstance(error, SignalledError):
            return SignalledError(text, signal=error.signal)
        return StoppedError(text)

    def _afterwards(self, said: list[str]) -> float | None:
        """The pressure [Pa] when it has fallen, or after some seconds; None where nothing can be read.

        There are no beats any more: a rig whose `vent` did nothing vents by itself. Samples that waited since before
        the stop tell nothing of what came of it.
        """
        at = self._names.index("pressure")
        calibration = self.bench.calibrations["pressure"]
        seen: float | None = None
        try:
            stopped = self.backend.clock()
            end = stopped + _AFTERWARDS
            for _ in range(_MOST_AFTERWARDS * math.ceil(_AFTERWARDS / self.bench.cycle)):
                block = self.backend.read(self.bench.samples_a_cycle, timeout=self.bench.cycle)
                self.backend.vent()
                self._note(lambda block=block: self._record(block, 1, -1), said)
                if not block.time[0] > stopped - 1 / self.bench.rate:
                    continue
                first, last = int(block.pulses[0]), int(block.pulses[-1])
                self._standing = last + self._origin if first == last else None
                volts = block.volts[:, at]
                if bool(np.any(calibration.lost(volts, self.backend.inputs[at]))):
                    return None
                seen = float(calibration.si(volts).mean())
                if seen <= self.bench.vented or block.time[-1] >= end:
                    break
        except (Exception, KeyboardInterrupt):  # it has been told to vent all the same
            return None
        return seen

    def _note(self, do: Callable[[], None], said: list[str]) -> None:
        """Do something for the record; what is wrong with it must not keep from venting, and is said once."""
        try:
            do()
        except Exception as error:
            if str(error) not in said:
                said.append(str(error))


def _interrupted(number: int, name: str) -> SignalledError:
    return SignalledError(f"it was interrupted ({name})", signal=number)
