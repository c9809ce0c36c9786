"""Simulated test rig: muscle, air, regulator and motor over time, a `MovingBackend` in simulated or in real time."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, PyTree
from numpy.typing import NDArray

from mckibben.actuator import AirState, AirVolume, PressureRegulator
from mckibben.component.base import Checked
from mckibben.component.checks import check_within
from mckibben.errors import RangeError, RigError
from mckibben.muscle import Muscle, MuscleState
from mckibben.muscle.air import L_PER_S_BAR, CriticalRatio, exchange_rate
from mckibben.numerics.calculus import rk4, value_and_derivative
from mckibben.numerics.compiled import numeric
from mckibben.plant.base import STABILITY_LIMIT
from mckibben.rig.backend import Channel, MovingBackend
from mckibben.rig.bench import FASTEST
from mckibben.rig.compiled import FlatTree, flat_program
from mckibben.rig.simulated.sampling import FORCE_SENSOR, INSTANT, PRESSURE_SENSOR, Sensor, SimulatedBackend
from mckibben.units import (
    Conductance,
    Hz,
    PositivePressure,
    PositiveTime,
    PressureNoise,
    PressureScale,
    Quantity,
    ShortTime,
    Volume,
    bar,
    kPa,
    ms,
    s,
)


@dataclass(frozen=True, kw_only=True)
class Regulator(Checked):
    """Proportional pressure regulator such as SMC's ITV0050-3ML, with supply, vent valve and tube.

    A `PressureRegulator` whose commands have an offset. Behind it is a 3/2 valve: without current its spring shuts off
    the regulator and vents the muscle.

    Numbers "of the maker" are quoted from memory from the ITV0000 data sheet, unverified; others are ours.

    Parameters
    ----------
    supply
        Supply pressure [Pa]; the maker allows 10 bar.
    conductance
        Sonic conductance C [m^3/(s*Pa)] fully open, in both directions: the maker's 6 dm^3/min at 10 bar.
    critical
        Critical pressure ratio b [-].
    band
        Error of the pressure [Pa] at which it is fully open.
    lag
        Time constant [s] of the command: a third of the maker's response of 0.1 s without a load.
    hysteresis
        Width [Pa] of the command's play: the maker's 0.5 % of 9 bar.
    repeatability
        Largest offset [Pa], drawn at each new command: the maker's 0.5 % of 9 bar.
    highest
        Highest command [Pa] (the maker).
    dead_volume
        Volume [m^3] of tube and fittings: a metre of tube with 2.5 mm inside.
    exhaust, exhaust_delay
        C [m^3/(s*Pa)] of the vent valve with its tube, and its opening time [s].
    leak
        C of a leak [m^3/(s*Pa)].

    Raises
    ------
    RangeError
        If a number is out of the range of its field.
    """

    supply: PositivePressure = 8 * bar
    conductance: Conductance = 0.0091 * L_PER_S_BAR
    critical: CriticalRatio = 0.3
    band: PressureScale = 0.1 * bar
    lag: PositiveTime = 30 * ms
    hysteresis: PressureNoise = 4.5 * kPa
    repeatability: PressureNoise = 4.5 * kPa
    highest: PositivePressure = 9 * bar
    dead_volume: Volume = 5e-6
    exhaust: Conductance = 0.1 * L_PER_S_BAR
    exhaust_delay: ShortTime = 20 * ms
    leak: Annotated[float, Quantity("m^3/(s*Pa)", "L/(s*bar)", 0, 1e4)] = 1e-5 * L_PER_S_BAR

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.supply <= self.band:
            raise RangeError("regulator: a supply below its band gives no pressure", remedy="raise the supply")

    def valve(self) -> PressureRegulator:
        """The same as an actuator."""
        return PressureRegulator(
            conductance=self.conductance,
            supply=self.supply,
            time_constant=self.lag,
            hysteresis=self.hysteresis,
            critical_ratio=self.critical,
            band=self.band,
            polytropic_index=1.0,
            dead_volume=self.dead_volume,
            leak=self.exhaust,
        )


class Motor:
    """Position of the motor over time.

    Examples
    --------
    >>> from mckibben.units import mm
    >>> motor = Motor()
    >>> motor.move(0.0, 0.1 * mm, 0.2 * mm)
    >>> (motor.positions(np.array([0.0, 0.25, 1.0])) / mm).round(6).tolist(), motor.moving(0.4)
    ([0.0, 0.05, 0.1], True)
    """

    def __init__(self, fastest: float = FASTEST) -> None:
        self._fastest = fastest
        self._begin = self._end = 0.0  # of the latest move [s]
        self._from = self._to = 0.0

    def move(self, now: float, distance: float, speed: float) -> None:
        """Begin a move by a distance [m] at a speed [m/s]; `RigError` if it is moving, or the speed is too high."""
        if self.moving(now):
            raise RigError("the motor is still moving", remedy="wait until it stops, or stop it")
        if not 0 < speed <= self._fastest * (1 + 1e-9):
            message, remedy = f"the motor cannot run at {speed:g} m/s", f"it reaches {self._fastest:g} m/s at most"
            raise RigError(message, value=speed, lower=0.0, upper=self._fastest, unit="m/s", remedy=remedy)
        self.stop(now)
        self._to, self._end = self._from + distance, now + abs(distance) / speed

    def moving(self, now: float) -> bool:
        """Whether it is moving."""
        return now < self._end - 1e-9

    def next_end(self, now: float) -> float:
        """End of the present move [s]; infinite without one."""
        return self._end if now < self._end else math.inf

    def stop(self, now: float) -> None:
        """Stop."""
        self._from = self._to = self.travel(now)
        self._begin = self._end = now

    def positions(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions [m] at times [s]."""
        part = (times - self._begin) / max(self._end - self._begin, INSTANT)
        return self._from + np.clip(part, 0.0, 1.0) * (self._to - self._from)

    def travel(self, now: float) -> float:
        """Position [m] at a time [s]."""
        return float(self.positions(np.array([now]))[0])


