"""Tube between a valve and a muscle, with a pressure of its own."""

from __future__ import annotations

import dataclasses
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.actuator.air_actuator import AirActuator, Exchange
from mckibben.actuator.air_valve import FASTER, AirValve
from mckibben.actuator.base import AirVolume, Attainable, CommandRange, Point, Reservoir, Scalar, State, lag_fraction
from mckibben.component.columns import Label
from mckibben.errors import RangeError
from mckibben.muscle.air import (
    ATMOSPHERE,
    DENSITY,
    ENERGY,
    LAMINAR,
    CriticalRatio,
    exchange_rate,
    flow_of_warm_air,
    flow_share,
    mass_flow,
    pressure_behind,
    pressure_rate,
)
from mckibben.numerics.elementary import Number, exp, floating
from mckibben.units import Conductance, Quantity

TubeVolume = Annotated[float, Quantity("m^3", "cm^3", 0, 1e6, open_lower=True)]


class TubeState(NamedTuple):
    """State of a valve with its tube: that of the valve, and the gauge pressure [Pa] at its outlet."""

    valve: State
    pressure: Scalar


class Tube(AirActuator):
    r"""Valve with a tube to the muscle: a restriction, with the volume V_t of its air at the valve's outlet.

    .. math:: \dot p_t = \frac{n R T}{V_t} (\dot m_v - \dot m_t), \qquad \dot p = \frac{n}{V}(R T \dot m_t - p \dot V)

    The flows of valve and tube follow ISO 6358 (`mckibben.muscle.air`). The valve measures and controls the pressure at
    its outlet, so that the muscle lags behind it. The time of sound through the tube, 3 ms per metre, belongs to the
    `command_delay` of the plant.

    Parameters
    ----------
    valve
        The valve; its `dead_volume` adds to that of the tube, its `leak` is that of the muscle.
    volume
        V_t [m^3].
    conductance, critical_ratio
        Sonic conductance C [m^3/(s*Pa)] and critical pressure ratio b [-] of the tube, as its manufacturer
        gives them for its length and diameter.
    """

    short_name = "tube"
    telemetry_labels: ClassVar = {
        f"outlet{number}": Label("Pa", f"gauge pressure between valve and tube of muscle {number}") for number in (1, 2)
    }

    valve: AirValve
    volume: TubeVolume = eqx.field(kw_only=True)
    conductance: Conductance = eqx.field(kw_only=True)
    critical_ratio: CriticalRatio = eqx.field(kw_only=True, default=0.3)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.valve.direct:
            remedy = "give it a valve without `direct`"
            raise RangeError("Tube: the valve takes openings in place of pressures", field="valve", remedy=remedy)

    @property
    def switches(self) -> bool:
        return self.valve.switches

    @property
    def supply(self) -> Number:
        """Gauge pressure [Pa] of the supply."""
        return self.valve.supply

    @property
    def polytropic_index(self) -> Number:
        """Index n of the air in tube and muscle."""
        return self.valve.polytropic_index

    @property
    def wall_conductance(self) -> Number | None:  # type: ignore[override]
        """Conductance [W/K] for heat from the wall of the muscle to its air."""
        return self.valve.wall_conductance

    @property
    def widest(self) -> float:
        return self.valve.widest

    @property
    def dead_volume(self) -> Number:  # type: ignore[override]
        return self.volume + self.valve.dead_volume

    @property
    def attached_volume(self) -> ArrayLike:
        return 0.0

    @property
    def reservoir(self) -> Reservoir | None:
        return self.valve.reservoir

    def averaged(self) -> Tube:
        return dataclasses.replace(self, valve=self.valve.averaged())

    def init(self, pressure: Scalar) -> TubeState:
        return TubeState(self.valve.init(pressure), floating(pressure))

    def before_step(self, state: TubeState, command: ArrayLike, pressure: ArrayLike, step: ArrayLike) -> TubeState:
        return state._replace(valve=self.valve.before_step(state.valve, command, state.pressure, step))

    def signals(self, state: TubeState, command: ArrayLike, pressure: ArrayLike) -> dict[str, Array]:
        return {**self.valve.signals(state.valve, command, state.pressure), "outlet": state.pressure}

    def exchange(
        self,
        pressure: Scalar,
        state: TubeState,
        command: ArrayLike,
        inlet: ArrayLike,
        temperature: Scalar | None = None,
    ) -> Exchange:
        outlet = state.pressure + ATMOSPHERE
        flows: tuple[Any, ...] = (mass_flow(self.conductance, self.critical_ratio, outlet, pressure + ATMOSPHERE),)
        if self.valve.leak is not None:
            flows = (*flows, -self.valve.leakage(pressure))
        if temperature is not None:
            flows = tuple(flow_of_warm_air(flow, temperature) for flow in flows)
        at_valve = AirVolume(jnp.asarray(self.dead_volume), self._growth(flows[0], outlet))
        tube, valve, drawn, _ = self._tight.muscle_rates(state.pressure, state.valve, command, at_valve, inlet)
        return Exchange(flows, TubeState(valve, tube), drawn)  # pyrefly: ignore[bad-argument-type]

    def command_for(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        absolute = jnp.asarray(pressure) + ATMOSPHERE
        needed = self.needed_flow(pressure, rate, volume) + self.valve.leakage(pressure)
        outlet = pressure_behind(self.conductance, self.critical_ratio, absolute, needed)
        at_valve = AirVolume(jnp.asarray(self.dead_volume), self._growth(needed, outlet))
        choked = -needed > self.conductance * DENSITY * absolute
        return jnp.where(choked, -jnp.inf, self._tight.command_for(outlet - ATMOSPHERE, rate, at_valve))

    def time_constant_at(self, pressure: Any, volume: Any) -> Any:
        slope = ENERGY * DENSITY * flow_share(self.critical_ratio, LAMINAR) / (1 - LAMINAR)
        tube = volume / (self.polytropic_index * self.conductance * slope)
        return self.valve.time_constant_at(pressure, volume + self.volume) + tube

    def fastest_rate_in(self, volume: float) -> float:
        index, critical, dead = self.fastest_index, float(self.critical_ratio), float(self.dead_volume)
        exchange = exchange_rate(index, critical, float(self.conductance), volume * dead / (volume + dead))
        return exchange + self.cooling_rate(volume) + self._tight.fastest_rate_in(float(self.volume))

    def scaled(self, factor: float) -> Self:
        return dataclasses.replace(self, valve=self.valve.scaled(factor))

    def init_model(self, pressure: Scalar) -> TubeState:
        return TubeState(self.valve.init_model(pressure), floating(pressure))

    def predict(self, at: Point, command: ArrayLike, duration: ArrayLike) -> tuple[Scalar, TubeState]:
        pressure, state, _ = at
        following = self.valve.follow(state.valve, command, duration)
        error = self.valve.effective((state.valve + following) / 2 - state.pressure)
        at_valve = AirVolume(jnp.asarray(self.dead_volume), jnp.zeros_like(pressure))
        rate, _ = self._tight.open_rate(jnp.where(error > 0, 1.0, -1.0), state.pressure, at_valve)
        speed = rate / jnp.maximum(jnp.abs(error), self.valve.band)
        muscle, tube = self._moved(at, error, speed, duration)
        return pressure + muscle, TubeState(following, state.pressure + tube)

    def attainable(self, at: Point, commands: CommandRange, duration: ArrayLike) -> Attainable:
        # the rates that last: those of one flow through valve and tube, which fills both muscle and tube
        pressure, state, air = at
        assert air is not None
        whole = AirVolume(air.volume + self.dead_volume, air.rate, air.by_pressure)
        return self._in_series.attainable(Point(pressure, state.valve, whole), commands, duration)

    def command_toward(self, at: Point, target: ArrayLike, lag: ArrayLike, period: ArrayLike) -> Scalar:
        pressure, state, air = at
        assert air is not None
        rate = (target - pressure) * (1 - exp(-jnp.asarray(period) / lag)) / period
        needed = self._flow_for(pressure + ATMOSPHERE, rate, air)
        outlet = pressure_behind(self.conductance, self.critical_ratio, pressure + ATMOSPHERE, needed)
        at_valve = AirVolume(jnp.asarray(self.dead_volume), self._growth(needed, state.pressure + ATMOSPHERE))
        faster = FASTER * jnp.asarray(lag)
        ahead = outlet - ATMOSPHERE + period / lag_fraction(faster, period) * rate
        clipped = jnp.clip(ahead, 0.0, self.supply)
        return self._tight.command_toward(Point(state.pressure, state.valve, at_valve), clipped, faster, period)

    @property
    def _tight(self) -> AirValve:
        """The valve without leak and wall, which are those of the muscle."""
        if self.valve.leak is None and self.valve.wall_conductance is None:
            return self.valve
        return dataclasses.replace(self.valve, leak=None, wall_conductance=None)

    @property
    def _in_series(self) -> AirValve:
        """The valve with the conductances of valve and tube in series, 1/C^2 = 1/C_v^2 + 1/C_t^2."""
        valve, tube = self.valve, self.conductance
        fill, vent = (
            1 / (1 / conductance**2 + 1 / tube**2) ** 0.5 for conductance in (valve.conductance, valve.exhaust)
        )
        # of the critical ratios, 1 - b = C^2 ((1 - b_v)/C_v^2 + (1 - b_t)/C_t^2)
        share = (fill / tube) ** 2
        critical = (1 - share) * valve.critical_ratio + share * self.critical_ratio
        return dataclasses.replace(valve, conductance=fill, exhaust_conductance=vent, critical_ratio=critical)

    def _growth(self, flow: ArrayLike, outlet: ArrayLike) -> Array:
        """Rate [m^3/s] of a volume that takes up a mass flow [kg/s] at an absolute pressure [Pa]."""
        return ENERGY * jnp.asarray(flow) / outlet

    def _flow_for(self, absolute: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        """Mass flow [kg/s] through the tube at which an absolute pressure [Pa] changes at a rate [Pa/s]."""
        room = volume.effective(self.polytropic_index, absolute)
        filling = (rate * room / self.polytropic_index + absolute * volume.rate) / ENERGY
        return jnp.asarray(filling + self.valve.leakage(absolute - ATMOSPHERE))

    def _moved(self, at: Point, error: ArrayLike, speed: ArrayLike, duration: ArrayLike) -> tuple[Scalar, Scalar]:
        """Changes [Pa] of the pressures of muscle and outlet within a time [s], from an error [Pa] and speed [1/s]."""
        # The step is that of the (0, 2) Pade approximant of the matrix exponential, stable with any tube.
        pressure, (_, outlet), air = at
        assert air is not None
        index, step = self.polytropic_index, jnp.asarray(duration)
        room = air.effective(index, pressure + ATMOSPHERE)
        tight = -(pressure + ATMOSPHERE) * air.rate / ENERGY - self.valve.leakage(pressure)
        drift = pressure_rate(index, pressure + ATMOSPHERE, tight, room, 0.0)
        muscle = tube = jnp.zeros_like(pressure)
        for _ in range(2):
            flow = self._conductance(outlet + tube / 2, pressure + muscle / 2)
            fill, drain = step * index * ENERGY * flow / room, step * index * ENERGY * flow / self.dead_volume
            lead, between = step * speed, outlet - pressure
            first, second = lead * error - drain * between, fill * between + step * drift  # rates times the step
            a, b, c, d = lead + drain, -drain, -fill, fill  # minus their derivatives, X
            first, second = first + (a * first + b * second) / 2, second + (c * first + d * second) / 2
            p, q = 1 + a + (a * a + b * c) / 2, b + b * (a + d) / 2  # 1 + X + X^2 / 2
            r, s = c + c * (a + d) / 2, 1 + d + (b * c + d * d) / 2
            scale = 1 / (p * s - q * r)
            tube, muscle = (s * first - q * second) * scale, (p * second - r * first) * scale
        return muscle, tube

    def _conductance(self, outlet: Scalar, pressure: Scalar) -> Scalar:
        """Mass flow [kg/s] through the tube over the difference of its pressures [Pa]."""
        upstream = jnp.maximum(outlet, pressure) + ATMOSPHERE
        ratio = (jnp.minimum(outlet, pressure) + ATMOSPHERE) / upstream
        share = flow_share(self.critical_ratio, ratio)
        return self.conductance * DENSITY * share / jnp.maximum(1 - ratio, 1 - LAMINAR)
