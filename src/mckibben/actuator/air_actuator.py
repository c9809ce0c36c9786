"""Base of actuators whose pressures follow from mass flow and volume."""

from __future__ import annotations

import abc
import functools
import operator
from typing import Any, ClassVar, NamedTuple, Self

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike

from mckibben.actuator.base import Actuator, AirVolume, Scalar, State
from mckibben.component.columns import Label
from mckibben.joint import AntagonisticJoint
from mckibben.muscle.air import (
    ATMOSPHERE,
    ENERGY,
    HEAT_CAPACITY_RATIO,
    TEMPERATURE,
    heat_as_flow,
    pressure_rate,
    temperature_rate,
)
from mckibben.numerics.elementary import Number


class Exchange(NamedTuple):
    """Air that a muscle exchanges with its actuator.

    Mass flows [kg/s] into the muscle, negative out of it, the rate of the state of the actuator, and the mass flow
    [kg/s] drawn from the supply.
    """

    flows: tuple[Array, ...]
    rate: State
    drawn: Array

    @property
    def net(self) -> Array:
        """Sum of the flows [kg/s]."""
        return functools.reduce(operator.add, self.flows)

    def enthalpy(self, temperature: Scalar) -> Array:
        """Return the enthalpy of the flows over that of 1 kg of air at room temperature [kg/s].

        Air flows in at room temperature, and out at the temperature of the muscle's air [K].
        """
        ratio = temperature * (1 / TEMPERATURE)
        return functools.reduce(operator.add, (jnp.where(flow < 0, flow * ratio, flow) for flow in self.flows))


