"""Creep of a muscle: what its rubber adds to the force after a change of length, and slowly gives up."""

from __future__ import annotations

import abc

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import floating
from mckibben.units import CreepTime, SpringRate

Relaxing = tuple[Array, ...]
"""What is on its way back to the law: the force [N] in each arm of the creep."""

_ARMS = range(1, 9)
_TIMES = (0.01, 1e7)  # s: what is quicker is viscous friction, what is slower is a spring
_DECADE = 10.0


class Creep(eqx.Module):
    """What creep adds to a muscle's law: a force [N], positive after the muscle was stretched.

    Its state is a value that goes in and comes out. `rate` is its derivative with respect to time, for an integrator;
    `settled` brings it within its bounds after each step.
    """

    @abc.abstractmethod
    def relaxed(self, length: ArrayLike) -> Relaxing:
        """The state of a muscle that has been at a length [m] for long."""

    @abc.abstractmethod
    def force(self, relaxing: Relaxing, tension: ArrayLike) -> Float[Array, "..."]:
        """The force [N] where the law has a tension [N]; none for an empty state."""

    @abc.abstractmethod
    def rate(self, relaxing: Relaxing, rate: ArrayLike) -> Relaxing:
        """The derivative [N/s] of the state while the length changes at a rate [m/s]."""

    @abc.abstractmethod
    def settled(self, relaxing: Relaxing, tension: ArrayLike) -> Relaxing:
        """The state after a step to where the law has a tension [N]; the force stays as it is."""

    @abc.abstractmethod
    def along(
        self,
        length: ArrayLike,
        tension: ArrayLike,
        *,
        moving: ArrayLike,
        resting: ArrayLike,
        read: ArrayLike,
    ) -> NDArray[np.float64]:
        """The force [N] at rest after each move of a way, in NumPy: for tests on a rig and their analysis.

        The way begins relaxed. Each move is even and goes one way, and so does the tension.

        Parameters
        ----------
        length
            Shape (points,): where the muscle is drawn to, one after the other [m].
        tension
            The law's tension [N] there, of that shape or one number.
        moving, resting
            The time [s] that each move takes, and that the muscle then stands; of that shape or one number.
        read
            Shape (readings,): the times [s] after each move at which to tell the force.

        Returns
        -------
        force
            Shape (points, readings).
        """


