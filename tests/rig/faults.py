"""Faults of simulated hardware at random instants: it has to vent, and no recorded sample may be lost or changed.

After each: the true pressure is below 0.2 bar a second and a half after the test
has ended; where the test was stopped, the rig was vented by the very next thing that was done to it after the reading
that told; the reason stands in the record; and the record holds the very values that were read.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mckibben import catalog
from mckibben.errors import SilentError, StoppedError
from mckibben.muscle import MaxwellSlip, Muscle
from mckibben.rig.backend import Block
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.record import Recorder, read_record
from mckibben.rig.runner import STOPPED, Runner, columns_of
from mckibben.rig.simulated import SimulatedRig
from mckibben.rig.simulated.joint import SimulatedJoint
from mckibben.rig.steps import Acquire, Dwell, Move, Pressurise, Vent, Walk
from mckibben.units import bar, mm, percent


class Fault(NamedTuple):
    """What happens to a rig at a time [s] since it was first opened."""

    at: float
    happen: Callable[[Any], object]


class Faulty:
    """Simulated hardware with faults."""

    silent, delay, late, dropped = False, 0.0, 0.0, 0

    def __init__(self, *parts: Any, faults: Any = (), **settings: Any) -> None:
        self.faults = sorted(faults)
        super().__init__(*parts, **settings)

    def _advance(self, to: float) -> None:
        while self.faults and self.faults[0].at <= to:
            fault = self.faults.pop(0)
            super()._advance(fault.at)
            fault.happen(self)
        super()._advance(to)

    def _sample(self, *knots: Any) -> None:
        if not self.silent:
            super()._sample(*knots)

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self._check_open()
        self._wait(self._due(count))
        if self.dropped:
            dropped, self.dropped = self.dropped, 0
            super().read(dropped)
            self._wait(self._due(count))
        if (self.silent and self._taken < self._next + count) or self.delay > timeout:
            self._wait(self._due(count) + timeout)
            raise SilentError(f"no samples for {timeout:g} s")
        self._wait(max(self.now + self.late, self._due(count) + self.delay))
        self.late = 0.0
        return super().read(count, timeout=timeout)


class FaultyRig(Faulty, SimulatedRig):
    """The test rig."""

    def change(self, **fields: float) -> None:
        """Change the regulator, also to what none could be built with."""
        self._regulator = copy.copy(self._regulator)
        for name, value in fields.items():
            object.__setattr__(self._regulator, name, value)
        vars(self).pop("_stable", None)
        self._resting = False


class FaultyJoint(Faulty, SimulatedJoint):
    """The joint."""


def supply_lost(at: float) -> Fault:
    def happen(rig: Any) -> None:
        if isinstance(rig, SimulatedRig):
            rig.change(supply=0.0)
        else:
            rig._rated = ((0.0, 0.0),) * 2
            rig._commands = 0.0, 0.0

    return Fault(at, happen)


def disconnected(at: float, name: str, value: float | None = math.inf) -> Fault:
    """The sensor reads a value, by default beyond its range; None: it floats."""

    class Lost:
        def __init__(self, sensor: Any) -> None:
            self.channel, self.noise, self.top = sensor.channel, sensor.noise, 1.02 * sensor.channel.high

        def values(self, truth: np.ndarray, noise: np.ndarray) -> np.ndarray:
            if value is None:
                return self.top * (0.1 + 0.2 * np.sin(np.arange(len(truth)))) + noise
            return np.full(len(truth), min(value, self.top))

    def happen(rig: Any) -> None:
        rig.sensors = tuple(Lost(sensor) if sensor.channel.name == name else sensor for sensor in rig.sensors)

    return Fault(at, happen)


def samples_stopped(at: float) -> Fault:
    return Fault(at, lambda rig: setattr(rig, "silent", True))


def samples_dropped(at: float, samples: int = 10) -> Fault:
    """Samples are lost, and all that wait to be read."""
    return Fault(at, lambda rig: setattr(rig, "dropped", rig._taken + samples - rig._next))


def samples_delayed(at: float, delay: float = 0.2) -> Fault:
    return Fault(at, lambda rig: setattr(rig, "delay", delay))


def host_delayed(at: float, duration: float = 1.0) -> Fault:
    return Fault(at, lambda rig: setattr(rig, "late", duration))


def burst(at: float) -> Fault:
    return Fault(at, lambda rig: rig.change(leak=5e-8))


def stalled(at: float) -> Fault:
    """Its position is counted all the same."""

    def happen(rig: Any) -> None:
        travel = rig._motor.travel(rig.now)
        rig._motor.travel = lambda now: travel  # positions go on

    return Fault(at, happen)


def stuck_shut(at: float) -> Fault:
    return Fault(at, lambda rig: rig.change(conductance=0.0))


def stuck_open(at: float) -> Fault:
    def happen(rig: Any) -> None:
        rig._set_signal(9 * bar, 0.0)
        rig._set_signal = lambda *_: None

    return Fault(at, happen)


FAULTS: Mapping[str, Callable[[float], Fault]] = {
    "supply lost": supply_lost,
    "force sensor unplugged, at a rail": partial(disconnected, name="force"),
    "force sensor unplugged, floating": partial(disconnected, name="force", value=None),
    "force sensor hangs": partial(disconnected, name="force", value=140.0),
    "pressure sensor unplugged, at a rail": partial(disconnected, name="pressure"),
    "pressure sensor unplugged, floating": partial(disconnected, name="pressure", value=None),
    "pressure sensor hangs": partial(disconnected, name="pressure", value=2 * bar),
    "muscle bursts": burst,
    "motor stalls": stalled,
    "host delayed, long": partial(host_delayed, duration=3.0),
    "host delayed, a little": partial(host_delayed, duration=0.3),
    "daq silent": samples_stopped,
    "daq drops": samples_dropped,
    "daq drops many": partial(samples_dropped, samples=900),
    "daq delays": samples_delayed,
    "daq delays a little": partial(samples_delayed, delay=0.03),
    "valve stuck open": stuck_open,
    "valve stuck shut": stuck_shut,
}
MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"), MaxwellSlip(12.0, 0.5e-3))
LIMITS = RigLimits(pressure=3.5 * bar, force=400.0, stretch=8 * mm, shorten=50 * mm, frozen=0.5, deviation=40.0)
ACQUIRE = Acquire(samples=100, duration=0.1, direction="unloading")
STEPS = (
    Move(to=1 * percent, speed=2 * mm),
    Pressurise(pressure=2 * bar),
    Dwell(duration=0.3),
    Walk(to=5 * percent, step=2 * mm, speed=4 * mm, dwell=0.1, acquire=ACQUIRE),
    Pressurise(pressure=3 * bar),
    ACQUIRE,
    Vent(),
)
DURATION = 5.5  # s of it
TOLD_BY_READING = "is lost|beyond the limit|outside the limits|does not follow|s old|were dropped|goes back".split("|")


class Spied:
    """A rig, and what was done to it."""

    def __init__(self, rig: SimulatedRig) -> None:
        self.rig = rig
        self.blocks: list[Block] = []
        self.calls: list[str] = []

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self.calls.append("read")
        self.blocks.append(self.rig.read(count, timeout=timeout))
        return self.blocks[-1]

    def __getattr__(self, name: str) -> Any:
        if name in ("set_valves", "move", "vent", "stop", "heartbeat"):
            self.calls.append(name)
        return getattr(self.rig, name)


def broken(fault: Fault, seed: int, folder: Path) -> str:
    """Run the test with a fault: why it was stopped; empty where it was not."""
    twin = FaultyRig(MUSCLE, seed=seed, faults=[fault])
    rig, reason = Spied(twin), ""
    bench = Bench(of=MUSCLE, limits=LIMITS, steady=0.3)
    with Recorder(folder, {}, columns_of(twin.inputs)) as recorder:
        try:
            Runner(rig, bench, recorder).run(STEPS)  # type: ignore[arg-type]
        except StoppedError as error:
            reason = str(error)
    twin.pass_time(1.5)
    assert twin.truth.pressure < 0.2 * bar, f"{twin.truth.pressure / bar:.3g} bar are left: {reason}"
    record = read_record(folder)
    if reason:
        (stopped,) = (event for event in record.events if event.kind == STOPPED)
        assert stopped.text in reason
        _vented_at_once(rig.calls, reason)
    told = any(words in reason for words in TOLD_BY_READING)
    before = rig.calls[: rig.calls.index("stop")].count("read") - 1 if told else len(rig.blocks)
    _faithful(record.columns, rig.blocks, before)
    return reason


def _vented_at_once(calls: list[str], reason: str) -> None:
    """From the reading that told to the vent nothing else was done, and nothing was pressed or moved after it."""
    first = calls.index("stop") - 1
    assert calls[first] == "vent"
    assert not {"set_valves", "move"} & {*calls[first:]}
    if any(words in reason for words in TOLD_BY_READING):
        assert calls[first - 1] == "read", (reason, calls[first - 3 : first + 1])


def _faithful(columns: Mapping[str, np.ndarray], blocks: list[Block], before: int) -> None:
    """Each row is what was read at its time; and from the block on that stopped the test none is left out."""
    if not blocks:
        assert not len(columns["time"])
        return
    time_read = np.concatenate([block.time for block in blocks])
    values = np.concatenate([block.values for block in blocks]).astype(np.float32)
    at = np.searchsorted(time_read, columns["time"] - 1e-9)
    np.testing.assert_array_equal(columns["time"], time_read[at])
    np.testing.assert_array_equal(columns["force"], values[at, 0])
    np.testing.assert_array_equal(columns["pressure"], values[at, 1])
    assert (np.diff(at) > 0).all()
    assert len(columns["time"]) >= len(blocks) - 1
    for block in blocks[before:]:
        assert np.isin(block.time, columns["time"]).all()