_LONGEST, _MOVING = 100 * ms, 10 * ms  # between two knots, at rest and in motion
_STEPS = 10  # of the integration between two knots
_STILL = 0.5  # Pa/s, highest rate at rest
_NOTHING = 1.0  # Pa, a signal of zero
_ADIABATIC = 1.4**1.5  # as `AirActuator.fastest_index`


class ClampedMuscle(NamedTuple):
    """State of a muscle between clamps and its air: stretch [m] since it was mounted, gauge pressure [Pa], valve."""

    stretch: PyTree
    pressures: tuple[PyTree]
    air: AirState
    muscle: MuscleState


class Clamps(NamedTuple):
    """Muscle, regulator, and contraction [-] at which the muscle is mounted."""

    muscle: Muscle
    valve: PressureRegulator
    mounted_at: PyTree

    def contraction(self, stretch: PyTree) -> PyTree:
        """Contraction [-] at a stretch [m]."""
        return self.mounted_at - stretch / self.muscle.specimen.initial_length


def advance_flat(numbers: FlatTree, states: FlatTree, packed: Array, state: Array, inputs: PyTree) -> Array:
    """State after a move at constant speed, followed by the force [N] at its end.

    Inputs are the command [Pa], the stretch at the end [m], the duration [s], the conductances of the regulator and of
    all leaks [m^3/(s*Pa)], and the supply [Pa].
    """
    clamps: Clamps = numbers.unpack(packed)
    command, end, duration, conductance, leak, supply = inputs
    valve = dataclasses.replace(clamps.valve, conductance=conductance, leak=leak, supply=supply)
    begin: ClampedMuscle = states.unpack(state)
    step, speed = duration / _STEPS, (end - begin.stretch) / duration

    def rate(stretch: PyTree, pressures: PyTree, air: AirState, creep: PyTree, *, muscle: MuscleState) -> PyTree:
        volume, growth = value_and_derivative(lambda at: clamps.muscle.specimen.volume(clamps.contraction(at)), stretch)
        room = AirVolume(volume + valve.dead_volume, growth * speed)
        rates, air_rates = valve.air_rate(pressures, air, (command,), (room,))
        creeping = clamps.muscle.state_rate(muscle._replace(creep=creep), speed, pressures[0]).creep
        return speed, rates, air_rates, creeping

    def integrate(_: PyTree, at: ClampedMuscle) -> ClampedMuscle:
        motion = at.stretch, at.pressures, at.air, at.muscle.creep
        stretch, pressures, air, creep = rk4(lambda now: rate(*now, muscle=at.muscle), motion, step)
        muscle = clamps.muscle.update_state(at.muscle._replace(creep=creep), clamps.contraction(stretch), pressures[0])
        return ClampedMuscle(stretch, pressures, air, muscle)

    after = lax.fori_loop(0, _STEPS, integrate, begin)
    contraction, pressure = clamps.contraction(end), after.pressures[0]
    force = clamps.muscle.tension(contraction, pressure, after.muscle)
    force = force + clamps.muscle.viscous_force(contraction, pressure, speed, after.muscle)
    return jnp.concatenate([states.pack(after, jnp), jnp.reshape(force, 1)])


