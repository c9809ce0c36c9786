"""Simulated hardware of a joint rig."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mckibben.component.base import Checked
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError, RigError, SilentError
from mckibben.plant import JointPlant, PlantState
from mckibben.rig.backend import Backend, Block, Channel, Watchdog
from mckibben.rig.compiled import PlantProgram, complete_state, vented_angle
from mckibben.rig.simulated.faults import (
    RAIL,
    Fault,
    HostDelayed,
    SamplesDelayed,
    SamplesDropped,
    SamplesStopped,
    SensorDisconnected,
    SupplyLost,
)
from mckibben.units import AngleStep, PressureNoise, bar, deg, kPa, ms

F = TypeVar("F", bound=Fault)

_SPIN = 80e-6  # s of spinning, as a sleep may end late
_DRAWN = 1024  # samples of noise drawn at once
_INPUTS = (
    Channel("angle", "rad", -170 * deg, 170 * deg, "simulated"),
    *(Channel(name, "Pa", -0.5 * bar, 10.2 * bar, "simulated") for name in ("pressure1", "pressure2")),
)


@dataclass(frozen=True)
class Sensing(Checked):
    """Sensors of a simulated joint.

    Parameters
    ----------
    angle_step
        Resolution of the encoder [rad], 14 bits per revolution; 0 for none.
    pressure_noise
        Standard deviation of each sample [Pa].
    """

    angle_step: AngleStep = 0.022 * deg
    pressure_noise: PressureNoise = 4 * kPa


PERFECT = Sensing(0.0, 0.0)
"""Ideal sensors, as in a simulation."""


def rated_commands(plant: JointPlant) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ranges of the commands [Pa] of both muscles: their rated pressures, and the supply if known."""
    valve, muscles = plant.valve, enumerate(plant.muscles)
    (low1, high1), (low2, high2) = (valve.for_muscle(i).command_range(one.specimen.domain) for i, one in muscles)
    return ((float(low1), float(high1)), (float(low2), float(high2)))


