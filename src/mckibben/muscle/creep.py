"""Creep of a muscle: viscoelastic force after a change of length or pressure, relaxing to zero."""

from __future__ import annotations

import abc
from collections.abc import Callable
from numbers import Real
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.numerics.elementary import floating
from mckibben.units import BoundedInt, Percent, Quantity

CreepState = tuple[Array, ...]
"""Force [N] in each Maxwell arm, then the delayed pressure [Pa] of each, if the creep follows the pressure."""

TensionAt = Callable[[ArrayLike], Array]
"""Tension [N] of the law at the present length, as a function of the gauge pressure [Pa]."""


class Creep(Component):
    """Creep force [N] added to a muscle's law, positive after stretching; its state is explicit."""

    default_class = "maxwell"

    @property
    def state_units(self) -> tuple[str, ...]:
        """SI unit of each number of the state; by default N."""
        return ("N",) * len(self.initial(0.0, 0.0))

    @abc.abstractmethod
    def initial(self, length: ArrayLike, pressure: ArrayLike) -> CreepState:
        """Return the relaxed state at a length [m] and a gauge pressure [Pa]."""

    @abc.abstractmethod
    def force(self, state: CreepState, tension: ArrayLike, tension_at: TensionAt) -> Float[Array, "..."]:
        """Return the force [N] at the law's tension [N], known for any pressure; zero for an empty state."""

    @abc.abstractmethod
    def rate(self, state: CreepState, rate: ArrayLike, pressure: ArrayLike) -> CreepState:
        """Return the time derivative of the state at a rate of the length [m/s] and a gauge pressure [Pa]."""

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

        The answer has shape (points, samples). The pressure is constant. The path starts relaxed; each move has a
        constant velocity, and the law's tension [N] changes monotonically over it.

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

    def initial(self, length: ArrayLike, pressure: ArrayLike) -> CreepState:
        return ()

    def force(self, state: CreepState, tension: ArrayLike, tension_at: TensionAt) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def rate(self, state: CreepState, rate: ArrayLike, pressure: ArrayLike) -> CreepState:
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


ArmStiffness = Annotated[float, Quantity("N/m", "N/mm", 0, 1e6)]
CreepTime = Annotated[float, Quantity("s", "s", 0.01, 1e6)]
PressureShare = Annotated[float, Percent("1", "%", -50, 50)]
Arms = Annotated[int, BoundedInt(1, 8)]


