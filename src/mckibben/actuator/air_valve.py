"""Valves that let air into the muscles and out: the pressures follow from mass flow and volume."""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.actuator.base import Actuator, AirState, AirVolume, Attainable, Scalar, lag_fraction
from mckibben.component.checks import check_within
from mckibben.component.columns import Label
from mckibben.errors import RangeError
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import Domain
from mckibben.muscle.air import (
    ATMOSPHERE,
    DENSITY,
    ENERGY,
    FLOATS,
    LAMINAR,
    CriticalRatio,
    flow_share,
    mass_flow,
    pressure_rate,
)
from mckibben.numerics.elementary import exp, floating
from mckibben.units import (
    Conductance,
    Percent,
    PositivePressure,
    PressureScale,
    Quantity,
    ShortTime,
    ValveTime,
    Volume,
    bar,
    ms,
)

_LEAST_RATE = 1e3  # Pa/s: of a model at the pressure of the supply, or without pressure
_FASTER = 0.5  # lag of the command relative to that of the pressure that it serves

PolytropicIndex = Annotated[float, Quantity("1", "1", 1, 1.67)]
DeadVolume = Annotated[float, Quantity("m^3", "cm^3", 0, 1e6)]
DeadZone = Annotated[float, Percent("1", "%", 0, 90)]
DeadBand = Annotated[float, Quantity("Pa", "bar", 0, 1e3)]
Compensation = Annotated[float, Percent("1", "%", 0, 99)]


