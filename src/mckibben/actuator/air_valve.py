"""Valves that let air into the muscles and out: the pressures follow from mass flow and volume."""

from __future__ import annotations

import abc
import dataclasses
from typing import Annotated, ClassVar, NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.actuator.air_actuator import AirActuator, Exchange
from mckibben.actuator.base import AirVolume, Attainable, CommandRange, Point, Reservoir, Scalar, State, lag_fraction
from mckibben.component.checks import check_within
from mckibben.component.columns import Label
from mckibben.muscle import Domain
from mckibben.muscle.air import ATMOSPHERE, DENSITY, ENERGY, CriticalRatio, exchange_rate, flow_of_warm_air, mass_flow
from mckibben.numerics.elementary import Number, exp, floating
from mckibben.units import (
    Conductance,
    HeatConductance,
    Percent,
    PressureScale,
    Quantity,
    ShortTime,
    SupplyPressure,
    ValveTime,
    Volume,
    bar,
    ms,
)

_LEAST_RATE = 1e3  # Pa/s: of a model at the pressure of the supply, or without pressure
FASTER = 0.5
"""Lag of a command, or of the pressure behind a valve, relative to that of the pressure which it serves."""

PolytropicIndex = Annotated[float, Quantity("1", "1", 1, 1.67)]
DeadVolume = Annotated[float, Quantity("m^3", "cm^3", 0, 1e6)]
DeadZone = Annotated[float, Percent("1", "%", 0, 90)]
DeadBand = Annotated[float, Quantity("Pa", "bar", 0, 1e3)]
Compensation = Annotated[float, Percent("1", "%", 0, 99)]


