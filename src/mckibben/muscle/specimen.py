"""Specimen data and the domain of contraction and pressure."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from numbers import Real
from typing import Annotated, Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool, Float

from mckibben.component.base import Component
from mckibben.errors import RangeError
from mckibben.numerics.elementary import polynomial
from mckibben.units import BraidAngle, Contraction, Diameter, Length, Pressure, Quantity, Tension, bar, percent

VolumeTerm = Annotated[float, Quantity("m^3", "cm^3", -1e6, 1e6)]


class Domain(Component):
    """A box of contraction [-] and gauge pressure [Pa], and within it the convex hull of measured points, if known.

    The hull is given by the contractions and pressures of its corners, counter-clockwise over these axes.
    """

    contraction_min: Contraction | Array = -jnp.inf
    contraction_max: Contraction | Array = jnp.inf
    pressure_min: Pressure | Array = -jnp.inf
    pressure_max: Pressure | Array = jnp.inf
    hull_contractions: tuple[Contraction, ...] = eqx.field(default=(), kw_only=True)
    hull_pressures: tuple[Pressure, ...] = eqx.field(default=(), kw_only=True)

    def __check_init__(self) -> None:
        super().__check_init__()
        for what, low, high in (
            ("contraction", self.contraction_min, self.contraction_max),
            ("pressure", self.pressure_min, self.pressure_max),
        ):
            if isinstance(low, Real) and isinstance(high, Real) and not low <= high:
                lower, upper = float(low), float(high)
                raise RangeError(
                    f"Domain: {what} from {low:g} to {high:g}", lower=lower, upper=upper, remedy="swap them"
                )

    def contains(self, contraction: ArrayLike, pressure: ArrayLike) -> Bool[Array, "..."]:
        """Return whether each point lies inside, edges included (to rounding)."""
        eps, p = _array(contraction), _array(pressure)
        inside = self.contains_contraction(eps) & (p >= self.pressure_min - 1e-3) & (p <= self.pressure_max + 1e-3)
        corners = list(zip(self.hull_contractions, self.hull_pressures, strict=True))
        for (eps1, p1), (eps2, p2) in zip(corners, corners[1:] + corners[:1], strict=True):
            inside = inside & ((eps2 - eps1) * (p - p1) >= (p2 - p1) * (eps - eps1) - 1e-3)
        return inside

    def contains_contraction(self, contraction: ArrayLike) -> Bool[Array, "..."]:
        """Return whether each contraction lies inside, edges included (to rounding)."""
        eps = _array(contraction)
        return (eps >= self.contraction_min - 1e-9) & (eps <= self.contraction_max + 1e-9)

    def describe_outside(self, contraction: ArrayLike, pressure: ArrayLike) -> str:
        """Describe the number of points outside and the first of them; empty for none, NaN or traced points."""
        if any(isinstance(value, Tracer) for value in (contraction, pressure, *vars(self).values())):
            return ""
        points = np.asarray(contraction), np.asarray(pressure)
        contractions, pressures, inside = np.broadcast_arrays(*points, self.contains(*points))
        outside = ~inside & ~np.isnan(contractions) & ~np.isnan(pressures)
        if not outside.any():
            return ""
        contraction, pressure = contractions[outside][0] / percent, pressures[outside][0] / bar
        point = f"contraction {contraction:.4g} % and pressure {pressure:.4g} bar"
        if outside.size > 1:
            point = f"{outside.sum()} of {outside.size} points, the first at {point},"
        return f"{point} are outside {'the measured points within ' if self.hull_pressures else ''}{self.bounds()}"

    def intersection(self, other: Domain) -> Domain:
        """Return the intersection of two domains; `RangeError` if concrete bounds do not overlap."""
        bounds = [
            _tightest(max, self.contraction_min, other.contraction_min),
            _tightest(min, self.contraction_max, other.contraction_max),
            _tightest(max, self.pressure_min, other.pressure_min),
            _tightest(min, self.pressure_max, other.pressure_max),
        ]
        if any(isinstance(a, Real) and isinstance(b, Real) and a > b for a, b in (bounds[:2], bounds[2:])):
            raise RangeError(
                f"the domains do not overlap: {self.bounds()}, and {other.bounds()}",
                remedy="give the law, or the limits, a domain inside the specimen's",
            )
        if (
            all(bound is bound_here for bound, bound_here in zip(bounds, vars(self).values(), strict=False))
            and not other.hull_pressures
        ):
            return self
        of = self if self.hull_pressures else other
        return Domain(*bounds, hull_contractions=of.hull_contractions, hull_pressures=of.hull_pressures)

    def filled(self, other: Domain) -> Domain:
        """Return the domain with infinite bounds replaced by the bounds of another."""
        missing = [name for name, bound in vars(self).items() if isinstance(bound, Real) and abs(bound) == float("inf")]  # type: ignore
        return dataclasses.replace(self, **{name: getattr(other, name) for name in missing}) if missing else self

    def check_contraction(self, contraction: float, owner: str, remedy: str = "") -> None:
        """Raise `RangeError` with value, range and remedy if a contraction lies outside."""
        if not bool(self.contains_contraction(contraction)):
            lower, upper = float(self.contraction_min), float(self.contraction_max)
            value = contraction / percent
            texts = (f"{value:.{digits}f}" for digits in range(1, 9))  # as many as show that it is outside
            number = next((text for text in texts if not self.contains_contraction(float(text) * percent)), f"{value}")
            message = f"contraction {number} % is outside {lower / percent:g}..{upper / percent:g} % of {owner}"
            raise RangeError(message, value=contraction, lower=lower, upper=upper, unit="1", remedy=remedy)

    def bounds(self) -> str:
        """Return the finite bounds as text."""
        texts = []
        for what, low, high, unit, scale in (
            ("contraction", self.contraction_min, self.contraction_max, "%", percent),
            ("pressure", self.pressure_min, self.pressure_max, "bar", bar),
        ):
            lower = f" from {low / scale:g} {unit}" if low > -jnp.inf else ""
            upper = f" to {high / scale:g} {unit}" if high < jnp.inf else ""
            texts += [f"{what}{lower}{upper}"] if lower or upper else []
        return ", ".join(texts) or "everything"

    def __str__(self) -> str:
        return (
            f"contraction {self.contraction_min / percent:g}..{self.contraction_max / percent:g} %, "
            f"pressure {self.pressure_min / bar:g}..{self.pressure_max / bar:g} bar"
        )


def _array(value: ArrayLike) -> Any:
    """Array; a NumPy array, which compares without compiling, unless the value is a JAX array."""
    return value if isinstance(value, Array) else np.asarray(value)


def _tightest(pick: Callable[..., Any], limit: float | Array, other: float | Array) -> float | Array:
    if isinstance(limit, Real) and isinstance(other, Real):
        return pick(limit, other)
    module: Any = jnp if isinstance(limit, Array) or isinstance(other, Array) else np  # NumPy compiles nothing
    return (module.maximum if pick is max else module.minimum)(limit, other)


class Specimen(Component):
    """Dimensions and ratings of a muscle; only the length is required, unless a law or a result needs more.

    Parameters
    ----------
    name
        Manufacturer's designation, or any other name.
    initial_length, initial_diameter, braid_angle
        l0 and d0 [m], and alpha0 [rad] between thread and axis, of the deflated, unloaded muscle. Chou's law (Eq. 1)
        and the volume, which determines air consumption, need diameter and angle. Default: unknown.
    rated_force
        Highest permissible force [N]. Default: none.
    domain
        Permissible contraction [-] and gauge pressure [Pa]. A `Muscle` replaces infinite bounds by the law's domain.
    volume_terms
        Coefficients c0, c1, ... [m^3] of a measured volume c0 + c1 e + c2 e^2 + ... over the contraction e. Default:
        the volume of the braid.

    Examples
    --------
    >>> from mckibben.units import bar, mm
    >>> specimen = Specimen("my muscle", 300 * mm, domain=Domain(pressure_max=6 * bar))
    >>> round(float(specimen.contraction_at(270 * mm)), 3)
    0.1
    >>> specimen.volume(0.1)
    Traceback (most recent call last):
        ...
    mckibben.errors.RangeError: the volume of my muscle needs its initial_diameter and braid_angle; give ...
    """

    name: str = eqx.field(static=True)
    initial_length: Length
    initial_diameter: Diameter | None = None
    braid_angle: BraidAngle | None = None
    rated_force: Tension | None = None
    domain: Domain = Domain()
    volume_terms: tuple[VolumeTerm, ...] | None = None

    def __repr__(self) -> str:
        return f"Specimen({self.name})"

    @property
    def force_limit(self) -> float:
        """Rated force [N]; infinite without one."""
        return float("inf") if self.rated_force is None else self.rated_force

    @property
    def known_force_limit(self) -> float:
        """Rated force [N]; `RangeError` without one."""
        if self.rated_force is None:
            remedy = "give the specimen its rated_force, or a limit of the force, such as `force: 200 N`"
            raise RangeError(f"{self.name} has no rated force", field="force", remedy=remedy)
        return self.rated_force

    @property
    def has_volume(self) -> bool:
        """Whether the volume is known: as a polynomial, or from diameter and angle of the braid."""
        if self.volume_terms is not None:
            return True
        return self.initial_diameter is not None and self.braid_angle is not None

    def braid(self, what: str) -> tuple[float, float]:
        """Return diameter [m] and angle [rad] of the braid; `RangeError` says that `what` needs them if unknown."""
        if self.initial_diameter is None or self.braid_angle is None:
            names = [name for name in ("initial_diameter", "braid_angle") if getattr(self, name) is None]
            missing = " and ".join(names)
            remedy = f"give the specimen its {missing}, or volume_terms, which `mckibben identify --inner` estimates"
            raise RangeError(f"{what} of {self.name} needs its {missing}", field=names[0], remedy=remedy)
        return self.initial_diameter, self.braid_angle

    def check_volume(self, what: str) -> None:
        """Raise `RangeError`, naming the quantity that needs it, if the volume is unknown."""
        if not self.has_volume:
            self.braid(what)

    def contraction_at(self, length: ArrayLike) -> Float[Array, "..."]:
        """Return the contraction (l0 - l)/l0 [-] at a length [m]."""
        return 1 - jnp.asarray(length) * (1 / self.initial_length)  # a product is faster in loops than a quotient

    def length_at(self, contraction: ArrayLike) -> Float[Array, "..."]:
        """Return the length [m] at a contraction [-]."""
        return self.initial_length * (1 - jnp.asarray(contraction))

    def volume(self, contraction: ArrayLike) -> Float[Array, "..."]:
        r"""Return the volume [m^3], measured (`volume_terms`) or inside the braid, a cylinder of inextensible thread.

        .. math::

            V = \frac{\pi d_0^2 l_0}{4} (1-\varepsilon) \frac{1 - \cos^2\alpha_0 (1-\varepsilon)^2}{\sin^2\alpha_0}

        The virtual work of the braid's volume, F = -p dV/dl, is Chou's law (Eq. 1). Raises `RangeError` if the volume
        is not known.
        """
        if self.volume_terms is not None:
            return polynomial(jnp.asarray(contraction), self.volume_terms)
        initial_diameter, braid_angle = self.braid("the volume")
        ratio = 1 - jnp.asarray(contraction)
        cylinder = jnp.pi * initial_diameter**2 * self.initial_length / 4
        widening = (1 - jnp.cos(braid_angle) ** 2 * ratio**2) / jnp.sin(braid_angle) ** 2
        return cylinder * ratio * widening