class AirValve(Actuator):
    """Base of valves between supply, muscle and exhaust; one for each muscle.

    An opening u in -1..1 has the conductance u C from the supply, or where it is negative, -u C from the muscle to the
    exhaust; see `mckibben.muscle.air` for mass flow and pressure. Commands are pressures: a proportional loop opens the
    valve fully at an error of one `band`.

    Parameters
    ----------
    conductance
        Sonic conductance C [m^3/(s*Pa)] of the open valve.
    supply
        Gauge pressure of the supply [Pa]; no muscle exceeds it.
    exhaust_conductance
        C to the exhaust; unless given, that from the supply.
    critical_ratio
        Critical pressure ratio b [-].
    band
        Error of the pressure [Pa] at which the valve is fully open.
    polytropic_index
        n of the air in the muscles, 1 (isothermal) to 1.4 (adiabatic).
    dead_volume
        Volume [m^3] of tube and fittings between valve and muscle.
    leak
        C of a leak of muscle, tube and fittings to the atmosphere; none by default.
    reservoir_volume, line_conductance
        Volume [m^3] of air at the valves' inlets, and the C of the line that fills it from the supply: with them the
        supply drops while air flows. Without, the pressure at the inlets is constant.
    """

    telemetry_labels: ClassVar = {
        "opening1": Label("1", "opening of the valve of muscle 1, to the supply or where negative to the exhaust"),
        "opening2": Label("1", "opening of the valve of muscle 2, to the supply or where negative to the exhaust"),
        "reservoir": Label("Pa", "gauge pressure at the inlets of the valves"),
    }

    holds_air = True

    conductance: Conductance
    supply: PositivePressure
    exhaust_conductance: Conductance | None = eqx.field(kw_only=True, default=None)
    critical_ratio: CriticalRatio = eqx.field(kw_only=True, default=0.3)
    band: PressureScale = eqx.field(kw_only=True, default=1 * bar)
    polytropic_index: PolytropicIndex = eqx.field(kw_only=True, default=1.2)
    dead_volume: DeadVolume = eqx.field(kw_only=True, default=0.0)
    leak: Conductance | None = eqx.field(kw_only=True, default=None)
    reservoir_volume: Volume | None = eqx.field(kw_only=True, default=None)
    line_conductance: Conductance | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        super().__check_init__()
        if (self.reservoir_volume is None) != (self.line_conductance is None):
            raise RangeError(
                f"{type(self).__name__}: a reservoir has a volume and a line that fills it",
                remedy="give reservoir_volume and line_conductance, or neither",
            )

    @abc.abstractmethod
    def init(self, pressure: Scalar) -> Any:
        """Return the state of a valve that holds a pressure [Pa]."""

    @abc.abstractmethod
    def opening(self, state: Any, command: ArrayLike, pressure: ArrayLike) -> Array:
        """Return the opening -1 (exhaust) to 1 (supply) at a command and a pressure [Pa]."""

    @abc.abstractmethod
    def rate(self, state: Any, command: ArrayLike, pressure: ArrayLike) -> Any:
        """Return the time derivative of the state."""

    @property
    def command_lag(self) -> ArrayLike:
        """Time constant [s] of the command before the loop of the pressure; 0 for none."""
        return 0.0

    @property
    def shut_within(self) -> Any:
        """Error [Pa] of the pressure up to which the loop keeps the valve shut; None for none."""
        return None

    def fastest_rate(self, stroke: float) -> float:
        """Return a bound on the rates [1/s] of valve and loop, where a pressure strokes by `stroke` [Pa/s]."""
        return stroke / float(self.band)

    def before_step(self, state: Any, command: ArrayLike, pressure: ArrayLike, step: ArrayLike) -> Any:
        """Return the state before an integration step [s]; for valves that switch."""
        return state

    @property
    def switches(self) -> bool:
        return type(self).before_step is not AirValve.before_step

    def init_states(self, pressures: tuple[Scalar, ...]) -> AirState:
        """Return the state of the valves at rest, and of the reservoir at the pressure of the supply."""
        filled = () if self.reservoir_volume is None else jnp.full_like(floating(pressures[0]), self.supply)
        return AirState(tuple(map(self.init, pressures)), filled)

    def telemetry(
        self, state: AirState | tuple[()], commands: Sequence[ArrayLike], pressures: Sequence[ArrayLike]
    ) -> dict[str, Array]:
        """Return columns of a result: openings, and the pressure [Pa] of the reservoir where there is one."""
        assert isinstance(state, AirState)
        opening1, opening2 = map(self.opening, state.valves, commands, pressures)
        reservoir = {} if self.reservoir_volume is None else {"reservoir": state.reservoir}
        return {"opening1": opening1, "opening2": opening2, **reservoir}

    def rates(
        self,
        pressures: Sequence[Scalar],
        states: AirState | tuple[()],
        commands: Sequence[ArrayLike],
        volumes: Callable[[], Sequence[AirVolume]],
    ) -> tuple[tuple[Array, ...], AirState]:
        assert isinstance(states, AirState)
        return self.air_rate(pressures, states, commands, volumes())

    def air_rate(
        self,
        pressures: Sequence[Scalar],
        air: AirState,
        commands: Sequence[ArrayLike],
        volumes: Sequence[AirVolume],
    ) -> tuple[tuple[Array, ...], AirState]:
        """Return the rates of the pressures [Pa/s] of all muscles, and of the state."""
        inlet = ATMOSPHERE + (self.supply if self.reservoir_volume is None else air.reservoir)
        rates, valve_rates, drawn = [], [], 0.0
        for pressure, state, command, volume in zip(pressures, air.valves, commands, volumes, strict=True):
            opening = self.opening(state, command, pressure)
            flow = self.flow(opening, inlet, pressure)
            index, absolute = self.polytropic_index, pressure + ATMOSPHERE
            rates.append(
                pressure_rate(
                    index, absolute, flow - self._leakage(pressure), volume.effective(index, absolute), volume.rate
                )
            )
            valve_rates.append(self.rate(state, command, pressure))
            drawn = drawn + jnp.where(opening > 0, flow, 0.0)
        reservoir: Any = ()
        if self.reservoir_volume is not None:
            line = mass_flow(self.line_conductance, self.critical_ratio, self.supply + ATMOSPHERE, inlet)
            reservoir = pressure_rate(self.polytropic_index, inlet, line - drawn, self.reservoir_volume, 0.0)
        return tuple(rates), AirState(tuple(valve_rates), reservoir)

    def flow(self, opening: ArrayLike, inlet: ArrayLike, pressure: ArrayLike) -> Array:
        """Return the mass flow [kg/s] into a muscle at a gauge pressure [Pa], from an absolute pressure [Pa]."""
        opening = jnp.asarray(opening)
        conductance = jnp.where(opening > 0, self.conductance * opening, -self._exhaust * opening)
        return mass_flow(
            conductance, self.critical_ratio, jnp.where(opening > 0, inlet, ATMOSPHERE), pressure + ATMOSPHERE
        )

    def _leakage(self, pressure: ArrayLike) -> Array | float:
        """Mass flow [kg/s] out of a muscle through the leak."""
        if self.leak is None:
            return 0.0
        return mass_flow(self.leak, self.critical_ratio, pressure + ATMOSPHERE, ATMOSPHERE)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        """Return the command [Pa] at which a pressure [Pa] changes at a rate [Pa/s], with a full supply.

        Infinite where the open valve or the supply is too small. The lag of a spool is left out.
        """
        absolute = jnp.asarray(pressure) + ATMOSPHERE
        room = volume.effective(self.polytropic_index, absolute)
        needed = (rate * room / self.polytropic_index + absolute * volume.rate) / ENERGY + self._leakage(pressure)
        full = jnp.where(needed > 0, 1.0, -1.0)
        share = needed / self.flow(full, self.supply + ATMOSPHERE, pressure)
        command = pressure + self._error_for(full * share) + self.command_lag * rate
        possible = (share >= 0) & (share <= 1) & (jnp.asarray(pressure) <= self.supply)
        return jnp.where(possible, command, full * jnp.inf)

    def init_model(self, pressure: Scalar) -> Scalar:
        """Return the command [Pa] after its lag; spool and modulation are left out of the model."""
        return floating(pressure)

    def predict(
        self, pressure: Scalar, state: Scalar, command: ArrayLike, air: AirVolume | None, duration: ArrayLike
    ) -> tuple[Scalar, Scalar]:
        slowest, fastest, drift = self._rates(pressure, air)
        following = state + lag_fraction(self.command_lag, duration) * (command - state)
        error = self._effective((state + following) / 2 - pressure)
        rate = jnp.where(error > 0, fastest, -slowest)  # of the open valve
        lag = self.band / rate
        full = jnp.clip(jnp.abs(error) / rate - lag, 0.0, duration)  # time [s] with a fully open valve
        rest = error - jnp.sign(error) * rate * full
        moved = error - rest * exp((full - duration) / lag)
        return pressure + moved + drift * lag * (1 - exp(-jnp.asarray(duration) / lag)), following

    def attainable(
        self,
        pressure: Scalar,
        state: Scalar,
        commands: tuple[ArrayLike, ArrayLike],
        air: AirVolume | None,
        duration: ArrayLike,
    ) -> Attainable:
        slowest, fastest, drift = self._rates(pressure, air)
        one = jnp.ones_like(pressure)
        return Attainable(one, (slowest + drift) * duration, (fastest + drift) * duration)

    def command_toward(
        self,
        pressure: Scalar,
        state: Scalar,
        target: ArrayLike,
        air: AirVolume | None,
        lag: ArrayLike,
        period: ArrayLike,
    ) -> Scalar:
        slowest, fastest, drift = self._rates(pressure, air)
        rate = (target - pressure) * (1 - exp(-jnp.asarray(period) / lag)) / period
        flow = jnp.clip(rate - drift, slowest, fastest)  # as a rate of the pressure [Pa/s]
        opening = flow / jnp.where(flow > 0, fastest, -slowest)
        wanted = pressure + period / 2 * (flow + drift) + self._error_for(opening)
        lead = lag_fraction(_FASTER * jnp.asarray(lag), period) / lag_fraction(self.command_lag, period)
        return state + lead * (wanted - state)

    def _rates(self, pressure: Scalar, air: AirVolume | None) -> tuple[Scalar, Scalar, Scalar]:
        """Rates [Pa/s] by the open valve, to the exhaust and from the full supply, and with the valve shut."""
        assert air is not None
        index, absolute = self.polytropic_index, pressure + ATMOSPHERE
        volume = air.effective(index, absolute)
        vent, fill = (
            pressure_rate(index, absolute, self.flow(opening, self.supply + ATMOSPHERE, pressure), volume, 0.0)
            for opening in (-1.0, 1.0)
        )
        drift = pressure_rate(index, absolute, -self._leakage(pressure), volume, air.rate)
        return jnp.minimum(vent, -_LEAST_RATE), jnp.maximum(fill, _LEAST_RATE), drift

    def model_lag(self, joint: AntagonisticJoint) -> Any:
        """Return `time_constant_at` the middle of the first muscle's pressures and contractions."""
        muscle = joint.muscle2 if joint.springs[0] else joint.muscle1
        domain = muscle.domain
        volume = muscle.specimen.volume((domain.contraction_min + domain.contraction_max) / 2)
        return self.time_constant_at((domain.pressure_min + domain.pressure_max) / 2, volume)

    def time_constant_at(self, pressure: Any, volume: Any) -> Any:
        """Return the first-order time constant [s] of a small change of the command at a pressure and volume.

        It is the area between a step of the command and the response of the pressure in a fixed volume [m^3] around a
        gauge pressure [Pa], over the step; the mean of filling and venting. For the valve model of a controller.
        """
        inside = pressure + ATMOSPHERE
        fill = mass_flow(self.conductance, self.critical_ratio, self.supply + ATMOSPHERE, inside)
        vent = mass_flow(self._exhaust, self.critical_ratio, inside, ATMOSPHERE)
        mass = self.band * (volume + self.dead_volume) / (self.polytropic_index * ENERGY)  # of a band
        return self.command_lag + mass * (1 / fill + 1 / vent) / 2

    def fastest_rate_in(self, volume: float) -> float:
        """Return a bound on the rates [1/s] of the air in a volume [m^3], of valve, loop and reservoir."""
        index, critical = float(self.polytropic_index), float(self.critical_ratio)
        widest = max(float(self.conductance), float(self._exhaust))
        slope = flow_share(critical, LAMINAR, FLOATS) / (1 - LAMINAR)  # of the flow over the pressure, both relative
        per_volume = index * ENERGY * DENSITY * slope
        room = volume + float(self.dead_volume)
        stroke = index * ENERGY * DENSITY * widest * (float(self.supply) + ATMOSPHERE) / room
        rates = [per_volume * widest / room + self.fastest_rate(stroke)]
        if self.reservoir_volume is not None and self.line_conductance is not None:
            rates.append(per_volume * (float(self.line_conductance) + 2 * widest) / float(self.reservoir_volume))
        return max(rates)

    @property
    def _exhaust(self) -> Conductance:
        return self.conductance if self.exhaust_conductance is None else self.exhaust_conductance

    def _loop(self, command: ArrayLike, pressure: ArrayLike) -> Array:
        """Opening that the proportional loop asks for."""
        return jnp.clip(self._effective(jnp.asarray(command) - jnp.asarray(pressure)) * (1 / self.band), -1.0, 1.0)

    def _effective(self, error: Array) -> Array:
        """Part of an error [Pa] of the pressure that opens the valve."""
        shut = self.shut_within
        return error if shut is None else error - jnp.clip(error, -shut, shut)

    def _error_for(self, opening: ArrayLike) -> Array:
        """Error [Pa] at which the loop gives an opening; where it is small, less than what keeps the valve shut."""
        error, shut = self.band * jnp.asarray(opening), self.shut_within
        return error if shut is None else error + jnp.clip(error, -shut, shut)


