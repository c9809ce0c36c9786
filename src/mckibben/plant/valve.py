"""Valves: response of the pressure in a muscle to its command."""

from __future__ import annotations

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.joint import AntagonisticJoint
from mckibben.muscle import Domain
from mckibben.units import PositivePressure, PressureRate, ValveTime


class ValveModel(Component):
    """Base of `Valve`, whose pressures are known in closed form, and `AirValve`, whose pressures are integrated."""

    default_class = "first_order"

    def lag_for(self, joint: AntagonisticJoint) -> Any:
        """Return the first-order time constant [s] for a controller's model; `KeyError` if it is not known."""
        raise KeyError(type(self).__name__)

    def command_range(self, rated: Domain) -> tuple[ArrayLike, ArrayLike]:
        """Return the lowest and the highest command [Pa] of a muscle: its rated pressures, and the supply if known."""
        supply = getattr(self, "supply", None)
        highest = rated.pressure_max if supply is None else jnp.minimum(jnp.asarray(rated.pressure_max), supply)
        return rated.pressure_min, highest

    def clip_command(self, command: ArrayLike, rated: Domain) -> Float[Array, "..."]:
        """Return a command within its range for a muscle."""
        return jnp.clip(jnp.asarray(command), *self.command_range(rated))


class Valve(ValveModel):
    """Response of the pressure to a command that is constant over a control period, in closed form.

    The plant evaluates it at the stages of its integration, so the step does not limit the time constant.
    """

    @abc.abstractmethod
    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        """Return the pressure [Pa] right after a new command [Pa]."""

    @abc.abstractmethod
    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        """Return the pressure [Pa] a time [s] after a pressure [Pa], under a constant command [Pa]."""

    @abc.abstractmethod
    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        """Return the command [Pa] at which a pressure [Pa] changes at a rate [Pa/s]."""


class IdealValve(Valve):
    """Pressure equal to the command, as in the paper's simulation."""

    short_name = "ideal"

    def lag_for(self, joint: AntagonisticJoint) -> float:
        return 0.0

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)


class FirstOrderValve(Valve):
    """First-order lag, p(t) = u + (p(0) - u) exp(-t / T) under a constant command u.

    T [s] is 20 to 100 ms for fast proportional valves on a small muscle. No command, and no start, is above the gauge
    pressure of the supply [Pa], and the pressure changes by no more than the rate [Pa/s], where they are given.

    >>> from mckibben.units import bar
    >>> valve = FirstOrderValve(0.1, rate=10 * bar)
    >>> [round(float(valve.pressure_after(0.0, 3 * bar, at)) / bar, 3) for at in (0.1, 0.2, 0.3)]
    [1.0, 2.0, 2.632]
    """

    short_name = "first_order"

    time_constant: ValveTime
    supply: PositivePressure | None = eqx.field(kw_only=True, default=None)
    rate: PressureRate | None = eqx.field(kw_only=True, default=None)

    def lag_for(self, joint: AntagonisticJoint) -> Any:
        return self.time_constant

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        command, elapsed = jnp.asarray(command), jnp.asarray(elapsed)
        error = pressure - command
        if self.rate is not None:
            limited = jnp.minimum(jnp.maximum(jnp.abs(error) / self.rate - self.time_constant, 0.0), elapsed)  # [s]
            error, elapsed = error - jnp.sign(error) * self.rate * limited, elapsed - limited
        return command + error * jnp.exp(-elapsed / self.time_constant)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        rate = jnp.asarray(rate)
        command = jnp.asarray(pressure) + self.time_constant * rate
        return command if self.rate is None else jnp.where(jnp.abs(rate) > self.rate, jnp.sign(rate) * jnp.inf, command)