class AirValve(AirActuator):
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
        C to the exhaust. Default: that from the supply.
    critical_ratio
        Critical pressure ratio b [-].
    band
        Error of the pressure [Pa] at which the valve is fully open.
    polytropic_index
        n of the air in the muscles, 1 (isothermal) to 1.4 (adiabatic), without a `wall_conductance`; controllers and
        the reservoir use it in any case.
    wall_conductance
        h A [W/K] of the wall of a muscle to its air: with it the temperature of the air is a state. 0 is adiabatic.
    dead_volume
        Volume [m^3] of tube and fittings between valve and muscle.
    leak
        C of a leak of muscle, tube and fittings to the atmosphere; none by default.
    reservoir_volume, line_conductance
        Volume [m^3] of air at the valves' inlets, and the C of the line that fills it from the supply: with them the
        supply drops while air flows. Default: the pressure at the inlets is constant.
    """

    together: ClassVar = (("reservoir_volume", "line_conductance"),)
    telemetry_labels: ClassVar = {
        "opening1": Label("1", "opening of the valve of muscle 1, to the supply or where negative to the exhaust"),
        "opening2": Label("1", "opening of the valve of muscle 2, to the supply or where negative to the exhaust"),
        "reservoir": Label("Pa", "gauge pressure at the inlets of the valves"),
    }

    conductance: Conductance
    supply: SupplyPressure
    exhaust_conductance: Conductance | None = eqx.field(kw_only=True, default=None)
    critical_ratio: CriticalRatio = eqx.field(kw_only=True, default=0.3)
    band: PressureScale = eqx.field(kw_only=True, default=1 * bar)
    polytropic_index: PolytropicIndex = eqx.field(kw_only=True, default=1.2)
    wall_conductance: HeatConductance | None = eqx.field(kw_only=True, default=None)
    dead_volume: DeadVolume = eqx.field(kw_only=True, default=0.0)
    leak: Conductance | None = eqx.field(kw_only=True, default=None)
    reservoir_volume: Volume | None = eqx.field(kw_only=True, default=None)
    line_conductance: Conductance | None = eqx.field(kw_only=True, default=None)

    @abc.abstractmethod
    def opening(self, state: State, command: ArrayLike, pressure: ArrayLike) -> Array:
        """Return the opening -1 (exhaust) to 1 (supply) at a command and a pressure [Pa].

        The state is that of spool, command or modulation, as `init` and `rate` define it.
        """

    @abc.abstractmethod
    def rate(self, state: State, command: ArrayLike, pressure: ArrayLike) -> State:
        """Return the time derivative of the state, of the same structure."""

    @property
    def command_lag(self) -> ArrayLike:
        """Time constant [s] of the command before the loop of the pressure; 0 for none."""
        return 0.0

    @property
    def shut_within(self) -> Number | None:
        """Error [Pa] of the pressure up to which the loop keeps the valve shut; None for none."""
        return None

    @property
    def held_within(self) -> Number | None:
        """Change [Pa] of the command, in either direction, that does not pass its lag; None for none."""
        return None

    def fastest_rate(self, stroke: float) -> float:
        """Return a bound on the rates [1/s] of valve and loop, for a pressure that changes by up to `stroke` [Pa/s]."""
        return stroke / float(self.band)

    @property
    def switches(self) -> bool:
        return type(self).before_step is not AirActuator.before_step

    @property
    def reservoir(self) -> Reservoir | None:
        if self.reservoir_volume is None or self.line_conductance is None:
            return None
        volume, line = self.reservoir_volume, self.line_conductance
        return Reservoir(volume, line, self.supply, self.critical_ratio, self.polytropic_index)

    def signals(self, state: State, command: ArrayLike, pressure: ArrayLike) -> dict[str, Array]:
        return {"opening": self.opening(state, command, pressure)}

    def exchange(
        self, pressure: Scalar, state: State, command: ArrayLike, inlet: ArrayLike, temperature: Scalar | None = None
    ) -> Exchange:
        opening = self.opening(state, command, pressure)
        flows: tuple[Array | float, ...] = (self.flow(opening, inlet, pressure),)
        if self.leak is not None:
            flows = (*flows, -self.leakage(pressure))
        if temperature is not None:
            flows = tuple(flow_of_warm_air(flow, temperature) for flow in flows)
        return Exchange(flows, self.rate(state, command, pressure), jnp.where(opening > 0, flows[0], 0.0))  # pyrefly: ignore[bad-argument-type]

    def flow(self, opening: ArrayLike, inlet: ArrayLike, pressure: ArrayLike) -> Array:
        """Return the mass flow [kg/s] into a muscle at a gauge pressure [Pa], from an absolute pressure [Pa].

        By ISO 6358, with the part `opening` of the conductance; a negative opening lets the muscle vent.
        """
        opening = jnp.asarray(opening)
        conductance = jnp.where(opening > 0, self.conductance * opening, -self.exhaust * opening)
        return mass_flow(
            conductance, self.critical_ratio, jnp.where(opening > 0, inlet, ATMOSPHERE), pressure + ATMOSPHERE
        )

    def leakage(self, pressure: ArrayLike) -> Array | float:
        """Mass flow [kg/s] out of a muscle through the leak."""
        if self.leak is None:
            return 0.0
        return mass_flow(self.leak, self.critical_ratio, pressure + ATMOSPHERE, ATMOSPHERE)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        # the lag of a spool is left out
        needed = self.needed_flow(pressure, rate, volume) + self.leakage(pressure)
        full = jnp.where(needed > 0, 1.0, -1.0)
        share = needed / self.flow(full, self.supply + ATMOSPHERE, pressure)
        command = pressure + self._error_for(full * share) + self.command_lag * rate
        if self.held_within is not None:
            command = command + jnp.sign(rate) * self.held_within
        possible = (share >= 0) & (share <= 1) & (jnp.asarray(pressure) <= self.supply)
        return jnp.where(possible, command, full * jnp.inf)

    def init_model(self, pressure: Scalar) -> Scalar:
        """Return the command [Pa] after its lag; spool and modulation are left out of the model."""
        return floating(pressure)

    def predict(self, at: Point, command: ArrayLike, duration: ArrayLike) -> tuple[Scalar, Scalar]:
        pressure, state, air = at
        following = self.follow(state, command, duration)
        error = self.effective((state + following) / 2 - pressure)
        side = jnp.where(error > 0, 1.0, -1.0)
        rate, drift = self.open_rate(side, pressure, air)
        inverse = 1 / rate  # a single division, the slowest operation
        lag = self.band * inverse
        full = jnp.clip(jnp.abs(error) * inverse - lag, 0.0, duration)  # time [s] with a fully open valve
        left = exp((full - duration) * (rate * (1 / self.band)))
        moved = error - (error - side * rate * full) * left
        return pressure + moved + drift * (full + lag * (1 - left)), following

    def attainable(self, at: Point, commands: CommandRange, duration: ArrayLike) -> Attainable:
        slowest, fastest, drift = self.open_rates(at.pressure, at.air)
        share = jnp.ones_like(at.pressure)
        return Attainable(share, (slowest + drift) * duration, (fastest + drift) * duration)

    def command_toward(self, at: Point, target: ArrayLike, lag: ArrayLike, period: ArrayLike) -> Scalar:
        pressure, state, air = at
        slowest, fastest, drift = self.open_rates(pressure, air)
        rate = (target - pressure) * (1 - exp(-jnp.asarray(period) / lag)) / period
        flow = jnp.clip(rate - drift, slowest, fastest)  # as a rate of the pressure [Pa/s]
        opening = flow / jnp.where(flow > 0, fastest, -slowest)
        covered = lag_fraction(FASTER * jnp.asarray(lag), period)
        opened = pressure + period / covered * (flow + drift) + self._error_for(opening)
        lead = covered / lag_fraction(self.command_lag, period)
        return state + _leading(lead * (opened - state), self.held_within)

    def follow(self, state: Scalar, command: ArrayLike, duration: ArrayLike) -> Scalar:
        """Return the command [Pa] after its lag, a time [s] later."""
        return state + lag_fraction(self.command_lag, duration) * _beyond(
            jnp.asarray(command) - state, self.held_within
        )

    def open_rates(self, pressure: Scalar, air: AirVolume | None) -> tuple[Scalar, Scalar, Scalar]:
        """Return the rates [Pa/s] by the open valve to the exhaust and from the full supply, and with it shut."""
        (vent, drift), (fill, _) = (self.open_rate(side, pressure, air) for side in (-1.0, 1.0))
        return -vent, fill, drift

    def open_rate(self, side: ArrayLike, pressure: Scalar, air: AirVolume | None) -> tuple[Scalar, Scalar]:
        """Return the magnitude of the rate [Pa/s] by the valve open to one side, 1 or -1, and the rate with it shut."""
        assert air is not None
        index, absolute = self.polytropic_index, pressure + ATMOSPHERE
        by_flow = index / air.effective(index, absolute)
        open_rate = side * by_flow * ENERGY * self.flow(side, self.supply + ATMOSPHERE, pressure)
        drift = -by_flow * (ENERGY * self.leakage(pressure) + absolute * air.rate)
        return jnp.maximum(open_rate, _LEAST_RATE), drift

    def time_constant_at(self, pressure: Number, volume: Number) -> Number:
        inside = pressure + ATMOSPHERE
        fill = mass_flow(self.conductance, self.critical_ratio, self.supply + ATMOSPHERE, inside)
        vent = mass_flow(self.exhaust, self.critical_ratio, inside, ATMOSPHERE)
        mass = self.band * (volume + self.dead_volume) / (self.polytropic_index * ENERGY)  # of a band
        return self.command_lag + mass * (1 / fill + 1 / vent) / 2

    def fastest_rate_in(self, volume: float) -> float:
        """Return a bound on the rates [1/s] of the air in a volume [m^3], of valve, loop and reservoir."""
        index, critical = self.fastest_index, float(self.critical_ratio)
        widest, room = self.widest, volume + float(self.dead_volume)
        stroke = index * ENERGY * DENSITY * widest * (float(self.supply) + ATMOSPHERE) / room
        fastest = exchange_rate(index, critical, widest, room) + self.cooling_rate(room) + self.fastest_rate(stroke)
        return fastest if self.reservoir is None else max(fastest, self.reservoir.fastest_rate(2 * widest))

    @property
    def widest(self) -> float:
        return max(float(self.conductance), float(self.exhaust))

    def scaled(self, factor: float) -> Self:
        exhaust = None if self.exhaust_conductance is None else self.exhaust_conductance * factor
        return dataclasses.replace(self, conductance=self.conductance * factor, exhaust_conductance=exhaust)

    @property
    def exhaust(self) -> Conductance:
        """C [m^3/(s*Pa)] to the exhaust."""
        return self.conductance if self.exhaust_conductance is None else self.exhaust_conductance

    def _loop(self, command: ArrayLike, pressure: ArrayLike) -> Array:
        """Opening that the proportional loop asks for."""
        return jnp.clip(self.effective(jnp.asarray(command) - jnp.asarray(pressure)) * (1 / self.band), -1.0, 1.0)

    def effective(self, error: Array) -> Array:
        """Return the part of an error [Pa] of the pressure that opens the valve."""
        return _beyond(error, self.shut_within)

    def _error_for(self, opening: ArrayLike) -> Array:
        """Error [Pa] at which the loop gives an opening; if small, below the error that keeps the valve shut."""
        return _leading(self.band * jnp.asarray(opening), self.shut_within)


def _beyond(error: Array, width: Number | None) -> Array:
    """Part of an error beyond a width, None for none, to either side."""
    return error if width is None else error - jnp.clip(error, -width, width)


def _leading(error: Array, width: Number | None) -> Array:
    """Error whose part beyond a width is as given, but where it is small twice as large."""
    return error if width is None else error + jnp.clip(error, -width, width)


def _compensated(opening: Array, shut: Number, compensation: Number) -> Array:
    """Command for an opening, which skips a part of the dead zone; within the rest of it the steps are small."""
    jump, remaining = compensation * shut, jnp.maximum((1 - compensation) * shut, 1e-9)
    return (1 - jump) * opening + jump * jnp.clip(opening * (1 / remaining), -1.0, 1.0)


class FlowValve(AirValve):
    """Proportional directional valve, 3/3 or 5/3: a spool with a lag and a dead zone.

    Parameters
    ----------
    spool_lag
        Time constant [s] of the spool.
    dead_zone
        Part of the stroke, on either side of the middle, at which the valve is shut.
    compensation
        Part of the dead zone that the loop skips. The rest, times `band`, is the error of the pressure at rest.
    direct
        Whether commands are openings -1..1 in place of pressures, for a controller with its own pressure loop.

    The spool s follows the opening that the loop wants by T s' = u - s, and opens the valve by
    (s - clip(s, -z, z)) / (1 - z), with the dead zone z. A `band` below 4 times `spool_lag` times the fastest change of
    the pressure makes the loop oscillate visibly.
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
        target = jnp.asarray(command)
        if not self.direct:
            target = _compensated(self._loop(command, pressure), self.dead_zone, self.compensation)
        return (target - state) * (1 / self.spool_lag)

    def command_range(self, rated: Domain) -> CommandRange:
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
    hysteresis
        Difference [Pa] between the pressures at a command that rose and one that fell to its value; none by default.
        The lagged command z follows the command u by T z' = e - clip(e, -h/2, h/2), e = u - z, as with dry friction.
    """

    short_name = "regulator"

    time_constant: ValveTime = eqx.field(kw_only=True)
    dead_zone: DeadBand | None = eqx.field(kw_only=True, default=None)
    hysteresis: DeadBand | None = eqx.field(kw_only=True, default=None)

    @property
    def shut_within(self) -> Number | None:
        return self.dead_zone

    @property
    def held_within(self) -> Number | None:
        return None if self.hysteresis is None else self.hysteresis / 2

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
        return _beyond(jnp.asarray(command) - state, self.held_within) * (1 / self.time_constant)


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

    def averaged(self) -> PressureRegulator:
        """Return the pair without modulation, whose commands lag until the next period begins."""
        of_air = {field.name: getattr(self, field.name) for field in dataclasses.fields(AirValve)}
        return PressureRegulator(**of_air, time_constant=self.command_lag)  # type: ignore[arg-type]

    def init(self, pressure: Scalar) -> Switching:
        zero = jnp.zeros_like(floating(pressure))
        return Switching(zero + jnp.inf, zero, zero)  # the first step begins a period

    def before_step(self, state: Switching, command: ArrayLike, pressure: ArrayLike, step: ArrayLike) -> Switching:
        period = jnp.maximum(jnp.round(self.period / step), 1.0) * step
        begins = state.phase >= period - 0.5 * step
        phase = jnp.where(begins, 0.0, state.phase)
        target = _compensated(self._loop(command, pressure), self.opening_delay / period, self.compensation)
        duty = jnp.where(begins, target, state.duty)
        width = jnp.abs(duty) * period
        open_for = jnp.clip(phase + step, self.opening_delay, width) - jnp.clip(phase, self.opening_delay, width)
        share = jnp.where(jnp.abs(duty) < 1, jnp.minimum(open_for / step, 1.0), 1.0)
        return Switching(phase + step, duty, jnp.sign(duty) * share)

    def opening(self, state: Switching, command: ArrayLike, pressure: ArrayLike) -> Array:
        return state.opening

    def rate(self, state: Switching, command: ArrayLike, pressure: ArrayLike) -> Switching:
        return jax.tree.map(jnp.zeros_like, state)