def _compensated(opening: Array, shut: Any, compensation: Any) -> Array:
    """Command that opens a valve which is shut up to a part of its range; within the rest of it the steps are small."""
    jump, rest = compensation * shut, jnp.maximum((1 - compensation) * shut, 1e-9)
    return (1 - jump) * opening + jump * jnp.clip(opening * (1 / rest), -1.0, 1.0)


class FlowValve(AirValve):
    """Proportional directional valve, 3/3 or 5/3: a spool with a lag and a dead zone.

    Parameters
    ----------
    spool_lag
        Time constant [s] of the spool.
    dead_zone
        Part of the stroke, to either side of the middle, at which the valve is shut.
    compensation
        Part of the dead zone that the loop skips. The rest, times `band`, is the error of the pressure at rest.
    direct
        Whether commands are openings -1..1 in place of pressures, for a controller with its own loop of the pressure.

    A `band` below 4 times `spool_lag` times the fastest change of the pressure makes the loop oscillate visibly.
    """

    short_name = "flow"

    spool_lag: ValveTime = eqx.field(kw_only=True, default=2 * ms)
    dead_zone: DeadZone = eqx.field(kw_only=True, default=0.0)
    compensation: Compensation = eqx.field(kw_only=True, default=0.9)
    direct: bool = eqx.field(kw_only=True, default=False, static=True)

    def fastest_rate(self, stroke: float) -> float:
        lag = float(self.spool_lag)
        loop = 0.0 if self.direct else (stroke / (float(self.band) * lag)) ** 0.5
        return max(1 / lag, loop)

    def init(self, pressure: Scalar) -> Scalar:
        return jnp.zeros_like(floating(pressure))

    def opening(self, state: Scalar, command: ArrayLike, pressure: ArrayLike) -> Array:
        return (state - jnp.clip(state, -self.dead_zone, self.dead_zone)) * (1 / (1 - self.dead_zone))

    def rate(self, state: Scalar, command: ArrayLike, pressure: ArrayLike) -> Array:
        wanted = jnp.asarray(command)
        if not self.direct:
            wanted = _compensated(self._loop(command, pressure), self.dead_zone, self.compensation)
        return (wanted - state) * (1 / self.spool_lag)

    def command_range(self, rated: Domain) -> tuple[ArrayLike, ArrayLike]:
        return (-1.0, 1.0) if self.direct else super().command_range(rated)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        command = super().command_for(pressure, rate, volume)
        return jnp.where(jnp.isfinite(command), pressure, command) if self.direct else command  # no loop to lead