class Truth(NamedTuple):
    """True state of the simulated clamps.

    Attributes
    ----------
    time
        Time since the rig was first opened [s].
    pressure
        Gauge pressure in the muscle [Pa].
    force
        Force at the clamps [N].
    stretch
        Travel of the carriage since the rig was first opened [m], positive = stretching.
    contraction
        Contraction [-].
    vented
        Whether the vent valve is open.
    """

    time: float
    pressure: float
    force: float
    stretch: float
    contraction: float
    vented: bool


VALVE = Channel("valve", "Pa", 0.0, 9 * bar, "simulated regulator")
"""ITV0050-3, 0 to 9 bar; inferred from its designation, unverified."""


class SimulatedRig(SimulatedBackend, MovingBackend):
    """The paper's stretching device with a muscle; two inputs and one output.

    The same seed and the same calls give the same samples.

    - The force is that of the muscle, with its friction and creep.
    - The air is that of a `PressureRegulator`, in the volume of the braid between the clamps: isothermal.
    - After `vent`, or a missed heartbeat, a spring-return valve vents, independent of the regulator: from 8 bar, at any
      contraction, the true pressure is below 0.2 bar within 1 s (tested).
    - `vent` holds until `set_valves` gives a signal above 0 again. A missed heartbeat holds until it is reopened.

    Parameters
    ----------
    seed
        Seed of noise and the regulator's offsets, each with its own stream.
    mounted_at
        Contraction [-] at which the muscle is clamped, relaxed.
    regulator, force_sensor, pressure_sensor
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

    homed = True

    def __init__(
        self,
        muscle: Muscle,
        *,
        seed: int = 0,
        mounted_at: float = 0.0,
        regulator: Regulator | None = None,
        force_sensor: Sensor = FORCE_SENSOR,
        pressure_sensor: Sensor = PRESSURE_SENSOR,
        rate: float = 1000 * Hz,
        patience: float = 1 * s,
        **others: PyTree,
    ) -> None:
        check_within("simulated rig", -0.5, 0.8, mounted_at=mounted_at)
        sensors = force_sensor, pressure_sensor
        super().__init__(sensors, rate=rate, patience=patience, seed=seed, **others)
        self._muscle, self._mounted_at = muscle, mounted_at
        self._regulator = regulator or Regulator()
        self.supply = min(self._regulator.supply, self._regulator.highest)
        self._motor, self._zero = Motor(self.fastest), 0.0  # position when it was opened [m]
        self._exhausting, self._exhaust_at = True, math.inf
        self._signal = self._command = 0.0  # of the regulator, as pressures [Pa], without and with its offset
        self._resting, self._force = False, 0.0
        self._clamps = Clamps(muscle, self._regulator.valve(), float(mounted_at))
        clamps: Clamps = numeric(self._clamps)
        layouts = FlatTree.like(clamps), FlatTree.like(jax.eval_shape(functools.partial(_relaxed, clamps)))
        self._numbers = layouts[0].pack(clamps)
        self._state = layouts[1].pack(jax.tree.map(np.asarray, _relaxed(clamps)))
        self._program = flat_program(advance_flat, layouts[0].size, layouts[1].size, 6, static=layouts)
        times = [*getattr(muscle.creep, "time_constants", ()), *getattr(muscle.creep, "pressure_time_constants", ())]
        self._creeps = bool(times)
        self._knot = min([_LONGEST, *(float(time) / _STEPS * 2 for time in times)])
        self._step(INSTANT, 0.0)

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
            **super().description,
        }

    @property
    def truth(self) -> Truth:
        """True state."""
        stretch = self._motor.travel(self.now)
        contraction = float(self._clamps.contraction(stretch))
        return Truth(self.now, self._air[1], self._force, stretch, contraction, self._exhausting)

    @property
    def _air(self) -> list[float]:
        """Stretch [m], pressure and command of the regulator [Pa]."""
        return self._state[:3].tolist()

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
        if abs(pressure - self._signal) > _NOTHING:
            most = self._regulator.repeatability
            self._set_signal(pressure, float(self._random.uniform(-most, most)))
        self._resting = False
        if self._signal > _NOTHING:
            self._exhausting, self._exhaust_at = False, math.inf

    def _set_signal(self, pressure: float, offset: float) -> None:
        """Set the signal of the regulator, as a pressure [Pa], with its offset [Pa]."""
        self._signal = min(max(pressure, 0.0), self._regulator.highest)
        self._command = self._signal + offset if self._signal > 0 else 0.0
        self._resting = False

    def vent(self) -> None:
        self._catch_up()
        self._cut()

    def _cut(self) -> None:
        """Cut the current of the vent valve, which opens after its delay."""
        self._set_signal(0.0, 0.0)
        if not self._exhausting:
            self._exhaust_at = min(self._exhaust_at, self.now + self._regulator.exhaust_delay)

    def move(self, distance: float, speed: float) -> None:
        """As `MovingBackend.move`; `RigError` also if the watchdog has expired."""
        self._check_armed()
        self._motor.move(self.now, distance, speed)

    @property
    def moving(self) -> bool:
        self._catch_up()
        return self._motor.moving(self.now)

    def stop(self) -> None:
        self._catch_up()
        self._motor.stop(self.now)

    def _rest(self) -> None:
        self._cut()
        self._motor.stop(self.now)

    def _begin(self) -> None:
        self._zero = self._motor.travel(self.now)

    def _positions(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        return self._motor.positions(times) - self._zero

    def _truth(self) -> tuple[float, ...]:
        return self._force, self._air[1]

    def _next_event(self) -> float:
        return min(self._exhaust_at, self._motor.next_end(self.now))

    def _settle(self) -> None:
        if self.now >= self._exhaust_at - INSTANT:
            self._exhausting, self._exhaust_at, self._resting = True, math.inf, False

    def _integrate(self, until: float) -> tuple[list[float], list[tuple[float, ...]]]:
        times, values = [self.now], [self._truth()]
        moving = self._motor.moving(self.now)
        while self.now < until:
            idle, span = self._resting and not moving, until - self.now
            if (not idle or self._creeps) and span > INSTANT:
                span = min(span, self._knot if idle else _MOVING, self._stable)
                self._step(span, self._motor.travel(self.now + span))
            self.now = until if self.now + span > until - INSTANT else self.now + span
            times.append(self.now)
            values.append(self._truth())
        return times, values

    def _step(self, span: float, stretch: float) -> None:
        """Integrate over a span [s] to a stretch [m]."""
        inputs = [self._command, stretch, span, *self._conductances, self._regulator.supply]
        before, after = self._air, np.asarray(self._program(self._numbers, self._state, np.array(inputs)))
        self._state, self._force = after[:-1], float(after[-1])
        _, *changes = (new - old for new, old in zip(self._air, before, strict=True))
        self._resting = max(map(abs, changes)) < _STILL * span

    @property
    def _conductances(self) -> tuple[float, float]:
        """Conductances [m^3/(s*Pa)] of the regulator and of all ways to the atmosphere."""
        regulator = self._regulator
        return 0.0 if self._exhausting else regulator.conductance, regulator.leak + regulator.exhaust * self._exhausting

    @functools.cached_property
    def _stable(self) -> float:
        """Longest span [s] that the steps resolve with all valves open: air, loop and lag of the regulator."""
        specimen, regulator, valve = self._muscle.specimen, self._regulator, self._clamps.valve
        ends = specimen.domain.contraction_min, specimen.domain.contraction_max, self._mounted_at
        volume = min(float(specimen.volume(end)) for end in ends) + regulator.dead_volume
        conductance = regulator.conductance + regulator.exhaust + regulator.leak
        rate = exchange_rate(_ADIABATIC, regulator.critical, conductance, volume)
        return 0.5 * _STEPS * STABILITY_LIMIT / max(rate, valve.fastest_rate_in(volume))


def _relaxed(clamps: Clamps) -> ClampedMuscle:
    """Vented and relaxed, as mounted."""
    pressure = jnp.zeros(())
    air = clamps.valve.init_states((pressure,))
    assert isinstance(air, AirState)
    return ClampedMuscle(jnp.zeros(()), (pressure,), air, clamps.muscle.init_state(clamps.mounted_at, pressure))
