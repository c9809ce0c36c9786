"""Simulated hardware of a joint rig."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mckibben.errors import RangeError, RigError, SilentError
from mckibben.numerics.checks import check_positive
from mckibben.plant import JointPlant, PlantState
from mckibben.realtime.compiled_step import PlantProgram, vented_angle
from mckibben.realtime.config import Wiring
from mckibben.rig.backend import Block, Channel
from mckibben.rig.twin.faults import Delaying, Dropping, Fault, HostDelayed, Silent, SupplyLost
from mckibben.units import deg, kPa, ms

SENSORS = ("angle", "pressure1", "pressure2")
"""The inputs of a joint rig."""


@dataclass(frozen=True)
class Unplugged(Fault):
    """A sensor's plug comes off.

    Parameters
    ----------
    sensor
        "angle", "pressure1" or "pressure2".
    volts
        What the open input then reads [V]: 0 V, to which a resistor pulls it.
    """

    sensor: str = "angle"
    volts: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sensor not in SENSORS:
            remedy = f"choose of {', '.join(SENSORS)}"
            raise RangeError(f"Unplugged: no sensor {self.sensor!r}", value=self.sensor, remedy=remedy)


_SPIN = 80e-6  # s: a sleep ends late by up to so much, and the rest is waited for awake
_DRAWN = 1024  # samples whose noise is drawn at once


@dataclass(frozen=True)
class Sensing:
    """How well a virtual joint is measured.

    Parameters
    ----------
    angle_step
        Of the encoder [rad]; 0 for none. 0.022 deg are 14 bits a turn.
    pressure_noise
        Standard deviation [Pa] of each sample.
    volts_step
        Of the converter [V]; 0 for none. 16 bits over 20 V are 0.31 mV.
    """

    angle_step: float = 0.022 * deg
    pressure_noise: float = 4 * kPa
    volts_step: float = 20 / 2**16

    def __post_init__(self) -> None:
        check_positive("Sensing", "rad", zero=True, angle_step=self.angle_step)
        check_positive("Sensing", "Pa", zero=True, pressure_noise=self.pressure_noise)
        check_positive("Sensing", "V", zero=True, volts_step=self.volts_step)


PERFECT = Sensing(0.0, 0.0, 0.0)
"""Without noise and steps: what a simulation has."""


class VirtualJoint:
    """The plant of a scenario as a `Backend`: angle and two pressures in, two valves out, all in volts.

    Samples are taken at whole multiples of the sample period, the first when it is opened. Signals reach the valves
    when they are pressed, in between. Unpaced, its clock stands still but for `read`; paced it is that of the wall, and
    `read` waits: first asleep, then awake.

    Parameters
    ----------
    plant
        Joint, load and valves.
    period
        Between samples [s].
    substeps
        Runge-Kutta steps a sample.
    start
        The state when it is opened. Unless given, it is as a `Backend` has to be: vented, and at rest where the load
        and the empty muscles leave it. A state of a simulation may have pressure; it is as if held there until then.
    wiring
        What its volts mean.
    sensing
        How well it is measured.
    patience
        How long it goes on without a beat [s].
    paced
        Whether its time is that of the wall.
    seed
        Of the noise.
    faults
        What happens to it, at times since it was opened: `Unplugged` of `joint_rig.faults`, and of `rig.twin.faults`
        ``SupplyLost``, ``HostDelayed``, ``Silent``, ``Dropping`` (once) and ``Delaying``.
    program
        Of this plant and number of steps, where it has been compiled before.

    Raises
    ------
    RigError
        If it knows no such fault.
    """

    outputs = (Channel("valve1", 0.0, 10.0, "virtual"), Channel("valve2", 0.0, 10.0, "virtual"))
    inputs = tuple(Channel(name, -10.0, 10.0, "virtual") for name in ("angle", "pressure1", "pressure2"))

    def __init__(
        self,
        plant: JointPlant,
        *,
        period: float,
        substeps: int = 4,
        start: PlantState | None = None,
        wiring: Wiring | None = None,
        sensing: Sensing | None = None,
        patience: float = 100 * ms,
        paced: bool = False,
        seed: int = 0,
        faults: Sequence[Fault] = (),
        program: PlantProgram | None = None,
    ) -> None:
        check_positive("VirtualJoint", "s", period=period, patience=patience)
        known = (Unplugged, SupplyLost, HostDelayed, Silent, Dropping, Delaying)
        strange = [type(fault).__name__ for fault in faults if not isinstance(fault, known)]
        if strange:
            raise RigError(
                f"a virtual joint knows no {', '.join(strange)}",
                remedy=f"choose of {', '.join(one.__name__ for one in known)}",
            )
        self.rate, self.patience, self.paced = 1 / period, patience, paced
        self._period, self._seed, self._faults = period, seed, tuple(faults)
        self._wiring, self._sensing = wiring or Wiring(), sensing or Sensing()
        self._program = program or PlantProgram(plant, substeps)
        state = plant.init_state(vented_angle(plant), (0.0, 0.0)) if start is None else plant.complete_state(start)
        self._start = self._program.state(state)
        self._held_at_start = (0.0, 0.0) if start is None else tuple(map(float, start.pressures))
        rated = plant.joint.muscle1.specimen.domain, plant.joint.muscle2.specimen.domain
        self._rated = tuple((float(domain.pressure_min), float(domain.pressure_max)) for domain in rated)
        self._volts_of = tuple((c.gain, c.offset, c.tare) for c in self._wiring.sensors)
        self.is_open = False
        self._reset()

    def _reset(self) -> None:
        self._state, self._at = self._start, 0.0  # the plant, integrated up to here
        self._held = self._held_at_start
        self._coming: deque[tuple[float, tuple[float, float]]] = deque()  # commands, and when they reach the valves
        self._now = self._beaten = 0.0
        self._next = 0  # sample
        self._vented_itself = False
        self._random = np.random.default_rng(self._seed)
        self._noise: list[list[float]] = []
        self._happened: set[Fault] = set()
        self._origin = time.perf_counter()

    @property
    def described(self) -> Mapping[str, str]:
        """What it is."""
        return {
            "kind": "virtual joint",
            "paced": "yes" if self.paced else "no",
            "seed": str(self._seed),
            "sensing": str(self._sensing),
            "faults": ", ".join(map(str, self._faults)) or "none",
        }

    def open(self) -> None:
        """Begin at the start, the clock at 0."""
        self._reset()
        self.is_open = True

    def clock(self) -> float:
        """Since it was opened [s]."""
        return time.perf_counter() - self._origin if self.paced else self._now

    def beat(self) -> None:
        """Say that the host lives."""
        now = self.clock()
        self._look_whether_host_lives(now)
        self._beaten = now

    def press(self, volts: Sequence[float]) -> None:
        """Hold these signals at the valves [V].

        Raises
        ------
        RigError
            If it has vented itself, or is not open.
        """
        self._check_open()
        now = self.clock()
        self._look_whether_host_lives(now)
        if self._vented_itself:
            raise RigError(
                f"the joint vented itself: there was no beat for {self.patience:g} s",
                remedy="find out what kept the host busy, and open it anew",
            )
        commands = []
        for signal, valve, channel, (low, high) in zip(
            volts, self._wiring.valves, self.outputs, self._rated, strict=True
        ):
            given = min(max(float(signal), channel.low), channel.high)
            commands.append(min(max((given - valve.offset) * valve.gain - valve.tare, low), high))
        self._command(now, (commands[0], commands[1]))

    def vent(self) -> None:
        """Let all air out, at once."""
        self._command(self.clock(), (0.0, 0.0))

    def close(self) -> None:
        """Vent, and let go."""
        if self.is_open:
            self.vent()
        self.is_open = False

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Wait for so many samples, and take them.

        Raises
        ------
        SilentError
            If they do not come.
        RigError
            If it is not open.
        """
        self._check_open()
        if count < 1:
            raise RangeError(f"{count} samples cannot be read", value=count, lower=1)
        self._drop()
        first, rows, times = self._next, [], []
        for _ in range(count):
            due = self._next * self._period
            if self._silent(due):
                self._wait((first + count - 1) * self._period + timeout)
                raise SilentError(
                    f"no sample for {timeout:g} s after it was due", remedy="check the device and its cable"
                )
            self._look_whether_host_lives(due)
            self._advance(due)
            rows.append(self._sensed(due))
            times.append(due)
            self._next += 1
        block = Block(first, np.array(times), np.array(rows), np.zeros(count, np.int64))
        self._wait(self._arriving(times[-1]))
        return block

    def pass_time(self, duration: float) -> None:
        """Let time go by without a host [s]; unpaced."""
        self._now += duration
        if self.is_open:
            self._look_whether_host_lives(self._now)
        self._advance(self._now)

    @property
    def truth(self) -> tuple[float, float, float, float]:
        """Angle [rad], velocity [rad/s] and pressures [Pa], where the plant was last looked at."""
        angle, velocity, pressure1, pressure2 = map(float, self._state[:4])
        return angle, velocity, pressure1, pressure2

    def _check_open(self) -> None:
        if not self.is_open:
            raise RigError("the virtual joint is not open", remedy="open it")

    def _command(self, at: float, commands: tuple[float, float]) -> None:
        self._coming.append((max(at, self._at), commands))

    def _look_whether_host_lives(self, now: float) -> None:
        """Vent when nobody has called for too long; at the time when patience ended, not when it is found."""
        if now - self._beaten > self.patience and not self._vented_itself:
            self._vented_itself = True
            self._command(self._beaten + self.patience, (0.0, 0.0))

    def _advance(self, until: float) -> None:
        """Integrate the plant, each command from when it reached the valves."""
        while self._coming and self._coming[0][0] <= until:
            at, commands = self._coming.popleft()
            self._integrate(at)
            self._held = commands
        self._integrate(until)

    def _integrate(self, until: float) -> None:
        """Under the commands in force, in whole sample periods and what is left of one."""
        little = 1e-9 * self._period
        while (stretch := until - self._at) > little:
            step = self._period if stretch > self._period - little else stretch
            supplied = not any(isinstance(fault, SupplyLost) and fault.at <= self._at for fault in self._faults)
            command1, command2 = self._held if supplied else (0.0, 0.0)
            self._state = self._program.over(self._state, command1, command2, step)
            self._at = until if stretch - step <= little else self._at + step

    def _sensed(self, due: float) -> list[float]:
        """The volts of the sensors."""
        angle, _, pressure1, pressure2 = self._state[:4].tolist()
        sensing = self._sensing
        if sensing.angle_step:
            angle = round(angle / sensing.angle_step) * sensing.angle_step
        if sensing.pressure_noise:
            if not self._noise:
                self._noise = (self._random.standard_normal((_DRAWN, 2)) * sensing.pressure_noise).tolist()
            noise1, noise2 = self._noise.pop()
            pressure1, pressure2 = pressure1 + noise1, pressure2 + noise2
        volts = []
        for value, (gain, offset, tare), channel in zip(
            (angle, pressure1, pressure2), self._volts_of, self.inputs, strict=True
        ):
            signal = (value + tare) / gain + offset
            for fault in self._faults:
                if isinstance(fault, Unplugged) and fault.sensor == channel.name and fault.at <= due:
                    signal = fault.volts
            if sensing.volts_step:
                signal = round(signal / sensing.volts_step) * sensing.volts_step
            volts.append(min(max(signal, channel.low), channel.high))
        return volts

    def _silent(self, due: float) -> bool:
        return any(isinstance(fault, Silent) and fault.at <= due for fault in self._faults)

    def _drop(self) -> None:
        """Lose the samples that a fault takes."""
        for fault in self._faults:
            due = self._next * self._period
            if isinstance(fault, Dropping) and fault.at <= due and fault not in self._happened:
                self._happened.add(fault)
                self._next += fault.samples

    def _arriving(self, due: float) -> float:
        """When a sample reaches the host [s], and the host comes to take it."""
        arriving = due
        for fault in self._faults:
            if isinstance(fault, Delaying) and fault.at <= due:
                arriving = max(arriving, due + fault.delay)
            if isinstance(fault, HostDelayed) and fault.at <= due and fault not in self._happened:
                self._happened.add(fault)
                arriving = max(arriving, due, self.clock()) + fault.duration
        return arriving

    def _wait(self, until: float) -> None:
        if not self.paced:
            self._now = max(self._now, until)
            return
        until += self._origin
        left = until - time.perf_counter()
        while left > _SPIN:
            time.sleep(left - _SPIN)
            left = until - time.perf_counter()
        while time.perf_counter() < until:
            pass