class AirActuator(Actuator):
    r"""Actuator that lets air into a muscle and out; pressures are integrated with the volumes of the muscles.

    It has a gauge pressure `supply` [Pa] and a `polytropic_index`, as fields or properties. With a `wall_conductance`
    h A [W/K] the temperature T of the air in each muscle is a state, in place of a polytropic change of state:

    .. math::

        \dot p = \frac{\kappa}{V} \left(R T_0 \dot m_\mathrm{in} - R T \dot m_\mathrm{out} - p \dot V
        + \frac{\kappa - 1}{\kappa} h A (T_0 - T)\right), \qquad
        \dot T = T \left(\frac{\dot p}{p} + \frac{\dot V}{V}
        - \frac{\dot m_\mathrm{in} - \dot m_\mathrm{out}}{m}\right)

    This is the energy balance of an open system (E. Richer and Y. Hurmuzlu, "A High Performance Pneumatic Force
    Actuator System: Part I", ASME Journal of Dynamic Systems, Measurement, and Control 122, 2000): supply and wall are
    at room temperature T0, and air leaves at T. h A = 0 is adiabatic; with a large h A the air is isothermal.
    """

    default_class = ""
    holds_air = True
    telemetry_labels: ClassVar = {
        f"temperature{number}": Label("K", f"temperature of the air in muscle {number}") for number in (1, 2)
    }

    @abc.abstractmethod
    def exchange(
        self, pressure: Scalar, state: State, command: ArrayLike, inlet: ArrayLike, temperature: Scalar | None = None
    ) -> Exchange:
        """Return the air exchanged with a muscle at a gauge pressure [Pa] and a temperature [K], by default the room's.

        The supply has an absolute pressure `inlet` [Pa].
        """

    def muscle_rates(
        self,
        pressure: Scalar,
        state: State,
        command: ArrayLike,
        volume: AirVolume,
        inlet: ArrayLike,
        temperature: Scalar | tuple[()] = (),
    ) -> tuple[Array, State, Array, Array | tuple[()]]:
        """Return the rates of pressure [Pa/s] and state, the flow drawn from the supply [kg/s], and the warming [K/s].

        The supply has an absolute pressure `inlet` [Pa]. Without a temperature [K] of its own, the air is polytropic.
        """
        absolute = pressure + ATMOSPHERE
        if isinstance(temperature, tuple):
            passed, index = self.exchange(pressure, state, command, inlet), self.polytropic_index  # type: ignore[attr-defined]
            rate = pressure_rate(index, absolute, passed.net, volume.effective(index, absolute), volume.rate)
            return rate, passed.rate, passed.drawn, ()
        passed, index = self.exchange(pressure, state, command, inlet, temperature), HEAT_CAPACITY_RATIO
        filling = passed.enthalpy(temperature) + heat_as_flow(self.wall_conductance, temperature)
        rate = pressure_rate(index, absolute, filling, volume.effective(index, absolute), volume.rate)
        growth = volume.rate if volume.by_pressure is None else volume.rate + volume.by_pressure * rate
        warming = temperature_rate(temperature, absolute, rate, passed.net, volume.volume, growth)
        return rate, passed.rate, passed.drawn, warming

    @property
    def fastest_index(self) -> float:
        """Index n of the fastest change of the pressure by a flow.

        With a `wall_conductance` kappa, times the flow of air that filling has heated to at most kappa times room
        temperature.
        """
        if self.wall_conductance is None:
            return float(self.polytropic_index)  # type: ignore[attr-defined]
        return HEAT_CAPACITY_RATIO**1.5

    def cooling_rate(self, volume: float) -> float:
        """Return the rate [1/s] at which the temperature of air of atmospheric pressure, in a volume [m^3], settles."""
        if self.wall_conductance is None:
            return 0.0
        return float(self.wall_conductance) * (HEAT_CAPACITY_RATIO - 1) * TEMPERATURE / (ATMOSPHERE * volume)

    def needed_flow(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        """Return the mass flow [kg/s] into a muscle at which a gauge pressure [Pa] changes at a rate [Pa/s].

        With a `wall_conductance` the larger one of isothermal air and adiabatic air, as the temperature is not known.
        """
        absolute = jnp.asarray(pressure) + ATMOSPHERE

        def polytropic(index: float) -> Any:
            return (rate * volume.effective(index, absolute) / index + absolute * volume.rate) / ENERGY

        if self.wall_conductance is None:
            return polytropic(self.polytropic_index)  # type: ignore[attr-defined]
        slow, fast = polytropic(1.0), polytropic(HEAT_CAPACITY_RATIO)
        return jnp.where(jnp.abs(slow) > jnp.abs(fast), slow, fast)

    @abc.abstractmethod
    def command_for(self, pressure: ArrayLike, rate: ArrayLike, volume: AirVolume) -> Array:
        """Return the command [Pa] at which a pressure [Pa] changes at a rate [Pa/s], with a full supply.

        Infinite where the open valve or the supply is too small.
        """

    @abc.abstractmethod
    def time_constant_at(self, pressure: Number, volume: Number) -> Number:
        """Return the first-order time constant [s] of a small change of the command at a pressure [Pa].

        It is the area between a step of the command and the response of the pressure in a fixed volume [m^3] around a
        gauge pressure [Pa], over the step; the mean of filling and venting. For the valve model of a controller.
        """

    def model_lag(self, joint: AntagonisticJoint, index: int | None = None) -> Number:
        """Return `time_constant_at` the middle of a muscle's pressures and contractions; default: of the first one."""
        index = int(joint.springs[0]) if index is None else index
        muscle = joint.muscles[index]
        domain = muscle.domain
        volume = muscle.specimen.volume((domain.contraction_min + domain.contraction_max) / 2)
        return self.time_constant_at((domain.pressure_min + domain.pressure_max) / 2, volume)

    @property
    @abc.abstractmethod
    def widest(self) -> float:
        """Largest conductance [m^3/(s*Pa)] of the open valve."""

    @abc.abstractmethod
    def scaled(self, factor: float) -> Self:
        """Return the actuator with conductances of the valve that are larger by a factor."""

    def before_step(self, state: State, command: ArrayLike, pressure: ArrayLike, step: ArrayLike) -> State:
        """Return the state before an integration step [s]; for valves that switch."""
        return state