class PressureRegulator(AirValve):
    """Proportional pressure regulator: a first-order lag of the command, and a limited flow.

    Parameters
    ----------
    time_constant
        Lag [s] of the command before the loop.
    dead_zone
        Error [Pa] of the pressure up to which the regulator stays shut; none by default.
    """

    short_name = "regulator"

    time_constant: ValveTime = eqx.field(kw_only=True)
    dead_zone: DeadBand | None = eqx.field(kw_only=True, default=None)

    @property
    def shut_within(self) -> Any:
        return self.dead_zone

    @property
    def command_lag(self) -> ArrayLike:
        return self.time_constant

    def fastest_rate(self, stroke: float) -> float:
        return max(1 / float(self.time_constant), stroke / float(self.band))

    def init(self, pressure: Scalar) -> Scalar:
        return floating(pressure)

    def opening(self, state: Scalar, command: ArrayLike, pressure: ArrayLike) -> Array:
        return self._loop(state, pressure)

    def rate(self, state: Scalar, command: ArrayLike, pressure: ArrayLike) -> Array:
        return (jnp.asarray(command) - state) * (1 / self.time_constant)


class Switching(NamedTuple):
    """State of a pair of switching valves: time in the period [s], duty -1..1, and opening over the present step."""

    phase: Scalar
    duty: Scalar
    opening: Scalar


