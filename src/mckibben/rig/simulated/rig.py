"""Simulated rig: a `MovingBackend` in simulated or in real time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mckibben.component.checks import check_within
from mckibben.errors import RigError
from mckibben.muscle import Muscle
from mckibben.rig.backend import Channel, MovingBackend
from mckibben.rig.bench import Drive
from mckibben.rig.simulated.faults import Fault
from mckibben.rig.simulated.machine import Machine, Truth
from mckibben.rig.simulated.parts import Regulator
from mckibben.rig.simulated.sampling import FORCE_SENSOR, PRESSURE_SENSOR, Sensor, SimulatedBackend
from mckibben.units import Hz, bar, s

VALVE = Channel("valve", "Pa", 0.0, 9 * bar, "simulated regulator")
"""ITV0050-3, 0 to 9 bar; inferred from its designation, unverified."""


class SimulatedRig(SimulatedBackend, MovingBackend):
    """The paper's stretching device with a muscle; two inputs and one output.

    The same seed and the same calls give the same samples.

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
    regulator, drive, force_sensor, pressure_sensor
        Its parts.
    rate, patience
        Sampling rate of each input [Hz], timeout of the watchdog [s].
    others
        `paced`, `wall` and `sleep` of `SimulatedBackend`.

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

    homed, shuts = True, True

    def __init__(
        self,
        muscle: Muscle,
        *,
        seed: int = 0,
        mounted_at: float = 0.0,
        faults: Sequence[Fault] = (),
        regulator: Regulator | None = None,
        drive: Drive | None = None,
        force_sensor: Sensor = FORCE_SENSOR,
        pressure_sensor: Sensor = PRESSURE_SENSOR,
        rate: float = 1000 * Hz,
        patience: float = 1 * s,
        **others: Any,
    ) -> None:
        check_within("simulated rig", -0.5, 0.8, mounted_at=mounted_at)
        sensors = force_sensor, pressure_sensor
        super().__init__(sensors, rate=rate, patience=patience, seed=seed, faults=faults, **others)
        self._muscle, self._mounted_at = muscle, mounted_at
        self._regulator, self.drive = regulator or Regulator(), drive or Drive()
        self.supply = min(self._regulator.supply, self._regulator.highest)
        self._machine = Machine(muscle, mounted_at, self._regulator, self.drive)
        self._zero = 0  # pulses when it was opened

    @property
    def outputs(self) -> Sequence[Channel]:
        return (VALVE,)

    @property
    def description(self) -> Mapping[str, str]:
        muscle = self._muscle
        return {
            "kind": "simulated",
            "muscle": muscle.specimen.name,
            **{name: repr(getattr(muscle, name)) for name in ("law", "friction", "creep")},
            "mounted_at": f"{self._mounted_at:g}",
            "regulator": repr(self._regulator),
            "drive": repr(self.drive),
            **super().description,
        }

    @property
    def truth(self) -> Truth:
        """True state."""
        return self._machine.truth

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
        self._check_armed()
        if len(pressures) != 1 or not VALVE.low <= pressures[0] <= VALVE.high:
            raise RigError(f"{list(pressures)} Pa cannot be given at one valve of 0..{VALVE.high:g} Pa")
        pressure = float(pressures[0])
        if self._machine.differs(pressure):
            most = self._regulator.repeatability
            self._machine.set_signal(pressure, float(self._random.uniform(-most, most)))
        self._machine.hold()

    def shut(self) -> None:
        self._check_armed()
        self._machine.close()

    def vent(self) -> None:
        self._catch_up()
        self._machine.set_signal(0.0, 0.0)
        self._machine.cut()

    def move(self, pulses: int, rate: float) -> None:
        """As `MovingBackend.move`; `RigError` also if the watchdog has expired."""
        self._check_armed()
        self._machine.motor.move(self.now, pulses, rate)

    @property
    def moving(self) -> bool:
        self._catch_up()
        return self._machine.motor.moving(self.now)

    def stop(self) -> None:
        self._catch_up()
        self._machine.motor.stop(self.now)

    def _rest(self) -> None:
        self._machine.set_signal(0.0, 0.0)
        self._machine.cut()
        self._machine.motor.stop(self.now)

    def _begin(self) -> None:
        self._zero = int(self._machine.motor.counted(np.array([self.now]))[0])

    def _pulses(self, times: NDArray[np.float64]) -> NDArray[np.int64]:
        return self._machine.motor.counted(times) - self._zero

    def _truth(self) -> tuple[float, ...]:
        return self.truth.force, self.truth.pressure

    def _next_event(self) -> float:
        return self._machine.next_event()

    def _settle(self) -> None:
        self._machine.settle()

    def _apply(self, fault: Fault) -> None:
        self._machine.apply(fault)

    def _integrate(self, until: float) -> tuple[list[float], list[tuple[float, ...]]]:
        times, values = self._machine.pass_until(until)
        self.now = self._machine.now
        return times, values
