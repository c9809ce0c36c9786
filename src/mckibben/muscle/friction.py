"""Friction between the threads of a muscle: rate-independent hysteresis with presliding, and a viscous part."""

from __future__ import annotations

import abc
from types import ModuleType
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.numerics.checks import check_positive, check_within
from mckibben.numerics.elementary import floating
from mckibben.units import FrictionForce, FrictionGrowth, Presliding, Pressure, Viscosity

Memory = tuple[Array, ...]
"""What friction remembers of the way: the length [m] at which each of its elements is unstressed."""

NARROWEST = 1e-6
"""The narrowest band [N] that is one; whoever wants less takes `NoFriction`."""

_ELEMENTS = range(1, 17)
_LEAST = 1e-9  # N: where the band shrinks with pressure it is never narrower, so that nothing is divided by 0
_LONGEST = 1.0  # m: a longer presliding is one in millimetres
_KNOT = 0.7  # places the knots of the polygon where its largest distance from the exponential is least


class Friction(eqx.Module):
    """What a muscle's friction adds to its law: a force [N], positive while the muscle is being stretched.

    Its memory is a value that goes in and comes out. Within a short move the memory is held, and the force is a
    function of the length alone; `settled` brings the memory up to date after it. So there is no sign of a velocity
    anywhere, nothing chatters, and what is at rest sticks.
    """

    @abc.abstractmethod
    def unstressed(self, length: ArrayLike) -> Memory:
        """The memory of a muscle that has come to a length [m] without friction."""

    @abc.abstractmethod
    def force(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """The force [N] at a length [m], where the law has a tension [N], at a gauge pressure [Pa]."""

    @abc.abstractmethod
    def settled(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> Memory:
        """The memory after a move to there; arguments as for `force`, which it leaves as it is."""

    @abc.abstractmethod
    def viscous_force(self, tension: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        """The force [N] that depends on the rate of the length [m/s]."""

    @abc.abstractmethod
    def half_width_at(self, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """What the force is at most [N], either way, at rest where the law has a tension [N], at a pressure [Pa]."""

    @abc.abstractmethod
    def along(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, *, side: float = 0.0
    ) -> NDArray[np.float64]:
        """The force [N] at rest at each point of a way, in NumPy: for tests on a rig and their analysis.

        Between two points the length shall go one way; whether it does so in one move or in several is then the same.

        Parameters
        ----------
        length
            Shape (points,): where the muscle is drawn to, one after the other [m].
        tension, pressure
            The law's tension [N] and the gauge pressure [Pa] there, of that shape or one number.
        side
            How the first point was reached: 1 by stretching, -1 by shortening, each from far, 0 without stress.
        """


class NoFriction(Friction):
    """None: the muscle is its law. It remembers nothing and costs nothing."""

    def unstressed(self, length: ArrayLike) -> Memory:
        return ()

    def force(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def settled(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> Memory:
        return memory

    def viscous_force(self, tension: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def half_width_at(self, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def along(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, *, side: float = 0.0
    ) -> NDArray[np.float64]:
        return np.zeros(np.shape(length))


class MaxwellSlip(Friction):
    r"""Springs in parallel, each with a slider that gives way at a force of its own.

    .. math::

        f = \sum_i \mathrm{clip}\big(k_i (l - a_i),\ \pm w_i A\big), \qquad a_i \leftarrow l - f_i/k_i,
        \qquad A = B \tanh\frac{T}{2B}, \quad B = B_0 + B_1 (p - p_0)

    An element remembers its anchor :math:`a_i`, the length at which it is unstressed. The band's half width
    :math:`A` fades with the law's tension :math:`T`: it is at most T/2, so the muscle never pushes, and 96 % of B are
    there at T = 4B. The stiffnesses :math:`k_i` do not change; where the band narrows, a slider gives way and stored
    energy is lost, where it widens none is gained. So energy is only lost, whatever length and pressure do.

    The elements follow from one number: together they are the polygon with so many knots that is nearest to
    :math:`f = B(1 - e^{-2s/s_0})`, what a muscle at rest without stress answers to a way s (within 1.1 % of B with six
    elements). After a reversal from one side of the band, 63 % of the change to the other are done after :math:`s_0`,
    86 % after twice that.

    The viscous part, :math:`(T/2) \tanh(2 c \dot l / T)`, is :math:`c \dot l` for a taut muscle and fades in the same
    way.

    Parameters
    ----------
    half_width
        B0 [N] at the reference pressure: half the distance between loading (above) and unloading (below).
    presliding_length
        s0 [m].
    growth
        B1 [N/Pa]; the half width is never taken below 0.
    reference_pressure
        p0 [Pa, gauge].
    viscous
        c [N*s/m].
    elements
        Springs, 1 to 16.

    References
    ----------
    D. D. Rizos and S. D. Fassois, "Presliding friction identification based upon the Maxwell Slip model structure",
    Chaos 14 (2004) 431-445; T. Vo-Minh et al., "A new approach to modeling hysteresis in a pneumatic artificial
    muscle using the Maxwell-slip model", IEEE/ASME Trans. Mechatronics 16 (2011) 177-186. That the band fades with
    the tension is ours.

    Examples
    --------
    Stretched far, let go by 1 mm, and far again:

    >>> friction = MaxwellSlip(half_width=12.0, presliding_length=0.5e-3)
    >>> friction.along([0.1, 0.11, 0.109, 0.10], tension=300.0, pressure=3e5).round(2)
    array([  0.  ,  12.  ,  -8.57, -12.  ])
    """

    half_width: FrictionForce
    presliding_length: Presliding
    growth: FrictionGrowth = eqx.field(default=0.0, kw_only=True)
    reference_pressure: Pressure = eqx.field(default=0.0, kw_only=True)
    viscous: Viscosity = eqx.field(default=0.0, kw_only=True)
    elements: int = eqx.field(default=6, kw_only=True, static=True)

    def __check_init__(self) -> None:
        check_within("MaxwellSlip", NARROWEST, 1e9, "N", half_width=self.half_width)
        check_positive("MaxwellSlip", "m", presliding_length=self.presliding_length)
        check_within("MaxwellSlip", 0.0, _LONGEST, "m", presliding_length=self.presliding_length)
        check_positive("MaxwellSlip", "N*s/m", zero=True, viscous=self.viscous)
        check_within("MaxwellSlip", -1.0, 1.0, "N/Pa", growth=self.growth)
        check_within("MaxwellSlip", -1e9, 1e9, "Pa", reference_pressure=self.reference_pressure)
        check_within("MaxwellSlip", _ELEMENTS[0], _ELEMENTS[-1], elements=self.elements)

    def half_width_at(self, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return faded(self._width(jnp.asarray(pressure)), jnp.asarray(tension), jnp)

    def unstressed(self, length: ArrayLike) -> Memory:
        return (floating(length),) * self.elements

    def force(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        forces = self._forces(memory, length, tension, pressure)
        total = forces[0]
        for force in forces[1:]:
            total = total + force
        return total

    def settled(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> Memory:
        forces = self._forces(memory, length, tension, pressure)
        yielding = self.presliding_length / self.half_width
        return tuple(
            jnp.asarray(length) - force * (yielding / stiffness)
            for force, stiffness in zip(forces, polygon(self.elements).stiffness.tolist(), strict=True)
        )

    def viscous_force(self, tension: ArrayLike, rate: ArrayLike) -> Float[Array, "..."]:
        half = jnp.asarray(tension) / 2
        taut = half > _LEAST
        return jnp.where(taut, half * jnp.tanh(self.viscous * rate / jnp.where(taut, half, 1.0)), 0.0)

    def along(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, *, side: float = 0.0
    ) -> NDArray[np.float64]:
        length, tension, pressure = np.broadcast_arrays(
            *(np.asarray(column, np.float64) for column in (length, tension, pressure))
        )
        limit = faded(self._width(pressure), tension, np)
        travel = np.diff(length, prepend=length[:1])
        deflections = drawn(travel, limit, self.stiffnesses, self.shares, side=side)
        return deflections @ self.stiffnesses

    @property
    def shares(self) -> NDArray[np.float64]:
        """Share w of each element [-], their sum being 1; shape (elements,)."""
        return polygon(self.elements).share

    @property
    def stiffnesses(self) -> NDArray[np.float64]:
        """Stiffness k of each element [N/m]; shape (elements,)."""
        return polygon(self.elements).stiffness * (float(self.half_width) / float(self.presliding_length))

    def _width(self, pressure: Any) -> Any:
        return self.half_width + self.growth * (pressure - self.reference_pressure)

    def _forces(self, memory: Memory, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> list[Array]:
        """Of each element [N]."""
        limit, steepness = self.half_width_at(tension, pressure), self.half_width / self.presliding_length
        share, stiffness = (column.tolist() for column in polygon(self.elements))
        return [
            jnp.clip(k * steepness * (jnp.asarray(length) - anchor), -w * limit, w * limit)
            for w, k, anchor in zip(share, stiffness, memory, strict=True)
        ]


def drawn(
    travel: NDArray[np.float64],
    limit: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    share: NDArray[np.float64],
    *,
    side: float | NDArray[np.float64] = 0.0,
) -> NDArray[np.float64]:
    """The deflections of the elements of a `MaxwellSlip`, for many ways and many of its numbers at once.

    Parameters
    ----------
    travel
        Shape (points, ...): the signed moves [m], positive = stretching; the first is not looked at.
    limit
        Shape (points, ...): the band's half width A [N] after each.
    stiffness, share
        Shape (..., elements): k [N/m] and w [-].
    side
        Of the band on which each way begins, -1 to 1; shape (...).

    Returns
    -------
    deflections
        Shape (points, ..., elements) [m]: k times these are the forces.
    """
    reach = limit[..., None] * (share / stiffness)
    deflections = np.empty_like(reach)
    now = reach[0] * np.asarray(side)[..., None]
    deflections[0] = now
    for k in range(1, len(reach)):
        now = np.minimum(np.maximum(now + travel[k][..., None], -reach[k]), reach[k])
        deflections[k] = now
    return deflections


def faded(width: Any, tension: Any, xp: ModuleType) -> Any:
    """The band's half width A [N] of a B [N] at a tension [N], in NumPy or `jax.numpy`; none for a B below 0."""
    width = xp.maximum(width, _LEAST)
    return width * xp.tanh(tension / (2 * width))


class Polygon(NamedTuple):
    """Elements whose sum is a polygon: shares w of the force, and stiffnesses k for a half width and an s0 of 1."""

    share: NDArray[np.float64]
    stiffness: NDArray[np.float64]


def polygon(elements: int) -> Polygon:
    """The polygon next to 1 - exp(-2 s); its knots are dense where the exponential bends, and the last is at 1."""
    at = -np.log(1 - np.arange(1, elements + 1) / (elements + _KNOT))
    height = 1 - np.exp(-2 * at)
    height[-1] = 1.0
    slope = np.diff(height, prepend=0.0) / np.diff(at, prepend=0.0)
    stiffness = slope - np.append(slope[1:], 0.0)
    return Polygon(stiffness * at, stiffness)
