"""Valves: how the pressure in a muscle follows its command."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.checks import check_positive, check_within
from mckibben.units import PositiveTime


class Valve(eqx.Module):
    """The response of the pressure to a command that is held over a control period, in closed form.

    The plant takes the pressures at the stages of its integration from it, so no valve is too fast for the step.
    """

    @abc.abstractmethod
    def switched(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        """The pressure [Pa] right after a new command [Pa]."""

    @abc.abstractmethod
    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        """The pressure [Pa] after a time [s] from a pressure [Pa], under a command [Pa] that is held."""

    @abc.abstractmethod
    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        """The command [Pa] under which a pressure [Pa] changes at a rate [Pa/s]."""


class IdealValve(Valve):
    """The pressure is the command, at once: what the paper's simulation assumes."""

    def switched(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)


_SLOWEST = 10.0  # s: a slower valve is one in milliseconds


class FirstOrderValve(Valve):
    """The pressure follows with a lag: p(t) = u + (p(0) - u) exp(-t / T) under a held command u.

    Parameters
    ----------
    time_constant
        After which 63 % of a step are done [s]. Fast proportional valves on a small muscle have 20 to 100 ms.
    """

    time_constant: PositiveTime

    def __check_init__(self) -> None:
        check_positive("FirstOrderValve", "s", time_constant=self.time_constant)
        check_within("FirstOrderValve", 0.0, _SLOWEST, "s", time_constant=self.time_constant)

    def switched(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        command = jnp.asarray(command)
        return command + (pressure - command) * jnp.exp(-jnp.asarray(elapsed) / self.time_constant)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure) + self.time_constant * jnp.asarray(rate)