class SimulatedJoint(Backend):
    """The plant of a scenario as a backend: angle and two pressures in, two valves out.

    Samples are taken at multiples of the sampling period [s], the first when it is opened. Signals reach the valves
    when they are set, between two samples, or after the plant's command delay. Without a heartbeat the watchdog
    vents. Unpaced, its time advances only in `read`; paced, it is real time, and `read` sleeps, then spins.

    Parameters
    ----------
    substeps
        Runge-Kutta steps per sample.
    start
        Initial state, at constant pressures until then. Default: vented and at rest.
    patience
        Timeout of the watchdog [s].
    seed
        Seed of the noise.
    faults
        Faults of `rig.simulated.faults` at times since it was opened: of sensors, samples, host and supply.
    program
        Compiled program of this plant and number of steps, if there is one.

    Raises
    ------
    RigError
        If a fault is not supported.
    """

    physical = False

    def __init__(
        self,
        plant: JointPlant,
        *,
        period: float,
        substeps: int = 4,
        start: PlantState | None = None,
        sensing: Sensing | None = None,
        patience: float = 100 * ms,
        paced: bool = False,
        seed: int = 0,
        faults: Sequence[Fault] = (),
        program: PlantProgram | None = None,
    ) -> None:
        check_positive("SimulatedJoint", "s", period=period, patience=patience)
        supported = (SensorDisconnected, SupplyLost, HostDelayed, SamplesStopped, SamplesDropped, SamplesDelayed)
        for fault in faults:
            if isinstance(fault, SensorDisconnected):
                fault.check([channel.name for channel in _INPUTS])
        unsupported = [type(fault).__name__ for fault in faults if not isinstance(fault, supported)]
        if unsupported:
            raise RigError(
                f"a simulated joint does not support {', '.join(unsupported)}",
                remedy=f"choose one of {', '.join(one.__name__ for one in supported)}",
            )
        self.rate, self.patience, self.paced = 1 / period, patience, paced
        self._delay = float(plant.command_delay or 0.0)
        self._period, self._seed, self._faults = period, seed, tuple(faults)
        self.sensing = sensing or Sensing()
        self.program = program or PlantProgram(plant, substeps)
        first = PlantState(vented_angle(plant), 0.0, (0.0, 0.0)) if start is None else start  # type: ignore[arg-type]
        self._start = self.program.state(complete_state(plant, first))
        self._initial_commands = (0.0, 0.0) if start is None else (float(start.pressures[0]), float(start.pressures[1]))
        self._rated = rated_commands(plant)
        self.is_open = False
        self._reset()

    def _reset(self) -> None:
        self._state, self._at = self._start, 0.0  # state of the plant, and its time
        self._commands = self._initial_commands
        self._pending: deque[tuple[float, tuple[float, float]]] = deque()  # times and commands
        self._now = 0.0
        self._next = 0  # sample
        self._watchdog = Watchdog(self.patience)
        self._random = np.random.default_rng(self._seed)
        self._noise: list[list[float]] = []
        self._happened: set[Fault] = set()
        self._origin = time.perf_counter()

    @property
    def inputs(self) -> Sequence[Channel]:
        return _INPUTS

    @property
    def outputs(self) -> Sequence[Channel]:
        highest = max(9 * bar, *(high for _, high in self._rated))
        return tuple(Channel(name, "Pa", 0.0, highest, "simulated") for name in ("valve1", "valve2"))

    @property
    def description(self) -> Mapping[str, str]:
        return {
            "kind": "simulated joint",
            "paced": "yes" if self.paced else "no",
            "seed": str(self._seed),
            "sensing": str(self.sensing),
            "faults": ", ".join(map(str, self._faults)) or "none",
        }

    def open(self) -> None:
        """Open it at the initial state, the clock at 0."""
        self._reset()
        self.is_open = True

    def clock(self) -> float:
        return time.perf_counter() - self._origin if self.paced else self._now

    def heartbeat(self) -> None:
        now = self.clock()
        self._check_watchdog(now)
        self._watchdog.reset(now)

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressures of the valves [Pa]; `RigError` if the watchdog has expired, or it is not open."""
        self._check_open()
        now = self.clock()
        self._check_watchdog(now)
        if self._watchdog.has_expired:
            raise RigError(
                f"the joint vented by itself: there was no heartbeat for {self.patience:g} s",
                remedy="find out what kept the host busy, and reopen it",
            )
        commands = [min(max(float(p), low), high) for p, (low, high) in zip(pressures, self._rated, strict=True)]
        self._command(now, (commands[0], commands[1]))

    def vent(self) -> None:
        self._command(self.clock(), (0.0, 0.0))

    def close(self) -> None:
        if self.is_open:
            self.vent()
        self.is_open = False

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        self._check_open()
        if count < 1:
            raise RangeError(f"{count} samples cannot be read", value=count, lower=1)
        self._next += sum(fault.samples for fault in self._new(SamplesDropped, self._next * self._period))
        first, rows, times = self._next, [], []
        for _ in range(count):
            due = self._next * self._period
            if self._active(SamplesStopped, due):
                self._wait((first + count - 1) * self._period + timeout)
                raise SilentError(
                    f"no sample for {timeout:g} s after it was due", remedy="check the device and its cable"
                )
            self._check_watchdog(due)
            self._advance(due)
            rows.append(self._sensed(due))
            times.append(due)
            self._next += 1
        block = Block(first, np.array(times), np.array(rows), np.zeros(count, np.int64))
        self._wait(self._arriving(times[-1]))
        return block

    def pass_time(self, duration: float) -> None:
        """Advance the time [s] without a host, if unpaced."""
        self._now += duration
        if self.is_open:
            self._check_watchdog(self._now)
        self._advance(self._now)

    @property
    def truth(self) -> tuple[float, float, float, float]:
        """True angle [rad], velocity [rad/s] and pressures [Pa], as last computed."""
        angle, velocity, pressure1, pressure2 = map(float, self._state[:4])
        return angle, velocity, pressure1, pressure2

    def _check_open(self) -> None:
        if not self.is_open:
            raise RigError("the simulated joint is not open", remedy="open it")

    def _command(self, sent: float, commands: tuple[float, float]) -> None:
        self._pending.append((max(sent + self._delay, self._at), commands))

    def _check_watchdog(self, now: float) -> None:
        """Vent at the time at which the watchdog expired, which may be before now [s]."""
        if self._watchdog.expires(now):
            deadline = self._watchdog.deadline
            self._pending = deque(one for one in self._pending if one[0] <= deadline)  # later ones have no effect
            self._pending.append((max(deadline, self._at), (0.0, 0.0)))

    def _advance(self, until: float) -> None:
        """Integrate the plant; each command takes effect at its time."""
        while self._pending and self._pending[0][0] <= until:
            at, commands = self._pending.popleft()
            self._integrate(at)
            self._commands = commands
        self._integrate(until)

    def _integrate(self, until: float) -> None:
        """Integrate under the present commands, in sampling periods and a remainder."""
        little = 1e-9 * self._period
        while (stretch := until - self._at) > little:
            step = self._period if stretch > self._period - little else stretch
            command1, command2 = (0.0, 0.0) if self._active(SupplyLost, self._at) else self._commands
            self._state = self.program.advance(self._state, command1, command2, step)
            self._at = until if stretch - step <= little else self._at + step

    def _sensed(self, due: float) -> list[float]:
        """Readings of the sensors."""
        angle, _, pressure1, pressure2 = self._state[:4].tolist()
        sensing = self.sensing
        if sensing.angle_step:
            angle = round(angle / sensing.angle_step) * sensing.angle_step
        if sensing.pressure_noise:
            if not self._noise:
                self._noise = self._drawn()
            noise1, noise2 = self._noise.pop()
            pressure1, pressure2 = pressure1 + noise1, pressure2 + noise2
        values = [angle, pressure1, pressure2]
        for fault in self._active(SensorDisconnected, due):
            column = [channel.name for channel in _INPUTS].index(fault.sensor)
            values[column] = float(fault.values_at(np.array([due]), RAIL * _INPUTS[column].high)[0])
        return values

    def _drawn(self) -> list[list[float]]:
        """Noise of the pressures [Pa]."""
        return (self._random.standard_normal((_DRAWN, 2)) * self.sensing.pressure_noise).tolist()

    def _active(self, kind: type[F], due: float) -> list[F]:
        """Faults of a kind that have happened until a time [s]."""
        return [fault for fault in self._faults if isinstance(fault, kind) and fault.at <= due]

    def _new(self, kind: type[F], due: float) -> list[F]:
        """Faults of a kind that have happened until a time [s], since the last call."""
        new = [fault for fault in self._active(kind, due) if fault not in self._happened]
        self._happened |= {*new}
        return new

    def _arriving(self, due: float) -> float:
        """Time at which the host reads a sample [s]."""
        arriving = max([due, *(due + fault.delay for fault in self._active(SamplesDelayed, due))])
        for fault in self._new(HostDelayed, due):
            arriving = max(arriving, self.clock()) + fault.duration
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
