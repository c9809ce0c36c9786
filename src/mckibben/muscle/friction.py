"""Friction between the threads of a muscle: rate-independent hysteresis with presliding, and a viscous part."""

from __future__ import annotations

import abc
from numbers import Real
from types import ModuleType
from typing import Annotated, Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float
from numpy.typing import NDArray

from mckibben.component.base import Component
from mckibben.numerics.batching import fusion_barrier
from mckibben.numerics.elementary import floating
from mckibben.units import BoundedInt, Force, Length, Pressure, Quantity, Speed

FrictionState = tuple[Array, ...]
"""Anchor of each element: the length [m] at which it is unstressed."""

MIN_HALF_WIDTH = 1e-6
"""Smallest half width [N] of a hysteresis band; below, use `NoFriction`."""

_LEAST = 1e-9  # N: lower bound of a half width that shrinks with pressure, to avoid a division by 0
_KNOT = 0.7  # knot spacing that minimises the largest distance between polygon and exponential
Elements = Annotated[int, BoundedInt(1, 16)]
"""Number of springs with a slider in parallel."""


class Friction(Component):
    """Friction force [N] added to a muscle's law, positive while the muscle is stretched.

    The state is explicit. Over a short move the force is a function of the length alone; `project` then updates the
    state. The sign of the velocity does not appear, so the force does not chatter and a muscle at rest sticks.
    """

    default_class = "maxwell_slip"

    @abc.abstractmethod
    def initial(self, length: ArrayLike) -> FrictionState:
        """Return the unstressed state at a length [m]."""

    @abc.abstractmethod
    def force(
        self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike
    ) -> Float[Array, "..."]:
        """Return the force [N] at a length [m], the law's tension [N] and a gauge pressure [Pa]."""

    @abc.abstractmethod
    def project(
        self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike
    ) -> FrictionState:
        """Return the state after a move; `force` is the same before and after."""

    @abc.abstractmethod
    def viscous_force(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, rate: ArrayLike
    ) -> Float[Array, "..."]:
        """Return the force [N] that follows from a rate of the length [m/s], as `force` without a state."""

    @property
    def follows_rate(self) -> bool:
        """Whether `viscous_force` is not zero; default: False."""
        return False

    @abc.abstractmethod
    def half_width_at(self, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        """Return half the width [N] of the hysteresis band at the law's tension [N] and a gauge pressure [Pa]."""

    @abc.abstractmethod
    def path_response(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, *, side: float = 0.0
    ) -> NDArray[np.float64]:
        """Return the static force [N] at each point of a displacement path, in NumPy, for tests on a rig.

        The length is monotonic between two points.

        Parameters
        ----------
        length, tension, pressure
            Lengths [m] in order, shape (points,); the law's tension [N] and the gauge pressure [Pa] at each, or
            scalars.
        side
            Side of the band at the first point: 1 after stretching, -1 after shortening, 0 unstressed.
        """


class NoFriction(Friction):
    """No friction: no state and no cost."""

    short_name = "none"

    def initial(self, length: ArrayLike) -> FrictionState:
        return ()

    def force(
        self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike
    ) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def project(
        self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike
    ) -> FrictionState:
        return state

    def viscous_force(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, rate: ArrayLike
    ) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def half_width_at(self, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        return jnp.zeros_like(floating(tension))

    def path_response(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, *, side: float = 0.0
    ) -> NDArray[np.float64]:
        return np.zeros(np.shape(length))


FrictionForce = Annotated[float, Quantity("N", "N", MIN_HALF_WIDTH, 1e6)]
FrictionGrowth = Annotated[float, Quantity("N/Pa", "N/bar", -1e4, 1e4)]
TensionGrowth = Annotated[float, Quantity("1", "1", -1, 1)]
Presliding = Annotated[float, Quantity("m", "mm", 0, 100, open_lower=True)]
Viscosity = Annotated[float, Quantity("N*s/m", "N*s/m", 0, 1e6)]
ViscousGrowth = Annotated[float, Quantity("N*s/m/Pa", "N*s/m/bar", -1e6, 1e6)]
ViscousLengthGrowth = Annotated[float, Quantity("N*s/m/m", "N*s/m/mm", -1e6, 1e6)]
RateGrowth = Annotated[float, Quantity("1", "1", 0, 100)]


class MaxwellSlip(Friction):
    r"""Springs in parallel, each with a slider that yields at its own force.

    .. math::

        f = \sum_i \mathrm{clip}\big(k_i (l - a_i),\ \pm w_i A\big), \qquad a_i \leftarrow l - f_i/k_i,
        \qquad A = B \tanh\frac{T}{B}, \quad B = B_0 + B_1 (p - p_0) + B_2 (T - T_0)

    The state of an element is its anchor :math:`a_i`, the length at which it is unstressed. The half width :math:`A` of
    the band is below the law's tension :math:`T`, so the muscle never pushes; the model is dissipative for any path of
    length and pressure. The parameters of the elements follow from their number: their sum is the polygon
    nearest to :math:`f = B(1 - e^{-2s/s_0})`, the response of an unstressed muscle to a displacement s (within 1.1 % of
    B with six). The part that follows the rate of the length, without presliding, is

    .. math::

        v = c\,(\dot l + a\,|\dot l|) + w A \tanh(\dot l/v_0), \qquad c = c_0 + c_1 (p - p_0) + c_2 (l - l_r) \ge 0,
        \qquad |v| \le T - A,

    where the bound is that the muscle never pushes: it acts only where the band and v together reach the tension.

    Properties and identification: docs/hysteresis.md.

    Parameters
    ----------
    half_width
        B0 [N] at the reference pressure and tension: half the distance between loading (above) and unloading (below).
    presliding_length
        s0 [m].
    growth, reference_pressure
        B1 [N/Pa], and p0 [Pa, gauge]; the half width is bounded below by 0.
    tension_growth, reference_tension
        B2 [-], and T0 [N]; None: independent of the tension.
    viscous
        c0 [N*s/m] at the reference pressure and length.
    viscous_growth, viscous_length_growth, reference_length
        c1 [N*s/(m*Pa)] and c2 [N*s/m^2], None: no dependence; and l_r [m].
    viscous_asymmetry
        a [-]: the damping is c (1 + a) while the muscle lengthens, c (1 - a) while it shortens; None: the same.
    rate_growth, rate_speed
        w [-], at least 0, and v0 [m/s]; None: the half width does not depend on the rate.
    elements
        Springs, 1 to 16.

    References
    ----------
    D. D. Rizos and S. D. Fassois, "Presliding friction identification based upon the Maxwell Slip model structure",
    Chaos 14 (2004) 431-445; T. Vo-Minh et al., "A new approach to modeling hysteresis in a pneumatic artificial
    muscle using the Maxwell-slip model", IEEE/ASME Trans. Mechatronics 16 (2011) 177-186; D. B. Reynolds et al., Annals
    of Biomedical Engineering 31 (2003) 310-317 (damping linear in the pressure); B. Tondu and S. D. Zagal, BioRob 2006,
    714-720 (growth with the rate, there with an exponential). The dependences on tension and length are ours.

    Examples
    --------
    Stretched by 10 mm, shortened by 1 mm, then by 9 mm:

    >>> friction = MaxwellSlip(half_width=12.0, presliding_length=0.5e-3)
    >>> friction.path_response([0.1, 0.11, 0.109, 0.10], tension=300.0, pressure=3e5).round(2)
    array([  0.  ,  12.  ,  -8.57, -12.  ])

    Friction that is 25 % larger in fast motion, at a speed far above 5 mm/s:

    >>> fast = MaxwellSlip(half_width=12.0, presliding_length=0.5e-3, rate_growth=0.25, rate_speed=5e-3)
    >>> round(float(fast.viscous_force(0.1, 300.0, 3e5, 0.05)), 3)
    3.0
    """

    short_name = "maxwell_slip"
    together: ClassVar = (("viscous_length_growth", "reference_length"), ("rate_growth", "rate_speed"))

    half_width: FrictionForce
    presliding_length: Presliding
    growth: FrictionGrowth = eqx.field(default=0.0, kw_only=True)
    reference_pressure: Pressure = eqx.field(default=0.0, kw_only=True)
    tension_growth: TensionGrowth | None = eqx.field(default=None, kw_only=True)
    reference_tension: Force = eqx.field(default=0.0, kw_only=True)
    viscous: Viscosity = eqx.field(default=0.0, kw_only=True)
    viscous_growth: ViscousGrowth | None = eqx.field(default=None, kw_only=True)
    viscous_length_growth: ViscousLengthGrowth | None = eqx.field(default=None, kw_only=True)
    reference_length: Length | None = eqx.field(default=None, kw_only=True)
    viscous_asymmetry: TensionGrowth | None = eqx.field(default=None, kw_only=True)
    rate_growth: RateGrowth | None = eqx.field(default=None, kw_only=True)
    rate_speed: Speed | None = eqx.field(default=None, kw_only=True)
    elements: Elements = eqx.field(default=6, kw_only=True, static=True)

    def half_width_at(self, tension: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        tension, pressure = jnp.asarray(tension), jnp.asarray(pressure)
        if self.tension_growth is None:
            return smooth_limit(self._width(tension, pressure), tension, jnp)
        # The tension is used twice: XLA would evaluate the law once per use, and again in derivatives.
        return fusion_barrier(lambda: smooth_limit(self._width(tension, pressure), tension, jnp))

    def initial(self, length: ArrayLike) -> FrictionState:
        return (floating(length),) * self.elements

    def force(
        self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike
    ) -> Float[Array, "..."]:
        forces = self._forces(state, length, tension, pressure)
        total = forces[0]
        for force in forces[1:]:
            total = total + force
        return total

    def project(
        self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike
    ) -> FrictionState:
        forces = self._forces(state, length, tension, pressure)
        return anchors(forces, length, self.presliding_length / self.half_width)

    def viscous_force(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, rate: ArrayLike
    ) -> Float[Array, "..."]:
        rate, half_width = jnp.asarray(rate), self.half_width_at(tension, pressure)
        directed = rate if self.viscous_asymmetry is None else rate + self.viscous_asymmetry * jnp.abs(rate)
        force = self._damping(jnp.asarray(length), jnp.asarray(pressure), jnp) * directed
        if self.rate_growth is not None and self.rate_speed is not None:
            force = force + self.rate_growth * half_width * jnp.tanh(rate / self.rate_speed)
        limit = jnp.maximum(jnp.asarray(tension) - half_width, 0.0)
        return jnp.clip(force, -limit, limit)

    @property
    def follows_rate(self) -> bool:
        if isinstance(self.viscous, Real) and self.viscous == 0:
            coefficients = (self.viscous_growth, self.viscous_length_growth, self.rate_growth)
            return any(coefficient is not None for coefficient in coefficients)
        return True

    def steepest_damping(self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> NDArray[np.float64]:
        """Return the largest slope [N*s/m] of `viscous_force` over the rate, in NumPy."""
        length, tension, pressure = (np.asarray(column, np.float64) for column in (length, tension, pressure))
        damping = self._damping(length, pressure, np) * (1 + abs(self.viscous_asymmetry or 0.0))
        if self.rate_growth is not None:
            damping = damping + self.rate_growth * self._width(tension, pressure) / self.rate_speed
        return np.asarray(damping, np.float64)

    def path_response(
        self, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike, *, side: float = 0.0
    ) -> NDArray[np.float64]:
        length, tension, pressure = np.broadcast_arrays(
            *(np.asarray(column, np.float64) for column in (length, tension, pressure))
        )
        limit = smooth_limit(self._width(tension, pressure), tension, np)
        travel = np.diff(length, prepend=length[:1])
        deflections = play_response(travel, limit, self.stiffnesses, self.shares, side=side)
        return deflections @ self.stiffnesses

    @property
    def shares(self) -> NDArray[np.float64]:
        """Share w [-] of each element; they sum to 1; shape (elements,)."""
        return polygon(self.elements).share

    @property
    def stiffnesses(self) -> NDArray[np.float64]:
        """Stiffness k of each element [N/m]; shape (elements,)."""
        return polygon(self.elements).stiffness * (float(self.half_width) / float(self.presliding_length))

    def _damping(self, length: Any, pressure: Any, xp: ModuleType) -> Any:
        """Damping c [N*s/m], in NumPy or `jax.numpy`."""
        damping = self.viscous
        if self.viscous_growth is None and self.viscous_length_growth is None:
            return damping
        if self.viscous_growth is not None:
            damping = damping + self.viscous_growth * (pressure - self.reference_pressure)
        if self.viscous_length_growth is not None:
            damping = damping + self.viscous_length_growth * (length - self.reference_length)
        return xp.maximum(damping, 0.0)

    def _width(self, tension: Any, pressure: Any) -> Any:
        width = self.half_width + self.growth * (pressure - self.reference_pressure)
        if self.tension_growth is None:
            return width
        return width + self.tension_growth * (tension - self.reference_tension)

    def _forces(self, state: FrictionState, length: ArrayLike, tension: ArrayLike, pressure: ArrayLike) -> list[Array]:
        """Force [N] of each element."""
        return slip_forces(
            state, length, self.half_width_at(tension, pressure), self.half_width / self.presliding_length
        )


def slip_forces(state: FrictionState, position: ArrayLike, limit: ArrayLike, steepness: ArrayLike) -> list[Array]:
    """Return the force of each element, within its share of a limit; the steepness is half width over presliding."""
    share, stiffness = (column.tolist() for column in polygon(len(state)))
    return [
        jnp.clip(k * steepness * (jnp.asarray(position) - anchor), -w * limit, w * limit)
        for w, k, anchor in zip(share, stiffness, state, strict=True)
    ]


def anchors(forces: list[Array], position: ArrayLike, yielding: ArrayLike) -> FrictionState:
    """Return the positions at which elements with these forces are unstressed; `yielding` is presliding over width."""
    return tuple(
        jnp.asarray(position) - force * (yielding / stiffness)
        for force, stiffness in zip(forces, polygon(len(forces)).stiffness.tolist(), strict=True)
    )


def play_response(
    travel: NDArray[np.float64],
    limit: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    share: NDArray[np.float64],
    *,
    side: float | NDArray[np.float64] = 0.0,
) -> NDArray[np.float64]:
    """Return the deflections [m] of play operators, shape (points, ..., elements), along many paths at once."""
    bounds = limit[..., None] * (share / stiffness)
    deflections = np.empty_like(bounds)
    deflections[0] = bounds[0] * np.asarray(side)[..., None]
    for k in range(1, len(bounds)):
        moved = deflections[k - 1] + travel[k][..., None]
        np.minimum(np.maximum(moved, -bounds[k]), bounds[k], out=deflections[k])
    return deflections


def smooth_limit(width: Any, tension: Any, xp: ModuleType) -> Any:
    """Half width A [N] of the band for B [N] at a tension [N], in NumPy or `jax.numpy`; zero for B or T below 0."""
    width = xp.maximum(width, _LEAST)
    # tanh(T/B) by one exponential, in half the time
    return width * (2 / (1 + xp.exp(xp.minimum(-2 * tension / width, 0.0))) - 1)


class Polygon(NamedTuple):
    """Shares w [-] and stiffnesses k of the elements that sum to a polygon, for a half width and an s0 of 1."""

    share: NDArray[np.float64]
    stiffness: NDArray[np.float64]


def polygon(elements: int) -> Polygon:
    """Return the polygon nearest to 1 - exp(-2 s), with knots dense where it bends and the last at height 1."""
    at = -np.log(1 - np.arange(1, elements + 1) / (elements + _KNOT))
    height = 1 - np.exp(-2 * at)
    height[-1] = 1.0
    slope = np.diff(height, prepend=0.0) / np.diff(at, prepend=0.0)
    stiffness = slope - np.append(slope[1:], 0.0)
    return Polygon(stiffness * at, stiffness)