class MaxwellCreep(Creep):
    r"""Maxwell arms (a spring in series with a dashpot) in parallel with the force law.

    .. math::

        \dot x_i &= k_i \dot l - \frac{x_i}{\tau_i}, \qquad |x_i| \le \frac{T}{2n} \\
        \dot y_i &= \frac{p - y_i}{\tau_i'} \\
        F &= T(l, p) + \sum_i \left(x_i + \frac{\varphi}{n} \big(T(l, y_i) - T(l, p)\big)\right)

    The state :math:`x_i` is the force in an arm; arms of equal stiffness, each ten times slower than the previous one,
    give nearly logarithmic creep. With a `pressure_share` :math:`\varphi`, this share of the law follows the delayed
    pressures :math:`y_i`. Together the arms carry at most half of the law's tension :math:`T` (so does each sum over
    :math:`i` above); beyond that they slip: the muscle never pushes, and is dissipative at constant pressure. The bound
    and the delayed pressure are ours (docs/hysteresis.md).

    Parameters
    ----------
    stiffness
        k [N/m] of all arms together; 0 only with a `pressure_share`.
    time_constant
        Time constant [s] of the first, quickest arm.
    arms
        Number of Maxwell arms, 1 to 8.
    pressure_share
        Share phi [-] of the law that follows the pressure with a delay; None: no creep after changes of the pressure.
    pressure_time_constant
        Time constant [s] of the quickest delayed pressure; None: `time_constant`.

    References
    ----------
    W. N. Findley, J. S. Lai and K. Onaran, "Creep and Relaxation of Nonlinear Viscoelastic Materials", North-Holland
    1976, section 5.2 (Maxwell models in parallel); T. V. Minh, B. Kamers, H. Ramon and H. Van Brussel, Mechatronics 22
    (2012) 923-933 (creep after steps of the pressure).

    Examples
    --------
    Stretched by 10 mm within 1 s; the force at its end, and 5 and 10 s later:

    >>> creep = MaxwellCreep(stiffness=500.0, time_constant=5.0)
    >>> path = {"length": [0.18, 0.19], "move_time": 1.0, "hold_time": 60.0}
    >>> creep.path_response(**path, tension=200.0, sample_times=[0.0, 5.0, 10.0])[1].round(3)
    array([4.532, 1.667, 0.613])

    The pressure was raised from 2 to 4 bar, at 100 N/bar; 10 % of the 200 N are missing at first:

    >>> creep = MaxwellCreep(stiffness=500.0, time_constant=5.0, pressure_share=0.1)
    >>> relaxed = creep.initial(0.18, 2e5)
    >>> round(float(creep.force(relaxed, 400.0, lambda pressure: 1e-3 * pressure)), 6)
    -20.0
    """

    short_name = "maxwell"

    stiffness: ArmStiffness
    time_constant: CreepTime
    arms: Arms = eqx.field(default=1, kw_only=True, static=True)
    pressure_share: PressureShare | None = eqx.field(default=None, kw_only=True)
    pressure_time_constant: CreepTime | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        if self.pressure_share is not None:
            return
        if isinstance(self.stiffness, Real) and not self.stiffness > 0:
            raise RangeError(
                "MaxwellCreep: the stiffness is 0",
                field="stiffness",
                value=float(self.stiffness),
                lower=0.0,
                unit="N/m",
                remedy="give a stiffness, a pressure_share, or no creep",
            )
        if self.pressure_time_constant is not None:
            message = "MaxwellCreep: a pressure_time_constant without a pressure_share"
            raise RangeError(message, field="pressure_time_constant", remedy="give both")

    @property
    def time_constants(self) -> list[float]:
        """Time constant [s] of each arm."""
        return [self.time_constant * 10.0**arm for arm in range(self.arms)]

    @property
    def pressure_time_constants(self) -> list[float]:
        """Time constant [s] of each delayed pressure; empty without a `pressure_share`."""
        if self.pressure_share is None:
            return []
        first = self.time_constant if self.pressure_time_constant is None else self.pressure_time_constant
        return [first * 10.0**arm for arm in range(self.arms)]

    @property
    def state_units(self) -> tuple[str, ...]:
        return ("N",) * self.arms + ("Pa",) * len(self.pressure_time_constants)

    def initial(self, length: ArrayLike, pressure: ArrayLike) -> CreepState:
        relaxed = (jnp.zeros_like(floating(length)),) * self.arms
        return relaxed + (floating(pressure),) * len(self.pressure_time_constants)

    def force(self, state: CreepState, tension: ArrayLike, tension_at: TensionAt) -> Float[Array, "..."]:
        arms = self.project(state, tension)[: self.arms]
        if self.pressure_share is not None:
            bound, share = jnp.asarray(tension) / (2 * self.arms), self.pressure_share / self.arms
            delayed = (share * (tension_at(pressure) - tension) for pressure in state[self.arms :])
            arms = tuple(jnp.clip(x + more, -bound, bound) for x, more in zip(arms, delayed, strict=True))
        return sum(arms, jnp.zeros_like(floating(tension)))

    def rate(self, state: CreepState, rate: ArrayLike, pressure: ArrayLike) -> CreepState:
        stretching = self.stiffness / self.arms * jnp.asarray(rate)
        arms = tuple(stretching - x / tau for x, tau in zip(state[: self.arms], self.time_constants, strict=True))
        delayed = zip(state[self.arms :], self.pressure_time_constants, strict=True)
        return arms + tuple((jnp.asarray(pressure) - y) / tau for y, tau in delayed)

    def project(self, state: CreepState, tension: ArrayLike) -> CreepState:
        bound = jnp.asarray(tension) / (2 * self.arms)
        return tuple(jnp.clip(x, -bound, bound) for x in state[: self.arms]) + tuple(state[self.arms :])

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