class NoCreep(Creep):
    """None: the force does not depend on time. It has no state and costs nothing."""

    def relaxed(self, length: ArrayLike) -> Relaxing:
        return ()

    def force(self, relaxing: Relaxing, tension: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def rate(self, relaxing: Relaxing, rate: ArrayLike) -> Relaxing:
        return relaxing

    def settled(self, relaxing: Relaxing, tension: ArrayLike) -> Relaxing:
        return relaxing

    def along(
        self,
        length: ArrayLike,
        tension: ArrayLike,
        *,
        moving: ArrayLike,
        resting: ArrayLike,
        read: ArrayLike,
    ) -> NDArray[np.float64]:
        return np.zeros((np.size(length), np.size(read)))


class MaxwellCreep(Creep):
    r"""Springs in series with dashpots, beside the law.

    .. math::

        \dot x_i = k_i \dot l - \frac{x_i}{\tau_i}, \qquad |x_i| \le \frac{T}{2n}, \qquad F = T + \sum_i x_i

    The state :math:`x_i` is the force in an arm. After a stretch the muscle pulls harder than its law, after a
    shortening less, and comes back to it with the time constant :math:`\tau_i`. A few arms with equal shares of the
    stiffness, each ten times slower than the one before, make it nearly logarithmic over as many decades of time.

    All arms together hold at most half of the law's tension :math:`T`: where that falls below, they slip, and what they
    stored is lost. So a slack muscle has none, the muscle never pushes, and energy is only lost, whatever length and
    pressure do. That bound is ours.

    It follows the length alone. What follows a step of the *pressure* at a constant length (a bladder that goes on
    bedding into its braid, and a force that goes on in the direction of the step) it does not know.

    Parameters
    ----------
    stiffness
        k [N/m] of all arms together: a quick stretch by 1 m would add so much.
    time_constant
        Of the first arm [s], the quickest.
    arms
        Springs with their dashpots, 1 to 8.

    References
    ----------
    W. N. Findley, J. S. Lai and K. Onaran, "Creep and Relaxation of Nonlinear Viscoelastic Materials", North-Holland
    1976, section 5.2 (Maxwell models in parallel); T. V. Minh, B. Kamers, H. Ramon and H. Van Brussel, "Modeling and
    control of a pneumatic artificial muscle manipulator joint - Part I: Modeling of a pneumatic artificial muscle
    manipulator joint with accounting for creep effect", Mechatronics 22 (2012) 923-933.

    Examples
    --------
    A stretch by 10 mm within 1 s; the force right after it, and 5 and 10 s later:

    >>> creep = MaxwellCreep(stiffness=500.0, time_constant=5.0)
    >>> creep.along([0.18, 0.19], tension=200.0, moving=1.0, resting=60.0, read=[0.0, 5.0, 10.0])[1].round(3)
    array([4.532, 1.667, 0.613])
    """

    stiffness: SpringRate
    time_constant: CreepTime
    arms: int = eqx.field(default=1, kw_only=True, static=True)

    def __check_init__(self) -> None:
        check_positive("MaxwellCreep", "N/m", stiffness=self.stiffness)
        check_within("MaxwellCreep", *_TIMES, "s", time_constant=self.time_constant)
        check_within("MaxwellCreep", _ARMS[0], _ARMS[-1], arms=self.arms)

    @property
    def time_constants(self) -> list[float]:
        """Of each arm [s]."""
        return [self.time_constant * _DECADE**arm for arm in range(self.arms)]

    def relaxed(self, length: ArrayLike) -> Relaxing:
        return (jnp.zeros_like(floating(length)),) * self.arms

    def force(self, relaxing: Relaxing, tension: ArrayLike) -> Float[Array, "..."]:
        total = jnp.zeros_like(floating(tension))
        for force in self.settled(relaxing, tension):
            total = total + force
        return total

    def rate(self, relaxing: Relaxing, rate: ArrayLike) -> Relaxing:
        stretching = self.stiffness / self.arms * jnp.asarray(rate)
        return tuple(stretching - x / tau for x, tau in zip(relaxing, self.time_constants, strict=True))

    def settled(self, relaxing: Relaxing, tension: ArrayLike) -> Relaxing:
        bound = jnp.asarray(tension) / (2 * self.arms)
        return tuple(jnp.clip(x, -bound, bound) for x in relaxing)

    def along(
        self,
        length: ArrayLike,
        tension: ArrayLike,
        *,
        moving: ArrayLike,
        resting: ArrayLike,
        read: ArrayLike,
    ) -> NDArray[np.float64]:
        length, tension, moving, resting = np.broadcast_arrays(
            *(np.asarray(column, np.float64) for column in (length, tension, moving, resting))
        )
        bound = tension / (2 * self.arms)
        share = float(self.stiffness) / self.arms
        readings = np.asarray(read, np.float64)
        force = np.zeros((len(length), len(readings)))
        for tau in map(float, self.time_constants):
            carried = np.exp(-(np.append(0.0, resting[:-1]) + moving) / tau)  # of what was there after the last move
            added = share * np.diff(length, prepend=length[:1]) * remaining(moving, tau)
            held = np.empty(len(length))
            now = 0.0
            for k, (part, more, most) in enumerate(zip(carried, added, bound, strict=True)):
                now = min(max(now * part + more, -most), most)
                held[k] = now
            force += held[:, None] * np.exp(-readings / tau)
        return force


def remaining(moving: ArrayLike, time_constant: ArrayLike) -> NDArray[np.float64]:
    """The part of an even move's stretch that an arm still holds at its end [-]; 1 for a sudden one.

    Parameters
    ----------
    moving
        The time [s] that the move takes.
    time_constant
        Of the arm [s].

    Examples
    --------
    >>> [round(float(part), 4) for part in (remaining(0.0, 5.0), remaining(5.0, 5.0))]  # 1 and 1 - exp(-1)
    [1.0, 0.6321]
    """
    ratio = np.asarray(moving, np.float64) / time_constant
    return np.where(ratio > 0, -np.expm1(-ratio) / np.where(ratio > 0, ratio, 1.0), 1.0)
