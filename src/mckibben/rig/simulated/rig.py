"""Simulated rig: a `MovingBackend` in simulated or in real time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mckibben.component.checks import check_positive, check_within
from mckibben.errors import RangeError, RigError, SilentError
from mckibben.muscle import Muscle
from mckibben.rig.backend import Block, Channel, MovingBackend, Watchdog
from mckibben.rig.simulated.faults import Fault, HostDelayed, SensorDisconnected
from mckibben.rig.simulated.machine import INSTANT, Machine, Truth
from mckibben.rig.simulated.parts import Regulator, Stretcher
from mckibben.rig.simulated.sensing import FORCE_SENSOR, PRESSURE_SENSOR, VALVE, Sampling, Sensor
from mckibben.units import Hz, s


class SimulatedRig(MovingBackend):
    """The paper's stretching device with a muscle; two inputs and one output.

    Simulated time advances only in `read`, by the duration of the samples, unless it is paced by real time. The
    same seed and the same calls give the same samples.

    - The force is that of the muscle, with its friction and creep.
    - The air is that of a `PressureRegulator`, in the volume of the braid between the clamps: isothermal, or with a
      `wall_conductance` of the regulator by the energy balance of `AirActuator`.
    - After `vent`, or a missed heartbeat, a spring-return valve vents, independent of the regulator: from 8 bar, at any
      contraction, the true pressure is below 0.2 bar within 1 s (tested), in spite of any other fault.
    - `vent` holds until `set_valves` gives a signal above 0 again. A missed heartbeat holds until it is reopened.

    Parameters
    ----------
    seed
        Seed of noise and the regulator's offsets, each with its own stream.
    mounted_at
        Contraction [-] at which the muscle is clamped, relaxed.
    regulator, stretcher, force_sensor, pressure_sensor
        Its parts.
    rate, patience
        Sampling rate of each input [Hz], timeout of the watchdog [s].
    paced
        Whether it runs in real time.
    wall, sleep
        Clock of real time [s], and function that sleeps for a time [s]; by default those of the system.

    Raises
    ------
    RangeError
        If a number is out of range.

    Examples
    --------
    >>> from mckibben import catalog
    >>> from mckibben.units import bar
    >>> muscle = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
    >>> rig = SimulatedRig(muscle, seed=1)
    >>> rig.open()
    >>> rig.set_valves([6 * bar])
    >>> for _ in range(20):
    ...     block = rig.read(100)
    ...     rig.heartbeat()
    >>> force, pressure = block.values.mean(axis=0)
    >>> round(float(force))  # of Eq. 3: 585 N
    582
    >>> rig.vent()
    >>> rig.pass_time(1.0)
    >>> rig.truth.pressure < 0.2 * bar
    True
    """

    physical, homed, shuts = False, True, True

    def __init__(
        self,
        muscle: Muscle,
        *,
        seed: int = 0,
        mounted_at: float = 0.0,
        faults: Sequence[Fault] = (),
        regulator: Regulator | None = None,
        stretcher: Stretcher | None = None,
        force_sensor: Sensor = FORCE_SENSOR,
        pressure_sensor: Sensor = PRESSURE_SENSOR,
        rate: float = 1000 * Hz,
        patience: float = 1 * s,
        paced: bool = False,
        wall: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        check_positive("simulated rig", "Hz", rate=rate)
        check_positive("simulated rig", "s", patience=patience)
        check_positive("simulated rig", zero=True, seed=seed)
        check_within("simulated rig", -0.5, 0.8, mounted_at=mounted_at)
        self.rate = float(rate)
        self.patience = float(patience)
        self._muscle, self._seed, self._faults = muscle, seed, tuple(faults)
        self._mounted_at = mounted_at
        self._regulator = regulator or Regulator()
        self.supply = min(self._regulator.supply, self._regulator.highest)
        self._stretcher = stretcher or Stretcher()
        self.drive = self._stretcher.drive
        self._sensors = {"force": force_sensor, "pressure": pressure_sensor}
        for fault in self._faults:
            if isinstance(fault, SensorDisconnected):
                fault.check([*self._sensors])
        noise, self._offsets = np.random.default_rng(seed).spawn(2)
        self._sampling = Sampling(self._sensors, self.rate, noise)
        self._machine = Machine(muscle, mounted_at, self._regulator, self._stretcher)
        self._opened = 0.0  # by the machine's time [s]
        self.paced, self._wall, self._sleep, self._began = paced, wall, sleep, wall()
        self.is_open = False
        self._watchdog = Watchdog(self.patience)
        self._late = 0.0  # of the host [s]
        self._schedule = sorted(self._faults, key=lambda fault: fault.at)

    @property
    def inputs(self) -> Sequence[Channel]:
        return tuple(sensor.channel for sensor in self._sensors.values())

    @property
    def outputs(self) -> Sequence[Channel]:
        return (VALVE,)

    @property
    def description(self) -> Mapping[str, str]:
        return {
            "kind": "simulated",
            "muscle": self._muscle.specimen.name,
            "law": repr(self._muscle.law),
            "friction": repr(self._muscle.friction),
            "creep": repr(self._muscle.creep),
            "mounted_at": f"{self._mounted_at:g}",
            "regulator": repr(self._regulator),
            "stretcher": repr(self._stretcher),
            **{f"{name} sensor": repr(sensor) for name, sensor in self._sensors.items()},
            "faults": ", ".join(map(repr, self._faults)) or "none",
            "seed": str(self._seed),
        }

    @property
    def truth(self) -> Truth:
        """True state."""
        return self._machine.truth

    def open(self) -> None:
        """Open the rig, vented and at rest. Times of faults count from the first opening."""
        if self.is_open:
            raise RigError("the simulated rig is already open", remedy="close it first")
        self._rest()
        self.is_open = True
        self._opened = now = self._machine.now
        self._began = self._wall()
        self._watchdog.start(now)
        self._sampling.begin(now, int(self._machine.motor.counted(np.array([now]))[0]))

    def clock(self) -> float:
        return self._wall() - self._began if self.paced else self._simulated

    @property
    def _simulated(self) -> float:
        """Simulated time since it was opened [s]."""
        return self._machine.now - self._opened

    def due(self, count: int) -> float:
        """Time at which the next samples will be available, by its clock [s]."""
        return self._sampling.due(count) + self._sampling.delay

    def pass_time(self, duration: float) -> None:
        """Advance the time [s] without a host; samples are buffered."""
        self._advance(self._machine.now + duration)

    def read(self, count: int, *, timeout: float = 1.0) -> Block:
        """Advance the time until samples are available, and return them; as `Backend.read`."""
        if not self.paced:
            return self._read(count, timeout)
        self._catch_up()
        most = count / self.rate + timeout
        while 1e-6 < (left := self.due(count) - self.clock()) <= most:  # later samples are refused by the rig
            self._sleep(left)
        try:
            return self._read(count, timeout)
        finally:  # timeout of a silent rig, delay of a late host
            if (ahead := self._simulated - self.clock()) > 1e-6:
                self._sleep(ahead)

    def _read(self, count: int, timeout: float) -> Block:
        self._check_open()
        if count < 1:
            raise RangeError(f"{count} samples cannot be read", value=count, lower=1)
        sampling, machine = self._sampling, self._machine
        sampling.want(count)
        while True:  # events may delay it
            taken = self._opened + sampling.due(count)
            if sampling.silent(count) or sampling.delay > timeout:
                self._advance(taken + timeout)
                raise SilentError(
                    f"no samples for {timeout:g} s", remedy="check the connection of the converter, and reopen it"
                )
            if machine.now >= taken + sampling.delay - INSTANT:
                break
            self._advance(taken + sampling.delay)
        if self._late:
            late, self._late = self._late, 0.0
            self._advance(machine.now + late)
        return sampling.take(count)

    def set_valves(self, pressures: Sequence[float]) -> None:
        """Set the pressure of the valve; one of more than 0 bar ends a `vent`.

        Parameters
        ----------
        pressures
            Pressure [Pa], one value.

        Raises
        ------
        RigError
            If the pressure cannot be given, the rig is not open, or its watchdog has expired.
        """
        self._catch_up()
        self._check_armed()
        if len(pressures) != 1 or not VALVE.low <= pressures[0] <= VALVE.high:
            raise RigError(f"{list(pressures)} Pa cannot be given at one valve of 0..{VALVE.high:g} Pa")
        pressure = float(pressures[0])
        if self._machine.differs(pressure):
            most = self._regulator.repeatability
            self._machine.set_signal(pressure, float(self._offsets.uniform(-most, most)))
        self._machine.hold()

    def shut(self) -> None:
        self._catch_up()
        self._check_armed()
        self._machine.close()

    def heartbeat(self) -> None:
        self._catch_up()
        self._watchdog.reset(self._machine.now)

    def vent(self) -> None:
        self._catch_up()
        self._machine.set_signal(0.0, 0.0)
        self._machine.cut()

    def close(self) -> None:
        """Vent, stop, and close. Its time stands still until `pass_time`. Never raises."""
        self._catch_up()
        self._rest()
        self.is_open = False
        self._sampling.forget()

    def move(self, pulses: int, rate: float) -> None:
        """As `MovingBackend.move`; `RigError` also if the watchdog has expired."""
        self._catch_up()
        self._check_armed()
        self._machine.motor.move(self._machine.now, pulses, rate)

    @property
    def moving(self) -> bool:
        self._catch_up()
        return self._machine.motor.moving(self._machine.now)

    def stop(self) -> None:
        self._catch_up()
        self._machine.motor.stop(self._machine.now)

    def _catch_up(self) -> None:
        """Advance the time to that of the host, if there is one."""
        if self.paced and (behind := self.clock() - self._simulated) > 0:
            self.pass_time(behind)

    def _rest(self) -> None:
        """Vent and stop, without advancing the time."""
        self._machine.set_signal(0.0, 0.0)
        self._machine.cut()
        self._machine.motor.stop(self._machine.now)

    def _check_open(self) -> None:
        if not self.is_open:
            raise RigError("the simulated rig is not open", remedy="open it first")

    def _check_armed(self) -> None:
        self._check_open()
        if self._watchdog.has_expired:
            raise RigError(
                f"the rig vented and stopped by itself, without a heartbeat for {self.patience:g} s",
                remedy="reopen it, and send heartbeats in time",
            )

    def _advance(self, to: float) -> None:
        """Advance the time to a time [s], from event to event."""
        machine = self._machine
        while machine.now < to - INSTANT:
            armed = self.is_open and not self._watchdog.has_expired
            expiry = self._watchdog.deadline if armed else math.inf
            fault = self._schedule[0].at if self._schedule else math.inf
            event = min(expiry, fault, machine.next_event())
            if event > machine.now:
                knots = machine.pass_until(min(to, event))
                if self.is_open:
                    self._sampling.sample(knots, machine.motor)
            if armed and self._watchdog.expires(machine.now + 2 * INSTANT):
                machine.cut()
                machine.motor.stop(machine.now)
            machine.settle()
            while self._schedule and machine.now >= self._schedule[0].at - INSTANT:
                self._apply(self._schedule.pop(0))

    def _apply(self, fault: Fault) -> None:
        if isinstance(fault, HostDelayed):
            self._late += fault.duration
        self._machine.apply(fault)
        self._sampling.apply(fault)
