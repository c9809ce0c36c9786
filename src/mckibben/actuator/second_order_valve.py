"""Second-order pressure regulator."""

from __future__ import annotations

from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.actuator.base import Scalar, State
from mckibben.actuator.valve import Valve
from mckibben.numerics.elementary import Number, floating
from mckibben.units import Bandwidth, Quantity, SupplyPressure

DampingRatio = Annotated[float, Quantity("1", "1", 0, 100, open_lower=True)]

_SERIES = 1e-2  # of the square of the phase


class SecondOrderValve(Valve):
    """Second-order lag, p'' + 2 D w p' + w^2 p = w^2 u, with the exact response to a constant command u.

    Commands are limited to the gauge pressure of the supply [Pa], if it is given; with D below 1 the pressure
    overshoots. Source: K. Ogata, Modern Control Engineering, sec. 5-3.

    Parameters
    ----------
    bandwidth
        Natural frequency w [rad/s].
    damping
        Damping ratio D [-].
    supply
        Gauge pressure [Pa] of the supply.

    Examples
    --------
    With D = 0.5 the overshoot is exp(-pi D / sqrt(1 - D^2)), 16.3 %, at the time pi / (w sqrt(1 - D^2)):

    >>> import math
    >>> valve = SecondOrderValve(60.0, damping=0.5)
    >>> round(float(valve.pressure_after(0.0, 1e5, math.pi / (60 * math.sqrt(0.75)))) / 1e5, 3)
    1.163
    """

    short_name = "second_order"

    bandwidth: Bandwidth
    damping: DampingRatio = eqx.field(kw_only=True, default=0.7)
    supply: SupplyPressure | None = eqx.field(kw_only=True, default=None)

    @property
    def is_linear(self) -> bool:
        return True

    def init(self, pressure: Scalar) -> Scalar:
        """Return the rate of the pressure [Pa/s] at rest."""
        return jnp.zeros_like(floating(pressure))

    def after(self, pressure: ArrayLike, state: State, command: ArrayLike, elapsed: ArrayLike) -> tuple[Array, Array]:
        command = jnp.asarray(command)
        error, decay = pressure - command, self.damping * self.bandwidth
        even, odd = _decaying(self.damping, self.bandwidth * jnp.asarray(elapsed))
        odd: Any = odd / self.bandwidth
        moved = error * even + (state + decay * error) * odd
        return command + moved, state * even - (self.bandwidth**2 * error + decay * state) * odd

    def pressure_after(self, pressure: ArrayLike, command: ArrayLike, elapsed: ArrayLike) -> Float[Array, "..."]:
        return self.after(pressure, 0.0, command, elapsed)[0]

    def command_for(self, pressure: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.asarray(pressure) + self.lag * jnp.asarray(rate)

    @property
    def lag(self) -> Number:
        return 2 * self.damping / self.bandwidth


def _decaying(damping: ArrayLike, phase: Array) -> tuple[Array, Array]:
    """exp(-D x) cosh(sqrt(D^2 - 1) x) and exp(-D x) sinh(sqrt(D^2 - 1) x) / sqrt(D^2 - 1), smooth at D = 1."""
    drop, square = damping * phase, (damping * damping - 1.0) * phase * phase
    over = jnp.sqrt(jnp.where(square > _SERIES, square, 1.0))
    under = jnp.sqrt(jnp.where(square < -_SERIES, -square, 1.0))
    rising, falling = jnp.exp(jnp.minimum(over - drop, 0.0)) / 2, jnp.exp(-over - drop) / 2
    decay = jnp.exp(-drop)
    even: Any = 1 + square / 2 * (1 + square / 12 * (1 + square / 30 * (1 + square / 56)))
    odd: Any = 1 + square / 6 * (1 + square / 20 * (1 + square / 42 * (1 + square / 72)))

    def chosen(over: Array, under: Array, series: Array) -> Array:
        return jnp.where(square > _SERIES, over, decay * jnp.where(square < -_SERIES, under, series))

    first = chosen(rising + falling, jnp.cos(under), even)
    return first, phase * chosen((rising - falling) / over, jnp.sin(under) / under, odd)
