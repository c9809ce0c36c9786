"""Faults of the simulated rig at random instants: it has to vent, and no recorded sample may be lost or changed.

After each: the true pressure is below 0.2 bar a second and a half after the test
has ended; where the test was stopped, the rig was vented by the very next thing that was done to it after the reading
that told; the reason stands in the record; and the record holds the very values that were read.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mckibben import catalog
from mckibben.errors import StoppedError
from mckibben.muscle import MaxwellSlip, Muscle
from mckibben.rig.backend import Block
from mckibben.rig.bench import Bench, RigLimits
from mckibben.rig.record import read_record
from mckibben.rig.recorder import Recorder
from mckibben.rig.runner import Runner, columns_of
from mckibben.rig.session import STOPPED, RigSession
from mckibben.rig.simulated import (
    Burst,
    Fault,
    HostDelayed,
    SamplesDelayed,
    SamplesDropped,
    SamplesStopped,
    SensorDisconnected,
    SimulatedRig,
    Stalled,
    SupplyLost,
    ValveStuck,
)
from mckibben.rig.steps import Acquire, Dwell, Move, Pressurise, Vent, Walk
from mckibben.units import bar, mm, percent

FAULTS: Mapping[str, Callable[[float], Fault]] = {
    "supply lost": SupplyLost,
    "force sensor unplugged, at a rail": lambda at: SensorDisconnected(at, "force"),
    "force sensor unplugged, floating": lambda at: SensorDisconnected(at, "force", value=None),
    "force sensor hangs": lambda at: SensorDisconnected(at, "force", value=140.0),
    "pressure sensor unplugged, at a rail": lambda at: SensorDisconnected(at, "pressure"),
    "pressure sensor unplugged, floating": lambda at: SensorDisconnected(at, "pressure", value=None),
    "pressure sensor hangs": lambda at: SensorDisconnected(at, "pressure", value=2 * bar),
    "muscle bursts": Burst,
    "motor stalls": Stalled,
    "host delayed, long": lambda at: HostDelayed(at, 3.0),
    "host delayed, a little": lambda at: HostDelayed(at, 0.3),
    "daq silent": SamplesStopped,
    "daq drops": SamplesDropped,
    "daq drops many": lambda at: SamplesDropped(at, 900),
    "daq delays": SamplesDelayed,
    "daq delays a little": lambda at: SamplesDelayed(at, 0.03),
    "valve stuck open": ValveStuck,
    "valve stuck shut": lambda at: ValveStuck(at, 0.0),
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
TOLD_BY_A_READING = (
    "is lost",
    "beyond the limit",
    "outside the limits",
    "does not follow",
    "s old",
    "were dropped",
    "goes back",
)


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
    twin = SimulatedRig(MUSCLE, seed=seed, faults=[fault])
    rig, reason = Spied(twin), ""
    bench = Bench(of=MUSCLE, drive=twin.drive, limits=LIMITS, steady=0.3)
    with Recorder(folder, {}, columns_of(twin.inputs)) as recorder:
        try:
            Runner(RigSession(rig, bench, recorder)).run(STEPS)  # type: ignore[arg-type]
        except StoppedError as error:
            reason = str(error)
    twin.pass_time(1.5)
    assert twin.truth.pressure < 0.2 * bar, f"{twin.truth.pressure / bar:.3g} bar are left: {reason}"
    record = read_record(folder)
    if reason:
        (stopped,) = (event for event in record.events if event.kind == STOPPED)
        assert stopped.text in reason
        _vented_at_once(rig.calls, reason)
    told = any(words in reason for words in TOLD_BY_A_READING)
    before = rig.calls[: rig.calls.index("stop")].count("read") - 1 if told else len(rig.blocks)
    _faithful(record.columns, rig.blocks, before)
    return reason


def _vented_at_once(calls: list[str], reason: str) -> None:
    """From the reading that told to the vent nothing else was done, and nothing was pressed or moved after it."""
    first = calls.index("stop") - 1
    assert calls[first] == "vent"
    assert not {"set_valves", "move"} & {*calls[first:]}
    if any(words in reason for words in TOLD_BY_A_READING):
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
