"""Valves: how the pressure in a muscle follows its command."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.checks import check_positive, check_within


class Valve(eqx.Module):
    """The pressure's answer to a command that is held over a control period."""

    @abc.abstractmethod
    def switched(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        """The pressure [Pa] right after a new command [Pa]."""

    @abc.abstractmethod
    def rate(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        """The rate of the pressure [Pa/s] while the command is held."""


class IdealValve(Valve):
    """The pressure is the command, at once: what the paper's simulation assumes."""

    def switched(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def rate(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(jnp.asarray(pressure))


_SLOWEST = 10.0  # s: a slower valve is one in milliseconds


class FirstOrderValve(Valve):
    """The pressure follows with a lag.

    Parameters
    ----------
    time_constant
        After which 63 % of a step are done [s]. Fast proportional valves on a small muscle have 20 to 100 ms.
    """

    time_constant: float

    def __check_init__(self) -> None:
        check_positive("FirstOrderValve", "s", time_constant=self.time_constant)
        check_within("FirstOrderValve", 0.0, _SLOWEST, "s", time_constant=self.time_constant)

    def switched(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)

    def rate(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return (jnp.asarray(command) - pressure) * (1 / self.time_constant)
