"""External torques on a joint."""

from __future__ import annotations

import abc

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.checks import check_positive
from mckibben.numerics.elementary import floating
from mckibben.units import Duration, PositiveTime, ShortTime, Torque


class Disturbance(Component):
    """External torque on the joint over time, constant over each control period."""

    default_class = "pulses"

    @abc.abstractmethod
    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        """Return the torque [N*m], positive in the direction of the angle, at a time [s] since the start."""


class NoDisturbance(Disturbance):
    """No external torque."""

    short_name = "none"

    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(time))


class TorquePulses(Disturbance):
    """Torque pulses of alternating sign, the first one positive.

    Parameters
    ----------
    height, width
        Torque [N*m] and duration [s] of a pulse.
    interval, start
        Time [s] from one pulse to the next, and that of the first.

    Examples
    --------
    >>> pulses = TorquePulses(height=0.5, width=0.1, interval=1.0, start=0.25)
    >>> pulses.torque(jnp.array([0.2, 0.3, 0.4, 1.3, 2.3])).tolist()
    [0.0, 0.5, 0.0, -0.5, 0.5]
    """

    short_name = "pulses"

    height: Torque
    width: PositiveTime = 0.1
    interval: Duration = 1.0
    start: ShortTime = 0.5

    def __check_init__(self) -> None:
        super().__check_init__()
        check_positive("TorquePulses", "s", zero=True, **{"interval minus width": self.interval - self.width})

    def torque(self, time: ArrayLike) -> Float[Array, "..."]:
        time, start = floating(time), jnp.asarray(self.start)
        elapsed = time - start
        rounding = 4 * jnp.finfo(time.dtype).eps * (jnp.abs(time) + start)
        index = jnp.floor((elapsed + rounding) / self.interval)  # starts in the control period at whose start it is due
        on = (index >= 0) & (elapsed - index * self.interval < self.width - rounding)
        return jnp.where(on, self.height * (1 - 2 * jnp.mod(index, 2.0)), 0.0)