class SwitchingValves(AirValve):
    """Two switching valves, one to fill and one to vent, with pulse width modulation.

    At the start of each period the loop sets the duty of one of them. Within an integration step the opening is the
    part of the step in which the valve is open, so that the air of a pulse does not depend on the step. Derivatives
    are those of that mean flow; they do not include a switch that moves to another period.

    Parameters
    ----------
    period
        Period of the modulation [s], rounded to whole integration steps.
    opening_delay
        Time [s] by which a valve opens late; shorter pulses do not open it.
    compensation
        Part of the delay by which pulses are longer. The rest over the period, times `band`, is the error at rest.
    """

    short_name = "switching"

    period: ValveTime = eqx.field(kw_only=True)
    opening_delay: ShortTime = eqx.field(kw_only=True, default=0.0)
    compensation: Compensation = eqx.field(kw_only=True, default=0.9)

    def __check_init__(self) -> None:
        super().__check_init__()
        if isinstance(self.period, float):  # else it is traced
            check_within("SwitchingValves", 0.0, self.period, "s", opening_delay=self.opening_delay)

    @property
    def command_lag(self) -> ArrayLike:
        return self.period / 2  # until the next period begins

    def init(self, pressure: Scalar) -> Switching:
        zero = jnp.zeros_like(floating(pressure))
        return Switching(zero + jnp.inf, zero, zero)  # the first step begins a period

    def before_step(self, state: Switching, command: ArrayLike, pressure: ArrayLike, step: ArrayLike) -> Switching:
        period = jnp.maximum(jnp.round(self.period / step), 1.0) * step
        begins = state.phase >= period - 0.5 * step
        phase = jnp.where(begins, 0.0, state.phase)
        wanted = _compensated(self._loop(command, pressure), self.opening_delay / period, self.compensation)
        duty = jnp.where(begins, wanted, state.duty)
        width = jnp.abs(duty) * period
        open_for = jnp.clip(phase + step, self.opening_delay, width) - jnp.clip(phase, self.opening_delay, width)
        share = jnp.where(jnp.abs(duty) < 1, jnp.minimum(open_for / step, 1.0), 1.0)
        return Switching(phase + step, duty, jnp.sign(duty) * share)

    def opening(self, state: Switching, command: ArrayLike, pressure: ArrayLike) -> Array:
        return state.opening

    def rate(self, state: Switching, command: ArrayLike, pressure: ArrayLike) -> Switching:
        return jax.tree.map(jnp.zeros_like, state)
