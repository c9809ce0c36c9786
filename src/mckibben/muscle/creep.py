"""Creep of a muscle: viscoelastic force after a change of length, relaxing to zero."""

from __future__ import annotations

import abc
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.component.base import Component
from mckibben.numerics.elementary import floating
from mckibben.units import BoundedInt, Quantity, SpringRate

CreepState = tuple[Array, ...]
"""Force [N] in each Maxwell arm."""

_DECADE = 10.0


class Creep(Component):
    """Creep force [N] added to a muscle's law, positive after stretching; its state is explicit."""

    default_class = "maxwell"

    @abc.abstractmethod
    def initial(self, length: ArrayLike) -> CreepState:
        """Return the relaxed state at a length [m]."""

    @abc.abstractmethod
    def force(self, state: CreepState, tension: ArrayLike) -> Float[Array, "..."]:
        """Return the force [N] at the law's tension [N]; zero for an empty state."""

    @abc.abstractmethod
    def rate(self, state: CreepState, rate: ArrayLike) -> CreepState:
        """Return the derivative [N/s] of the state at a rate of the length [m/s]."""

    @abc.abstractmethod
    def project(self, state: CreepState, tension: ArrayLike) -> CreepState:
        """Return the state within its bounds at the law's tension [N]; `force` is the same before and after."""

    @abc.abstractmethod
    def path_response(
        self,
        length: ArrayLike,
        tension: ArrayLike,
        *,
        move_time: ArrayLike,
        hold_time: ArrayLike,
        sample_times: ArrayLike,
    ) -> NDArray[np.float64]:
        """Return the force [N] after each move of a displacement path, in NumPy, for tests on a rig.

        The answer has shape (points, samples). The path starts relaxed; each move has a constant velocity, and the
        law's tension [N] changes monotonically over it.

        Parameters
        ----------
        length, tension, move_time, hold_time
            Lengths [m], shape (points,); tension at each, durations [s] of each move and the hold after it, or scalars.
        sample_times
            Shape (samples,): times [s] after each move.
        """


class NoCreep(Creep):
    """No creep: no state and no cost."""

    short_name = "none"

    def initial(self, length: ArrayLike) -> CreepState:
        return ()

    def force(self, state: CreepState, tension: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def rate(self, state: CreepState, rate: ArrayLike) -> CreepState:
        return state

    def project(self, state: CreepState, tension: ArrayLike) -> CreepState:
        return state

    def path_response(
        self,
        length: ArrayLike,
        tension: ArrayLike,
        *,
        move_time: ArrayLike,
        hold_time: ArrayLike,
        sample_times: ArrayLike,
    ) -> NDArray[np.float64]:
        return np.zeros((np.size(length), np.size(sample_times)))


CreepTime = Annotated[float, Quantity("s", "s", 0.01, 1e6)]
Arms = Annotated[int, BoundedInt(1, 8)]


class MaxwellCreep(Creep):
    r"""Maxwell arms (a spring in series with a dashpot) in parallel with the force law.

    .. math::

        \dot x_i = k_i \dot l - \frac{x_i}{\tau_i}, \qquad |x_i| \le \frac{T}{2n}, \qquad F = T + \sum_i x_i

    The state :math:`x_i` is the force in an arm. After stretching, the muscle pulls harder than its law; after
    shortening, less; it returns to the law with the time constants :math:`\tau_i`. Arms of equal stiffness, each ten
    times slower than the previous one, give nearly logarithmic creep, one decade of time per arm.

    Together the arms carry at most half of the law's tension :math:`T`; beyond that they slip and lose stored energy.
    The muscle therefore never pushes, and the model is dissipative for any path of length and pressure. The bound is
    ours. Creep after a step of the *pressure* at a constant length is not modelled.

    Parameters
    ----------
    stiffness
        k [N/m] of all arms together.
    time_constant
        Time constant [s] of the first, quickest arm.
    arms
        Number of Maxwell arms, 1 to 8.

    References
    ----------
    W. N. Findley, J. S. Lai and K. Onaran, "Creep and Relaxation of Nonlinear Viscoelastic Materials", North-Holland
    1976, section 5.2 (Maxwell models in parallel); T. V. Minh, B. Kamers, H. Ramon and H. Van Brussel, "Modeling and
    control of a pneumatic artificial muscle manipulator joint - Part I", Mechatronics 22 (2012) 923-933.

    Examples
    --------
    Stretched by 10 mm within 1 s; the force at its end, and 5 and 10 s later:

    >>> creep = MaxwellCreep(stiffness=500.0, time_constant=5.0)
    >>> path = {"length": [0.18, 0.19], "move_time": 1.0, "hold_time": 60.0}
    >>> creep.path_response(**path, tension=200.0, sample_times=[0.0, 5.0, 10.0])[1].round(3)
    array([4.532, 1.667, 0.613])
    """

    short_name = "maxwell"

    stiffness: SpringRate
    time_constant: CreepTime
    arms: Arms = eqx.field(default=1, kw_only=True, static=True)

    @property
    def time_constants(self) -> list[float]:
        """Time constant [s] of each arm."""
        return [self.time_constant * _DECADE**arm for arm in range(self.arms)]

    def initial(self, length: ArrayLike) -> CreepState:
        return (jnp.zeros_like(floating(length)),) * self.arms

    def force(self, state: CreepState, tension: ArrayLike) -> Float[Array, "..."]:
        return sum(self.project(state, tension), jnp.zeros_like(floating(tension)))

    def rate(self, state: CreepState, rate: ArrayLike) -> CreepState:
        stretching = self.stiffness / self.arms * jnp.asarray(rate)
        return tuple(stretching - x / tau for x, tau in zip(state, self.time_constants, strict=True))

    def project(self, state: CreepState, tension: ArrayLike) -> CreepState:
        bound = jnp.asarray(tension) / (2 * self.arms)
        return tuple(jnp.clip(x, -bound, bound) for x in state)

    def path_response(
        self,
        length: ArrayLike,
        tension: ArrayLike,
        *,
        move_time: ArrayLike,
        hold_time: ArrayLike,
        sample_times: ArrayLike,
    ) -> NDArray[np.float64]:
        length, tension, move_time, hold_time = np.broadcast_arrays(
            *(np.asarray(column, np.float64) for column in (length, tension, move_time, hold_time))
        )
        bounds = tension / (2 * self.arms)
        stretch = float(self.stiffness) / self.arms * np.diff(length, prepend=length[:1])
        sample_times = np.asarray(sample_times, np.float64)
        force = np.zeros((len(length), len(sample_times)))
        for tau in map(float, self.time_constants):
            decay = np.exp(-(np.append(0.0, hold_time[:-1]) + move_time) / tau)  # since the end of the last move
            added = stretch * retained_fraction(move_time, tau)
            at_end, x = np.empty(len(length)), 0.0
            for k, (factor, more, bound) in enumerate(zip(decay, added, bounds, strict=True)):
                at_end[k] = x = min(max(x * factor + more, -bound), bound)
            force += at_end[:, None] * np.exp(-sample_times / tau)
        return force


def retained_fraction(move_time: ArrayLike, time_constant: ArrayLike) -> NDArray[np.float64]:
    """Return the fraction [-] of a stretch, applied over a time [s], that a Maxwell arm retains at its end."""
    ratio = np.asarray(move_time, np.float64) / time_constant
    return np.where(ratio > 0, -np.expm1(-ratio) / np.where(ratio > 0, ratio, 1.0), 1.0)
