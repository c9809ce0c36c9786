"""Disturbances: what pushes the joint from outside."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.numerics.checks import check_positive
from mckibben.numerics.elementary import floating
from mckibben.units import Duration, PositiveTime, ShortTime, Torque


class Disturbance(eqx.Module):
    """A torque on the joint over time, held over each control period."""

    @abc.abstractmethod
    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        """The torque [N*m] at a time [s] since the start, positive = in the direction of the angle."""


class NoDisturbance(Disturbance):
    """Nothing pushes."""

    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(time))


class TorquePulses(Disturbance):
    """Pushes of the same torque, to and fro: the first in the direction of the angle, the next against it.

    Parameters
    ----------
    height
        [N*m].
    width
        How long each lasts [s].
    interval
        From the beginning of one to the beginning of the next [s].
    start
        When the first begins [s].

    Examples
    --------
    >>> pulses = TorquePulses(height=0.5, width=0.1, interval=1.0, start=0.25)
    >>> pulses.torque(jnp.array([0.2, 0.3, 0.4, 1.3, 2.3])).tolist()
    [0.0, 0.5, 0.0, -0.5, 0.5]
    """

    height: Torque
    width: PositiveTime = 0.1
    interval: Duration = 1.0
    start: ShortTime = 0.5

    def __check_init__(self) -> None:
        check_positive("TorquePulses", "s", width=self.width, interval=self.interval)
        check_positive("TorquePulses", "s", zero=True, start=self.start)

    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        time, start = floating(time), jnp.asarray(self.start)
        since = time - start
        near = 4 * jnp.finfo(time.dtype).eps * (jnp.abs(time) + start)  # rounding of a time
        number = jnp.floor((since + near) / self.interval)  # begins in the control period at whose start it is due
        on = (number >= 0) & (since - number * self.interval < self.width - near)
        return jnp.where(on, self.height * (1 - 2 * jnp.mod(number, 2.0)), 0.0)
