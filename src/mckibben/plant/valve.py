"""Valves: response of the pressure in a muscle to its command."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.notebook import Displayed
from mckibben.numerics.checks import check_positive, check_within
from mckibben.units import PositiveTime, PressureScale


class ValveModel(eqx.Module, Displayed):
    """Base of `Valve`, whose pressures are known in closed form, and `AirValve`, whose pressures are integrated."""


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

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)


_SLOWEST = 10.0  # s: a slower valve is one in milliseconds


class FirstOrderValve(Valve):
    """First-order lag, p(t) = u + (p(0) - u) exp(-t / T) under a constant command u.

    T [s] is 20 to 100 ms for fast proportional valves on a small muscle. No command, and no start, is above the gauge
    pressure of the supply [Pa], where it is given.
    """

    time_constant: PositiveTime
    supply: PressureScale | None = eqx.field(kw_only=True, default=None)

    def __check_init__(self) -> None:
        check_positive("FirstOrderValve", "s", time_constant=self.time_constant)
        if self.supply is not None:
            check_positive("FirstOrderValve", "Pa", supply=self.supply)
        check_within("FirstOrderValve", 0.0, _SLOWEST, "s", time_constant=self.time_constant)

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        command = jnp.asarray(command)
        return command + (pressure - command) * jnp.exp(-jnp.asarray(elapsed) / self.time_constant)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure) + self.time_constant * jnp.asarray(rate)
