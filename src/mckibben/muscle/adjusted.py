"""A law scaled by a factor and corrected over contraction, affine in pressure, as estimated on the joint."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from mckibben.component.base import Component
from mckibben.component.checks import check_positive
from mckibben.errors import RangeError
from mckibben.muscle.base import ForceLaw, PositiveContraction, PressureAffineLaw, pressure_for
from mckibben.muscle.specimen import Domain
from mckibben.units import Contraction, ForcePerPressure, SignedForce, Strength


class ForceCorrection(Component):
    r"""Correction of a muscle's force, affine in pressure and polynomial in contraction.

    .. math:: \Delta F = \sum_i o_i v^i + p \sum_i g_i v^i, \quad
        v = \mathrm{clip}\left(\frac{\varepsilon - \varepsilon_m}{h}, -1, 1\right)

    Parameters
    ----------
    offset, gain
        Coefficients o_i [N] and g_i [N/Pa], equal in number.
    centre, half_width
        Middle eps_m and half width h [-] of the contractions that were calibrated; the correction is constant outside.
    """

    offset: Sequence[SignedForce]
    gain: Sequence[ForcePerPressure]
    centre: Contraction
    half_width: PositiveContraction

    def __check_init__(self) -> None:
        super().__check_init__()
        if len(self.offset) != len(self.gain) or not self.offset:
            raise RangeError(
                f"ForceCorrection: {len(self.offset)} offsets and {len(self.gain)} gains",
                remedy="give equal numbers of both",
            )

    def terms(self, contraction: ArrayLike) -> tuple[Array, Array]:
        """Return offset [N] and gain [N/Pa] of the correction at a contraction [-]."""
        v = jnp.clip((jnp.asarray(contraction) - self.centre) / self.half_width, -1.0, 1.0)
        offset, gain = jnp.zeros_like(v), jnp.zeros_like(v)
        for o, g in zip(self.offset[::-1], self.gain[::-1], strict=True):
            offset, gain = offset * v + o, gain * v + g
        return offset, gain


class AdjustedLaw(ForceLaw):
    """A law multiplied by a factor, with a `ForceCorrection`; see `adjusted_law`."""

    law: ForceLaw
    domain: Domain
    strength: Strength | None = None
    correction: ForceCorrection | None = None

    equation = "F = s F_law + sum_i (o_i + g_i p) v^i"
    source = "ours"

    def force(self, contraction: ArrayLike, pressure: ArrayLike) -> Float[Array, "..."]:
        force = self.law.force(contraction, pressure)
        force = force if self.strength is None else self.strength * force
        if self.correction is None:
            return force
        offset, gain = self.correction.terms(contraction)
        return force + offset + gain * pressure

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        if self.correction is not None:
            return pressure_for(self, force, contraction)
        return self.law.pressure_for(
            jnp.asarray(force) / (1.0 if self.strength is None else self.strength), contraction
        )


class AdjustedAffineLaw(PressureAffineLaw, AdjustedLaw):
    """An `AdjustedLaw` affine in pressure."""

    def pressure_terms(self, contraction: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        assert isinstance(self.law, PressureAffineLaw)
        offset, gain = self.law.pressure_terms(contraction)
        if self.strength is not None:
            offset, gain = self.strength * offset, self.strength * gain
        if self.correction is None:
            return offset, gain
        more, steeper = self.correction.terms(contraction)
        return offset + more, gain + steeper

    def pressure_for(self, force: ArrayLike, contraction: ArrayLike) -> Float[Array, "..."]:
        of = AdjustedLaw if self.law.is_passive else PressureAffineLaw  # pressures do not move a spring
        return of.pressure_for(self, force, contraction)


def adjusted_law(
    law: ForceLaw, *, strength: ArrayLike | None = None, correction: ForceCorrection | None = None
) -> ForceLaw:
    """Return a law with its force scaled by a positive factor and then corrected; the domain is kept.

    The factor stands for scatter among muscles and ageing. `RangeError` for a factor that is not positive.

    Examples
    --------
    >>> from mckibben import catalog
    >>> law = catalog.law("lei-mas-10-180n")
    >>> correction = ForceCorrection(offset=(-20.0, 5.0), gain=(1e-5, 0.0), centre=0.1, half_width=0.05)
    >>> more = adjusted_law(law, correction=correction)
    >>> round(float(more.force(0.125, 4e5) - law.force(0.125, 4e5)), 6)  # -20 + 0.5 * 5 + 1e-5 * 4e5
    -13.5
    """
    if strength is not None:
        check_positive("adjusted_law", strength=strength)
    kind = AdjustedAffineLaw if isinstance(law, PressureAffineLaw) else AdjustedLaw
    return kind(law, law.domain.intersection(law.formula_domain), strength, correction)  # type: ignore[arg-type]
