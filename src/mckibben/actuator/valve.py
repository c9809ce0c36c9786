"""Valves: response of the pressure in a muscle to its command."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator.base import Actuator, Attainable, CommandRange, Point, Scalar, State
from mckibben.numerics.elementary import Number
from mckibben.units import PressureRate, SupplyPressure, ValveTime


class Valve(Actuator):
    """Response of the pressure to a command that is constant over a control period, in closed form.

    The plant evaluates it at the stages of its integration, so the step does not limit the time constant. It
    continues from the state at the end of each control period, so two consecutive intervals must give the result of
    their sum. A response that depends on more than the pressure has an internal state, given by `init` and `after`.
    """

    def init(self, pressure: Scalar) -> State:
        return ()

    def after(self, pressure: ArrayLike, state: State, command: ArrayLike, elapsed: ArrayLike) -> tuple[Array, State]:
        """Return the pressure [Pa] and the state a time [s] after these, under a constant command [Pa]."""
        return self.pressure_after(pressure, command, elapsed), state

    @abc.abstractmethod
    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        """Return the pressure [Pa] a time [s] after a pressure [Pa], under a constant command [Pa].

        The arguments broadcast.
        """

    @abc.abstractmethod
    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        """Return the command [Pa] at which a pressure [Pa] changes at a rate [Pa/s]; infinite if there is none."""


class IdealValve(Valve):
    """Pressure equal to the command, as in the paper's simulation.

    It has no state and no lag: the pressure before a command does not matter.
    """

    short_name = "ideal"
    holds_pressure = False

    @property
    def is_linear(self) -> bool:
        return True

    @property
    def lag(self) -> Number:
        return 0.0

    def after_command(self, pressure: ArrayLike, command: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(command)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure)


class FirstOrderValve(Valve):
    """First-order lag, p(t) = u + (p(0) - u) exp(-t / T) under a constant command u.

    Parameters
    ----------
    time_constant
        T [s], 20 to 100 ms for fast proportional valves on a small muscle.
    supply
        Gauge pressure [Pa] to which commands and initial pressures are limited. Default: not limited.
    rate
        Highest rate [Pa/s] of the pressure. Default: not limited.

    Examples
    --------
    >>> from mckibben.units import bar
    >>> valve = FirstOrderValve(0.1, rate=10 * bar)
    >>> [round(float(valve.pressure_after(0.0, 3 * bar, at)) / bar, 3) for at in (0.1, 0.2, 0.3)]
    [1.0, 2.0, 2.632]

    The command that makes the pressure rise at 5 bar/s leads it by T times the rate:

    >>> round(float(valve.command_for(1 * bar, 5 * bar)) / bar, 3)
    1.5
    """

    short_name = "first_order"
    is_first_order = True

    time_constant: ValveTime
    supply: SupplyPressure | None = eqx.field(kw_only=True, default=None)
    rate: PressureRate | None = eqx.field(kw_only=True, default=None)

    @property
    def is_linear(self) -> bool:
        return self.rate is None

    @property
    def lag(self) -> Number:
        return self.time_constant

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        command, elapsed = jnp.asarray(command), jnp.asarray(elapsed)
        error = pressure - command
        if self.rate is not None:
            excess = jnp.maximum(jnp.abs(error) / self.rate - self.time_constant, 0.0)  # [s]
            limited = jnp.where(elapsed < excess, elapsed, excess)  # `minimum` would halve the slope where both are 0
            error, elapsed = error - jnp.sign(error) * self.rate * limited, elapsed - limited
        return command + error * jnp.exp(-elapsed / self.time_constant)

    def predict(self, at: Point, command: ArrayLike, duration: ArrayLike) -> tuple[Scalar, State]:
        if self.rate is None:
            return super().predict(at, command, duration)
        return self.pressure_after(at.pressure, command, duration), at.state

    def attainable(self, at: Point, commands: CommandRange, duration: ArrayLike) -> Attainable:
        if self.rate is None:
            return super().attainable(at, commands, duration)
        low, high = (self.pressure_after(at.pressure, command, duration) - at.pressure for command in commands)
        return Attainable(jnp.ones_like(at.pressure), low, high)

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        rate = jnp.asarray(rate)
        command = jnp.asarray(pressure) + self.time_constant * rate
        return command if self.rate is None else jnp.where(jnp.abs(rate) > self.rate, jnp.sign(rate) * jnp.inf, command)
