"""The ranges of contraction and pressure in which a law or a specimen may be trusted."""

from __future__ import annotations

from numbers import Real

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, ArrayLike, Bool

from mckibben.errors import RangeError
from mckibben.units import bar, percent


class Domain(eqx.Module):
    """A box of contraction [-] and gauge pressure [Pa]."""

    contraction_min: float | Array = -jnp.inf
    contraction_max: float | Array = jnp.inf
    pressure_min: float | Array = -jnp.inf
    pressure_max: float | Array = jnp.inf

    def __check_init__(self) -> None:
        for what, low, high in (
            ("contraction", self.contraction_min, self.contraction_max),
            ("pressure", self.pressure_min, self.pressure_max),
        ):
            if isinstance(low, Real) and isinstance(high, Real) and low > high:
                lower, upper = float(low), float(high)
                raise RangeError(
                    f"Domain: {what} from {low:g} to {high:g}", lower=lower, upper=upper, remedy="swap them"
                )

    def contains(self, contraction: ArrayLike, pressure: ArrayLike) -> Bool[Array, "..."]:
        """Whether each point lies inside, the edges included (to rounding)."""
        return self.contains_contraction(contraction) & (
            (jnp.asarray(pressure) >= self.pressure_min - 1e-3) & (jnp.asarray(pressure) <= self.pressure_max + 1e-3)
        )

    def contains_contraction(self, contraction: ArrayLike) -> Bool[Array, "..."]:
        """Whether each contraction lies inside, the edges included (to rounding)."""
        contraction = jnp.asarray(contraction)
        return (contraction >= self.contraction_min - 1e-9) & (contraction <= self.contraction_max + 1e-9)

    def describe_outside(self, contraction: ArrayLike, pressure: ArrayLike) -> str:
        """The first point outside and their number, as text; empty if there is none or they are traced.

        NaN is no point.

        >>> Domain(contraction_min=0.0).describe_outside(-0.08, np.array([1e5, 6e5]))
        '2 of 2 points, the first at contraction -8 % and pressure 1 bar, are outside contraction from 0 %'
        """
        inside = self.contains(contraction, pressure)
        if isinstance(inside, Tracer):
            return ""
        contractions, pressures, inside = np.broadcast_arrays(contraction, pressure, inside)
        outside = ~inside & ~np.isnan(contractions) & ~np.isnan(pressures)
        if not outside.any():
            return ""
        contraction, pressure = contractions[outside][0] / percent, pressures[outside][0] / bar
        point = f"contraction {contraction:.4g} % and pressure {pressure:.4g} bar"
        if outside.size > 1:
            point = f"{outside.sum()} of {outside.size} points, the first at {point},"
        return f"{point} are outside {self.bounds()}"

    def intersection(self, other: Domain) -> Domain:
        """The part that both share."""
        return Domain(
            jnp.maximum(self.contraction_min, other.contraction_min),
            jnp.minimum(self.contraction_max, other.contraction_max),
            jnp.maximum(self.pressure_min, other.pressure_min),
            jnp.minimum(self.pressure_max, other.pressure_max),
        )

    def check_contraction(self, contraction: float, of: str, remedy: str = "") -> None:
        """Raise if a contraction lies outside.

        Raises
        ------
        RangeError
            It names the value, the range, whose range it is, and the remedy.
        """
        if not bool(self.contains_contraction(contraction)):
            lower, upper = float(self.contraction_min), float(self.contraction_max)
            raise RangeError(
                f"contraction {contraction / percent:.1f} % is outside "
                f"{lower / percent:g}..{upper / percent:g} % of {of}",
                value=contraction,
                lower=lower,
                upper=upper,
                unit="1",
                remedy=remedy,
            )

    def bounds(self) -> str:
        """Only the bounds that there are, as text.

        >>> Domain(contraction_min=0.0).bounds()
        'contraction from 0 %'
        """
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
